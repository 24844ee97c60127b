"""``refine``: runs the verb that is asked for, and words what went wrong in one line.

What it works with is imported in `main`: Ctrl-C is one line even while that takes its time.
"""

import errno
import os
import sys
from collections.abc import Sequence

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # where a write finds no room, errors name no file


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command: 0 when it is done, 1 when it found what it checks wanting, 2 for what the user can mend, 130
    after Ctrl-C."""
    open_streams()
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
        drop_output()
        return 0
    except OSError as error:
        if error.errno in FULL and error.filename is None:
            drop_output()
            return fail(f"the output cannot be written ({error.strerror}); make room, or write elsewhere", 2)
        if error.filename is None:
            raise
        return fail(f"{error.filename}: {error.strerror}", 2)
    return result.code if isinstance(result, Result) else result or 0


def open_streams() -> None:
    """Stand in for standard streams that whoever started us has closed: they are empty, and what they get is lost."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115 - for as long as we run


def drop_output() -> None:
    """Lose what standard output still holds, which Python would try to write once more at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def fail(message: str, code: int) -> int:
    from renderers.checks import printable

    print("refine:", printable(" ".join(message.split())), file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
