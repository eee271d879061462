"""Worker processes of an attack."""

import errno
import multiprocessing as mp
import os
import signal
import time
from contextlib import suppress
from functools import partial
from multiprocessing.context import SpawnProcess
from threading import Thread

import pytest

pytest.importorskip("mujoco")

from deploy.operation.interrupts import SIGNALS, handled, interrupt
from eval.attack.pool import processes
from robots.child_process import CROWDED
from robots.errors import ConfigError, ResultLostError

STOP = partial(signal.raise_signal, signal.SIGSTOP)


def refuse():
    raise ConfigError("as said")


def test_results_are_in_the_order_of_the_calls():
    calls = [partial(time.sleep, 0.2), *(partial(divmod, number, 3) for number in range(5))]
    with processes(2) as pool:
        assert list(pool.results(calls)) == [None, *(divmod(number, 3) for number in range(5))]
        assert list(pool.results([])) == []


def test_the_exception_of_a_call_is_raised_with_its_traceback():
    with processes(1) as pool, pytest.raises(ConfigError, match=r"^as said") as caught:
        list(pool.results([refuse]))
    assert "in refuse" in caught.value.__notes__[0]


def test_workers_ignore_the_signals_that_their_parent_handles():
    """From their start on: a terminal sends Ctrl-C to all of them."""
    with processes(1) as pool:
        handlers = list(pool.results([partial(signal.getsignal, each) for each in SIGNALS]))
        (blocked,) = pool.results([partial(signal.pthread_sigmask, signal.SIG_BLOCK, ())])
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
        list(pool.results([os.getpid]))
    assert len(started) == 1
    assert not mp.active_children()


def interrupt_when_stopped():
    """Send this process Ctrl-C once its only worker has stopped."""

    def look():
        while not any(state(child.pid) == "T" for child in mp.active_children()):
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGINT)

    Thread(target=look, daemon=True).start()


def state(pid):
    """State of a process in the words of the kernel: T is stopped."""
    with open(f"/proc/{pid}/stat") as file:
        return file.read().rpartition(")")[2].split()[0]


@pytest.mark.skipif(not os.path.exists("/proc/self/stat"), reason="states of processes are read from Linux")
def test_a_worker_that_somebody_has_stopped_is_killed_after_an_interrupt():
    """SIGSTOP: it hears of nothing any more. Others take its place."""
    with handled(interrupt), processes(1) as pool:
        interrupt_when_stopped()
        with pytest.raises(KeyboardInterrupt):
            list(pool.results([STOP]))
        assert not mp.active_children()
        assert list(pool.results([partial(abs, -1)])) == [1]
    assert not mp.active_children()


def test_no_worker_survives_an_error():
    """Not even one that is stopped."""
    with suppress(ZeroDivisionError), processes(2) as pool:
        next(pool.results([os.getpid, STOP]))
        raise ZeroDivisionError
    assert not mp.active_children()


def test_a_killed_worker_is_a_result_lost():
    with processes(1) as pool, pytest.raises(ResultLostError) as caught:
        list(pool.results([partial(signal.raise_signal, signal.SIGKILL)]))
    assert str(caught.value) == (
        "a worker of the attack was ended by the system: Killed; what was found is lost"
    )


def test_a_worker_that_fails_is_a_defect():
    with processes(1) as pool, pytest.raises(RuntimeError, match=r"failed, with exit code 3$"):
        list(pool.results([partial(os._exit, 3)]))


def test_a_worker_without_a_thread_is_a_lack_of_the_computer():
    with processes(1) as pool, pytest.raises(BlockingIOError, match=os.strerror(errno.EAGAIN)):
        list(pool.results([partial(os._exit, CROWDED)]))
