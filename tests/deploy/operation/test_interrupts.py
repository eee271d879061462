"""Signals that arrive at the wrong moment."""

import os
import signal
import subprocess
import sys
from functools import partial
from threading import Thread

import pytest

from deploy.operation.interrupts import handled, held_back, interrupt

REQUESTS = pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])


def send_held_back(send, number):
    """Send a signal while signals are held back; return whether the block went on."""
    reached = []

    def hold():
        with handled(interrupt), held_back():
            send(number)
            reached.append(number)

    with pytest.raises(KeyboardInterrupt):
        hold()
    return bool(reached)


@REQUESTS
def test_signals_are_held_back_until_the_block_ends(number):
    assert send_held_back(partial(os.kill, os.getpid()), number)
    assert number not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


@REQUESTS
def test_signals_that_another_thread_receives_are_held_back(number):
    """Threads that began before the block, as those of a progress bar."""

    def send(number):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [number])
        other = Thread(target=signal.raise_signal, args=[number])
        other.start()
        other.join()

    assert send_held_back(send, number)


def test_signals_that_are_ignored_stay_ignored():
    with handled(signal.SIG_IGN), held_back():
        os.kill(os.getpid(), signal.SIGTERM)


WORKER = """
import signal
from deploy.operation.interrupts import ignore_signals
assert signal.SIGTERM in signal.sigpending()
ignore_signals()
assert not signal.sigpending() and not signal.pthread_sigmask(signal.SIG_BLOCK, ())
signal.raise_signal(signal.SIGTERM)
"""


def test_a_worker_ignores_signals_from_its_start_on():
    worker = f"import os, signal; os.kill(os.getpid(), signal.SIGTERM)\n{WORKER}"
    with held_back():
        done = subprocess.run([sys.executable, "-c", worker], capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
