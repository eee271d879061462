"""Command lines: exit codes, and errors printed on standard error."""

import functools
import signal
import sys
from collections.abc import Callable, Sequence
from itertools import pairwise

import typer

from deploy.operation.interrupts import REQUESTS, handled, interrupt, raised_again
from deploy.start import BAD_INPUT, INTERRUPTED, report_failure
from robots.errors import ConfigError, FirstshiftError, ResultLostError, printable

PASSED, BUDGET_EXCEEDED = 0, 1


def main(*commands: Callable[..., int]) -> None:
    """Run one command line; the function's result, or its error, becomes the exit code.

    An option that typer refuses and a `FirstshiftError` are printed on standard error and exit with 2, a result that
    was lost, and a computer that lacks room on its disk, memory or open files, with 1. Ctrl-C that a command did not
    handle itself, and a request to end, which is taken for Ctrl-C unless it is ignored, exit with 130. Any other
    exception, of firstshift or of a robot's bus, is printed with its traceback and exits with 70, which is no verdict
    about the robot.

    Args:
        commands: functions with typer's annotations that return an exit code. If there are several, the first word of
            the command line names one.
    """
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
    for command in commands:
        app.command()(_guarded(command))
    requests = [each for each in REQUESTS if signal.getsignal(each) is signal.SIG_DFL]
    with handled(interrupt, requests), raised_again():
        try:
            app()
        finally:
            for stream in filter(None, (sys.stdout, sys.stderr)):
                stream.flush()  # now, while a request to end still ends what waits for a reader


def _guarded(command: Callable[..., int]) -> Callable[..., None]:
    @functools.wraps(command)
    def guarded(*args: object, **kwargs: object) -> None:
        def checked() -> int:
            _check_values(sys.argv[1:])
            return command(*args, **kwargs)

        raise typer.Exit(exit_code_of(checked))

    return guarded


def _check_values(words: Sequence[str]) -> None:
    """Refuse (ConfigError) an option without a value: as a path it would be the working directory."""
    for word, following in pairwise((*words, "-")):
        option, equals, value = word.partition("=")
        if option.startswith("--") and not (value if equals else following):
            raise ConfigError(f"{option}: found nothing, expected a value")


def exit_code_of(call: Callable[[], int]) -> int:
    """Run a command; return its exit code, or that of its error, which is printed."""
    try:
        return call()
    except FirstshiftError as e:
        print("\n".join(map(printable, f"error: {e}".split("\n"))), file=sys.stderr)
        return BUDGET_EXCEEDED if isinstance(e, ResultLostError) else BAD_INPUT
    except KeyboardInterrupt:
        return INTERRUPTED
    except Exception as e:
        raise typer.Exit(report_failure(e)) from e
