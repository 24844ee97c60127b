"""The recogniser: a spatial temporal graph convolutional network that names the action of a clip.

Yan et al. 2018 ("ST-GCN") as ACTOR's evaluation has it: only rotations go in, never the translation, and the vector
before the last layer is the feature of every metric. A recogniser may see a part of the body alone: then nothing else
can change its mind, and two of them say whether both actions are in a composition.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn

from refine.folded import Folded
from renderers.checks import UserError, check_known, check_range, check_shapes
from renderers.skeleton import JOINT_NAMES, PARENTS, PARTS

OTHER = "other"
"""What a recogniser of a part calls actions that do not live in that part."""
LEG_JOINTS = tuple(sorted((0, *PARTS["left_leg"], *PARTS["right_leg"])))
ARM_JOINTS = tuple(sorted((*PARTS["torso"], *PARTS["left_arm"], *PARTS["right_arm"])))

Graph = Literal["actor", "centripetal"]


@dataclass(frozen=True)
class RecogniserConfig:
    """Everything needed to build the network again."""

    classes: tuple[str, ...]
    """Names of the classes, in the order of the logits."""
    joints: tuple[int, ...] = tuple(range(len(JOINT_NAMES)))
    """Joints that it sees, in SMPL's order."""
    graph: Graph = "actor"
    """How neighbours are told apart, see ``partitions``."""
    widths: tuple[int, ...] = (64, 128, 256)
    """Channels; every width after the first halves the frames. The last one is the length of a feature."""
    depths: tuple[int, ...] = (4, 3, 3)
    """Blocks of each width."""
    kernel: int = 9
    """Frames that a temporal convolution spans, odd."""
    alike: tuple[tuple[str, ...], ...] = ()
    """Groups of classes that it cannot tell apart by what it sees, as legs that march with or without punches: for
    ``names`` one of them is as good as another."""

    def __post_init__(self):
        check_range(self, 1, 999, "kernel")
        if not self.classes:
            raise UserError("RecogniserConfig(classes)", "there is no class", "name at least one")
        if not self.joints or sorted({*self.joints} & {*range(len(JOINT_NAMES))}) != list(self.joints):
            raise UserError("RecogniserConfig(joints)", f"expected some of 0 to 23 in ascending order: {self.joints}")
        if self.graph not in ("actor", "centripetal"):
            raise UserError("RecogniserConfig(graph)", f"{self.graph!r} is neither actor nor centripetal")
        if not self.widths or len(self.widths) != len(self.depths) or min(*self.widths, *self.depths) < 1:
            raise UserError("RecogniserConfig(widths)", f"{self.widths} do not go with depths {self.depths}")
        for name in {name for group in self.alike for name in group}:
            check_known("RecogniserConfig(alike)", name, self.classes)
        if self.kernel % 2 == 0:
            raise UserError("RecogniserConfig(kernel)", f"{self.kernel} is not odd, so it has no middle frame")


def partitions(graph: Graph = "actor", joints: Sequence[int] = range(len(JOINT_NAMES))) -> Tensor:
    """Weights [3 V V] with which joint v (row) is heard by joint w (column): itself; neighbours; nearer neighbours.

    The bones and every joint's link to itself are normalised by columns, so that each column sums to 1 over the three.
    ST-GCN tells neighbours that are nearer to the pelvis from the others: ``"centripetal"``. In ACTOR's code, as in
    other copies of ST-GCN's, distances are known only up to one bone and infinite beyond, so that neighbours count as
    nearer only between the pelvis and the joints two bones away: ``"actor"``.

    Args:
        joints: of the 24, ascending; bones between them stay, and distances are those in the whole body.
    """
    count = len(JOINT_NAMES)
    linked = torch.eye(count, dtype=torch.float64)
    distance = torch.zeros(count)
    for joint, parent in enumerate(PARENTS[1:], start=1):
        linked[joint, parent] = linked[parent, joint] = 1
        distance[joint] = distance[parent] + 1
    if graph == "actor":
        distance[distance > 1] = math.inf
    kept = list(joints)
    linked, distance = linked[kept][:, kept], distance[kept]
    heard = linked / linked.sum(0)
    itself = torch.eye(len(kept), dtype=torch.bool)
    nearer = distance[:, None] < distance
    return torch.stack([heard * itself, heard * (~itself & ~nearer), heard * nearer]).float()


class SpatialConvolution(nn.Module):
    """Every joint hears the three partitions of its neighbours, each through weights of its own.

    ``edges`` learns how much each bone counts. Maps [B C T V] to [B D T V], both with channels last in memory.
    """

    def __init__(self, width_in: int, width: int, graph: Tensor):
        super().__init__()
        self.register_buffer("graph", graph, persistent=False)
        self.edges = nn.Parameter(torch.ones_like(graph))
        self.linear = nn.Linear(width_in, len(graph) * width)

    def forward(self, x: Tensor) -> Tensor:
        weighed = self.graph * self.edges
        kinds, joints, _ = weighed.shape
        # Joints are mixed first, with rows ordered (joint, partition): two matrix products and no copy between.
        mixed = weighed.permute(2, 0, 1).reshape(-1, joints) @ x.permute(0, 2, 3, 1)
        weight = self.linear.weight.unflatten(0, (kinds, -1)).transpose(0, 1).flatten(1)
        bias = weighed.sum(1).mT @ self.linear.bias.unflatten(0, (kinds, -1))
        mixed = mixed.unflatten(2, (joints, kinds)).flatten(3)
        return (mixed @ weight.mT + bias).permute(0, 3, 1, 2)


class Block(nn.Module):
    """Over joints, over time, and past both: [B C T V] to [B D ceil(T / stride) V]."""

    def __init__(self, width_in: int, width: int, stride: int, kernel: int, graph: Tensor, residual: bool = True):
        super().__init__()
        self.spatial = SpatialConvolution(width_in, width, graph)
        self.temporal = nn.Sequential(
            nn.BatchNorm2d(width),
            nn.ReLU(),
            nn.Conv2d(width, width, (kernel, 1), (stride, 1), (kernel // 2, 0)),
            nn.BatchNorm2d(width),
        )
        if not residual:
            self.past = None
        elif width_in == width and stride == 1:
            self.past = nn.Identity()
        else:
            self.past = nn.Sequential(nn.Conv2d(width_in, width, 1, (stride, 1)), nn.BatchNorm2d(width))

    def forward(self, x: Tensor) -> Tensor:
        y = self.temporal(self.spatial(x))
        return torch.relu(y if self.past is None else y + self.past(x))


class Recogniser(nn.Module):
    """forward(six [B T 24 6]) -> logits [B C]; ``features`` is what the metrics compare."""

    def __init__(self, config: RecogniserConfig):
        super().__init__()
        self.config = config
        graph = partitions(config.graph, config.joints)
        self.norm = nn.BatchNorm1d(len(config.joints) * 6)
        blocks, before = [], 6
        for width, depth in zip(config.widths, config.depths, strict=True):
            for index in range(depth):
                stride = 2 if blocks and index == 0 else 1
                blocks.append(Block(before, width, stride, config.kernel, graph, residual=bool(blocks)))
                before = width
        self.blocks = nn.Sequential(*blocks)
        self.classify = nn.Linear(before, len(config.classes))

    def features(self, six: Tensor) -> Tensor:
        """The mean over frames and joints of what the last block sees, [B F].

        Args:
            six: [B T 24 6] rotations as first two rows; joints that it does not see have no influence.
        """
        check_shapes("Recogniser", six=(six, f"B T {len(JOINT_NAMES)} 6"))
        seen = six[:, :, list(self.config.joints)]
        batch, frames, joints, _ = seen.shape
        x = self.norm(seen.reshape(batch * frames, -1)).reshape(batch, frames, joints, 6).permute(0, 3, 1, 2)
        return self.blocks(x).mean((2, 3))

    def forward(self, six: Tensor) -> Tensor:
        return self.classify(self.features(six))

    def names(self, logits: Tensor, classes: Tensor) -> Tensor:
        """Whether logits [N C] are largest at the classes [N], or at one that is ``alike``: bool [N]."""
        group = torch.arange(len(self.config.classes), device=logits.device)
        for names in self.config.alike:
            members = [self.config.classes.index(name) for name in names]
            group[members] = members[0]
        return group[logits.argmax(1)] == group[classes]


class Recognised(NamedTuple):
    """features [N F] and logits [N C], float64."""

    features: Tensor
    logits: Tensor


@torch.no_grad()
def features_of(recogniser: Recogniser, six: Tensor, batch: int = 32) -> Recognised:
    """What a recogniser in evaluation mode makes of clips [N T 24 6], ``batch`` of them at a time, on its own device.

    More at a time are slower on a CPU, whose caches they leave.

    Returns:
        features and logits, float64, where ``six`` was.
    """
    if recogniser.training:
        raise UserError("features_of", "the recogniser is in training mode", "call its eval()")
    device = recogniser.classify.weight.device
    foldable = device.type == "cpu" and type(recogniser) is Recogniser
    network = Folded(recogniser) if foldable else recogniser
    features = [network.features(part.to(device, torch.float32)) for part in six.split(batch)]
    logits = [recogniser.classify(part) for part in features]
    return Recognised(*(torch.cat(parts).to(six.device, torch.float64) for parts in (features, logits)))


class BothActions(NamedTuple):
    """For each clip, bool [N]: the legs do the first action, arms and trunk do the second, and both at once."""

    legs: Tensor
    arms: Tensor
    both: Tensor


def both_actions(
    legs: Recogniser, arms: Recogniser, six: Tensor, labels: Sequence[str], batch: int = 32
) -> BothActions:
    """Whether both actions are recognised in compositions, by recognisers that have learned single actions alone.

    Args:
        legs: knows the first actions; sees pelvis and legs.
        arms: knows the second actions; sees trunk, head and arms.
        six: [N T 24 6].
        labels: N names ``"i+j"``.

    Raises:
        UserError: a label that is no pair, or an action that a recogniser does not know.
    """
    if len(labels) != len(six):
        raise UserError("both_actions(labels)", f"{len(labels)} labels for {len(six)} clips")
    pairs = [label.split("+") for label in labels]
    for label, pair in zip(labels, pairs, strict=True):
        if len(pair) != 2:
            raise UserError("both_actions(labels)", f"{label!r} is no pair of actions", "write it as first+second")
    right = []
    for side, recogniser in enumerate((legs, arms)):
        classes = recogniser.config.classes
        for name in {pair[side] for pair in pairs}:
            check_known("both_actions(labels)", name, [name for name in classes if name != OTHER])
        wanted = torch.tensor([classes.index(pair[side]) for pair in pairs], device=six.device)
        right.append(recogniser.names(features_of(recogniser, six, batch).logits, wanted))
    return BothActions(*right, right[0] & right[1])
