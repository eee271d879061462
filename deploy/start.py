"""Start of a command line: Ctrl-C while its modules are imported, which takes a second or more, ends it quietly.

It then ends at once, without cleaning up: nothing is open yet.
"""

import io
import os
import signal
import sys
from functools import partial
from importlib import import_module

INTERRUPTED = 130
"""Exit code after Ctrl-C."""
FAIL = ("strict", "surrogateescape")
"""Handlers by which standard output fails at a letter that it cannot show: the default ones."""


def start(module: str) -> None:
    """Import the module of a command line, and run its `cli`."""
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors in FAIL:
        sys.stdout.reconfigure(errors="backslashreplace")  # as standard error
    by_default = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if by_default:  # an exception could be raised inside a C extension, which makes another one of it
        signal.signal(signal.SIGINT, lambda *_: os._exit(INTERRUPTED))
    cli = import_module(module).cli
    if by_default:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    cli()


deploy_check = partial(start, "deploy.commissioning.cli")
deploy_run = partial(start, "deploy.operation.cli")
