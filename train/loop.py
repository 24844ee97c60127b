"""One training loop for every program: steps in, a run folder out.

A run folder holds ``config.json``, ``log.jsonl`` (one line a logged step), ``curves.png``, ``last`` and ``best``
weights and ``state.safetensors`` to go on from. The randomness of a step is a function of the seed and the step's
number alone, so a run that was killed and resumed gives the very losses of an unbroken one.

A step is taken in shards, one after the other and on several processes: each yields its parts of the terms, whose sums
are those of the whole batch, and so are the sums of their gradients.
"""

import json
import math
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor, nn
from tqdm import tqdm

from renderers.checks import UserError, check_range
from train.checkpoints import load_state, replace_file, save_state, save_weights, to_json
from train.curves import draw_curves
from train.processes import Processes

Losses = Callable[[int, torch.Generator], Iterator[dict[str, Tensor]]]
"""(step, random) -> scalar terms of each of this process's shards; ``"total"`` is the one that is minimised."""

MAY_CHANGE = {"steps", "log_every", "save_every", "device", "out", "resume", "accumulate", "tensorboard"}
"""Names of values that a resumed run may be given anew."""

RULE = "numpy.random.SeedSequence((seed, step, 0)) seeds what a step draws, (seed, step, 1, rank) its dropout"
"""The sampler's state, beside the seed and the step."""

ALONE = Processes()


@dataclass(frozen=True)
class LoopConfig:
    """How long and how fast to train, and how often to write."""

    steps: int = 1000
    learning_rate: float = 1e-4
    weight_decay: float = 0.01
    betas: tuple[float, float] = (0.9, 0.999)
    warmup: int = 0
    """Steps over which the learning rate rises from zero."""
    schedule: Literal["constant", "cosine"] = "constant"
    """After the warm-up: stay, or fall to zero at the last step along a cosine."""
    clip_gradients: float | None = None
    """Largest norm of all gradients together; none leaves them as they are."""
    log_every: int = 1
    save_every: int = 500
    """Steps between checkpoints; each also measures the held-out clips and draws the curves."""
    seed: int = 10
    tensorboard: bool = False
    """Write the terms for TensorBoard too, into the run folder."""

    def __post_init__(self):
        check_range(self, 1, math.inf, "steps", "log_every", "save_every")
        check_range(self, 0, 2**32 - 1, "seed", "warmup")
        if not 0 < self.learning_rate < math.inf:
            raise UserError("LoopConfig(learning_rate)", f"{self.learning_rate} is not positive")


def seed_of(*keys: int) -> int:
    """One 32-bit seed from several numbers, such as a run's seed and a step."""
    return int(np.random.SeedSequence(keys).generate_state(1)[0])


def learning_rate(step: int, config: LoopConfig) -> float:
    """The rate at a step, counted from 0."""
    rise = min(1.0, (step + 1) / max(1, config.warmup))
    if config.schedule == "constant":
        return config.learning_rate * rise
    done = max(0, step - config.warmup) / max(1, config.steps - config.warmup)
    return config.learning_rate * rise * 0.5 * (1 + math.cos(math.pi * min(1.0, done)))


def fit(
    model: nn.Module,
    losses: Losses,
    config: LoopConfig,
    folder: Path,
    kind: str,
    record: dict[str, Any],
    measure: Callable[[], dict[str, float]],
    resume: bool = False,
    processes: Processes = ALONE,
    describe: Callable[[int], str] | None = None,
) -> Path:
    """Train ``model`` with AdamW and return the path of its best weights.

    Args:
        losses: the terms of one step, drawn with the generator it is given, shard by shard.
        folder: exists; filled as the module says.
        kind, record: written with the weights, see ``checkpoints.save_weights``.
        measure: figures on held-out data; the model is in evaluation mode. Best = lowest ``"total"``.
        resume: go on from ``folder / "state.safetensors"``.
        processes: those that share the work; the first measures and writes.
        describe: words for the batch of a step, for when its losses are not finite.

    Raises:
        UserError: a loss term or the gradient is not finite (the last checkpoint stays as it is), or the state that
            should be resumed cannot be read.
    """
    optimiser = torch.optim.AdamW(
        model.parameters(),
        config.learning_rate,
        betas=config.betas,
        weight_decay=config.weight_decay,
        fused=next(model.parameters()).is_cuda,  # one call instead of hundreds
    )
    state = folder / "state.safetensors"
    # A run that was killed before it wrote anything goes on from its first step.
    begun = resume and (state.exists() or (folder / "last.safetensors").exists())
    progress = load_state(state, model, optimiser) if begun else {"step": 0, "best": math.inf}
    random, started, first = torch.Generator(), time.monotonic(), progress["step"]
    processes.wait()  # or the first could write over what another has yet to read
    if processes.first and not begun:  # a kill between the first weights and the first state must not part them
        save_state(state, model, optimiser, progress)
    shown = None if processes.first else True
    with torch.random.fork_rng(), journal(folder, first, config, processes) as write:
        for step in tqdm(range(first, config.steps), initial=first, total=config.steps, desc=kind, disable=shown):
            random.manual_seed(seed_of(config.seed, step, 0))
            torch.manual_seed(seed_of(config.seed, step, 1, processes.rank))
            row = {"step": step, **take_step(model, optimiser, losses, step, random, config, processes)}
            if not all(map(math.isfinite, row.values())):
                with processes.agreeing():
                    if processes.first:
                        refuse_row(row, state, describe)
            optimiser.step()
            if not processes.first:
                continue
            row["seconds"] = round(time.monotonic() - started, 3)
            done = step + 1
            due = done % config.save_every == 0 or done == config.steps
            if due:
                model.eval()
                with torch.no_grad():
                    row["held_out"] = measure()
                # A step can break the weights with losses and gradients that are still finite.
                refuse_row(row["held_out"] | {"step": step}, state, None)
            if due or step % config.log_every == 0:
                write(row)
            if due:
                described = {"step": done, "held_out": row["held_out"], **record}
                save_weights(folder / "last.safetensors", kind, model, described)
                if row["held_out"]["total"] < progress["best"]:
                    progress["best"] = row["held_out"]["total"]
                    save_weights(folder / "best.safetensors", kind, model, described)
                sampler = {"seed": config.seed, "step": done, "rule": RULE}
                save_state(state, model, optimiser, progress | {"step": done, "sampler": sampler})
                draw_curves(folder / "log.jsonl", folder / "curves.png")
    return folder / "best.safetensors"


def take_step(
    model: nn.Module,
    optimiser: torch.optim.Optimizer,
    losses: Losses,
    step: int,
    random: torch.Generator,
    config: LoopConfig,
    processes: Processes = ALONE,
) -> dict[str, float]:
    """The gradients of one update; the terms of the whole batch and the gradient's norm as numbers."""
    model.train()
    for group in optimiser.param_groups:
        group["lr"] = learning_rate(step, config)
    optimiser.zero_grad()
    sums: dict[str, Tensor] = {}
    for terms in losses(step, random):
        terms["total"].backward()
        for name, value in terms.items():
            sums[name] = sums.get(name, 0.0) + value.detach()
    processes.sum_gradients(model)
    values = torch.stack(list(sums.values()))
    processes.sum([values])
    norm = nn.utils.clip_grad_norm_(model.parameters(), config.clip_gradients or math.inf)
    return dict(zip(sums, values.tolist(), strict=True)) | {"gradient": float(norm)}


def refuse_row(row: dict[str, float], state: Path, describe: Callable[[int], str] | None):
    """Refuse a step with a term that is not finite: say which, on what, and where the last good checkpoint is."""
    if all(map(math.isfinite, row.values())):
        return
    name, value = next((name, value) for name, value in row.items() if not math.isfinite(value))
    on = f" on {describe(row['step'])}" if describe else ""
    written = state.with_name("last.safetensors").exists()
    kept = f"the last good checkpoint is {state}" if written else "there is no checkpoint yet"
    remedy = f"{kept}; start again in another folder with a lower --loop.learning-rate or with --loop.clip-gradients"
    raise UserError(f"step {row['step']}", f"the term {name!r} became {value}{on}", remedy)


@contextmanager
def journal(
    folder: Path, first: int, config: LoopConfig, processes: Processes
) -> Iterator[Callable[[dict[str, Any]], None]]:
    """A function that writes a row to ``log.jsonl`` and, if it is asked for, to TensorBoard; only the first process
    may call it."""
    if not processes.first:
        yield lambda row: None
        return
    keep_rows(folder / "log.jsonl", first)
    with ExitStack() as opened:
        lines = opened.enter_context((folder / "log.jsonl").open("a"))
        board = opened.enter_context(closing(open_board(folder, first))) if config.tensorboard else None

        def write(row: dict[str, Any]):
            lines.write(json.dumps(row) + "\n")
            lines.flush()
            if board:
                for name, value in leaves(row).items():
                    if name not in ("step", "seconds"):
                        board.add_scalar(name.replace(".", "/"), value, row["step"])

        yield write


def open_board(folder: Path, first: int) -> Any:
    """TensorBoard's writer; what a killed run wrote from step ``first`` on is hidden."""
    from torch.utils.tensorboard import SummaryWriter

    return SummaryWriter(folder / "tensorboard", purge_step=first or None)


def keep_rows(log: Path, step: int):
    """Drop what a killed run logged after its last checkpoint."""
    rows = log.read_text().splitlines(keepends=True) if log.exists() else []
    kept = [row for row in rows if row.endswith("\n") and json.loads(row)["step"] < step]
    replace_file(log, "".join(kept).encode())


def check_loop(config: LoopConfig):
    """Refuse, before anything is written, what is not installed."""
    if config.tensorboard and find_spec("tensorboard") is None:
        remedy = "pip install 'refine-motion[tensorboard]', or leave it out"
        raise UserError("--loop.tensorboard", "TensorBoard is not installed", remedy)


def check_device(device: str):
    """Refuse a device that torch cannot use here."""
    try:
        torch.empty(1, device=device)
    except (RuntimeError, AssertionError) as error:
        raise UserError(
            "--device", f"{device!r} does not work here ({str(error).splitlines()[0]})", "try cpu"
        ) from error


def open_run(folder: Path, config: Any, resume: bool):
    """Make the run folder and write its resolved configuration.

    Raises:
        UserError: the folder holds a run and ``resume`` is not asked for, or the other way round; or it holds a run of
            another configuration; or it is a file.
    """
    check_folder(folder, resume)
    if resume:
        refuse_changes(folder / "config.json", config)
    folder.mkdir(parents=True, exist_ok=True)
    replace_file(folder / "config.json", to_json(config))


def check_folder(folder: Path, resume: bool):
    """Refuse a run folder for what is in it, as ``open_run`` does, and write nothing."""
    if folder.exists() and not folder.is_dir():
        raise UserError(folder, "is a file", "give a folder with --out")
    held = (folder / "config.json").exists()
    if held and not resume:
        raise UserError(folder, "already holds a run", "go on with --resume, or choose another folder with --out")
    if resume and not held:
        raise UserError(folder, "holds no run to resume", "start it without --resume")


def refuse_changes(stored: Path, config: Any):
    """Refuse to go on with a run under another configuration, but for how long it is and what it writes where."""
    try:
        before, now = (leaves(json.loads(content)) for content in (stored.read_bytes(), to_json(config)))
    except (ValueError, AttributeError) as error:
        raise UserError(stored, f"is no configuration ({error})", "start again in another folder with --out") from error
    changed = sorted(
        name for name in before | now if name.split(".")[-1] not in MAY_CHANGE and before.get(name) != now.get(name)
    )
    if changed:
        was = ", ".join(f"{name} was {before.get(name)} and is {now.get(name)}" for name in changed)
        raise UserError(stored, f"is of another run: {was}", "give the same, or choose another folder with --out")


def leaves(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested dictionaries as one, its keys joined by dots."""
    flat = {}
    for name, value in tree.items():
        flat |= leaves(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return flat
