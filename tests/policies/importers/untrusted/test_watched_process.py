"""Command in a child process: its exit code, its crash, its end when it handles no signal."""

import errno
import os
import signal
import subprocess
import sys

import pytest

from deploy.start import LACKING
from support.paths import ROOT
from support.processes import NO_THREADS

SCRIPT = """
import sys, os, signal, time
from policies.importers.untrusted import watched_process
watched_process.GRACE_S = 0.2
def hold():  # as native code with Python's lock, which delays handlers
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    print("begun", flush=True)
    time.sleep(600)
def wait():
    try:
        print("begun", flush=True)
        time.sleep(600)
    finally:
        print("cleaned up", flush=True)
def finish():
    raise SystemExit(7)
def crash():
    os.kill(os.getpid(), signal.SIGSEGV)
def main(command):
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    command()
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may ignore it
watched_process.run_watched(lambda: main(globals()[sys.argv[1]]), float(sys.argv[2]))
"""


def started(command, seconds=60.0, before=""):
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    arguments = [sys.executable, "-c", before + SCRIPT, command, str(seconds)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(arguments, text=True, env=environment, **pipes)


def ended(command, seconds=60.0, before=""):
    child = started(command, seconds, before)
    out, err = child.communicate(timeout=60)
    return child.returncode, out, err


def test_exit_code_is_passed_on():
    assert ended("finish") == (7, "", "")


NO_FORK = """
import errno, os
def fork():
    raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))
os.fork = fork
"""


@pytest.mark.parametrize("before", [NO_FORK, NO_THREADS])
def test_too_few_processes_are_one_line(before):
    lack = f"error: a process or a thread: {os.strerror(errno.EAGAIN)}\n"
    assert ended("finish", before=before) == (LACKING, "", lack)


def test_a_crash_is_one_line():
    assert ended("crash") == (2, "", "error: crash 60.0: ended by the system: Segmentation fault\n")


def test_a_command_that_does_not_end_is_killed():
    assert ended("hold", 2) == (2, "begun\n", "error: hold 2: not finished after 2 s\n")


def test_a_command_ends_with_its_killed_parent():
    child = started("wait")
    assert child.stdout.readline() == "begun\n"
    child.kill()
    assert child.communicate(timeout=60) == ("", "")  # both processes held the pipes


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(("command", "rest"), [("hold", ""), ("wait", "cleaned up\n")])
def test_a_request_to_end_is_followed(number, command, rest):
    child = started(command)
    assert child.stdout.readline() == "begun\n"
    child.send_signal(number)
    out, err = child.communicate(timeout=60)
    assert (child.returncode, out) == (130, rest)
    assert err == "" or "KeyboardInterrupt" in err
