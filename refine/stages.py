"""The stages of the loss for one picture of a trace, as pictures for people."""

import torch
from torch import Tensor

from refine.composition import Composition
from refine.decoupling import Trace
from refine.seeing import COLOURED
from renderers.images import (
    contact_sheet,
    difference_picture,
    enlarged,
    heat_map,
    kept_patches,
    part_picture,
    with_joints,
)
from renderers.skeleton import DRAWN_PART_NAMES

STAGES = (
    "sub-action",
    "composition",
    "energies",
    "attention",
    "kept patches",
    "inpainted",
    "difference",
    "what counts of it",
)
NOTES = (
    "All bodies: one camera, one scale, place and heading taken out. Left arm red, right arm green, left leg {leg}, "
    "right leg blue.",
    "Energies: the larger and darker, the more the part moves, relative to this action's busiest. "
    "Attention: the darker, the more a pixel belongs to the action; each picture has its own scale.",
    "Kept patches: what the inpainting network sees, without the parts that are the other action's; hatched is hidden. "
    "Inpainted: those patches of the composition, the rest completed.",
    "Difference: red where inpainted has more, blue where the sub-action has more. "
    "What counts: the difference in the parts that this action answers for; its square is the loss.",
)


def stage_pictures(trace: Trace, index: int, factor: int = 1) -> list[list[Tensor]]:
    """Every stage of the loss for picture ``index`` of a trace: for each sub-action one picture [3 H W] a stage.

    ``factor`` enlarges the loop's own small pictures.
    """
    composed = trace.composed.pictures[index]
    whole = enlarged(visible(composed), factor)
    rows = []
    for reference, answer in zip(trace.references, trace.sides, strict=True):
        answers, shown = (value[index].cpu() for value in reference.owned)
        own, inpainted = reference.seen.pictures[index], answer.inpainted[index].clamp(0, 1)
        own_picture = enlarged(visible(own), factor)
        weigh = answers.sqrt()[:, None, None].to(own)
        patches = round(answer.kept.shape[1] ** 0.5)
        rows.append(
            [
                own_picture,
                whole,
                with_joints(own_picture, reference.seen.joints_px[index], reference.energies[index], factor),
                heat_map(whole, answer.attention[index].sqrt()),
                kept_patches(
                    enlarged(visible(composed.cpu() * shown[:, None, None]), factor),
                    answer.kept[index].reshape(patches, patches),
                ),
                enlarged(visible(inpainted), factor),
                enlarged(difference_picture(inpainted, own), factor),
                enlarged(difference_picture(*(picture * weigh for picture in (inpainted, own))), factor),
            ]
        )
    return rows


def stage_sheet(trace: Trace, index: int, names: tuple[str, str], title: str = "", side: int = 192) -> Tensor:
    """Every stage of the loss for picture ``index`` of a trace: one row a sub-action, one column a stage [3 H W].

    Args:
        side: pixels of each picture; the loop's own are enlarged by a whole number.
    """
    factor = max(1, side // trace.composed.pictures.shape[-1])
    captions = []
    for name, reference, answer in zip(names, trace.references, trace.sides, strict=True):
        owned = answers_for(reference.owned.answers[index].cpu())
        captions.append(f"{name}: loss {float(answer.loss[index]):.6f}{owned}")
    rows = stage_pictures(trace, index, factor)
    leg = "purple" if trace.composed.pictures.shape[1] == COLOURED else "orange"
    return contact_sheet(rows, captions, STAGES, title, notes=[NOTES[0].format(leg=leg), *NOTES[1:]])


def stage_sheets(composition: Composition, frames: int) -> dict[str, Tensor]:
    """``stage_sheet`` of evenly spread frames in the first view, of every motion, by file name."""
    names = (composition.i.label or "i", composition.j.label or "j")
    length, fps = len(composition.motion), composition.motion.fps
    shown = torch.linspace(0, length - 1, min(frames, length)).round().long().tolist()
    sheets = {}
    for frame in shown:
        for made, trace in composition.traces().items():
            index = frame * len(trace.composed.pictures) // length
            title = f"{made} motion at {frame / fps:.2f} s, first view"
            sheets[f"stages-{frame:04d}-{made}"] = stage_sheet(trace, index, names, title)
    return sheets


def visible(picture: Tensor) -> Tensor:
    """A picture of the loop [C H W] as one for people [3 H W]; one in colours is that already."""
    return picture if len(picture) == COLOURED else part_picture(picture)


def answers_for(answers: Tensor) -> str:
    """In words, the share of each drawn part [C] that an action answers for; nothing where parts have no channels."""
    if len(answers) != len(DRAWN_PART_NAMES):
        return ""
    shares = zip(DRAWN_PART_NAMES, answers.tolist(), strict=True)
    named = [f"{name.replace('_', ' ')} {share:.0%}" for name, share in shares if share >= 0.05]
    return f", answers for {', '.join(named) or 'no part'}"
