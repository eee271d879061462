"""Start of a command line: Ctrl-C while its modules are imported, which takes a second or more, ends it quietly."""

import sys
from functools import partial
from importlib import import_module

INTERRUPTED = 130
"""Exit code after Ctrl-C."""


def start(module: str) -> None:
    """Import the module of a command line, and run its `cli`."""
    try:
        cli = import_module(module).cli
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    cli()


deploy_check = partial(start, "deploy.commissioning.cli")
deploy_run = partial(start, "deploy.operation.cli")
