"""The training program of the generator."""

from pathlib import Path

import torch

from refine.decoupling import Decoupler
from refine.generator import Generator, GeneratorConfig
from refine.mae import load_mae
from renderers.body import Body
from renderers.checks import UserError
from train.checkpoints import hash_motions, provenance, read_weights
from train.config import GeneratorTraining
from train.data import Pairs, draw_pairs, group, load_clips_for, pair_labels, split
from train.loop import check_device, fit, open_run, seed_of
from train.steps import generator_step

SIZES = {"tiny": GeneratorConfig.tiny, "paper": GeneratorConfig.paper}


def train_generator(config: GeneratorTraining) -> Path:
    """Run the whole program and return the path of the best weights, which ``load_generator`` reads.

    Raises:
        UserError: see ``open_run``, ``load_clips_for``, ``load_mae`` and ``fit``.
    """
    check_device(config.device)
    body = Body.free("light").to(config.device)
    motions = load_clips_for(config.data, body.rest_joints.cpu())
    train, test = (group(clips) for clips in split(motions, config.data.held_out, config.data.seed))
    classes = tuple(train)
    pairs = pair_labels(config.data, classes)
    decoupler = (
        Decoupler(body, load_mae(config.mae).to(config.device), config.decoupling) if config.loss.decoupling else None
    )
    open_run(config.out, config, config.resume)
    record = {
        "provenance": provenance(config.loop.seed, hash_motions(motions)),
        "data": {"source": config.data.source, "clips": sum(map(len, train.values())), "pairs": len(pairs)},
        "loss": config.loss,
    }
    with torch.random.fork_rng():
        torch.manual_seed(seed_of(config.loop.seed))
        generator = Generator(SIZES[config.size](classes, config.data.fps)).to(config.device)
    held_out = draw_pairs(test, pairs, config.measured, config.data, torch.Generator().manual_seed(2))

    def losses(batch: Pairs, random: torch.Generator) -> dict[str, torch.Tensor]:
        batch = Pairs(*(value.to(config.device) for value in batch))
        return generator_step(batch, generator, body.rest_joints, decoupler, config.loss, config.coupling, random)

    return fit(
        generator,
        lambda _, random: losses(draw_pairs(train, pairs, config.batch, config.data, random), random),
        config.loop,
        config.out,
        "generator",
        record,
        lambda: {name: float(value) for name, value in losses(held_out, torch.Generator().manual_seed(3)).items()},
        config.resume,
    )


def load_generator(path: str | Path) -> Generator:
    """A trained generator in evaluation mode.

    Args:
        path: a ``.safetensors`` with its ``.json`` beside, or a run folder, whose best weights are taken.

    Raises:
        UserError: missing or damaged files, or the weights of something else.
    """
    path = Path(path)
    path = path / "best.safetensors" if path.is_dir() else path
    tensors, description = read_weights(path, "generator")
    try:
        stored = description["config"]
        generator = Generator(GeneratorConfig(**stored | {"classes": tuple(stored["classes"])}))
        generator.load_state_dict(tensors)
    except (KeyError, TypeError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise UserError(path, f"does not fit its description ({reason})", "train it again") from error
    return generator.eval().requires_grad_(False)
