"""Shared fixtures: real clips where they are, a seeded generator, the free body's T-pose joints."""

import os
import signal
import zipfile
from pathlib import Path

# The tensors here are small: several threads would mostly wait for each other, and for whatever else runs.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ["HF_HUB_OFFLINE"] = "1"  # no test asks a network

import pytest
import torch

# A job in the background ignores Ctrl-C, and so would every program that a test starts and interrupts.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

SHARED = Path(os.environ.get("REFINE_SHARED", Path(__file__).resolve().parents[2] / "shared"))


@pytest.fixture(scope="session")
def real_clips(tmp_path_factory) -> list[Path]:
    """The 594 Bandai-Namco BVH clips, unpacked."""
    archives = sorted((SHARED / "data" / "bandai-namco").glob("*.zip"))
    if not archives:
        pytest.skip(f"the Bandai-Namco clips are not at {SHARED / 'data' / 'bandai-namco'} (set REFINE_SHARED)")
    folder = tmp_path_factory.mktemp("bandai-namco")
    for archive in archives:
        with zipfile.ZipFile(archive) as packed:
            packed.extractall(folder)
    return sorted(folder.rglob("*.bvh"))


@pytest.fixture
def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


@pytest.fixture(scope="session")
def free_body():
    """The free body, light."""
    from renderers.body import Body

    return Body.free("light")


@pytest.fixture(scope="session")
def rest_joints() -> torch.Tensor:
    """[24 3] T-pose joints of the free body, metres."""
    from renderers.body import Body

    return Body.free().rest_joints
