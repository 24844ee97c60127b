"""A recogniser as it computes fastest on a CPU: the same features, up to rounding.

Norms that no longer learn are folded into the convolutions beside them. Joints come first in memory, so that a joint is
one piece and hears another by one addition: in a tree of bones these are few, where a product with the matrix of the
graph multiplies mostly zeros. What channels are multiplied with is a convolution of one frame, for which PyTorch's CPU
kernels are faster than for the product of matrices that it is.
"""

from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn
from torch.nn.functional import conv2d, relu_
from torch.nn.utils.fusion import fuse_conv_bn_eval

if TYPE_CHECKING:
    from refine.recogniser import Block, Recogniser


class Folded:
    """features(six [B T 24 6]) -> [B F] of a recogniser in evaluation mode, as its weights are now; no gradients."""

    @torch.no_grad()
    @torch.autocast("cpu", enabled=False)
    def __init__(self, recogniser: "Recogniser"):
        self.norm, self.joints = recogniser.norm, list(recogniser.config.joints)
        self.blocks = [FoldedBlock(block) for block in recogniser.blocks]

    @torch.no_grad()
    @torch.autocast("cpu", enabled=False)
    def features(self, six: Tensor) -> Tensor:
        seen = six[:, :, self.joints]
        x = self.norm(seen.flatten(2).flatten(0, 1)).view(seen.shape).permute(2, 0, 1, 3).contiguous()
        for block in self.blocks:
            x = block(x)
        return x.mean((0, 2))


class FoldedBlock:
    """[V B T C] to [V B ceil(T / stride) D]."""

    def __init__(self, block: "Block"):
        spatial, (norm, _, temporal, last) = block.spatial, block.temporal
        weighed, kinds = spatial.graph * spatial.edges, len(spatial.graph)
        scale = norm.weight / (norm.running_var + norm.eps).sqrt()
        bias = weighed.sum(1).mT @ spatial.linear.bias.unflatten(0, (kinds, -1))
        self.bias = ((bias - norm.running_mean) * scale + norm.bias)[:, None, None]
        self.weights = spatial.linear.weight.unflatten(0, (kinds, -1)) * scale[:, None]
        self.heard = [
            {
                w: {v: float(weighed[kind, v, w]) for v in spatial.graph[kind, :, w].nonzero().flatten().tolist()}
                for w in spatial.graph[kind].any(0).nonzero().flatten().tolist()
            }
            for kind in range(kinds)
        ]
        self.temporal, self.stride = fuse_conv_bn_eval(temporal, last), temporal.stride[0]
        self.past = block.past
        if isinstance(block.past, nn.Sequential):
            self.past = fuse_conv_bn_eval(*block.past)

    def __call__(self, x: Tensor) -> Tensor:
        y = self.bias.expand(-1, *x.shape[1:3], -1).contiguous()
        for heard, weight in zip(self.heard, self.weights, strict=True):
            if heard:
                y.index_add_(0, torch.tensor([*heard]), over_time(mix(x, heard), weight[..., None]))
        y = over_time(relu_(y), self.temporal.weight[..., 0], self.temporal.bias, self.stride)
        if isinstance(self.past, nn.Conv2d):
            y += over_time(x, self.past.weight[..., 0], self.past.bias, self.stride)
        elif self.past is not None:
            y += x
        return relu_(y)


def mix(x: Tensor, heard: dict[int, dict[int, float]]) -> Tensor:
    """What joints hear of x [V ...]: for each w of ``heard`` in order, the weighed sum over its v, [W ...]."""
    found = x.new_empty(len(heard), *x.shape[1:])
    for row, weights in zip(found, heard.values(), strict=True):
        (first, weight), *others = weights.items()
        torch.mul(x[first], weight, out=row)
        for joint, weight in others:
            row.add_(x[joint], alpha=weight)
    return found


def over_time(x: Tensor, weight: Tensor, bias: Tensor | None = None, stride: int = 1) -> Tensor:
    """Convolve [V B T C] over its frames with [D C kernel], at half a kernel of padding: [V B ceil(T / stride) D]."""
    image = x.flatten(0, 1)[:, None].permute(0, 3, 1, 2)
    found = conv2d(image, weight[:, :, None], bias, (1, stride), (0, weight.shape[-1] // 2))
    return found.permute(0, 2, 3, 1).reshape(*x.shape[:2], -1, len(weight))
