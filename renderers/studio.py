"""Still pictures of bodies as in a photographer's studio, through Mitsuba: a large soft light, a sky, a seamless floor.

The light comes from infinitely far, so that every spot of the floor that no body shades is equally bright and shows the
palette's background: there is no horizon. Bodies and floor are rendered one after the other, each by its direct light
alone, with what the floor throws back at bodies as light from below; paths took as long for three times the noise in
the shadows.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import cos, inf, pi, radians, sin
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from renderers import mitsuba_scene
from renderers.camera import Camera
from renderers.checks import UserError, check_finite, check_range, check_shapes
from renderers.palette import BACKGROUND, rgb
from renderers.silhouette import blur

STRIPES = 16  # parts of a picture that are rendered one after the other
MAP = 128  # rows of the map of light; one is 1.4 degrees
FLOOR = 1000.0  # metres from its middle to its sides
SMOOTHING = 1.2  # pixels over which the noise of shadows on the floor is evened out
UP = torch.tensor([0.0, 1.0, 0.0])


@dataclass(frozen=True)
class Studio:
    """How a picture is lit, and how carefully it is rendered.

    Attributes:
        samples: rays a pixel to the bodies, stratified; half as many to the floor.
        azimuth: degrees by which the large light stands to the left of the camera.
        altitude: degrees by which it stands above the horizon.
        spread: radians at which it has fallen off like a Gaussian; the larger, the softer the shadows.
        sky: share of the sky in what reaches the floor; the light has the rest.
        bounce: share of that which the floor throws back at bodies.
        fade: metres around the bodies over which shadows on the floor fade away.
        seed: of the rays.
    """

    samples: int = 100
    azimuth: float = 28.0
    altitude: float = 50.0
    spread: float = 0.11
    sky: float = 0.32
    bounce: float = 0.45
    fade: float = 1.0
    seed: int = 0

    def __post_init__(self):
        check_range(self, 1, 65536, "samples")
        check_range(self, -180, 180, "azimuth")
        check_range(self, 10, 90, "altitude")
        check_range(self, 0.02, 1, "spread")
        check_range(self, 0.01, 0.99, "sky")
        check_range(self, 0, 1, "bounce")
        check_range(self, 0.01, inf, "fade")
        check_range(self, 0, 2**32 - 1, "seed")


def studio(
    vertices: Tensor,
    faces: Tensor,
    colours: Tensor,
    camera: Camera,
    config: Studio | None = None,
    progress: Callable[[], None] = lambda: None,
) -> Tensor:
    """Pictures of closed meshes on a floor, with the arguments of `shade`.

    The same seed gives the same picture, up to the order in which sums are rounded.

    Args:
        vertices: [N V 3] metres, y up. The floor is y = 0, or lies under the lowest vertex if that is lower; it is left
            out for a camera that does not look down on it.
        faces: [F 3]; several bodies of one picture are one mesh.
        colours: [V 3] sRGB in 0..1.
        camera: N views, or one for all, of square pixels.
        progress: is called `STRIPES` times a picture.

    Returns:
        [N 3 H W] float, sRGB in 0..1.

    Raises:
        UserError: shapes that do not fit, values that are not finite, or a camera with two focal lengths.
    """
    config = config or Studio()
    check_shapes("studio", vertices=(vertices, "N V 3"), faces=(faces, "F 3"), colours=(colours, "V 3"))
    check_finite("studio(vertices)", vertices, "frame vertex coordinate")
    if len(camera) not in (1, len(vertices)):
        raise UserError("studio", f"{len(camera)} cameras do not fit {len(vertices)} pictures")
    if (camera.focal[:, 0] != camera.focal[:, 1]).any():
        raise UserError("studio(camera)", "expected one focal length for both axes", "give it square pixels")
    vertices, camera = vertices.detach().cpu().float(), camera.to("cpu", torch.float32)
    albedo = _linear(colours.cpu().float().clamp(0, 1))
    views = [camera[k : k + 1] if len(camera) > 1 else camera for k in range(len(vertices))]
    return torch.stack(
        [_picture(body, faces, albedo, view, config, progress) for body, view in zip(vertices, views, strict=True)]
    )


def _picture(
    body: Tensor, faces: Tensor, albedo: Tensor, camera: Camera, config: Studio, progress: Callable[[], None]
) -> Tensor:
    ground = min(0.0, body[:, 1].min().item())
    near = _nearness(body, camera, ground, config.fade)
    films = torch.zeros(2, *camera.size, 4)
    coarser = replace(config, samples=-(-config.samples // 2))  # shadows are smoothed afterwards
    with mitsuba_scene.using() as mi, _silent(mi):
        layers = _layers(mi, body, faces, albedo, camera, ground, config)
        for top, bottom in _stripes(camera.size[0]):
            films[0, top:bottom] = _exposed(mi, layers[0], body, camera, config, top, bottom)
            if near[top:bottom].any():
                films[1, top:bottom] = _exposed(mi, layers[1], body, camera, coarser, top, bottom)
            progress()
    bodies, floor = films
    clear = 1 - bodies[..., 3]
    # How much of the light arrives at the floor, evened out over the pixels that show it.
    arrives, seen = blur(torch.stack([floor[..., :3].mean(-1) + 1 - floor[..., 3], clear])[:, None], SMOOTHING)[:, 0]
    lit = torch.lerp(torch.ones_like(seen), arrives / seen.clamp(min=1e-3), near)
    background = _linear(torch.tensor(rgb(BACKGROUND)))
    return _developed(bodies[..., :3] + (clear * lit)[..., None] * background, background.max())


@contextmanager
def _silent(mi: Any) -> Iterator[None]:
    """Keeps Mitsuba from having a word of its own to say on Ctrl-C."""
    level = mi.log_level()
    mi.set_log_level(mi.LogLevel.Error)
    try:
        yield
    finally:
        mi.set_log_level(level)


def _layers(
    mi: Any, body: Tensor, faces: Tensor, albedo: Tensor, camera: Camera, ground: float, config: Studio
) -> tuple[list[Any], list[Any]]:
    """The bodies, and a white floor that they hide and shade; of either, a scene for each of the two lights.

    The lamp is sampled by where it shines from, the sky by where the surface looks to: so both have little noise.
    """
    lamp, sky = {"emitter_samples": 1, "bsdf_samples": 0}, {"emitter_samples": 0, "bsdf_samples": 1}
    white = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}}
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
    coloured = {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}}
    lying = mi.ScalarTransform4f().translate([0.0, ground, 0.0]).rotate([1, 0, 0], -90).scale(FLOOR)
    bodies = {"body": mitsuba_scene.mesh(body, faces, {"type": "twosided", "bsdf": coloured}, None, albedo, True)}
    floor = {
        "body": mitsuba_scene.mesh(body, faces, black),
        "floor": {"type": "rectangle", "to_world": lying, "bsdf": white},
    }
    shine = _lamp(camera, config)
    return (
        [_scene(mi, shine, lamp, bodies), _scene(mi, _sky(config, config.bounce), sky, bodies)],
        [_scene(mi, shine, lamp, floor), _scene(mi, _sky(config, 0.0), sky, floor)],
    )


def _scene(mi: Any, light: Tensor, sampling: dict[str, int], shapes: dict[str, Any]) -> Any:
    light = mi.Bitmap(light[..., None].expand(-1, -1, 3).contiguous().numpy())
    integrator = {"type": "direct", "hide_emitters": True, **sampling}
    return mi.load_dict(
        {"type": "scene", "integrator": integrator, "light": {"type": "envmap", "bitmap": light}, **shapes}
    )


def _exposed(mi: Any, layer: list[Any], body: Tensor, camera: Camera, config: Studio, top: int, bottom: int) -> Tensor:
    """Linear RGB of all light, and coverage, of some rows [h W 4]."""
    sensor = mitsuba_scene.sensor(camera, body, config.samples, "gaussian", (top, 0, bottom - top, camera.size[1]))
    seed = (config.seed * camera.size[0] + top) % 2**32
    lamp, sky = (torch.from_numpy(np.array(mi.render(scene, sensor=sensor, seed=seed))) for scene in layer)
    return torch.cat([lamp[..., :3] + sky[..., :3], lamp[..., 3:]], dim=-1)


def _stripes(height: int) -> list[tuple[int, int]]:
    return [(height * k // STRIPES, height * (k + 1) // STRIPES) for k in range(STRIPES)]


def _developed(light: Tensor, knee: Tensor) -> Tensor:
    """Linear [H W 3] -> sRGB [3 H W]; true up to the knee, what is brighter approaches white."""
    bright = (light - knee).clamp(min=0)
    light = light.clamp(min=0).minimum(knee) + (1 - knee) * (1 - torch.exp(-bright / (1 - knee)))
    curve = 1.055 * light.clamp(min=1e-4) ** (1 / 2.4) - 0.055
    return torch.where(light < 0.0031308, 12.92 * light, curve).permute(2, 0, 1)


def _linear(colour: Tensor) -> Tensor:
    return torch.where(colour < 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)


def _lamp(camera: Camera, config: Studio) -> Tensor:
    """Radiance [MAP, 2 MAP] of the large light, which turns with the camera; a white floor would have 1 - sky."""
    right = normalize(camera.rotation[0, 0] * (1 - UP), dim=0)
    azimuth, altitude = radians(config.azimuth), radians(config.altitude)
    across = cos(azimuth) * torch.linalg.cross(right, UP) - sin(azimuth) * right
    direction, onto_floor = _directions()
    shine = torch.exp((direction @ (cos(altitude) * across + sin(altitude) * UP) - 1) / config.spread**2)
    return shine * (1 - config.sky) * pi / (shine * onto_floor).sum()


def _sky(config: Studio, below: float) -> Tensor:
    """Radiance [MAP, 2 MAP] of a sky that is brightest in the zenith, and ``below`` the horizon."""
    direction, onto_floor = _directions()
    up = direction[..., 1]
    return torch.where(up > 0, up * config.sky * pi / (up * onto_floor).sum(), below)


def _directions() -> tuple[Tensor, Tensor]:
    """World directions [MAP, 2 MAP, 3] of Mitsuba's map of light, and what one of radiance 1 sends to the floor.

    Its rows go from pole to pole, and its columns from -z over +x, which begin half a column late.
    """
    down = torch.linspace(0, pi, MAP)[:, None]
    around = (torch.arange(2 * MAP)[None] + 0.5) * (pi / MAP)
    direction = torch.stack([down.sin() * around.sin(), down.cos().expand(-1, 2 * MAP), -down.sin() * around.cos()], -1)
    return direction, direction[..., 1].clamp(min=0) * down.sin() * pi / (MAP - 1) * pi / MAP


def _nearness(body: Tensor, camera: Camera, ground: float, fade: float) -> Tensor:
    """1 where a pixel sees the floor under the bodies, 0 from ``fade`` metres around them, [H W]; 0 from below."""
    height, width = camera.size
    x, y = torch.meshgrid(torch.arange(width) + 0.5, torch.arange(height) + 0.5, indexing="xy")
    (focal, _), (cx, cy) = camera.focal[0].tolist(), camera.centre[0].tolist()
    x, y, zero, one = (x - cx) / focal, (y - cy) / focal, torch.zeros_like(x), torch.ones_like(x)
    eye, ray = ([zero, zero, zero], [x, y, one]) if camera.kind == "pinhole" else ([x, y, zero], [zero, zero, one])
    eye = (torch.stack(eye, -1) - camera.translation[0]) @ camera.rotation[0]
    ray = torch.stack(ray, -1) @ camera.rotation[0]
    spot = eye + ((ground - eye[..., 1:2]) / ray[..., 1:2]) * ray
    low, high = body.amin(0), body.amax(0)
    outside = torch.maximum(low - spot, spot - high)[..., [0, 2]].clamp(min=0).norm(dim=-1) / fade
    return torch.where(ray[..., 1] < 0, (1 - outside.clamp(max=1) ** 2) ** 2, 0.0)
