"""What all commands share: exit codes, and where a mistake is said."""

import sys
from collections.abc import Callable
from typing import Any

import typer
from typer.exceptions import TyperException

from robots.errors import FirstshiftError

PASSED, BUDGET_EXCEEDED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


def main(command: Callable[..., int]) -> None:
    """Run one command line: the function's result, or its error, becomes the exit code.

    `command` has typer's annotations and returns an exit code. A `FirstshiftError` is printed to standard error
    and exits with 2; Ctrl-C that the command did not handle itself exits with 130.
    """
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
    app.command()(command)
    sys.exit(exit_code(app))


def exit_code(call: Callable[..., Any]) -> int:
    """The exit code of a typer application run without its own error handling."""
    try:
        return int(call(standalone_mode=False) or PASSED)
    except FirstshiftError as e:
        print(f"error: {e}", file=sys.stderr)
        return BAD_INPUT
    except TyperException as e:
        e.show()
        return BAD_INPUT
    except (typer.Abort, KeyboardInterrupt):
        return INTERRUPTED
