"""The table of all verbs."""

from dataclasses import dataclass
from typing import Any

from tyro.conf import Positional
from tyro.extras import SubcommandApp

from refine.cli.check_renderer import CheckRenderer
from refine.cli.completion import Shell, script
from refine.cli.compose import Compose
from refine.cli.data import BuildBenchmark, ImportData
from refine.cli.data_texts import DataTexts
from refine.cli.demo import Demo
from refine.cli.doctor import Doctor
from refine.cli.evaluate import Evaluate
from refine.cli.export import Export
from refine.cli.generate import Generate
from refine.cli.grammar import grammar
from refine.cli.inspect import Inspect
from refine.cli.inspect_data import InspectData
from refine.cli.render import Render
from refine.cli.text import TextParts
from refine.cli.train import TrainGenerator, TrainMAE, TrainText, TrainTextDiffusion, TrainTextScorer
from refine.cli.train_recogniser import TrainRecogniser
from refine.cli.view import View

# What is typed: a class whose fields are the verb's flags, or verbs under a common word, with its description in "".
VERBS: dict[str, Any] = {
    "demo": Demo,
    "compose": Compose,
    "inspect": Inspect,
    "render": Render,
    "view": View,
    "export": Export,
    "data": {
        "": "Prepare motion data.\n\nExample: refine data import clips --out clips.npz",
        "inspect": InspectData,
        "import": ImportData,
        "benchmark": BuildBenchmark,
        "texts": DataTexts,
    },
    "text": {
        "": 'Read what describes motions.\n\nExample: refine text parts "walk forwards"',
        "parts": TextParts,
    },
    "train": {
        "": "Train the networks.\n\nExample: refine train mae tiny --out runs/mae",
        "mae": TrainMAE,
        "generator": TrainGenerator,
        "recogniser": TrainRecogniser,
        "text": TrainText,
        "text-scorer": TrainTextScorer,
        "text-diffusion": TrainTextDiffusion,
    },
    "generate": Generate,
    "evaluate": Evaluate,
    "check-renderer": CheckRenderer,
    "doctor": Doctor,
}


@dataclass(frozen=True)
class Completion:
    """Print a script that completes verbs, flags, choices, built-in actions and files when Tab is pressed.

    Its first lines say where to keep it. After an update of Refine, write it anew.

    Example: refine completion bash > ~/.local/share/bash-completion/completions/refine
    """

    shell: Positional[Shell]
    """Which shell."""
    seed: int = 0
    """Taken by every verb; nothing is drawn here."""

    def run(self) -> None:
        from refine.synthetic import ACTIONS

        print(script(self.shell, grammar(VERBS), ACTIONS), end="")


VERBS["completion"] = Completion


def app(verbs: dict[str, Any]) -> SubcommandApp:
    """Every verb's flags. Their modules are light: what a verb works with it imports when it runs."""
    made = SubcommandApp()
    for name, verb in verbs.items():
        if isinstance(verb, dict):
            made.command(app(verb), name=name, help=verb[""])
        elif name:
            made.command(verb, name=name)
    return made


def name_of(verb: type, verbs: dict[str, Any]) -> str:
    """What is typed for a verb, such as "data import"."""
    for name, each in verbs.items():
        if each is verb:
            return name
        if isinstance(each, dict) and (below := name_of(verb, each)):
            return f"{name} {below}"
    return ""
