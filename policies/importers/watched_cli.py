"""Start of policy-import in a process that is watched."""

from functools import partial

from deploy.start import start
from policies.importers.untrusted.watched_process import run_watched


def cli() -> None:
    """Entry point of `policy-import`."""
    run_watched(partial(start, "policies.importers.cli"))
