"""The rows of the result tables: LFCA's method, its baselines and ablations, and ours, as changes of one preset.

A row changes nothing but what it is named after, so that any preset can be run as any row. LFCA does not say what its
ablations have in common; here those of coupling are without decoupling refinement, like its row "w/o DR".
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from refine.decoupling import PAPER, DecouplingConfig, default_for
from renderers.checks import UserError, check_known
from train.config import GeneratorTraining


@dataclass(frozen=True)
class Variant:
    """One row."""

    about: str
    change: Callable[[GeneratorTraining], GeneratorTraining]
    published: str | None = None
    """The name of the row that LFCA prints."""
    plain: bool = False
    """It looks at plain silhouettes, and needs an inpainter of these."""


def changed(config: GeneratorTraining, **groups: dict[str, Any]) -> GeneratorTraining:
    """The configuration with some fields of its parts replaced, as ``data={"lam": "half"}``."""
    return replace(config, **{name: replace(getattr(config, name), **fields) for name, fields in groups.items()})


def plain(**groups: dict[str, Any]) -> Callable[[GeneratorTraining], GeneratorTraining]:
    """Without decoupling refinement, and with some fields replaced."""
    return lambda config: changed(config, **groups, loss={"decoupling": 0.0}, shares={"looks": 0})


def looking(config: GeneratorTraining, decoupling: DecouplingConfig) -> GeneratorTraining:
    """The configuration with another way of looking, at the precision that it has."""
    return replace(config, decoupling=replace(decoupling, precision=config.decoupling.precision))


VARIANTS: dict[str, Variant] = {
    "pretrain-mask": Variant(
        "ACTOR, trained on single actions; two of its motions are coupled by Eq. 3.",
        plain(data={"pairs": "single"}),
        "Pre-train+Mask",
    ),
    "disentanglement": Variant("Lambda is always a half.", plain(data={"lam": "half"}), "Latent Disentanglement"),
    "without-mask": Variant("Every part is blended by lambda alone.", plain(coupling={"mask": False}), "w/o Mask"),
    "without-gaussian": Variant("Lambda from U(0, 1).", plain(data={"lam": "uniform"}), "w/o Gaussian"),
    "all-classes": Variant("All pairs of different actions.", plain(data={"pairs": "all"}), "full class"),
    "without-dr": Variant("LFCA without decoupling refinement.", plain(), "w/o DR"),
    "dr-paper": Variant(
        "LFCA's decoupling refinement as published: of generated motions, plain silhouettes from one camera.",
        lambda config: looking(changed(config, shares={"looks": 0}), PAPER),
        "w/ DR",
        plain=True,
    ),
    "dr-plain": Variant(
        "Ours on plain silhouettes, in which no action owns a part.",
        lambda config: looking(config, replace(default_for(1), pinned="sequence")),
        plain=True,
    ),
    "dr-generated": Variant(
        "Ours, of generated motions alone: the pseudo-compositions stay as Eq. 3 makes them.",
        lambda config: changed(config, shares={"looks": 0}),
    ),
    "dr-shares": Variant(
        "Ours, of the pseudo-compositions' shares alone.", lambda config: changed(config, loss={"decoupling": 0.0})
    ),
    "dr-one-camera": Variant(
        "Ours, seen from the front alone.", lambda config: changed(config, decoupling={"views": (0.0,)})
    ),
    "with-dr": Variant(
        "Ours: decoupling refinement of the pseudo-compositions' shares and of generated motions, from two sides.",
        lambda config: config,
    ),
}


def as_variant(config: GeneratorTraining) -> GeneratorTraining:
    """The configuration as the row that it names, if it names one.

    Raises:
        UserError: there is no such row, or it needs an MAE that is not given.
    """
    if not config.variant:
        return config
    check_known("--variant", config.variant, VARIANTS)
    variant = VARIANTS[config.variant]
    if variant.plain and config.mae is None:
        problem = "looks at plain silhouettes, and the MAE that comes with the package knows parts"
        remedy = (
            "train one with `refine train mae plain --out runs/mae-plain` and add --mae runs/mae-plain/best.safetensors"
        )
        raise UserError(f"--variant {config.variant}", problem, remedy)
    return variant.change(config)
