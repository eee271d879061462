"""Readers that fail, for the fuzzer to find."""

import os
import time

from eval.fuzz import worker
from eval.fuzz.target import Target
from robots.errors import ConfigError

worker.CASE_S = 1


def reads(fail):
    """A reader that fails on every mutation of its example."""

    def read(folder):
        if (folder / "x.txt").read_bytes() != b"good" * 9:
            fail()

    return read


def raises(error):
    raise error


FAILURES = {
    "traceback": lambda: raises(ZeroDivisionError("of ours")),
    "crash": os.abort,
    "hang": lambda: time.sleep(1e6),
    "memory": lambda: bytearray(1 << 40),
    "flood": lambda: raises(ConfigError("x" * 10_000)),
    "refusal": lambda: raises(ConfigError("x")),
}
TARGETS = {
    name: Target(make=lambda folder: (folder / "x.txt").write_bytes(b"good" * 9), read=reads(fail))
    for name, fail in FAILURES.items()
}
