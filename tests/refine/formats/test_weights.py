"""Weights: what PyTorch writes comes back, and a description must be that of its tensors."""

import argparse
import zipfile

import pytest
import torch
from safetensors.torch import save_file
from torch import nn

from refine.formats.weights import check_network, read_checkpoint, read_safetensors
from renderers.checks import UserError


def contents() -> dict[str, object]:
    torch.manual_seed(0)
    model = nn.Sequential(nn.Linear(3, 4), nn.BatchNorm1d(4), nn.Linear(4, 2))
    optimiser = torch.optim.AdamW(model.parameters())
    model(torch.randn(5, 3)).sum().backward()
    optimiser.step()
    whole = torch.arange(12.0).reshape(3, 4)
    return {
        "model": model.state_dict(),
        "optimizer": optimiser.state_dict(),
        "parameter": nn.Parameter(torch.ones(2)),
        "views": [whole, whole[1:], whole.T, whole[:, ::2]],
        "types": [torch.zeros(2, dtype=kind) for kind in (torch.float64, torch.float16, torch.bfloat16, torch.int64)],
        "more types": [torch.zeros(2, dtype=kind) for kind in (torch.int32, torch.int16, torch.int8, torch.uint8)],
        "flags": torch.tensor([True, False]),
        "small": [torch.tensor(1.5), torch.zeros(0), torch.zeros(0, 3)],
        "args": argparse.Namespace(lr=1e-3, name="mae"),
        "plain": {"epoch": 3, "text": "a", "none": None, "tuple": (1, 2.5), "size": torch.Size([1, 2])},
    }


def same(one: object, other: object) -> bool:
    if isinstance(one, torch.Tensor):
        return one.dtype == other.dtype and torch.equal(one, other)
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same, one, other))
    return one == other


@pytest.mark.parametrize("zipped", [True, False])
def test_what_pytorch_writes_comes_back(tmp_path, zipped):
    stored = contents()
    torch.save(stored, tmp_path / "a.pth", _use_new_zipfile_serialization=zipped)
    assert zipfile.is_zipfile(tmp_path / "a.pth") == zipped
    assert same(stored, read_checkpoint(tmp_path / "a.pth", "give another"))


@pytest.mark.parametrize("zipped", [True, False])
def test_a_checkpoint_cut_anywhere_is_one_line(tmp_path, zipped):
    torch.save({"model": nn.Linear(3, 4).state_dict()}, tmp_path / "a.pth", _use_new_zipfile_serialization=zipped)
    whole = (tmp_path / "a.pth").read_bytes()
    for length in range(1, len(whole) - 1, 37):
        (tmp_path / "b.pth").write_bytes(whole[:length])
        with pytest.raises(UserError, match=r"b\.pth: ") as caught:
            read_checkpoint(tmp_path / "b.pth", "give another")
        assert "\n" not in str(caught.value)


def test_safetensors_and_what_they_say_of_themselves(tmp_path):
    tensors = {"a": torch.arange(6.0).reshape(2, 3), "b": torch.zeros(0)}
    save_file(tensors, tmp_path / "a.safetensors", {"progress": "{}"})
    found, said = read_safetensors(tmp_path / "a.safetensors", "give another")
    assert same(tensors, found) and said == {"progress": "{}"}
    (tmp_path / "b.safetensors").write_bytes((tmp_path / "a.safetensors").read_bytes()[:-4])
    with pytest.raises(UserError, match=r"b.safetensors: is damaged or no safetensors file .*; give another"):
        read_safetensors(tmp_path / "b.safetensors", "give another")


def test_a_network_is_held_against_its_tensors_before_it_is_made(tmp_path):
    path, tensors = tmp_path / "a", nn.Linear(3, 4).state_dict()
    check_network(path, lambda: nn.Linear(3, 4), 1, tensors, "train it")
    for build, blocks, said in (
        (lambda: nn.Linear(3, 5), 1, r"weight has the shape \[4, 3\], expected \[5, 3\]"),
        (lambda: nn.Linear(1 << 20, 1 << 20), 1, r"expected \[1048576, 1048576\]"),  # four terabytes
        (lambda: nn.Linear(3, 4, bias=False), 1, "1 tensors missing or unknown: bias"),
        (lambda: nn.Linear(3, 4), 4096, "4096 blocks, 2 tensors"),
    ):
        with pytest.raises(UserError, match=f"a: does not fit its description .*{said}.*; train it"):
            check_network(path, build, blocks, tensors, "train it")
