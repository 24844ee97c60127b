"""``refine``: runs the verb that is asked for, and words what went wrong in one line.

What it works with is imported in `main`: Ctrl-C is one line even while that takes its time.
"""

import os
import sys
from collections.abc import Sequence


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command: 0 when it is done, 1 when it found what it checks wanting, 2 for what the user can mend, 130
    after Ctrl-C."""
    try:
        return run(sys.argv[1:] if argv is None else list(argv))
    except KeyboardInterrupt:
        return fail("stopped; nothing half-written is left", 130)


def run(argv: Sequence[str]) -> int:
    from refine.cli.results import Output, Result, hushed, show
    from refine.cli.verbs import VERBS, name_of
    from refine.cli.words import check_seed, parsed
    from renderers.checks import UserError

    try:
        verb = parsed(argv)
        check_seed(getattr(verb, "seed", None))
        output = getattr(verb, "output", Output())
        with hushed(output.quiet):
            result = verb.run()
        if isinstance(result, Result):
            show(result, output, name_of(type(verb), VERBS))
        sys.stdout.flush()
    except UserError as error:
        return fail(str(error), 2)
    except BrokenPipeError:  # whoever read our lines has enough of them, as in `refine demo | head -1`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        if error.filename is None:
            raise
        return fail(f"{error.filename}: {error.strerror}", 2)
    return result.code if isinstance(result, Result) else result or 0


def fail(message: str, code: int) -> int:
    from renderers.checks import printable

    print("refine:", printable(" ".join(message.split())), file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
