"""From single actions to a benchmark on disk: windows, compositions, hashes."""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from refine.coupling import CouplingConfig, couple
from refine.formats.clips import load_clips, save_clips
from refine.motion import Motion
from renderers.checks import UserError
from renderers.outputs import replacing_folder
from train.benchmarks import MANIFEST, SCHEMA, SPLITS, Benchmark, load_benchmark, seal, sha256
from train.data import window

LAM = 0.5
NOT_FINITE = "not finite"


@dataclass(frozen=True, eq=False)
class Material:
    """What a benchmark is made of: single actions, already split, and the pairs that are composed.

    Attributes:
        pairs: (i, j) in the order of their compositions.
        train, test, extra: whole clips at ``fps``, each with a source of its own.
        rule: how the clips were chosen and split, in words.
        together: both test clips performed at once, over their whole length; only where there is such a thing.
    """

    name: str
    version: int
    fps: float
    frames: int
    lower: tuple[str, ...]
    upper: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...]
    train: list[Motion]
    test: list[Motion]
    extra: list[Motion]
    rule: str
    together: Callable[[Motion, Motion], Motion] | None = None


def build_benchmark(
    folder: str | Path,
    material: Material,
    rest_joints: Tensor,
    seed: int = 0,
    command: str = "",
    config: CouplingConfig | None = None,
    progress: Callable[[Sequence], Iterable] = iter,
) -> Benchmark:
    """Write a benchmark; the same material and seed give the same bytes. A folder of that name is replaced.

    Of every pair (i, j), each test clip of i meets each of j. A window starts at a frame drawn uniformly among all that
    fit: one for each side, as ACTOR draws them; where both are also performed at once, one for both sides, so that the
    composition by energies and the true one show the same moments. A clip that is shorter than the window stands still
    in its last pose. Windows are canonical: they face +z and begin at x = z = 0.

    Args:
        rest_joints: [24 3] T-pose joints in metres, on which energies are measured.
        command: what builds it again, for the manifest.
        progress: wraps the list of pairs, as ``tqdm`` does.

    Raises:
        UserError: material that does not fit together, or a folder that cannot be written.
    """
    config = config or CouplingConfig()
    _check(material)
    with replacing_folder(folder) as partial:
        files, clips = {}, {}
        for split in SPLITS:
            # What is read back is what everyone else will have, so that is what is composed.
            clips[split] = _packed(partial, files, split, getattr(material, split))
        composed = _compose(material, clips["test"], rest_joints, seed, config, progress)
        _packed(partial, files, "mask", composed.mask)
        _packed(partial, files, "true", composed.true)
        manifest = {
            "schema": SCHEMA,
            "name": material.name,
            "version": material.version,
            "command": command,
            "seed": seed,
            "fps": material.fps,
            "frames": material.frames,
            "lambda": LAM,
            "coupling": asdict(config),
            "rest_joints_sha256": sha256(rest_joints.detach().cpu().float().numpy().tobytes()),
            "rule": material.rule,
            "same_start": material.together is not None,
            "lower": material.lower,
            "upper": material.upper,
            "pairs": material.pairs,
            "files": files,
            "shorter_than_window": {
                split: sum(len(clip) < material.frames for clip in clips[split]) for split in SPLITS
            },
            "padded_compositions": sum(any(side["padded"] for side in (one["i"], one["j"])) for one in composed.made),
            "rejected": dict(sorted(composed.rejected.items())),
            "clips": {split: [_describe(clip) for clip in clips[split]] for split in SPLITS},
            "compositions": composed.made,
        }
        text = json.dumps({**manifest, "sha256": seal(manifest)}, indent=1)
        (partial / MANIFEST).write_text(text + "\n")
    return load_benchmark(folder)


@dataclass(frozen=True, eq=False)
class _Composed:
    mask: list[Motion]
    true: list[Motion]
    made: list[dict[str, Any]]
    rejected: Counter[str]


def _compose(
    material: Material,
    test: list[Motion],
    rest_joints: Tensor,
    seed: int,
    config: CouplingConfig,
    progress: Callable[[Sequence], Iterable],
) -> _Composed:
    random = torch.Generator().manual_seed(seed)
    composed = _Composed([], [], [], Counter({NOT_FINITE: 0}))
    for pair in progress(material.pairs):
        clips_i, clips_j = ([clip for clip in test if clip.label == label] for label in pair)
        for i, j in ((i, j) for i in clips_i for j in clips_j):
            lengths = [min(len(i), len(j))] if material.together else [len(i), len(j)]
            starts = [_start(length, material.frames, random) for length in lengths] * (2 // len(lengths))
            windows = [window(clip, start, material.frames) for clip, start in zip((i, j), starts, strict=True)]
            try:
                mask = couple(windows[0][0], windows[1][0], rest_joints, LAM, config).motion
                true = [_true(material, i, j, starts[0])] if material.together else []
            except UserError:  # frame rates and lengths agree here, so a value was not finite
                composed.rejected[NOT_FINITE] += 1
                continue
            composed.mask.append(mask)
            composed.true.extend(true)
            sides = zip("ij", (i, j), starts, windows, strict=True)
            composed.made.append(
                {
                    side: {"clip": clip.source, "start": start, "padded": material.frames - real}
                    for side, clip, start, (_, real) in sides
                }
            )
    return composed


def _true(material: Material, i: Motion, j: Motion, start: int) -> Motion:
    together, _ = window(material.together(i, j), start, material.frames)
    return replace(together, label=f"{i.label}+{j.label}", source=f"{i.source} + {j.source}")


def _start(length: int, frames: int, random: torch.Generator) -> int:
    return int(torch.randint(max(0, length - frames) + 1, (), generator=random))


def _packed(folder: Path, files: dict[str, Any], name: str, motions: list[Motion]) -> list[Motion]:
    """Write clips, note their file, and read them back."""
    if not motions:
        return []
    path = folder / f"{name}.npz"
    save_clips(path, motions)
    frames = sum(map(len, motions))
    files[path.name] = {"sha256": sha256(path.read_bytes()), "clips": len(motions), "frames": frames}
    return load_clips(path)


def _describe(clip: Motion) -> dict[str, Any]:
    arrays = clip.six.numpy().tobytes() + clip.root.numpy().tobytes()
    return {"source": clip.source, "label": clip.label, "frames": len(clip), "sha256": sha256(arrays)}


def _check(material: Material) -> None:
    """Refuse material that would not make a benchmark."""
    where = material.name
    sources = Counter(clip.source for split in SPLITS for clip in getattr(material, split))
    for source, count in sources.items():
        if count > 1:
            raise UserError(where, f"has {count} clips called {source}", "give every clip a name of its own")
    for label in {label: None for pair in material.pairs for label in pair}:
        for split in ("train", "test"):
            if not any(clip.label == label for clip in getattr(material, split)):
                raise UserError(where, f"has no {split} clips of {label}", "give more clips of it")
