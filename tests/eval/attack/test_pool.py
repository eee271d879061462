"""Worker processes of an attack."""

import os
import signal
from multiprocessing.context import SpawnProcess

import pytest

pytest.importorskip("mujoco")

from deploy.operation.interrupts import SIGNALS, handled, interrupt
from eval.attack.pool import processes


def test_workers_ignore_the_signals_that_their_parent_handles():
    """From their start on: a terminal sends Ctrl-C to all of them."""
    with processes(1) as pool:
        handlers = list(pool.map(signal.getsignal, SIGNALS))
        blocked = pool.submit(signal.pthread_sigmask, signal.SIG_BLOCK, ()).result()
    assert set(handlers) == {signal.SIG_IGN}
    assert blocked == set()
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_that_arrives_while_workers_start_is_not_lost(number, monkeypatch):
    def start(self, start=SpawnProcess.start):
        os.kill(os.getpid(), number)
        start(self)
        started.append(self)

    started = []
    monkeypatch.setattr(SpawnProcess, "start", start)
    with pytest.raises(KeyboardInterrupt), handled(interrupt), processes(1) as pool:
        pool.submit(os.getpid)
    assert len(started) == 1
