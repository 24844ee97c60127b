"""Writes what docs/commands/ and docs/README.md take from the code: flags, printed output, pictures, the index.

Run as ``python tools/write_commands.py``: the tables of flags and of commands are written anew; a test asks for that
after a change of flags. With ``--run FOLDER`` the commands of every ```console block are run in that folder, one page
after the other, and what they print replaces what is there; then the pictures are drawn from what they left. That takes
half an hour on two cores. ``--only PAGE...`` runs some of the pages in a folder where the others have run; ``--draw``
draws the pictures alone.
"""

import argparse
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from refine.cli.grammar import Command, Flag, grammar
from refine.cli.verbs import VERBS

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
COMMANDS, PICTURES = DOCS / "commands", DOCS / "commands" / "pictures"
BLOCK = re.compile(r"(<!-- (?P<what>[a-z]+) -->\n).*?(<!-- end -->)", re.DOTALL)
CONSOLE = re.compile(r"```console\n(?P<lines>.*?)```", re.DOTALL)
SHOWN = re.compile(r"```(?:console|text)\n(.*?)```", re.DOTALL)
COLUMNS = 110  # of a terminal that is drawn
WIDTH, HEAVIEST = 900, 120_000  # pixels, bytes
MONOSPACED = "DejaVuSansMono.ttf"
COLOURS = {"ok": "#3fb950", "missing": "#d29922", "broken": "#f85149"}
PAPER, INK, PROMPT = "#0d1117", "#e6edf3", "#58a6ff"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--run", type=Path, metavar="FOLDER", help="run the examples here, and draw the pictures")
    parser.add_argument("--only", nargs="+", default=[], metavar="PAGE", help="with --run: these pages alone")
    parser.add_argument("--draw", action="store_true", help="with --run: draw the pictures of what is there")
    flags = parser.parse_args()
    for path, text in written().items():
        path.write_text(text)
    if flags.run:
        flags.run.mkdir(parents=True, exist_ok=True)
        PICTURES.mkdir(exist_ok=True)
        for command in verbs():
            name = page_name(command)
            if not flags.only or name in flags.only:
                print(name, flush=True)
                path = COMMANDS / f"{name}.md"
                if not flags.draw:
                    path.write_text(CONSOLE.sub(lambda block: rerun(block["lines"], flags.run), path.read_text()))
                save_small(DRAWN[name](flags.run), PICTURES / f"{name}.png")


# --- text ------------------------------------------------------------------------------------------------------------


def verbs() -> list[Command]:
    """Every verb, in the order of ``--help``, which is one in which the examples can be run."""
    return [command for command in grammar(VERBS).every() if command.flags and not is_preset(command)]


def is_preset(command: Command) -> bool:
    return command.name.startswith("train ") and command.name.count(" ") == 2


def page_name(command: Command) -> str:
    return command.name.replace(" ", "-")


def written() -> dict[Path, str]:
    """The pages with their tables as the code has them."""
    pages = {COMMANDS / f"{page_name(command)}.md": {"flags": flags_table(command)} for command in verbs()}
    pages[DOCS / "README.md"] = {"commands": commands_table()}
    return {
        path: BLOCK.sub(lambda block, made=made: f"{block[1]}{made[block['what']]}\n{block[3]}", path.read_text())
        for path, made in pages.items()
    }


def commands_table() -> str:
    rows = ["| command | what it does |", "|---|---|"]
    for command in verbs():
        link = f"[`refine {command.name}`](commands/{page_name(command)}.md)"
        rows.append(f"| {link} | {cell(first_line(command.said))} |")
    return "\n".join(rows)


def first_line(said: str) -> str:
    """The first paragraph, as one line."""
    return " ".join(said.partition("\n\n")[0].split())


def flags_table(command: Command) -> str:
    """A row a flag; of a verb with presets, a row for these, and what each of them has."""
    rows = ["| flag | what it is | unless given |", "|---|---|---|"]
    rows += [row(flag, given(flag.default)) for flag in command.flags]
    presets = {name: {flag.names: flag for flag in preset.flags} for name, preset in command.commands.items()}
    if presets:
        every = {key: flag for flags in presets.values() for key, flag in flags.items()}
        rows.insert(2, f"| the preset | {explained(command)} | has to be given |")
        for key, flag in every.items():
            defaults = {name: flags[key].default for name, flags in presets.items() if key in flags}
            rows.append(row(flag, unless(defaults, everywhere=len(defaults) == len(presets))))
    return "\n".join(rows)


def explained(command: Command) -> str:
    return "<br>".join(f"`{name}`: {cell(first_line(preset.said))}" for name, preset in command.commands.items())


def row(flag: Flag, default: str) -> str:
    return f"| {typed(flag)} | {cell(flag.said)} | {default} |"


def typed(flag: Flag) -> str:
    """As one types it."""
    value = f" *{', '.join(flag.choices)}*{' ...' if flag.many else ''}" if flag.choices else ""
    if flag.positional:
        return f"`{flag.names[0]}{' ...' if flag.many else ''}`{value}"
    shown = "" if flag.choices or not flag.value else f" {flag.value}"
    return ", ".join(f"`{name}{shown}`" for name in flag.names) + value


def given(default: str | None) -> str:
    return "has to be given" if default is None else f"`{default}`" if default not in ("none", "on", "off") else default


def unless(defaults: dict[str, str | None], everywhere: bool = True) -> str:
    """One default, or those that each preset has; a switch may be another one in another preset."""
    if everywhere and len(set(defaults.values())) == 1:
        return given(next(iter(defaults.values())))
    return ", ".join(f"{given(default)} ({name})" for name, default in defaults.items())


def cell(text: str) -> str:
    return text.replace("``", "`").replace("|", "\\|").replace("<", "&lt;")


# --- examples --------------------------------------------------------------------------------------------------------


def rerun(lines: str, folder: Path) -> str:
    """The block with what its commands print now; stops at a command that fails, unless the page says its exit code."""
    made = ""
    for line in lines.splitlines():
        if line.startswith("$ "):
            made += f"{line}\n{printed(line[2:], folder)}"
    return f"```console\n{made}```"


def printed(command: str, folder: Path) -> str:
    paths = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    environment = os.environ | {"PATH": paths, "OMP_NUM_THREADS": "1", "NO_COLOR": "1", "COLUMNS": "100"}
    done = subprocess.run(
        ["bash", "-c", command], cwd=folder, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True
    )
    if done.returncode and "echo $?" not in command:
        sys.exit(f"{command} ended with {done.returncode}: {done.stderr}")
    return done.stdout + done.stderr


# --- pictures --------------------------------------------------------------------------------------------------------


def save_small(picture: Image.Image, path: Path) -> None:
    """A PNG of at most WIDTH pixels' width and HEAVIEST bytes: of fewer colours, then smaller, until it fits."""
    picture = picture.convert("RGB")
    width = min(WIDTH, picture.width)
    while True:
        small = picture.resize((width, round(picture.height * width / picture.width)), Image.Resampling.LANCZOS)
        for colours in (256, 128, 64):
            small.quantize(colours, dither=Image.Dither.NONE).save(path, optimize=True)
            if path.stat().st_size <= HEAVIEST:
                return
        width = round(width * 0.9)


def stored(name: str) -> Callable[[Path], Image.Image]:
    """A picture that a command left; the first that matches."""
    return lambda folder: Image.open(sorted(folder.glob(name))[0])


def rendered(*words: str) -> Callable[[Path], Image.Image]:
    """What ``refine render`` draws of a file that a command left."""

    def draw(folder: Path) -> Image.Image:
        out = folder / "drawn.png"
        command = [sys.executable, "-m", "refine.cli.main", "render", *words, "-o", str(out), "--force", "--quiet"]
        subprocess.run(command, cwd=folder, check=True)
        return Image.open(out)

    return draw


def compositions(folder: Path) -> Image.Image:
    """Two actions of a benchmark, their composition by the mask operator, and the true one."""
    from refine.drawing import strip
    from refine.formats.clips import load_clips
    from renderers.body import Body
    from renderers.images import contact_sheet, save_png

    masks, truths = (load_clips(folder / "synth-c" / f"{name}.npz") for name in ("mask", "true"))
    chosen = [number for number, motion in enumerate(masks) if motion.label.startswith("walk")][:1] or [0]
    motions = [each for number in chosen for each in (masks[number], truths[number])]
    rows = [[row] for row in strip(motions, Body.free("full"), poses=8, height=200)]
    captions = [f"{motion.label}, {how}" for motion, how in zip(motions, ("by energies", "true"), strict=True)]
    save_png(folder / "drawn.png", contact_sheet(rows, captions))
    return Image.open(folder / "drawn.png")


def described(folder: Path) -> Image.Image:
    """A few clips of a set, each with two of its descriptions."""
    from refine.drawing import strip
    from refine.text.corpus import load_corpus
    from refine.text.sentences import combine
    from renderers.body import Body
    from renderers.images import contact_sheet, save_png

    items = {item.key: item for item in load_corpus(folder / "texts")}
    chosen = [items[key] for key in ("drink-000", "walk-000", "walk+drink-train-000")]
    rows = [[row] for row in strip([item.motion for item in chosen], Body.free("full"), poses=8, height=200)]
    captions = ["; ".join(f'"{combine(said)}"' for said in item.phrasings[:2]) for item in chosen]
    save_png(folder / "drawn.png", contact_sheet(rows, captions))
    return Image.open(folder / "drawn.png")


def terminal(page: str, first: int = 0, lines: int = 40) -> Callable[[Path], Image.Image]:
    """What the first blocks of a page show, as on a terminal."""

    def draw(_: Path) -> Image.Image:
        shown = "\n".join(SHOWN.findall((COMMANDS / f"{page}.md").read_text())).splitlines()[first : first + lines]
        block = [line if len(line) <= COLUMNS else f"{line[: COLUMNS - 1]}…" for line in shown]
        font, height = ImageFont.truetype(MONOSPACED, 13), 18
        width = max(font.getlength(line) for line in block)
        picture = Image.new("RGB", (round(width) + 32, height * len(block) + 24), PAPER)
        pen = ImageDraw.Draw(picture)
        for number, line in enumerate(block):
            word = line.split(maxsplit=1)[0] if line.strip() else ""
            colour = PROMPT if line.startswith("$ ") else INK
            place = (16, 12 + number * height)
            pen.text(place, line, colour, font)
            if word in COLOURS and line.startswith("  "):
                pen.text(place, f"  {word}", COLOURS[word], font)
        return picture

    return draw


DRAWN: dict[str, Callable[[Path], Image.Image]] = {
    "demo": stored("refine-demo/motions.png"),
    "compose": rendered("both.bvh", "--poses", "8", "--size", "230"),
    "inspect": stored("pictures/stages-*-refined.png"),
    "render": stored("strobe.png"),
    "view": lambda _: Image.open(DOCS / "viewer.png"),
    "export": stored("both-strobe.png"),
    "data-inspect": lambda _: Image.open(DOCS / "data.png"),
    "data-import": rendered("clips/squat_001.bvh", "--poses", "8", "--size", "230"),
    "data-benchmark": compositions,
    "data-texts": described,
    "text-parts": terminal("text-parts"),
    "train-mae": stored("runs/mae/curves.png"),
    "train-generator": stored("runs/generator/curves.png"),
    "train-recogniser": terminal("train-recogniser"),
    "train-text": stored("runs/text/curves.png"),
    "train-text-scorer": stored("runs/text-scorer/curves.png"),
    "train-text-diffusion": stored("runs/diffusion/curves.png"),
    "generate": stored("motions/motions.png"),
    "evaluate": terminal("evaluate", first=8, lines=25),
    "check-renderer": stored("check/sheet.png"),
    "doctor": terminal("doctor"),
    "completion": terminal("completion"),
}


if __name__ == "__main__":
    main()
