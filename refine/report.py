"""What the loop did, as numbers, pictures and one page that opens from disk."""

import base64
import html
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from torch import Tensor

from refine.composition import Composition
from refine.decoupling import Trace
from refine.drawing import strip
from refine.stages import stage_sheets
from refine.viewer.page import composition_page
from renderers.body import Body
from renderers.images import chart, contact_sheet, save_png
from renderers.skeleton import PARTS

UNIT = "mean squared joint step relative to the pelvis, m² per frame²"
INTRODUCTION = (
    "Two actions were put into one motion: the two as they were given, their {blend} (coupled), and what was made of "
    "it."
)
LOSS = (
    "The smaller, the better each action is recognised in pictures of the motion: the mean over all frames and views "
    "of the squared difference between the action's own picture and the composition's, completed by a network that has "
    "only seen single actions. The chart, if there was a refinement, shows the terms that it lowered: decoupling is "
    "this loss in the frames drawn at that step; the others hold the motion near its start, smooth, and its feet down."
)
OWNERS = (
    "Composed by parts: the action that is about the most parts is the base, the others take theirs from it. Global is "
    "travel and global orientation, which go with the legs."
)
SEEN = (
    "The stages of the loss for a few moments, read from left to right. Each row asks whether one of the actions can "
    "be recognised in the composition."
)


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
    if composition.owners:
        report["owners"] = dict(composition.owners)
    if traces := composition.traces():
        report["decoupling_loss"] = {name: losses(trace) for name, trace in traces.items()}
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


def write_report(
    folder: Path, composition: Composition, body: Body, frames: int = 4, extra: dict | None = None
) -> dict[str, Any]:
    """Write ``report.json``, ``report.html`` and the pictures into a folder.

    Args:
        folder: exists; see ``renderers.outputs.replacing_folder``.
        body: for the shaded pictures and the moving bodies.
        frames: moments, evenly spread, whose every stage is drawn.
        extra: further JSON values for the report.

    Returns:
        what ``report.json`` holds.
    """
    report = measure(composition) | (extra or {})
    pictures = {"motions": motions_sheet(composition, body), **stage_sheets(composition, frames)}
    if composition.history and len(composition.history["total"]) > 1:
        pictures["loss"] = chart(composition.history, "Refinement: weighted loss terms by step")
    for name, picture in pictures.items():
        save_png(folder / f"{name}.png", picture)
    (folder / "report.json").write_text(json.dumps(report, indent=2) + "\n")
    blend = "composition by body parts" if composition.owners else "blend by energies"
    introduction = INTRODUCTION.format(blend=blend)
    page = composition_page(composition, body, introduction, sections(report, folder, list(pictures)))
    (folder / "report.html").write_text(page, encoding="utf-8")
    return report


def motions_sheet(composition: Composition, body: Body, poses: int = 8, height: int = 240) -> Tensor:
    """Sub-actions, coupled motion and what was made of it, each as a row of poses over time [3 H W]."""
    made = composition.motions()
    captions = [composition.i.label or "sub-action i", composition.j.label or "sub-action j", *made]
    rows = strip([composition.i, composition.j, *made.values()], body, poses, height)
    return contact_sheet([[row] for row in rows], captions)


def sections(report: dict[str, Any], folder: Path, pictures: list[str]) -> str:
    """HTML that explains the numbers and holds the pictures of ``folder`` itself, so that it can be mailed."""
    i, j = (html.escape(clip["label"] or clip["source"]) for clip in report["sub_actions"])
    figures = {
        name: f'<figure><img alt="{name}" src="data:image/png;base64,{in_base64(folder / f"{name}.png")}"></figure>'
        for name in pictures
    }
    stages = "".join(figures[name] for name in pictures if name.startswith("stages"))
    return f"""<h2>From the first frame to the last</h2>
{figures["motions"]}
<h2>Who moves what</h2>
{table(("part", f"energy of {i}", f"energy of {j}", f"share of {i}"), energy_rows(report))}
<p>Energy: {html.escape(UNIT)}. Coupling blends the rotations of each part by these shares; travel and global
orientation follow the root's.</p>
{owners_section(report)}
{loss_section(report, i, j) + figures.get("loss", "")}
{f"<h2>What the loop saw</h2><p>{html.escape(SEEN)}</p>" + stages if stages else ""}
<details><summary>report.json</summary><pre>{html.escape(json.dumps(report, indent=2))}</pre></details>
"""


def energy_rows(report: dict[str, Any]) -> list[tuple[str, ...]]:
    of_i, of_j, shares = report["energies"]["i"], report["energies"]["j"], report["share_of_i"]
    parts = [
        (part.replace("_", " "), f"{of_i[part]:.2e}", f"{of_j[part]:.2e}", f"{shares[part]:.0%}") for part in PARTS
    ]
    return [*parts, ("root", "", "", f"{shares['root']:.0%}")]


def owners_section(report: dict[str, Any]) -> str:
    """Which action each part comes from, as a table; empty where energies were blended."""
    if "owners" not in report:
        return ""
    rows = [(part, html.escape(action)) for part, action in report["owners"].items()]
    return f"<h2>Who owns which part</h2>{table(('part', 'comes whole from'), rows)}<p>{OWNERS}</p>"


def loss_section(report: dict[str, Any], i: str, j: str) -> str:
    """The decoupling loss of every motion as a table; empty when nobody looked."""
    if "decoupling_loss" not in report:
        return ""
    rows = [
        (made, *(f"{loss[key]:.6f}" for key in ("i", "j", "total"))) for made, loss in report["decoupling_loss"].items()
    ]
    return (
        f"<h2>Can both be recognised?</h2>{table(('motion', i, j, 'decoupling loss'), rows)}<p>{html.escape(LOSS)}</p>"
    )


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """An HTML table of cells that are HTML already."""
    body = "".join(f"<tr><th>{first}" + "".join(f"<td>{cell}" for cell in rest) for first, *rest in rows)
    return f"<table><thead><tr>{''.join(f'<th>{cell}' for cell in head)}</thead><tbody>{body}</tbody></table>"


def in_base64(path: Path) -> str:
    return base64.b64encode(path.read_bytes()).decode()
