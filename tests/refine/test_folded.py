"""The folded recogniser is the recogniser."""

from dataclasses import replace

import pytest
import torch

from refine.folded import Folded
from refine.recogniser import ARM_JOINTS, LEG_JOINTS, Recogniser, RecogniserConfig

SMALL = RecogniserConfig(("a", "b", "c"), widths=(4, 6), depths=(2, 2), kernel=5)


@pytest.mark.parametrize(
    "config",
    [
        SMALL,
        replace(SMALL, graph="centripetal"),
        replace(SMALL, joints=LEG_JOINTS),
        replace(SMALL, joints=ARM_JOINTS, kernel=1),
        replace(SMALL, widths=(4, 4), depths=(1, 2)),
    ],
)
def test_features_are_those_of_the_recogniser(config, generator):
    """After a few passes in training mode and with learned edges, so that nothing stands at its first value."""
    recogniser = Recogniser(config)
    with torch.no_grad():
        for value in recogniser.parameters():
            value += 0.2 * torch.randn(value.shape, generator=generator)
        for _ in range(5):
            recogniser(torch.randn(6, 13, 24, 6, generator=generator) + 0.5)
    six = torch.randn(3, 13, 24, 6, generator=generator)
    expected = recogniser.eval().double().features(six.double())
    found = Folded(recogniser.float()).features(six)
    assert not found.requires_grad
    assert (found - expected).abs().max() < 1e-5 * expected.abs().max()
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.equal(Folded(recogniser).features(six), found)
