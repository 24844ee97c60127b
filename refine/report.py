"""What the loop did, as numbers, pictures and one page that opens from disk."""

import base64
import html
import json
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from refine.composition import Composition
from refine.decoupling import Trace
from refine.drawing import strip
from renderers.body import Body
from renderers.images import (
    chart,
    contact_sheet,
    difference_picture,
    enlarged,
    heat_map,
    kept_patches,
    part_picture,
    save_png,
    with_joints,
)
from renderers.skeleton import PARTS

STAGES = ("sub-action", "composition", "joints, energies", "attention", "kept patches", "inpainted", "difference")
UNIT = "mean squared joint step relative to the pelvis, m² per frame²"

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 76rem; padding: 0 1rem;
       background: #f7f5f0; color: #2b2d42 }
img { max-width: 100%; display: block; margin: 1rem 0 }
td, th { padding: .1rem 1rem .1rem 0; text-align: right }
th:first-child { text-align: left }
pre { overflow: auto; background: #fff; padding: 1rem }
"""


def measure(composition: Composition) -> dict[str, Any]:
    """Energies per part, weights, and loss terms before and after, as plain JSON values."""
    coupling = composition.coupling
    report = {
        "sub_actions": [
            {"label": clip.label, "source": clip.source, "frames": len(clip), "fps": clip.fps}
            for clip in (composition.i, composition.j)
        ],
        "energies": {"unit": UNIT, "i": by_part(coupling.energies_i), "j": by_part(coupling.energies_j)},
        "share_of_i": {**by_part(coupling.weights), "root": round(float(coupling.weights[0]), 6)},
    }
    if composition.before and composition.after:
        report["decoupling_loss"] = {"coupled": losses(composition.before), "refined": losses(composition.after)}
    if composition.history:
        terms = {name: values for name, values in composition.history.items() if values}
        report["refinement"] = {
            "steps": len(terms["total"]),
            "first_step": {name: values[0] for name, values in terms.items()},
            "last_step": {name: values[-1] for name, values in terms.items()},
        }
    return report


def by_part(of_joints: Tensor) -> dict[str, float]:
    """[24] values that are equal within a part -> one a part."""
    return {part: float(f"{float(of_joints[joints[0]]):.6g}") for part, joints in PARTS.items()}


def losses(trace: Trace) -> dict[str, float]:
    """Eq. 7, the whole and each sub-action's share."""
    of_i, of_j = (float(side.loss.mean()) for side in trace.sides)
    return {"total": of_i + of_j, "i": of_i, "j": of_j}


def stage_sheet(trace: Trace, index: int, names: tuple[str, str], title: str = "", side: int = 192) -> Tensor:
    """Every stage of the loss for picture ``index`` of a trace: one row a sub-action, one column a stage [3 H W]."""
    composed = trace.composed.pictures[index]
    factor = max(1, side // composed.shape[-1])
    whole = enlarged(part_picture(composed), factor)
    rows = []
    for reference, answer in zip(trace.references, trace.sides, strict=True):
        own, inpainted = reference.seen.pictures[index], answer.inpainted[index].clamp(0, 1)
        own_picture = enlarged(part_picture(own), factor)
        patches = round(answer.kept.shape[1] ** 0.5)
        rows.append(
            [
                own_picture,
                whole,
                with_joints(own_picture, reference.seen.joints_px[index], reference.energies[index], factor),
                heat_map(whole, answer.attention[index].sqrt()),
                kept_patches(whole, answer.kept[index].reshape(patches, patches)),
                enlarged(part_picture(inpainted), factor),
                enlarged(difference_picture(inpainted, own), factor),
            ]
        )
    captions = [
        f"{name}: loss {float(answer.loss[index]):.4f}" for name, answer in zip(names, trace.sides, strict=True)
    ]
    return contact_sheet(rows, captions, STAGES, title)


def write_report(
    folder: Path, composition: Composition, body: Body, frames: int = 4, extra: dict | None = None
) -> dict[str, Any]:
    """Write ``report.json``, ``report.html`` and the pictures into a folder.

    Args:
        folder: exists; see ``renderers.outputs.replacing_folder``.
        body: for the shaded pictures.
        frames: moments, evenly spread, whose every stage is drawn.
        extra: further JSON values for the report.

    Returns:
        what ``report.json`` holds.
    """
    report = measure(composition) | (extra or {})
    pictures = {"motions": motions_sheet(composition, body), **stage_sheets(composition, frames)}
    if composition.history and len(composition.history["total"]) > 1:
        pictures["loss"] = chart(composition.history, "Refinement: weighed loss terms by step")
    for name, picture in pictures.items():
        save_png(folder / f"{name}.png", picture)
    (folder / "report.json").write_text(json.dumps(report, indent=2) + "\n")
    (folder / "report.html").write_text(page(report, folder, list(pictures)))
    return report


def stage_sheets(composition: Composition, frames: int) -> dict[str, Tensor]:
    """``stage_sheet`` of evenly spread frames in the first view, coupled and refined, by file name."""
    names = (composition.i.label or "i", composition.j.label or "j")
    length, fps = len(composition.motion), composition.motion.fps
    shown = torch.linspace(0, length - 1, min(frames, length)).round().long().tolist()
    traces = {"coupled": composition.before, "refined": composition.after}
    sheets = {}
    for frame in shown:
        for when, trace in traces.items():
            if trace:
                index = frame * len(trace.composed.pictures) // length
                title = f"{when}, {frame / fps:.2f} s"
                sheets[f"stages-{frame:04d}-{when}"] = stage_sheet(trace, index, names, title)
    return sheets


def motions_sheet(composition: Composition, body: Body, poses: int = 8, height: int = 240) -> Tensor:
    """Sub-actions, coupled and refined motion, each as a row of poses over time [3 H W]."""
    motions = [composition.i, composition.j, composition.coupling.motion, composition.motion]
    captions = [composition.i.label or "sub-action i", composition.j.label or "sub-action j", "coupled", "refined"]
    return contact_sheet([[row] for row in strip(motions, body, poses, height)], captions)


def page(report: dict[str, Any], folder: Path, pictures: list[str]) -> str:
    """One HTML page that holds the pictures of ``folder`` itself, so that it can be mailed."""
    title = html.escape(" and ".join(clip["label"] or clip["source"] for clip in report["sub_actions"]))
    columns = (report["energies"]["i"], report["energies"]["j"], report["share_of_i"])
    rows = "".join(
        f"<tr><th>{part.replace('_', ' ')}" + "".join(f"<td>{column[part]:.3g}" for column in columns) for part in PARTS
    )
    figures = "".join(
        f'<img alt="{name}" src="data:image/png;base64,{in_base64(folder / f"{name}.png")}">' for name in pictures
    )
    return f"""<!doctype html><meta charset="utf-8"><title>{title}</title><style>{STYLE}</style>
<h1>{title}</h1>
<table><tr><th>part<th>energy of i<th>energy of j<th>share of i{rows}</table>
<p>Energies: {html.escape(UNIT)}.</p>
{figures}
<details><summary>report.json</summary><pre>{html.escape(json.dumps(report, indent=2))}</pre></details>
"""


def in_base64(path: Path) -> str:
    return base64.b64encode(path.read_bytes()).decode()
