"""Process that reads mutated files until its time is over; it may hang or crash."""

import os
import resource
import shutil
import signal
import time
import traceback
import zlib
from pathlib import Path

import numpy as np

from eval.fuzz.mutation import mutate_file
from eval.fuzz.target import Target, find_targets
from robots.errors import FirstshiftError
from robots.resource_limits import limit_resource

CASE_S, MEMORY_GIB = 30, 6
"""Bounds of a case: a torch graph is traced in seconds, and torch itself takes a GiB."""
ACCEPTED, REFUSED = "accepted", "refused"
LONGEST = 2000
"""Characters of a message that a person still reads."""


def make_case(target: Target, name: str, example: Path, folder: Path, *, seed: int, number: int) -> None:
    """Fill `folder` with a mutation of an example; the same for the same seed and number."""
    rng = np.random.default_rng([seed, zlib.crc32(name.encode()), number])
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(example, folder)
    files = sorted(path for path in folder.rglob(target.files) if os.path.isfile(path))
    mutate_file(files[rng.integers(len(files))], rng)
    target.seal(folder)


def read_case(target: Target, folder: Path) -> str:
    """Read a case; return `ACCEPTED`, `REFUSED`, or what is wrong with the reader, on one line."""
    try:
        target.read(folder)
    except FirstshiftError as e:
        too_long = len(str(e)) > LONGEST
        return f"a message of {len(str(e))} characters: {str(e)[:80]!r}" if too_long else REFUSED
    except Exception as e:  # noqa: BLE001 - that is what is looked for
        last = traceback.extract_tb(e.__traceback__)[-1]
        return f"{type(e).__name__}: {str(e)[:200]!r} in {Path(last.filename).name}:{last.lineno}"
    return ACCEPTED


def work(table: str, name: str, example: str, folder: str, *numbers: str) -> None:
    """Read cases until the time is over; print the number of each before it is read, and what came of it after.

    Args:
        table: name of the table of targets, as in `find_targets`. folder: for the files of cases.
        numbers: seed, first case and seconds.
    """
    seed, number, seconds = map(int, numbers)
    target, end = find_targets(table)[name], time.monotonic() + seconds
    limit_resource(resource.RLIMIT_DATA, MEMORY_GIB << 30)
    limit_resource(resource.RLIMIT_CORE, 0)
    while time.monotonic() < end:
        case = Path(folder, f"{name}-{seed}-{number}")
        print(number, flush=True)
        make_case(target, name, Path(example), case, seed=seed, number=number)
        signal.alarm(CASE_S)  # nothing handles it: the process ends
        began = time.monotonic()
        outcome = read_case(target, case)
        signal.alarm(0)
        print(f"{time.monotonic() - began:.3f} {outcome}", flush=True)
        if outcome in (ACCEPTED, REFUSED):
            shutil.rmtree(case)
        number += 1
