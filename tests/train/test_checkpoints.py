"""Weights and states on disk: round trips, and one-line refusals of damaged files."""

import json
from dataclasses import dataclass

import pytest
import torch
from torch import nn

from refine.motion import Motion
from renderers.checks import UserError
from train.checkpoints import hash_motions, load_state, provenance, read_weights, save_state, save_weights


@dataclass(frozen=True)
class Config:
    width: int


class Model(nn.Module):
    def __init__(self, width: int = 3):
        super().__init__()
        self.config = Config(width)
        self.layer = nn.Linear(width, 2)


@pytest.fixture
def trained():
    model = Model()
    optimiser = torch.optim.AdamW(model.parameters())
    model.layer(torch.ones(1, 3)).sum().backward()
    optimiser.step()
    return model, optimiser


def test_weights_come_back_with_their_description(tmp_path, trained):
    model, _ = trained
    path = tmp_path / "new" / "w.safetensors"
    save_weights(path, "mae", model, {"step": 7})
    tensors, description = read_weights(path, "mae")
    assert {name: value.tolist() for name, value in tensors.items()} == {
        name: value.tolist() for name, value in model.state_dict().items()
    }
    assert description == {"schema": 1, "kind": "mae", "config": {"width": 3}, "step": 7}


def test_half_weights_take_half_the_room_and_are_read_as_float32(tmp_path):
    model = Model(1000)
    for half in (True, False):
        save_weights(tmp_path / f"{half}.safetensors", "mae", model, {}, half)
    sizes = [(tmp_path / f"{half}.safetensors").stat().st_size for half in (True, False)]
    assert sizes[0] < 0.6 * sizes[1]
    tensors, _ = read_weights(tmp_path / "True.safetensors", "mae")
    assert tensors["layer.weight"].dtype == torch.float32
    torch.testing.assert_close(tensors["layer.weight"], model.layer.weight.data, atol=2e-5, rtol=1e-3)


def test_state_brings_back_model_optimiser_and_progress(tmp_path, trained):
    model, optimiser = trained
    save_state(tmp_path / "state.safetensors", model, optimiser, {"step": 4, "best": 0.5})
    fresh = Model()
    other = torch.optim.AdamW(fresh.parameters())
    assert load_state(tmp_path / "state.safetensors", fresh, other) == {"step": 4, "best": 0.5}
    assert torch.equal(fresh.layer.weight, model.layer.weight)
    ours, theirs = other.state_dict()["state"], optimiser.state_dict()["state"]
    assert ours.keys() == theirs.keys() == {0, 1}
    for index in ours:
        assert ours[index].keys() == {"step", "exp_avg", "exp_avg_sq"}
        assert all(torch.equal(ours[index][name], theirs[index][name]) for name in ours[index])


def test_bad_weights_are_refused_in_one_line(tmp_path, trained):
    path = tmp_path / "w.safetensors"
    with pytest.raises(UserError, match=r"w\.json: no such file; give the \.safetensors that `refine train mae` wrote"):
        read_weights(path, "mae")
    save_weights(path, "mae", trained[0], {})
    with pytest.raises(UserError, match="holds the weights of a mae, expected a generator"):
        read_weights(path, "generator")
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(UserError, match="damaged or no safetensors file") as caught:
        read_weights(path, "mae")
    assert "\n" not in str(caught.value)
    path.unlink()
    with pytest.raises(UserError, match="no such file"):
        read_weights(path, "mae")


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"kind": "mae"}', "\x00\xff"])
def test_a_bad_description_is_refused(tmp_path, trained, text):
    save_weights(tmp_path / "w.safetensors", "mae", trained[0], {})
    (tmp_path / "w.json").write_text(text)
    with pytest.raises(UserError, match="does not describe any weights"):
        read_weights(tmp_path / "w.safetensors", "mae")


def test_a_newer_schema_is_refused(tmp_path, trained):
    save_weights(tmp_path / "w.safetensors", "mae", trained[0], {})
    described = json.loads((tmp_path / "w.json").read_text())
    (tmp_path / "w.json").write_text(json.dumps(described | {"schema": 2}))
    with pytest.raises(UserError, match="is of schema 2, this version reads 1"):
        read_weights(tmp_path / "w.safetensors", "mae")


def test_a_state_of_another_model_is_refused(tmp_path, trained):
    save_state(tmp_path / "state.safetensors", *trained, {"step": 1})
    other = Model(5)
    with pytest.raises(UserError, match="is not a state of this model"):
        load_state(tmp_path / "state.safetensors", other, torch.optim.AdamW(other.parameters()))
    save_weights(tmp_path / "w.safetensors", "mae", trained[0], {})
    with pytest.raises(UserError, match="is not a state of this model"):
        load_state(tmp_path / "w.safetensors", *trained)


def test_a_command_is_named_as_one_would_type_it(monkeypatch):
    monkeypatch.setattr("sys.argv", ["/somewhere/refine/cli/main.py", "evaluate", "my run"])
    assert provenance(0, "")["command"] == "refine evaluate 'my run'"
    monkeypatch.setattr("sys.argv", ["/somewhere/bin/refine", "demo"])
    assert provenance(0, "")["command"] == "refine demo"


def test_provenance_names_seed_data_and_versions():
    found = provenance(3, "abc")
    assert (found["seed"], found["data_sha256"]) == (3, "abc")
    assert (
        found["versions"]["torch"] == torch.__version__.split("+")[0] or found["versions"]["torch"] == torch.__version__
    )
    assert found["commit"] is None or len(found["commit"].rstrip("+")) == 40


def test_the_data_hash_changes_with_every_part():
    still = Motion(torch.eye(3).expand(2, 24, 3, 3), torch.zeros(2, 3), 30.0, "walk")
    moved = Motion(still.rotations, torch.ones(2, 3), 30.0, "walk")
    named = Motion(still.rotations, still.root, 30.0, "run")
    faster = Motion(still.rotations, still.root, 60.0, "walk")
    assert len({hash_motions([motion]) for motion in (still, moved, named, faster)}) == 4
    assert hash_motions([still, moved]) != hash_motions([moved, still])
