"""Coupling by body parts: every part of the body comes whole from one of the actions (SINC, section 3.2).

Where ``refine.coupling`` weighs energies, here somebody has said which parts an action is about. The action with the
most parts is the base; each of the others takes the parts that it is about, those with fewer parts later, so that they
win. Both legs, travel and global orientation go together.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from refine.coupling import Coupling
from refine.energies import energy_signal, joint_energies
from refine.motion import Motion, trimmed
from refine.text.parts import BODY_PARTS, Parts
from renderers.checks import UserError
from renderers.skeleton import JOINTS, part_of_joint
from renderers.skeleton import PARTS as JOINTS_OF_PARTS

GROUNDED = ("global", "left leg", "right leg")  # whoever is about one of these has them all
JOINTS_OF: dict[str, tuple[int, ...]] = {
    "global": (JOINTS["pelvis"],),
    **{name.replace("_", " "): joints for name, joints in JOINTS_OF_PARTS.items()},
}
PART_OF = part_of_joint({name: JOINTS_OF[name] for name in BODY_PARTS})  # hands go with their arms


@dataclass(frozen=True)
class Contest:
    """A part, or the legs with all that goes with them, that several actions are about."""

    what: str
    """Such as "torso" or "legs"."""
    winner: int
    losers: tuple[int, ...]


@dataclass(frozen=True)
class Division:
    """Which of several actions has which part; actions are numbered as they were given."""

    order: tuple[int, ...]
    """The base, then those that override it, one after the other."""
    owners: tuple[int, ...]
    """Of each of ``BODY_PARTS``."""
    contests: tuple[Contest, ...]

    def parts_of(self, action: int) -> Parts:
        """What an action has in the end."""
        return Parts(*(owner == action for owner in self.owners))

    def joints_of(self, action: int) -> Tensor:
        """[24] bool, what an action has in the end."""
        return torch.tensor([self.owners[part] == action for part in PART_OF])


def divide(actions: Sequence[Parts]) -> Division:
    """Give each part to one action: the last in order that is about it, or else the base.

    Raises:
        UserError: there is no action.
    """
    if not actions:
        raise UserError("divide", "there are no actions to divide a body between", "give at least one")
    order = sorted(range(len(actions)), key=lambda action: -sum(actions[action]))  # ties as given
    claims = [grounded(parts) for parts in actions]
    owners, contests = [], []
    for part, name in enumerate(BODY_PARTS):
        claimants = [action for action in order if claims[action][part]]
        owners.append(claimants[-1] if claimants else order[0])
        if len(claimants) > 1 and name not in GROUNDED[1:]:
            what = "legs" if name in GROUNDED else name
            contests.append(Contest(what, claimants[-1], tuple(claimants[:-1])))
    return Division(tuple(order), tuple(owners), tuple(contests))


def grounded(parts: Parts) -> Parts:
    """The same, with all of ``GROUNDED`` where there is one of them."""
    named = set(parts.names)
    return Parts.of(named | set(GROUNDED)) if named & set(GROUNDED) else parts


def unclaimed(actions: Sequence[Parts]) -> Tensor:
    """[24] bool: joints that no action is about; never those of ``GROUNDED``, which stay as one action has them."""
    claimed = [name in GROUNDED or any(name in parts.names for parts in actions) for name in BODY_PARTS]
    return torch.tensor([not claimed[part] for part in PART_OF])


def compatible(parts_i: Parts, parts_j: Parts) -> bool:
    """Whether no part is in both: SINC's test of what can be done at once, on the parts as they were said."""
    return not any(i and j for i, j in zip(parts_i, parts_j, strict=True))


def random_parts(generator: torch.Generator) -> Parts:
    """Each part with probability one half; two of them make SINC's random composition."""
    return Parts(*torch.randint(2, (len(BODY_PARTS),), generator=generator).bool().tolist())


def put_together(motions: Sequence[Motion], division: Division, centred: bool = False) -> Motion:
    """Every joint from the action that has it, travel from the one that has the pelvis; as long as the shortest.

    One that has no part in the end is not seen. Nothing is smoothed, and rotations are local: an arm follows the torso
    that it is put on.

    Args:
        motions: of one frame rate, one an action of the division.
        centred: trim to the middles, or from the first frames.
    """
    motions = trimmed(motions, centred)
    owner = [division.owners[part] for part in PART_OF]
    rotations = torch.stack([motions[action].rotations[:, joint] for joint, action in enumerate(owner)], dim=1)
    label = "+".join(motion.label for motion in motions if motion.label)
    source = " + ".join(motion.source for motion in motions)
    grounds = motions[owner[JOINTS["pelvis"]]]
    return replace(grounds, rotations=rotations, root=grounds.root.clone(), label=label, source=source)


def couple_by_parts(
    i: Motion, j: Motion, parts_i: Parts, parts_j: Parts, rest_joints: Tensor, centred: bool = True
) -> Coupling:
    """Two actions in one motion, each joint from one of them, bit for bit.

    Rotations are local, so that an arm follows the torso that it is put on; nothing is smoothed.

    Args:
        parts_i, parts_j: what each action is about; see ``divide``.
        rest_joints: [24 3] T-pose joints, metres.
        centred: trim the longer clip to its middle, as SINC does when it composes motions, or from its first frame, as
            it does in training.

    Returns:
        weights of 0 and 1.

    Raises:
        UserError: their frame rates differ (resample first), or one has a single frame.
    """
    return couple_divided(i, j, divide([parts_i, parts_j]).joints_of(0), rest_joints, centred)


def couple_divided(i: Motion, j: Motion, of_i: Tensor, rest_joints: Tensor, centred: bool = True) -> Coupling:
    """``couple_by_parts`` where i has the joints ``of_i`` [24] bool, and j the others."""
    if i.fps != j.fps:
        problem = f"{i.source} has {i.fps:g} fps, {j.source} {j.fps:g}"
        raise UserError("couple_by_parts", problem, "resample one of them first")
    i, j = trimmed((i, j), centred)
    of_i = of_i.to(i.root.device)
    rotations = torch.where(of_i[:, None, None], i.rotations, j.rotations)
    root = (i if of_i[JOINTS["pelvis"]] else j).root.clone()
    label = "+".join(label for label in (i.label, j.label) if label)
    motion = replace(i, rotations=rotations, root=root, label=label, source=f"{i.source} + {j.source}")
    energies = [joint_energies(energy_signal(clip.rotations, clip.root, rest_joints)) for clip in (i, j)]
    return Coupling(motion, of_i.to(i.root.dtype), *energies)
