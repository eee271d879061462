"""Children hold the writing end of a pipe that the test reads: it ends when none of them is left."""

import os
import signal
import subprocess
import sys
from contextlib import suppress

import pytest

from robots.child_process import ENDED, Lifeline

WAIT_S = 60.0
CHILD = """
import os, signal, sys, time
from robots.child_process import end_with
signal.signal(signal.SIGTERM, signal.SIG_IGN)
end_with(sys.stdin.fileno())
os.write(1, b"began\\n")  # at once: two children share the pipe
time.sleep(3600)
"""
PARENT = """
import subprocess, sys, time
from robots.child_process import Lifeline
with Lifeline() as lifeline:
    children = [subprocess.Popen([sys.executable, "-c", sys.argv[1]], stdin=lifeline.end) for _ in range(2)]
    time.sleep(3600)
"""
POOL = """
import os, signal, sys, time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from robots.child_process import Lifeline, end_with
def work(_):
    os.write(1, b"began\\n")  # at once: two children share the pipe
    time.sleep(3600)
if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    with Lifeline() as lifeline:
        with ProcessPoolExecutor(2, get_context("spawn"), end_with, (lifeline.end,)) as pool:
            list(pool.map(work, range(2)))
"""


@pytest.mark.parametrize("how", ["children", "pool"])
def test_children_end_with_a_killed_parent(tmp_path, how):
    """Children that ignore SIGTERM, started as programs and as workers of a pool."""
    (tmp_path / "pool.py").write_text(POOL)
    arguments = ["-c", PARENT, CHILD] if how == "children" else [str(tmp_path / "pool.py")]
    command = [sys.executable, *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as parent:
        try:
            assert [parent.stdout.readline() for _ in range(2)] == ["began\n", "began\n"]
            parent.send_signal(signal.SIGKILL)
            assert parent.communicate(timeout=WAIT_S) == ("", None)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(parent.pid, signal.SIGKILL)


def test_a_child_ends_when_its_lifeline_is_cut():
    with (
        Lifeline() as lifeline,
        subprocess.Popen(
            [sys.executable, "-c", CHILD], stdin=lifeline.end.fileno(), stdout=subprocess.PIPE, text=True
        ) as child,
    ):
        assert child.stdout.readline() == "began\n"
        lifeline.cut()
        assert child.wait(WAIT_S) == ENDED


def test_a_child_may_finish_within_its_grace():
    child = """
from threading import Event
from robots import child_process

cut, sleep = Event(), child_process.time.sleep
child_process.time.sleep = lambda grace_s: (cut.set(), sleep(grace_s))
child_process.end_with(0, 3600.0)
cut.wait()
"""
    lifeline = Lifeline()
    lifeline.cut()
    end = lifeline.end.fileno()
    done = subprocess.run([sys.executable, "-c", child], stdin=end, check=False, timeout=WAIT_S)
    assert done.returncode == 0


def test_a_child_that_starts_late_ends_at_once():
    lifeline = Lifeline()
    lifeline.cut()
    child = subprocess.run(
        [sys.executable, "-c", CHILD],
        stdin=lifeline.end.fileno(),
        check=False,
        timeout=WAIT_S,
        stdout=subprocess.DEVNULL,
    )
    assert child.returncode == ENDED
