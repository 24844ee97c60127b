"""One page that shows motions as moving bodies. It holds all that it needs, and opens from disk without a network.

The page is ``assets/viewer.html`` with its style, its script and one block of data filled in. Its policy allows that
one script and that one style, by their digests, and pictures in data URLs; nothing is fetched.
"""

import base64
import hashlib
import html
import json
import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from importlib.resources import files
from typing import Any

from torch import Tensor

from refine.composition import Composition
from refine.drawing import strip
from refine.metrics import foot_skate, jitter
from refine.motion import Motion, canonicalise
from refine.viewer.looking import data_url, history, pack_looking
from refine.viewer.packing import Packer, pack_body, pack_motion
from renderers.body import Body
from renderers.checks import UserError
from renderers.images import contact_sheet

SCRIPTS = ("algebra", "motion", "shaders", "renderer", "orbit", "cards", "painting", "controls", "viewer")
MOST = 9  # motions, one a digit
LONGEST = 200_000  # frames of all motions: 40 MB
POSES, HEIGHT = 8, 220  # of the poster


def page(
    motions: Sequence[Motion],
    body: Body,
    roles: Sequence[str] = (),
    title: str = "",
    lead: str = "",
    poster: Tensor | None = None,
    composition: Composition | None = None,
    below: str = "",
) -> str:
    """A page of HTML that shows motions in step, by seconds, each from its first frame.

    All start at the same place and face the same way. Every text is shown as text, whatever signs it holds.

    Args:
        motions: one to nine.
        body: that performs them.
        roles: of each motion, shown beside its label.
        title: the labels, if none is given.
        lead: a sentence below the title; how many frames there are, if none is given.
        poster: a picture [3 H W] for browsers without WebGL2, and for print.
        composition: what the loop saw of it is shown; its sub-actions and ``motions()`` are the motions.
        below: HTML that is put below as it is.

    Raises:
        UserError: no motion, more than nine, or more frames than a browser would like.
    """
    check_motions(motions)
    title = title or " · ".join(motion.label or "motion" for motion in motions)
    data = pack(motions, body, roles, composition)
    script, style = code()
    policy = (
        f"default-src 'none'; script-src '{digest(script)}'; style-src '{digest(style)}'; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )
    spoken = ", ".join(motion.label or "motion" for motion in motions)
    picture = "" if poster is None else f'<figure class="poster"><img src="{data_url(poster)}" alt="Poses"></figure>'
    fill = {
        "policy": html.escape(policy, quote=False),
        "title": html.escape(title),
        "lead": html.escape(lead or summary(motions)),
        "spoken": html.escape(spoken),
        "style": style,
        "script": script,
        "data": in_script(data),
        "poster": picture,
        "below": below,
        "footer": "Made with Refine. This page is one file and asks nothing of a network.",
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda match: fill[match[1]], asset("viewer.html"))


def composition_page(composition: Composition, body: Body, lead: str = "", below: str = "") -> str:
    """:func:`page` of both sub-actions, the coupled motion and what was made of it, with all that the loop saw."""
    motions, roles = cast(composition)
    title = " and ".join(motion.label or role for motion, role in zip(motions[:2], roles, strict=False))
    return page(motions, body, roles, title, f"{lead} {summary(motions)}.".lstrip(), None, composition, below)


def cast(composition: Composition) -> tuple[list[Motion], list[str]]:
    """The motions of a composition, and what each is in it."""
    made = composition.motions()
    named = [replace(motion, label=name) for name, motion in made.items()]
    roles = ["sub-action i", "sub-action j", *("" for _ in made)]
    return [composition.i, composition.j, *named], roles


def check_motions(motions: Sequence[Motion]) -> None:
    if not 1 <= len(motions) <= MOST:
        raise UserError("the page", f"shows 1 to {MOST} motions at once, not {len(motions)}", "give more or fewer")
    frames = sum(map(len, motions))
    if frames > LONGEST:
        raise UserError("the page", f"would hold {frames} frames, {LONGEST} are the most", "crop the motions")


def pack(
    motions: Sequence[Motion], body: Body, roles: Sequence[str] = (), composition: Composition | None = None
) -> dict[str, Any]:
    """All that the script needs, as plain JSON values; arrays are in ``bytes``, in base64."""
    packer, rest_joints = Packer(), body.rest_joints.detach().cpu()
    placed = [canonicalise(motion.to("cpu")) for motion in motions]
    data: dict[str, Any] = {"body": pack_body(packer, body), "motions": []}
    for index, motion in enumerate(placed):
        entry = pack_motion(packer, motion, rest_joints)
        data["motions"].append(
            {**entry, "role": roles[index] if roles else "", "numbers": numbers(motion, rest_joints)}
        )
    if composition is not None:
        data["history"] = history(composition)
        names = list(composition.motions())
        first = len(motions) - len(names)
        if composition.traces():
            shown = dict(zip(names, placed[first:], strict=True))
            data["looking"] = pack_looking(packer, composition, shown, rest_joints)
            for made in data["looking"]["made"]:
                made["motion"] = first + names.index(made["name"])
    data["bytes"] = packer.base64()
    return data


def numbers(motion: Motion, rest_joints: Tensor) -> dict[str, float]:
    """What is said of a motion in numbers, by name with the unit; nothing that it is too short for."""
    joints = motion.joints(rest_joints)
    said = {"travel, m": float(motion.root[:, [0, 2]].diff(dim=0).norm(dim=1).sum())}
    if len(motion) >= 4:
        said |= {"jitter, m/s³": jitter(joints, motion.fps), "foot skate, m/s": foot_skate(joints, motion.fps)}
    return {name: float(f"{value:.4g}") for name, value in said.items()}


def summary(motions: Sequence[Motion]) -> str:
    """How long the motions are, in one line."""
    lengths = sorted({f"{len(motion)} frames at {motion.fps:.5g} a second" for motion in motions})
    many = "" if len(motions) == 1 else f"{len(motions)} motions, "
    return many + (lengths[0] if len(lengths) == 1 else f"up to {max(m.seconds for m in motions):.2f} seconds")


def poster(motions: Sequence[Motion], body: Body) -> Tensor:
    """A row of poses for each motion [3 H W]."""
    rows = strip(motions, body, POSES, HEIGHT)
    return contact_sheet([[row] for row in rows], [motion.label or "motion" for motion in motions])


@cache
def code() -> tuple[str, str]:
    """The page's script, in a function of its own, and its style."""
    script = "".join(asset(f"{name}.js") for name in SCRIPTS)
    return f'"use strict";\n(() => {{\n{script}}})();\n', asset("viewer.css")


@cache
def asset(name: str) -> str:
    return files("refine.viewer").joinpath("assets", name).read_text(encoding="utf-8")


def digest(text: str) -> str:
    """What a content security policy calls a script or a style that is written in the page."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def in_script(value: Any) -> str:
    """JSON that may stand within a script element: nothing in it can end the element or begin another."""
    text = json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return text
