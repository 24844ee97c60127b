"""Shared by the tests of the viewer: a small composition with all that the loop saw."""

import pytest
import torch

from refine.composition import Composition, compose
from refine.decoupling import Decoupler, DecouplingConfig
from refine.mae import MAE, MAEConfig
from refine.refinement import RefinementConfig
from refine.synthetic import draw, perform


@pytest.fixture(scope="session")
def small_composition(free_body) -> Composition:
    """Eight frames, refined by three steps and an untrained inpainter of 32 pixels."""
    size = MAEConfig(size=32, width=16, depth=1, heads=1, decoder_width=16, decoder_depth=1, decoder_heads=1)
    decoupler = Decoupler(free_body, MAE(size), DecouplingConfig(views=(0.0, 90.0)))
    random = torch.Generator().manual_seed(1)
    i, j = (perform(draw(name, random), 8, free_body.rest_joints) for name in ("walk", "drink"))
    return compose(i, j, decoupler, refinement=RefinementConfig(steps=3, frames=2))
