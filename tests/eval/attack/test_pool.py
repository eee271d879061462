"""Worker processes of an attack."""

import signal

import pytest

pytest.importorskip("mujoco")

from deploy.operation.interrupts import SIGNALS
from eval.attack.pool import processes


def test_workers_ignore_the_signals_that_their_parent_handles():
    """From their start on: a terminal sends Ctrl-C to all of them."""
    with processes(1) as pool:
        handlers = list(pool.map(signal.getsignal, SIGNALS))
    assert set(handlers) == {signal.SIG_IGN}
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
