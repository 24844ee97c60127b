"""Every verb on tiny data: what it writes, what it says, what it refuses."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from refine.cli.main import main
from refine.formats.clips import load_clips
from refine.formats.files import load_motion, save_motion
from refine.mae import MAE, MAEConfig
from refine.motion import resample
from refine.synthetic import draw, perform
from renderers.body import Body
from renderers.skeleton import PARTS
from train.checkpoints import save_weights


@pytest.fixture(scope="module")
def rest_joints() -> torch.Tensor:
    return Body.free("light").rest_joints


@pytest.fixture(scope="module")
def clips(tmp_path_factory, rest_joints, free_body) -> Path:
    """A folder with a walk of 12 frames and a wave of 9, both at 30 fps, and the walk at 15 fps."""
    folder = tmp_path_factory.mktemp("clips")
    for name, frames in (("walk", 12), ("wave-left-hand", 9)):
        motion = perform(draw(name, torch.Generator().manual_seed(3), 30.0), frames, rest_joints)
        save_motion(motion, folder / f"{name}.bvh", free_body)
        if name == "walk":
            save_motion(resample(motion, 15.0), folder / "slow.bvh", free_body)
    return folder


@pytest.fixture(scope="module")
def mae(tmp_path_factory) -> str:
    """An untrained MAE, as small as can be."""
    path = tmp_path_factory.mktemp("mae") / "mae.safetensors"
    size = MAEConfig(size=32, width=16, depth=1, heads=1, decoder_width=16, decoder_depth=1, decoder_heads=1)
    with torch.random.fork_rng():
        torch.manual_seed(0)
        save_weights(path, "mae", MAE(size), {})
    return str(path)


def refused(capsys, *arguments) -> str:
    """Run a command that must fail by the user's fault, and return its one line."""
    assert main([str(word) for word in arguments]) == 2
    said = capsys.readouterr().err
    assert said.startswith("refine: ")
    assert said.count("\n") == 1
    return said


# --- compose ---------------------------------------------------------------------------------------------------------


def test_compose_couples_over_the_shorter_clip(clips, tmp_path, capsys, rest_joints):
    out = tmp_path / "new" / "both.bvh"
    assert (
        main(["compose", str(clips / "walk.bvh"), str(clips / "wave-left-hand.bvh"), "-o", str(out), "--steps", "0"])
        == 0
    )
    both = load_motion(out, rest_joints)
    assert (len(both), both.fps) == (9, pytest.approx(30.0))
    assert capsys.readouterr().out.startswith(str(out))
    assert "left_shoulder" in out.read_text()


def test_lambda_one_gives_the_first_clip_and_zero_the_second(clips, tmp_path, rest_joints):
    first, second = (load_motion(clips / f"{name}.bvh", rest_joints) for name in ("walk", "wave-left-hand"))
    for lam, expected in (("1", first), ("0", second)):
        out = str(tmp_path / f"{lam}.npz")
        pair = [str(clips / "walk.bvh"), str(clips / "wave-left-hand.bvh")]
        assert main(["compose", *pair, "-o", out, "--steps", "0", "--lam", lam]) == 0
        found = load_motion(out, rest_joints)
        assert torch.allclose(found.rotations, expected.rotations[:9], atol=2e-3)


def test_another_frame_rate_is_resampled_and_said(clips, tmp_path, capsys, rest_joints):
    out = str(tmp_path / "both.npz")
    assert main(["compose", str(clips / "walk.bvh"), str(clips / "slow.bvh"), "-o", out, "--steps", "0"]) == 0
    assert "slow.bvh has 15 fps, resampled to the 30 fps of" in capsys.readouterr().err
    assert load_motion(out, rest_joints).fps == pytest.approx(30.0)


def test_compose_refines_and_reports(clips, mae, tmp_path, capsys):
    out, report = tmp_path / "both.bvh", tmp_path / "report"
    pair = [str(clips / "walk.bvh"), str(clips / "wave-left-hand.bvh")]
    assert main(["compose", *pair, "-o", str(out), "--steps", "2", "--mae", mae, "--report", str(report)]) == 0
    said = capsys.readouterr().out
    assert "decoupling loss" in said and "A answers for left leg 100%, right leg 100%\nB answers for left arm" in said
    assert json.loads((report / "report.json").read_text())["refinement"]["steps"] == 2
    assert {path.suffix for path in report.iterdir()} == {".png", ".json", ".html"}


def test_a_motion_may_lie_in_its_report_folder(clips, mae, tmp_path, capsys):
    folder = tmp_path / "both"
    pair = [str(clips / "walk.bvh"), str(clips / "wave-left-hand.bvh")]
    command = ["compose", *pair, "-o", str(folder / "both.bvh"), "--report", str(folder), "--steps", "0", "--mae", mae]
    assert main(command) == 0
    assert "refined" not in capsys.readouterr().out
    assert (folder / "both.bvh").is_file() and (folder / "report.html").is_file()
    assert list(json.loads((folder / "report.json").read_text())["decoupling_loss"]) == ["coupled"]


# --- inspect, render -------------------------------------------------------------------------------------------------


def test_inspect_judges_a_given_composition(clips, mae, tmp_path):
    pair, out = [str(clips / "walk.bvh"), str(clips / "wave-left-hand.bvh")], tmp_path / "stages"
    given = ["--composition", pair[0], "-o", str(out), "--mae", mae, "--frames", "2"]
    assert main(["inspect", *pair, *given]) == 0
    report = json.loads((out / "report.json").read_text())
    assert set(report["energies"]["i"]) == set(report["energies"]["j"]) == set(PARTS)
    assert report["energies"]["i"]["left_leg"] > report["energies"]["j"]["left_leg"]
    assert set(report["decoupling_loss"]) == {"coupled", "given"}
    assert len(list(out.glob("stages-*.png"))) == 4
    page = (out / "report.html").read_text()
    assert page.count("<figure><img") == 5
    assert "walk and wave-left-hand" in page


def test_inspect_draws_what_an_official_network_sees(clips, tmp_path):
    torch.manual_seed(0)
    config = MAEConfig(32, 8, 3, 64, 1, 1, decoder_width=32, decoder_depth=1, decoder_heads=1, normalisation="imagenet")
    torch.save({"model": MAE(config).state_dict()}, tmp_path / "mae.pth")
    pair, out = [str(clips / "walk.bvh"), str(clips / "wave-left-hand.bvh")], tmp_path / "stages"
    flags = ["-o", str(out), "--mae", str(tmp_path / "mae.pth"), "--frames", "1", "--steps", "1"]
    assert main(["inspect", *pair, *flags]) == 0
    assert set(json.loads((out / "report.json").read_text())["decoupling_loss"]) == {"coupled", "refined"}
    with Image.open(next(out.glob("stages-*-refined.png"))) as picture:
        red, green, blue = np.moveaxis(np.asarray(picture).astype(int), -1, 0)
    assert ((red > 90) & (green < 10) & (blue < 10)).sum() > 50  # a left arm


@pytest.mark.parametrize("style", ["shaded", "parts", "silhouette"])
def test_render_draws_a_strip(clips, tmp_path, style):
    out = tmp_path / "walk.png"
    arguments = ["--size", "64", "--poses", "3", "--style", style]
    assert main(["render", str(clips / "walk.bvh"), "-o", str(out), *arguments]) == 0
    with Image.open(out) as picture:
        assert picture.height == 64
        assert np.asarray(picture).std() > 10


def test_render_films_in_real_time(clips, tmp_path):
    import av

    out = tmp_path / "walk.mp4"
    assert main(["render", str(clips / "walk.bvh"), "-o", str(out), "--size", "48", "--fps", "10"]) == 0
    with av.open(str(out)) as movie:
        assert len(list(movie.decode(video=0))) == 4
    assert main(["render", "squat", "-o", str(tmp_path / "a.gif"), "--size", "32", "--fps", "1"]) == 0
    with Image.open(tmp_path / "a.gif") as movie:
        assert movie.n_frames == 4


# --- data, train, generate -------------------------------------------------------------------------------------------


def test_import_packs_what_can_be_read_and_names_what_cannot(clips, tmp_path, capsys):
    folder = tmp_path / "clips"
    folder.mkdir()
    for name in ("walk.bvh", "slow.bvh"):
        (folder / name).write_bytes((clips / name).read_bytes())
    (folder / "broken.bvh").write_text("HIERARCHY\nROOT")
    out = tmp_path / "clips.npz"
    assert main(["data", "import", str(folder), "--out", str(out)]) == 0
    said = capsys.readouterr()
    assert "left out" in said.err and "broken.bvh" in said.err
    assert "2 clips, 18 frames" in said.out
    assert [motion.label for motion in load_clips(out)] == ["slow", "walk"]


def test_train_then_generate(mae, tmp_path, capsys, rest_joints):
    run, out = tmp_path / "run", tmp_path / "motions"
    data = ["--data.actions", "walk", "wave-both-hands", "--data.synthetic-clips", "2", "--data.frames", "8"]
    sizes = ["--batch", "2", "--measured", "2", "--loop.steps", "2", "--loop.save-every", "1", "--seed", "5"]
    assert main(["train", "generator", "tiny", "--out", str(run), "--mae", mae, *data, *sizes]) == 0
    assert capsys.readouterr().out.strip() == str(run / "best.safetensors")
    assert json.loads((run / "config.json").read_text())["loop"]["seed"] == 5
    both = ["generate", "--actions", "walk", "wave-both-hands", "--model", str(run)]
    assert main([*both, "-n", "2", "--seconds", "0.5", "-o", str(out)]) == 0
    names = [f"walk+wave-both-hands_00{k}.bvh" for k in range(2)]
    assert sorted(path.name for path in out.iterdir()) == ["motions.png", *names]
    motions = [load_motion(out / name, rest_joints) for name in names]
    assert {motion.label for motion in motions} == {"walk+wave-both-hands"}
    assert [len(motion) for motion in motions] == [15, 15]
    assert (motions[0].rotations - motions[1].rotations).abs().max() > 1e-3
    unknown = ["generate", "--actions", "wlak", "--model", run, "-o", tmp_path / "none"]
    assert "unknown name 'wlak'; did you mean walk?" in refused(capsys, *unknown)
    assert not (tmp_path / "none").exists()


def test_train_mae_writes_weights_that_load(tmp_path):
    network = ["--network.size", "32", "--network.width", "16", "--network.depth", "1", "--network.heads", "1"]
    data = ["--data.actions", "walk", "--data.synthetic-clips", "2", "--data.synthetic-seconds", "0.5"]
    sizes = ["--batch", "2", "--measured", "4", "--loop.steps", "1"]
    assert main(["train", "mae", "tiny", "--out", str(tmp_path / "run"), *network, *data, *sizes]) == 0
    from refine.mae import load_mae

    assert load_mae(tmp_path / "run" / "best.safetensors").config.size == 32


# --- demo ------------------------------------------------------------------------------------------------------------


def test_demo_writes_everything_it_names(mae, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("refine.cli.demo.FILM_SIZE", (40, 32))
    out = tmp_path / "demo"
    assert main(["demo", "--out", str(out), "--seconds", "0.3", "--steps", "1", "--mae", mae]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("walk + wave-left-hand, 9 frames")
    assert all(Path(line).is_file() for line in said if line.startswith(str(out)))
    report = json.loads((out / "report.json").read_text())
    assert 0 < report["metres_from_true_composition"]["coupled"] < 1
    assert {path.name for path in out.iterdir()} >= {"report.html", "film.mp4", "motions.png", "composition.bvh"}


# --- what is refused -------------------------------------------------------------------------------------------------

ZEROS = np.zeros((4, 156))
NOT_A_NUMBER = np.where(np.arange(4 * 156).reshape(4, 156) == 200, np.nan, 0.0)


@pytest.fixture
def broken(tmp_path, clips) -> dict[str, Path]:
    """A file for each way in which a motion can be broken."""
    bvh = (clips / "walk.bvh").read_text()
    head, _, values = bvh.partition("MOTION")
    lines = values.splitlines()
    contents = {
        "empty.bvh": "",
        "blank.npz": "",
        "truncated.bvh": bvh[: len(bvh) // 2],
        "cut-short.bvh": "\n".join(bvh.splitlines()[:-3]) + "\n",
        "novel.bvh": "It was a dark and stormy night.\n",
        "novel.txt": "It was a dark and stormy night.\n",
        "nan.bvh": bvh.replace(lines[-1], lines[-1].replace(lines[-1].split()[5], "nan", 1)),
        "no-frames.bvh": head + "MOTION\nFrames: 0\nFrame Time: 0.0333333\n",
        "one-frame.bvh": "\n".join([head + "MOTION", "Frames: 1", *lines[2:4]]) + "\n",
    }
    for name, content in contents.items():
        (tmp_path / name).write_text(content)
    np.savez(tmp_path / "nan.npz", poses=NOT_A_NUMBER, trans=np.zeros((4, 3)), mocap_framerate=30.0)
    np.savez(tmp_path / "no-frames.npz", poses=ZEROS[:0], trans=np.zeros((0, 3)), mocap_framerate=30.0)
    np.savez(tmp_path / "one-frame.npz", poses=ZEROS[:1], trans=np.zeros((1, 3)), mocap_framerate=30.0)
    np.savez(tmp_path / "other.npz", pixels=np.zeros(4))
    return {path.name: path for path in tmp_path.iterdir()}


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("empty.bvh", "is empty"),
        ("blank.npz", "is empty"),
        ("truncated.bvh", "truncated.bvh"),
        ("cut-short.bvh", "12"),
        ("novel.bvh", "novel.bvh"),
        ("novel.txt", "is not a motion file"),
        ("nan.bvh", "nan"),
        ("nan.npz", "frame 1"),
        ("no-frames.bvh", "no-frames.bvh"),
        ("no-frames.npz", "no-frames.npz"),
        ("one-frame.bvh", "has a single frame"),
        ("one-frame.npz", "has a single frame"),
        ("other.npz", "other.npz"),
        ("missing.bvh", "cannot be read"),
    ],
)
def test_a_broken_motion_is_named_in_one_line(broken, clips, tmp_path, capsys, name, place):
    out = tmp_path / "outputs" / "both.bvh"
    path = broken.get(name, tmp_path / name)
    said = refused(capsys, "compose", clips / "walk.bvh", path, "-o", out, "--steps", "0")
    assert name in said and place in said and "; " in said
    assert not out.parent.exists()


def test_outputs_that_are_there_are_refused_before_any_work(clips, tmp_path, capsys):
    taken, packed, folder = tmp_path / "taken.bvh", tmp_path / "taken.npz", tmp_path / "folder"
    for file in (taken, packed):
        file.write_text("mine")
    folder.mkdir()
    (folder / "mine").write_text("")
    pair = [clips / "walk.bvh", clips / "wave-left-hand.bvh"]
    for command in (
        ["compose", *pair, "-o", taken],
        ["compose", *pair, "-o", tmp_path / "free.bvh", "--report", folder],
        ["inspect", *pair, "-o", folder],
        ["demo", "--out", folder],
        ["data", "import", clips, "--out", packed],
        ["generate", "--actions", "walk", "--model", tmp_path, "-o", folder],
    ):
        assert "is already there; choose another name or pass --force" in refused(capsys, *command)
    assert taken.read_text() == "mine"
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["folder", "mine", "taken.bvh", "taken.npz"]
    assert main(["compose", *map(str, pair), "-o", str(taken), "--steps", "0", "--force"]) == 0
    assert taken.read_text().startswith("HIERARCHY")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["compose", "wlk", "wave-left-hand", "-o", "a.bvh"], "unknown name 'wlk'; did you mean walk"),
        (["compose", "walk", "squat", "-o", "a.fbm"], "a.fbm: no motion format has the suffix '.fbm'"),
        (["compose", "walk", "squat", "-o", "a.bvh", "--lam", "2"], "--lam: expected a weight between 0 and 1, got 2"),
        (["compose", "walk", "squat", "-o", "a.bvh", "--steps", "-1"], "--steps: expected 0 or more"),
        (["compose", "walk", "squat", "-o", "a.bvh", "--mae", "none.safetensors"], "none.safetensors: no such file"),
        (["compose", "walk", "squat", "-o", "a.bvh", "--body", "none.npz"], "none.npz"),
        (["compose", "walk", "squat", "-o", "a.bvh", "--report", "a.bvh"], "cannot be a folder while a.bvh is a file"),
        (["compose", "walk", "squat", "-o", "a.bvh", "--seed", str(10**30)], "--seed: expected 0 to 4294967295"),
        (["inspect", "walk", "squat", "-o", "a", "--frames", "0"], "--frames: expected 1 to 100, got 0"),
        (["inspect", "walk", "squat", "-o", "a", "--lam", "2"], "--lam: expected a weight between 0 and 1, got 2"),
        (["inspect", "walk", "squat", "-o", "."], ".: is no name for an output; name a new folder"),
        (["render", "walk", "-o", "a.png", "--yaw", "nan"], "--yaw: expected degrees, got nan"),
        (["demo", "--seconds", "nan"], "--seconds: expected 0.1 to 60, got nan"),
        (["data", "import", ".", "--out", "a.txt"], "a.txt: packed clips are an .npz file"),
        (["train", "mae", "tiny", "--loop.steps", "0"], "LoopConfig(steps): expected 1 or more, got 0"),
        (["train", "mae", "tiny", "--batch", "0"], "MAETraining(batch): expected 1 or more, got 0"),
        (["train", "mae", "tiny", "--loop.seed", "-1"], "LoopConfig(seed): expected 0 to"),
        (["train", "mae", "tiny", "--data.held-out", "2"], "DataConfig(held_out): expected 0 to 0.9, got 2"),
        (["train", "mae", "tiny", "--pictures.kept", "nan"], "PictureConfig(kept): expected 0.01 to 0.99, got nan"),
        (["train", "mae", "tiny", "--network.patch", "0"], "MAEConfig(patch): expected 1 to 4096, got 0"),
        (["train", "mae", "tiny", "--network.size", "60"], "a picture of 60 px has no whole patches of 8 px"),
        (["train", "mae", "tiny", "--network.channels", "2"], "3 (colours) or 6 (parts) channels, not 2"),
        (
            ["train", "mae", "tiny", "--network.channels", "1"],
            "limbs on a straight trunk need a channel for each part, not 1",
        ),
        (["train", "mae", "tiny", "--out", "/dev/null/run"], "cannot be written (/dev/null is a file)"),
        (["train", "mae", "tiny", "--network.heads", "5"], "MAEConfig(width): 96 is not divisible by 4 and by 5 heads"),
        (["train", "generator", "tiny", "--loss.decoupling-frames", "99"], "99 of 60 frames cannot be drawn"),
        (["render", "walk", "-o", "a.jpg"], "a.jpg: unknown picture format; end it in .png, .gif or .mp4"),
        (["render", "walk", "-o", "a.png", "--size", "1"], "size must be 32 to 2160"),
        (["demo", "--actions", "walk", "fly"], "unknown name 'fly'"),
        (["data", "import", "nowhere", "--out", "a.npz"], "nowhere: does not exist"),
        (["generate", "--actions", "walk", "--model", "nowhere", "-o", "a"], "nowhere"),
        (["generate", "--actions", "walk", "--model", "m", "-o", "a", "-n", "0"], "-n: expected 1 to 1000, got 0"),
    ],
)
def test_a_mistake_costs_one_line_and_leaves_nothing(tmp_path, monkeypatch, capsys, arguments, said):
    monkeypatch.chdir(tmp_path)
    assert said in refused(capsys, *arguments)
    assert not list(tmp_path.iterdir())


VERBS = ("demo", "compose", "inspect", "render", "data import", "train mae", "train generator", "generate")


@pytest.mark.parametrize("verb", VERBS)
def test_help_shows_an_example_and_a_seed(capsys, verb):
    with pytest.raises(SystemExit) as stopped:
        main([*verb.split(), "--help"])
    assert stopped.value.code == 0
    said = capsys.readouterr().out
    assert f"Example: refine {verb}" in " ".join(said.split())
    assert "--seed" in said


def test_an_interrupt_is_one_line_and_130(clips, tmp_path, capsys, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("refine.formats.files.save_motion", interrupted)
    pair = [str(clips / "walk.bvh"), str(clips / "wave-left-hand.bvh")]
    assert main(["compose", *pair, "-o", str(tmp_path / "a.bvh"), "--steps", "0"]) == 130
    assert capsys.readouterr().err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def refine(*arguments: str, folder: Path) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "refine.cli.main", *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder)


def test_the_program_itself_composes_from_any_folder(clips, tmp_path):
    done = refine("compose", str(clips / "walk.bvh"), "squat", "-o", "both.npz", "--steps", "0", folder=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == "both.npz  12 frames at 30 fps\n"


def test_the_program_itself_fails_in_one_line(tmp_path):
    done = refine("render", "missing.bvh", "-o", "a.png", folder=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "refine: missing.bvh: cannot be read (No such file or directory); check the path\n"


def test_a_reader_that_leaves_is_no_error(clips, tmp_path):
    command = [sys.executable, "-m", "refine.cli.main", "compose", str(clips / "walk.bvh"), "squat", "-o", "a.bvh"]
    with subprocess.Popen(
        [*command, "--steps", "0"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=tmp_path
    ) as running:
        running.stdout.close()
        assert running.stderr.read() == b""
        assert running.wait() == 0
    assert (tmp_path / "a.bvh").is_file()


def test_a_wrong_flag_is_a_usage_error(tmp_path):
    done = refine("demo", "--otu", "a", folder=tmp_path)
    assert done.returncode == 2
    assert "--out" in done.stderr and "Traceback" not in done.stderr
