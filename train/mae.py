"""The training program of the inpainting MAE, and how well it inpaints."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from refine.mae import MAE, load_mae
from refine.patches import patchify
from refine.seeing import mesh_to_draw
from renderers.body import Body
from renderers.checks import UserError
from train.checkpoints import hash_motions, provenance
from train.config import MAETraining
from train.data import open_source, split
from train.loop import check_device, fit, open_run, seed_of
from train.pictures import Pictures, Poses, draw_pictures, poses_of
from train.steps import inpainting_terms, mae_step


def train_mae(config: MAETraining) -> Path:
    """Run the whole program and return the path of the best weights, which ``refine.mae.load_mae`` reads.

    Raises:
        UserError: see ``open_run``, ``open_source`` and ``fit``.
    """
    check_device(config.device)
    body = Body.free("light").to(config.device)
    rest_joints = body.rest_joints.cpu()
    source = open_source(config.data, rest_joints)
    config, motions = replace(config, data=source.config), source.clips
    train, test = split(motions, config.data.held_out, config.data.seed)
    mae, start = first_weights(config)
    mae = mae.to(config.device)
    open_run(config.out, config, config.resume)
    record = {
        "provenance": provenance(config.loop.seed, hash_motions(motions)),
        "data": {"source": config.data.source, "clips": len(train), "held_out_clips": len(test)},
        "pictures": config.pictures,
        "start": start,
    }
    draw = drawing(body, config)
    poses, unseen = (
        Poses(*(value.to(config.device) for value in poses_of(clips, rest_joints, config.pictures.pinned)))
        for clips in (train, test)
    )
    mean = draw(poses, 512, torch.Generator().manual_seed(1)).images.mean(0)
    held_out = draw(unseen, config.measured, torch.Generator().manual_seed(2))
    half = torch.autocast(torch.device(config.device).type, torch.bfloat16, config.precision == "bfloat16")

    def losses(_: int, random: torch.Generator) -> Iterator[dict[str, Tensor]]:
        pictures = draw(poses, config.batch, random)
        with half:
            terms = mae_step(pictures, mae, config.body_weight)
        yield terms

    return fit(
        mae,
        losses,
        config.loop,
        config.out,
        "mae",
        record,
        lambda: measure(mae, held_out, mean, config.body_weight),
        config.resume,
    )


def first_weights(config: MAETraining) -> tuple[MAE, dict | None]:
    """The network to train, and the description of the weights that it starts from.

    Raises:
        UserError: the weights cannot be read, or are of another network than the configuration's.
    """
    if config.start is None:
        with torch.random.fork_rng():
            torch.manual_seed(seed_of(config.loop.seed))
            return MAE(config.network), None
    mae = load_mae(config.start).requires_grad_(True)
    if mae.config != config.network:
        raise UserError(config.start, f"holds {mae.config}", f"give the same network, not {config.network}")
    described = config.start.with_suffix(".json")
    return mae, json.loads(described.read_text()) if described.is_file() else {"official": config.start.name}


def drawing(body: Body, config: MAETraining):
    """(poses, count, random) -> Pictures, as the configuration wants them."""
    mesh = mesh_to_draw(body, config.pictures.pinned, config.network.channels)

    def draw(poses: Poses, count: int, random: torch.Generator) -> Pictures:
        return draw_pictures(poses, count, body, mesh, config.network, config.pictures, random)

    return draw


@torch.no_grad()
def measure(mae: MAE, pictures: Pictures, mean: Tensor, body_weight: float) -> dict[str, float]:
    """``inpainting_terms`` of the MAE on whole pictures, and those of two inpainters that know nothing of bodies.

    Args:
        mean: [C H W] the mean picture of the training poses.

    Returns:
        ``total``, ``hidden`` and ``body`` of the MAE, and those of the baselines, named ``mean_*`` (every hidden patch
        as in the mean picture) and ``nearest_*`` (as the nearest visible patch).
    """
    images, kept = pictures.images, pictures.kept
    patch, hidden = mae.config.patch, ~kept[..., None].expand(-1, -1, images.shape[1])
    filled = {
        "": torch.cat([mae(*part) for part in zip(images.split(64), kept.split(64), strict=True)]),
        "mean_": patchify(mean[None], patch).expand(len(images), -1, -1),
        "nearest_": fill_from_nearest(patchify(images, patch), kept),
    }
    return {
        f"{prefix}{name}": float(value)
        for prefix, patches in filled.items()
        for name, value in inpainting_terms(patches, images, hidden, patch, body_weight).items()
    }


def fill_from_nearest(patches: Tensor, kept: Tensor) -> Tensor:
    """Patches [N P D] of a square grid, each replaced by the nearest one that is kept [N P] (of equals the first)."""
    side = round(patches.shape[1] ** 0.5)
    at = torch.cartesian_prod(torch.arange(side), torch.arange(side)).to(patches)
    distance = torch.cdist(at, at).expand(len(kept), -1, -1).masked_fill(~kept[:, None], torch.inf)
    return patches.gather(1, distance.argmin(-1)[..., None].expand(-1, -1, patches.shape[-1]))
