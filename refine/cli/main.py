"""``refine``: reads the command line, runs the verb, and words what went wrong in one line."""

import os
import sys
from collections.abc import Sequence

from tyro.conf import CascadeSubcommandArgs, FlagCreatePairsOff
from tyro.extras import SubcommandApp

from refine.cli.check_renderer import CheckRenderer
from refine.cli.compose import Compose
from refine.cli.data import BuildBenchmark, ImportData
from refine.cli.demo import Demo
from refine.cli.evaluate import Evaluate
from refine.cli.generate import Generate
from refine.cli.inspect import Inspect
from refine.cli.render import Render
from refine.cli.train import TrainGenerator, TrainMAE
from refine.cli.train_recogniser import TrainRecogniser
from renderers.checks import UserError

DESCRIPTION = "Compose two human actions into one motion and refine it with a differentiable renderer in the loop."


def verbs() -> SubcommandApp:
    """Every verb's flags. Their modules are light: what a verb works with it imports when it runs."""
    app, data, train = SubcommandApp(), SubcommandApp(), SubcommandApp()
    data.command(ImportData, name="import")
    data.command(BuildBenchmark, name="benchmark")
    train.command(TrainMAE, name="mae")
    train.command(TrainGenerator, name="generator")
    train.command(TrainRecogniser, name="recogniser")
    app.command(Demo, name="demo")
    app.command(Compose, name="compose")
    app.command(Inspect, name="inspect")
    app.command(Render, name="render")
    app.command(data, name="data", help="Prepare motion data.\n\nExample: refine data import clips --out clips.npz")
    app.command(train, name="train", help="Train the networks.\n\nExample: refine train mae tiny --out runs/mae")
    app.command(Generate, name="generate")
    app.command(Evaluate, name="evaluate")
    app.command(CheckRenderer, name="check-renderer")
    return app


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command: 0 when it is done, 1 when it found what it checks wanting, 2 for what the user can mend, 130
    after Ctrl-C."""
    try:
        verb = verbs().cli(
            prog="refine", description=DESCRIPTION, args=argv, config=(FlagCreatePairsOff, CascadeSubcommandArgs)
        )
        check_seed(verb.seed)
        code = verb.run()
        sys.stdout.flush()
    except KeyboardInterrupt:
        return fail("stopped; nothing half-written is left", 130)
    except UserError as error:
        return fail(str(error), 2)
    except BrokenPipeError:  # whoever read our lines has enough of them, as in `refine demo | head -1`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        if error.filename is None:
            raise
        return fail(f"{error.filename}: {error.strerror}", 2)
    return code or 0


def check_seed(seed: int | None) -> None:
    """Refuse what some of the random generators would."""
    if seed is not None and not 0 <= seed < 2**32:
        raise UserError("--seed", f"expected 0 to {2**32 - 1}, got {seed}")


def fail(message: str, code: int) -> int:
    print("refine:", " ".join(message.split()), file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
