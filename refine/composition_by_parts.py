"""Two or more actions, and the body parts that each is about: one motion that does them all."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from torch import Tensor

from refine.composition import Composition, aligned, refined
from refine.coupling_by_parts import couple_divided, divide, unclaimed
from refine.decoupling import Decoupler
from refine.motion import Motion
from refine.ownership import Divided
from refine.refinement import RefinementConfig
from refine.text.parts import BODY_PARTS, Parts
from renderers.checks import UserError


def compose_by_parts(
    motions: Sequence[Motion],
    parts: Sequence[Parts],
    rest_joints: Tensor,
    decoupler: Decoupler | None = None,
    refinement: RefinementConfig | None = None,
    centred: bool = True,
    progress: Callable[[int, dict[str, float]], None] | None = None,
) -> Composition:
    """Couple actions by parts, and refine the result through the decoupling loss.

    Refinement leaves each action what it is about; what no action is about takes up how the others move there, see
    ``refine_motion``.

    All are brought to the first one's frame rate and cut to the shortest. Of three and more, the base (see
    ``coupling_by_parts.divide``) is composed with the second in order, their composition with the third, and so on;
    each is refined before the next.

    Args:
        parts: what each action is about.
        rest_joints: [24 3] T-pose joints, metres.
        decoupler: none only couples, and nobody looks.
        refinement: ``refinement.BY_PARTS``, unless given.
        centred: cut to the middles, or from the first frames.

    Returns:
        the last of these compositions, of which one side is the composition so far. Of two actions i is the first.

    Raises:
        UserError: fewer than two actions, one that is left without any part, or a clip of a single frame.
    """
    if len(motions) < 2 or len(motions) != len(parts):
        problem = f"{len(motions)} actions and parts of {len(parts)}"
        raise UserError("compose_by_parts", problem, "give two actions or more, and the parts of each")
    division = divide(parts)
    motions = aligned(*motions, centred=centred)
    for action, motion in enumerate(motions):
        if action not in division.owners:
            winners = {motions[owner].label or motions[owner].source for owner in division.owners}
            problem = f"is left without any part: {' and '.join(sorted(winners))} take the whole body"
            raise UserError(motion.label or motion.source, problem, "say more narrowly what each action is about")
    members = [division.order[0]]
    made = motions[members[0]]
    for action in division.order[1:]:
        i, j, of_i = made, motions[action], ~division.joints_of(action)
        if action < min(members):
            i, j, of_i = j, i, ~of_i
        coupled = couple_divided(i, j, of_i, rest_joints)
        if decoupler is None:
            composition = Composition(i, j, coupled, coupled.motion, made="coupled")
        else:
            divided = Divided(of_i, unclaimed([parts[member] for member in [*members, action]]))
            composition = refined(i, j, coupled, decoupler, refinement, progress, divided)
        made = composition.motion
        members.append(action)
    names = [motion.label or motion.source for motion in motions]
    owners = {part: names[owner] for part, owner in zip(BODY_PARTS, division.owners, strict=True)}
    return replace(composition, owners=owners)
