"""The training program of recognisers: those that a benchmark needs, kept in its folder.

``mask`` and ``true`` learn the test compositions themselves, as LFCA's does: real accuracy is 100 % by construction.
``half`` learns every other test composition and is asked about the rest, so that "real" is not trivially perfect.
``legs`` and ``arms`` learn single actions and see one part of the body each: together they say whether both actions are
in a composition, whichever way it was made; ``parts.json`` holds how often they do in the test compositions.
"""

import math
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor, nn
from tqdm import tqdm

from refine.formats.weights import check_network
from refine.recogniser import OTHER, Graph, Recogniser, RecogniserConfig, both_actions, features_of
from renderers.checks import UserError, check_known, check_range
from renderers.outputs import check_place
from renderers.rotations import matrix_from_6d, matrix_to_6d
from train.benchmarks import Benchmark, load_benchmark
from train.checkpoints import provenance, read_weights, replace_file, save_weights, to_json
from train.lessons import KINDS, PARTS, Examples, Kind, Lesson, compositions_of, kinds_of, lesson_of
from train.loop import LoopConfig, check_device, learning_rate, seed_of


@dataclass(frozen=True)
class RecogniserTraining:
    """How recognisers are trained; the defaults are those of ACTOR's evaluation."""

    kinds: tuple[Kind, ...] = ()
    """Which to train; none means all that the benchmark needs."""
    graph: Graph = "actor"
    """How neighbouring joints are told apart: as ACTOR's code does, or as the ST-GCN paper says (centripetal)."""
    widths: tuple[int, ...] = (64, 128, 256)
    """Channels of the network; every width after the first halves the frames."""
    depths: tuple[int, ...] = (4, 3, 3)
    """Blocks of each width."""
    learning_rate: float = 1e-4
    schedule: Literal["constant", "cosine"] = "constant"
    """Stay at the rate; or rise to it over a fifth of ``epochs`` and fall to zero at the last along a cosine."""
    weight_decay: float = 0.01
    noise: float = 0.0
    """Disturb the clips in training, each by a pose offset and by a tremor, whose standard deviations are drawn up to
    this, radians: a network that has seen clean clips alone takes a degree of tremor for another action."""
    batch: int = 64
    epochs: int = 100
    """Largest number of passes over what is learned."""
    patience: int = 2
    """Training ends earlier, after so many passes in a row with 100 % accuracy on what is learned."""
    finish: int = 0
    """Steps in which the last layer alone goes on, with undisturbed clips, where the passes end before 100 %; not those
    of the recognisers of a part, which are to know other clips than the ones they learn."""
    held_out: float = 0.2
    """Share of each action's clips that the recognisers of a part are not trained on."""
    alike: float = 0.25
    """Two actions count as one for a part that mistakes this share of their held-out windows for the other."""
    precision: Literal["float32", "bfloat16"] = "float32"
    """Of the products in training; bfloat16 is twice as fast where the processor knows it."""
    device: str = "cpu"
    """As torch names it, for example ``cuda``. Random numbers are the same on every device."""
    seed: int = 10
    """Of weights, windows, order and of what is held out."""

    def __post_init__(self):
        check_range(self, 1, math.inf, "batch", "epochs", "patience")
        check_range(self, 0, 2**32 - 1, "seed")
        check_range(self, 0, 1, "noise")
        check_range(self, 0, math.inf, "finish")
        check_range(self, 0.01, 0.9, "held_out")
        check_range(self, 0.01, 1, "alike")
        for kind in self.kinds:
            check_known("RecogniserTraining(kinds)", kind, KINDS)
        if not 0 < self.learning_rate < math.inf:
            raise UserError("RecogniserTraining(learning_rate)", f"{self.learning_rate} is not positive")


RECOGNISER_PRESETS: dict[str, tuple[str, RecogniserTraining]] = {
    "small": (
        "A small network: minutes on one core for all recognisers of a benchmark.",
        RecogniserTraining(
            widths=(32, 64, 96),
            depths=(2, 2, 2),
            learning_rate=3e-3,
            schedule="cosine",
            noise=0.1,
            batch=16,
            epochs=20,
            finish=300,
            precision="bfloat16",
        ),
    ),
    "paper": (
        "The network and the rates of ACTOR's evaluation, for a graphics card.",
        RecogniserTraining(device="cuda"),
    ),
}


def place_of(benchmark: Benchmark, kind: str) -> Path:
    """Where the weights of a recogniser are; the description is the .json beside."""
    return benchmark.folder / "recognisers" / f"{kind}.safetensors"


def train_recognisers(folder: Path, config: RecogniserTraining, force: bool = False) -> dict[str, dict[str, Any]]:
    """Train the recognisers of the benchmark in ``folder`` and write each to ``folder/recognisers`` when it is done.

    Returns:
        for each kind what its .json says of it.

    Raises:
        UserError: no benchmark or a changed one, ``true`` where there are no true compositions, a recogniser that is
            already there without ``force``, a device that does not work, or a loss that is not finite.
    """
    check_device(config.device)
    benchmark = load_benchmark(folder)
    wanted = tuple(kind for kind in KINDS if kind in (config.kinds or kinds_of(benchmark)))
    if not {*wanted} <= {*kinds_of(benchmark)}:
        raise UserError(folder, "has no true compositions", "leave out the recogniser 'true'")
    refuse_trained(benchmark, wanted, force)
    records = {kind: train_one(benchmark, kind, config) for kind in wanted}
    parts = [place_of(benchmark, kind) for kind in PARTS]
    if {*wanted} & {*PARTS} and all(path.with_suffix(".json").is_file() for path in parts):
        described = {"benchmark": named(benchmark), **calibrate(benchmark, *map(load_recogniser, parts))}
        replace_file(parts[0].with_name("parts.json"), to_json(described))
    return records


def refuse_trained(benchmark: Benchmark, wanted: tuple[Kind, ...], force: bool):
    """Refuse, before any work is done, to train what is there or to write where nothing may be written."""
    paths = {kind: place_of(benchmark, kind).with_suffix(".json") for kind in wanted}
    there = [path for path in paths.values() if path.exists()]
    if there and not force:
        rest = " ".join(kind for kind, path in paths.items() if path not in there)
        others = f", or the others with --kinds {rest}" if rest else ""
        raise UserError(there[0], "is already there", f"train it again with --force{others}")
    for path in paths.values():
        check_place(path)


def train_one(benchmark: Benchmark, kind: Kind, config: RecogniserTraining) -> dict[str, Any]:
    """Train one recogniser of a benchmark, write it, and return the record beside its weights."""
    lesson = lesson_of(benchmark, kind, config.held_out, config.seed)
    seed = seed_of(config.seed, KINDS.index(kind))
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        recogniser = Recogniser(
            RecogniserConfig(lesson.classes, lesson.joints, config.graph, config.widths, config.depths)
        ).to(config.device)
    started = time.monotonic()
    history = learn(recogniser, lesson, config, seed, kind)
    finished = kind not in PARTS and config.finish > 0 and history[-1]["accuracy"] < 1
    if finished:
        fit_last_layer(recogniser, lesson, config.finish)
    recogniser.eval().requires_grad_(False).cpu()
    if kind in PARTS:
        mistaken = confusion(recogniser, lesson.unseen["held out"])
        recogniser.config = replace(recogniser.config, alike=alike(mistaken, lesson.classes, config.alike))
    examples = {"learned": lesson.learned, **lesson.unseen}
    record = {
        "recogniser": kind,
        "benchmark": named(benchmark),
        "classes": len(lesson.classes),
        "clips": lesson.clips,
        "epochs": len(history),
        "steps": len(history) * math.ceil(lesson.clips / config.batch),
        "finished": finished,
        "seconds": round(time.monotonic() - started, 1),
        "accuracy": {name: accuracy(recogniser, asked) for name, asked in examples.items()},
        "history": history,
        "training": config,
        "provenance": provenance(config.seed, benchmark.hash),
    }
    path = place_of(benchmark, kind)
    # Weights without a description are refused, so that a kill between the two leaves no mixture.
    path.with_suffix(".json").unlink(missing_ok=True)
    save_weights(path, "recogniser", recogniser, record)
    return record


def load_recogniser(path: str | Path) -> Recogniser:
    """A trained recogniser in evaluation mode, frozen; ``path`` is a ``.safetensors`` with its ``.json`` beside.

    Raises:
        UserError: missing or damaged files, or the weights of something else.
    """
    path = Path(path)
    return build(path, *read_weights(path, "recogniser"))


def build(path: Path, tensors: dict[str, Tensor], description: dict[str, Any]) -> Recogniser:
    try:
        # JSON knows no tuples.
        stored = {name: hashable(value) for name, value in description["config"].items()}
        config = RecogniserConfig(**stored)
        check_network(path, lambda: Recogniser(config), sum(config.depths), tensors, "train it again")
        with torch.random.fork_rng(devices=[]):  # the weights that are drawn are not those that stay
            recogniser = Recogniser(config)
        recogniser.load_state_dict(tensors)
    except (KeyError, TypeError, AttributeError, RuntimeError, UserError) as error:
        reason = str(error).splitlines()[0]
        raise UserError(path, f"does not fit its description ({reason})", "train it again") from error
    return recogniser.eval().requires_grad_(False)


def hashable(value: Any) -> Any:
    """Lists as tuples, however deep."""
    return tuple(map(hashable, value)) if isinstance(value, list) else value


def load_recognisers(benchmark: Benchmark) -> dict[str, Recogniser]:
    """All recognisers that a benchmark needs (``kinds_of``), by kind.

    Raises:
        UserError: one is missing or damaged, or was trained on other data than the benchmark's.
    """
    command = f"refine train recogniser small --benchmark {benchmark.folder}"
    found = {}
    for kind in kinds_of(benchmark):
        path = place_of(benchmark, kind)
        if not path.with_suffix(".json").is_file():
            raise UserError(path, "there is no such recogniser", f"train it with `{command} --kinds {kind}`")
        tensors, description = read_weights(path, "recogniser")
        if description.get("benchmark", {}).get("hash") != benchmark.hash:
            raise UserError(
                path, "was trained on other data than the benchmark's", f"train it again with `{command} --force`"
            )
        found[kind] = build(path, tensors, description)
    return found


def named(benchmark: Benchmark) -> dict[str, str]:
    return {"name": benchmark.name, "hash": benchmark.hash}


def calibrate(benchmark: Benchmark, legs: Recogniser, arms: Recogniser) -> dict[str, Any]:
    """How often the recognisers of the parts find both actions in compositions that have both, and which actions each
    of them cannot tell apart. For each kind of composition the shares ``legs``, ``arms`` and ``both``, and ``pairs``,
    the share of both for each pair."""
    shares: dict[str, Any] = {"alike": {"legs": legs.config.alike, "arms": arms.config.alike}}
    for kind in compositions_of(benchmark):
        motions = benchmark.compositions(kind)
        labels = [motion.label for motion in motions]
        found = both_actions(legs, arms, torch.stack([motion.six for motion in motions]), labels)
        pairs = {label: [] for label in labels}
        for label, both in zip(labels, found.both.tolist(), strict=True):
            pairs[label].append(both)
        shares[kind] = {name: float(value.double().mean()) for name, value in found._asdict().items()}
        shares[kind]["pairs"] = {label: sum(values) / len(values) for label, values in pairs.items()}
    return shares


def learn(recogniser: Recogniser, lesson: Lesson, config: RecogniserTraining, seed: int, name: str) -> list[dict]:
    """Train with cross-entropy, classes weighing alike, until ``patience`` or ``epochs`` says stop.

    Returns:
        for each pass the mean loss and the accuracy after it, in evaluation mode, on what is learned.

    Raises:
        UserError: a loss that is not finite.
    """
    optimiser = torch.optim.AdamW(recogniser.parameters(), config.learning_rate, weight_decay=config.weight_decay)
    weight = weights_of(lesson).to(config.device)
    passes = math.ceil(lesson.clips / config.batch)
    rates = LoopConfig(
        steps=config.epochs * passes,
        learning_rate=config.learning_rate,
        warmup=config.epochs * passes // 5 if config.schedule == "cosine" else 0,
        schedule=config.schedule,
    )
    half = torch.autocast(torch.device(config.device).type, torch.bfloat16, config.precision == "bfloat16")
    random, history, in_a_row = torch.Generator(), [], 0
    progress = tqdm(range(config.epochs), desc=name, disable=None)
    for epoch in progress:
        random.manual_seed(seed_of(seed, epoch))
        six, classes = lesson.draw(random)
        parts = torch.randperm(len(six), generator=random).split(config.batch)
        losses = []
        recogniser.train()
        for step, part in enumerate(parts, start=epoch * passes):
            optimiser.param_groups[0]["lr"] = learning_rate(step, rates)
            seen = disturb(six[part], config.noise, random).to(config.device)
            with half:
                logits = recogniser(seen)
            loss = nn.functional.cross_entropy(logits.float(), classes[part].to(config.device), weight)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            losses.append(float(loss.detach()))
        if not math.isfinite(sum(losses)):
            raise UserError(f"recogniser {name!r}", f"the loss of pass {epoch} is not finite", "lower --learning-rate")
        with half:
            share = accuracy(recogniser.eval(), lesson.learned)
        history.append({"loss": sum(losses) / len(losses), "accuracy": share})
        progress.set_postfix(accuracy=f"{share:.1%}")
        in_a_row = in_a_row + 1 if share == 1 else 0
        if in_a_row == config.patience:
            break
    return history


def weights_of(lesson: Lesson) -> Tensor:
    """[C] for the loss, so that every class counts alike however many clips it has; their mean over clips is 1."""
    counts = torch.bincount(lesson.learned.classes, minlength=len(lesson.classes))
    return counts.sum() / counts.clamp(min=1) / (counts > 0).sum()


def fit_last_layer(recogniser: Recogniser, lesson: Lesson, steps: int):
    """Let the last layer name what is learned by features that stay as they are.

    Disturbed clips keep a network from naming those that hardly differ; a linear layer on its features can, and what
    the metrics compare is still not upset by a tremor.
    """
    last = recogniser.eval().classify
    device = last.weight.device
    features = features_of(recogniser, lesson.learned.six).features.to(device, last.weight.dtype)
    classes, weight = lesson.learned.classes.to(device), weights_of(lesson).to(device)
    optimiser = torch.optim.AdamW(last.parameters(), lr=1e-2)
    for _ in range(steps):
        loss = nn.functional.cross_entropy(last(features), classes, weight)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()


def disturb(six: Tensor, noise: float, random: torch.Generator) -> Tensor:
    """Clips [N T 24 6] whose joints are turned a little: by the same in all frames of a clip, and anew in each.

    Args:
        noise: radians, small; the standard deviation of either is drawn for each clip as noise * U(0, 1) squared, so
            that many clips stay nearly clean. 0 changes nothing.
    """
    if not noise:
        return six
    of_clip, of_frame = noise * torch.rand(2, len(six), 1, 1, 1, generator=random).square()
    turns = of_clip * torch.randn(len(six), 1, *six.shape[2:3], 3, generator=random)
    turns = turns + of_frame * torch.randn(*six.shape[:3], 3, generator=random)
    rows = six.unflatten(-1, (2, 3))
    # A small turn to first order, then orthonormal again: much cheaper than the matrix of every turn.
    rows = rows + torch.linalg.cross(turns[..., None, :].expand_as(rows), rows)
    return matrix_to_6d(matrix_from_6d(rows.flatten(-2)))


def accuracy(recogniser: Recogniser, examples: Examples) -> float:
    """Share of examples that are named rightly, or by a class that is alike."""
    return float(recogniser.names(features_of(recogniser, examples.six).logits, examples.classes).double().mean())


def confusion(recogniser: Recogniser, examples: Examples) -> Tensor:
    """[C C] how many examples of each class (row) are taken for each (column)."""
    count = len(recogniser.config.classes)
    taken = features_of(recogniser, examples.six).logits.argmax(1)
    return torch.bincount(examples.classes * count + taken, minlength=count**2).reshape(count, count)


def alike(mistaken: Tensor, classes: tuple[str, ...], share: float) -> tuple[tuple[str, ...], ...]:
    """Groups of classes of which, two by two, at least ``share`` of the examples are mistaken for the other.

    Args:
        mistaken: [C C], see ``confusion``. The class "other" is never alike.
    """
    groups = [[name] for name in classes]
    for a, first in enumerate(classes):
        for b, second in enumerate(classes[:a]):
            between, all_of = mistaken[a, b] + mistaken[b, a], mistaken[[a, b]].sum()
            if OTHER not in (first, second) and all_of and between >= share * all_of:
                mine, its = (next(group for group in groups if name in group) for name in (first, second))
                if mine is not its:
                    its += mine
                    groups.remove(mine)
    return tuple(tuple(sorted(group, key=classes.index)) for group in groups if len(group) > 1)
