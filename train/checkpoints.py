"""What a run leaves on disk: weights for use, and a state to go on from. safetensors and JSON, never a pickle.

``<name>.safetensors`` holds a model's tensors under their own names and ``<name>.json`` beside it says what they are:
``kind``, the model's ``config``, and the record of how they came to be. ``state.safetensors`` holds model and optimiser
together in one file, so that it can never be half of one step and half of another.
"""

import dataclasses
import hashlib
import json
import platform
import shlex
import subprocess
import sys
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save
from torch import Tensor, nn

from refine.formats.untrusted import read_json
from refine.formats.weights import check_network, read_safetensors
from refine.motion import Motion
from renderers.checks import UserError
from renderers.outputs import replacing

SCHEMA = 1


def replace_file(path: Path, content: bytes):
    """Write beside and rename, so that a reader never meets a half-written file."""
    with replacing(path) as partial:
        partial.write_bytes(content)


def to_json(value: Any) -> bytes:
    """Readable JSON of dataclasses, paths and plain values."""
    return (json.dumps(value, indent=2, default=plain) + "\n").encode()


def plain(value: Any) -> Any:
    return dataclasses.asdict(value) if dataclasses.is_dataclass(value) else str(value)


def save_weights(path: Path, kind: str, model: nn.Module, record: dict[str, Any], half: bool = False):
    """Write a model's tensors to ``path`` and what they are to the JSON beside it.

    Args:
        kind: ``"mae"`` or ``"generator"``; a reader refuses the other.
        model: has a dataclass ``config``.
        record: further JSON, such as the step and ``provenance``.
        half: store float16.
    """
    tensors = {name: value.half() if half else value for name, value in model.state_dict().items()}
    replace_file(path, save({name: value.contiguous().cpu() for name, value in tensors.items()}))
    described = {"schema": SCHEMA, "kind": kind, "config": model.config, **record}
    replace_file(path.with_suffix(".json"), to_json(described))


def read_weights(path: Path, kind: str) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors (as float32) and description of ``save_weights``.

    Raises:
        UserError: one of the two files is missing or damaged, or they hold another kind of model.
    """
    again = f"give the .safetensors that `refine train {kind}` wrote, its .json beside it"
    described = path.with_suffix(".json")
    if not described.is_file():
        raise UserError(described, "no such file", again)
    try:
        description = read_json(described, finite=False)
        found, schema = description["kind"], description["schema"]
    except (UserError, KeyError, TypeError) as error:
        raise UserError(described, f"does not describe any weights ({error})", again) from error
    if found != kind:
        raise UserError(path, f"holds the weights of a {found}, expected a {kind}", again)
    if schema != SCHEMA:
        raise UserError(path, f"is of schema {schema}, this version reads {SCHEMA}", "use the version that wrote it")
    if not path.exists():
        raise UserError(path, "no such file", again)
    tensors, _ = read_safetensors(path, again)
    return {name: value.float() for name, value in tensors.items()}, description


def weights_of(path: str | Path) -> Path:
    """The best weights of a run folder, or the file that is given."""
    path = Path(path)
    return path / "best.safetensors" if path.is_dir() else path


def load_network(
    path: str | Path, kind: str, build: Callable[[dict[str, Any]], Any], blocks: Callable[[dict[str, Any]], int]
) -> Any:
    """The network that a description describes, with the weights beside it, in evaluation mode.

    Args:
        path: see ``weights_of``.
        build: makes the network from what is stored of its configuration.
        blocks: how many repeated parts that has, each with a tensor at least.

    Raises:
        UserError: missing or damaged files, or the weights of something else.
    """
    path = weights_of(path)
    tensors, description = read_weights(path, kind)
    try:
        stored = description["config"]
        check_network(path, lambda: build(stored), blocks(stored), tensors, "train it again")
        network = build(stored)
        network.load_state_dict(tensors)
    except (KeyError, TypeError, AttributeError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise UserError(path, f"does not fit its description ({reason})", "train it again") from error
    return network.eval().requires_grad_(False)


def save_state(path: Path, model: nn.Module, optimiser: torch.optim.Optimizer, progress: dict[str, Any]):
    """Write everything a run needs to go on: ``progress`` is small JSON (the step, the best value so far)."""
    tensors = {f"model.{name}": value for name, value in model.state_dict().items()}
    for index, moments in optimiser.state_dict()["state"].items():
        tensors |= {f"optimiser.{index}.{name}": value for name, value in moments.items()}
    content = save(
        {name: value.contiguous().cpu() for name, value in tensors.items()}, {"progress": json.dumps(progress)}
    )
    replace_file(path, content)


def load_state(path: Path, model: nn.Module, optimiser: torch.optim.Optimizer) -> dict[str, Any]:
    """Put a saved state back into model and optimiser, and return its ``progress``.

    Raises:
        UserError: the file is missing, damaged, or belongs to another model.
    """
    remedy = "start again in another folder with --out"
    if not path.exists():
        raise UserError(path, "no such file", remedy)
    tensors, header = read_safetensors(path, remedy)
    try:
        model.load_state_dict(under(tensors, "model"))
        indices = {int(name.split(".")[0]) for name in under(tensors, "optimiser")}
        moments = {index: under(tensors, f"optimiser.{index}") for index in indices}
        optimiser.load_state_dict({"state": moments, "param_groups": optimiser.state_dict()["param_groups"]})
        return json.loads(header["progress"])
    except (RuntimeError, ValueError, KeyError) as error:
        raise UserError(path, f"is not a state of this model ({str(error).splitlines()[0]})", remedy) from error


def under(tensors: dict[str, Tensor], owner: str) -> dict[str, Tensor]:
    """The tensors named ``owner.<name>``, as ``<name>``."""
    return {name.removeprefix(f"{owner}."): value for name, value in tensors.items() if name.startswith(f"{owner}.")}


def provenance(seed: int, data_hash: str) -> dict[str, Any]:
    """How a run came to be: the command, the seed, the data, the versions and, in a checkout, the commit."""
    return {
        "command": command(),
        "seed": seed,
        "data_sha256": data_hash,
        "versions": {"python": platform.python_version()}
        | {name: metadata.version(name) for name in ("refine-motion", "torch", "timm")},
        "commit": commit(),
    }


def command() -> str:
    """The command line of this process, as one would type it."""
    name = Path(sys.argv[0]).name
    return shlex.join(["refine" if name == "main.py" else name, *sys.argv[1:]])  # python -m refine.cli.main


def commit() -> str | None:
    """The git commit of the source, with ``+`` when it has changes; None outside a checkout or without git."""
    git = ["git", "-C", str(Path(__file__).parent)]
    try:
        head = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True, check=True).stdout.strip()
        changed = subprocess.run([*git, "status", "--porcelain", "-uno"], capture_output=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return None
    return head + ("+" if changed else "")


def hash_motions(motions: list[Motion]) -> str:
    """SHA-256 over labels, frame rates, rotations and roots, in order."""
    digest = hashlib.sha256()
    for motion in motions:
        digest.update(f"{motion.label} {motion.fps} {len(motion)}".encode())
        digest.update(motion.rotations.contiguous().numpy().tobytes())
        digest.update(motion.root.contiguous().numpy().tobytes())
    return digest.hexdigest()


def hash_tensors(model: nn.Module) -> str:
    """SHA-256 over names and values of a model's tensors, in order."""
    digest = hashlib.sha256()
    for name, value in model.state_dict().items():
        digest.update(f"{name} {list(value.shape)}".encode())
        digest.update(value.detach().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()
