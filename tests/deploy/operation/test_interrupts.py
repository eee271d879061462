"""Signals that arrive at the wrong moment."""

import os
import signal
import subprocess
import sys
import threading
import time
from functools import partial
from threading import Thread

import pytest

import deploy.operation.interrupts as interrupts_module
from deploy.operation.interrupts import Interrupts, handled, held_back, interrupt, not_dropped, raised_again

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


@REQUESTS
@pytest.mark.parametrize("made", [None, ValueError("half of a library")])
def test_an_interrupt_that_a_library_drops_is_raised_at_the_end(number, made):
    def drop():
        with handled(interrupt), not_dropped():
            try:
                signal.raise_signal(number)
            except KeyboardInterrupt:
                if made:
                    raise made from None

    with pytest.raises(KeyboardInterrupt):
        drop()


def test_an_error_without_an_interrupt_stays():
    with pytest.raises(ValueError, match="a library"), not_dropped():
        raise ValueError("a library")


def test_handlers_of_others_are_left_alone():
    got = []
    with handled(lambda number, _: got.append(number)), not_dropped():
        signal.raise_signal(signal.SIGTERM)
    assert got == [signal.SIGTERM]


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


class Interrupted:
    """An object in whose destructor a signal arrives: Python drops what its handler raises there."""

    def __init__(self, number):
        self.number = number

    def __del__(self):
        signal.raise_signal(self.number)


def die_and_wait(number):
    Interrupted(number)
    time.sleep(60)
    pytest.fail("not interrupted")


def test_an_interrupt_is_not_raised_where_it_would_be_dropped_once_more(monkeypatch):
    """The machine may be so slow that the time has passed before Python has done with the first one."""
    monkeypatch.setattr(interrupts_module, "AGAIN_S", 0.0)
    started = interrupts_module.Timer.start

    def slow(timer):
        started(timer)
        timer.join(0.2)  # in the hook

    monkeypatch.setattr(interrupts_module.Timer, "start", slow)
    with pytest.raises(KeyboardInterrupt), handled(interrupt), raised_again():
        die_and_wait(signal.SIGTERM)


@REQUESTS
def test_an_interrupt_that_python_drops_is_raised_again(number, capsys):
    with pytest.raises(KeyboardInterrupt), handled(interrupt), raised_again():
        die_and_wait(number)
    assert capsys.readouterr().err == ""


def test_a_request_that_python_drops_is_raised_again_where_ctrl_c_is_ignored():
    ignored, requests = handled(signal.SIG_IGN, [signal.SIGINT]), handled(interrupt, [signal.SIGTERM])
    with pytest.raises(KeyboardInterrupt), ignored, requests, raised_again():
        die_and_wait(signal.SIGTERM)


def test_a_second_ctrl_c_that_python_drops_is_raised_again():
    interrupts = Interrupts()
    interrupts.running = interrupts.powered = True
    interrupts(signal.SIGINT, None)
    with pytest.raises(KeyboardInterrupt), handled(interrupts), raised_again():
        die_and_wait(signal.SIGINT)


def test_no_ctrl_c_raises_between_the_first_file_and_power():
    """Files of the run before are gone then; the first tick ends it."""
    interrupts = Interrupts()
    interrupts.running = True
    for _ in range(3):
        interrupts(signal.SIGINT, None)
    assert interrupts.count == 3


def test_every_further_ctrl_c_raises_while_there_may_be_power():
    interrupts = Interrupts()
    interrupts.running = interrupts.powered = True
    interrupts(signal.SIGINT, None)
    for _ in range(3):
        interrupts(signal.SIGTERM, None)
        with pytest.raises(KeyboardInterrupt):
            interrupts(signal.SIGINT, None)
    interrupts.powered = False
    for number in (signal.SIGINT, signal.SIGTERM):
        interrupts(number, None)
    assert interrupts.count == 9


def test_an_interrupt_that_is_dropped_at_the_end_of_a_command_comes_no_more(monkeypatch):
    sent = []
    monkeypatch.setattr("deploy.operation.interrupts.AGAIN_S", 60.0)
    monkeypatch.setattr(signal, "pthread_kill", lambda *_: sent.append(1))
    with handled(interrupt), raised_again():
        Interrupted(signal.SIGTERM)
    for timer in [each for each in threading.enumerate() if isinstance(each, threading.Timer)]:
        timer.join()
    assert not sent


def test_other_errors_that_python_drops_are_shown(monkeypatch):
    class Broken:
        def __del__(self):
            raise ZeroDivisionError

    shown = []
    monkeypatch.setattr(sys, "unraisablehook", lambda dropped: shown.append(dropped.exc_type))
    with raised_again():
        Broken()
    Broken()
    assert shown == [ZeroDivisionError] * 2
