"""Worker processes of an attack: they try candidates, and end with their parent."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from itertools import repeat
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from deploy.operation.interrupts import ignore_signals, starting_workers
from eval.attack.archive import Found
from eval.attack.arena import Outcome, Setting, try_block
from eval.attack.candidate import Block
from eval.attack.peak import Bundle, write_peak
from robots.child_process import Lifeline, end_with


class _Pool(ProcessPoolExecutor):
    """Pool of processes that signals do not reach: only the parent handles them."""

    def submit(self, call: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Submit a call; workers may start for it."""
        with starting_workers():
            return super().submit(call, *args, **kwargs)


def _begin(lifeline: Connection) -> None:
    """Begin the life of a worker."""
    ignore_signals()
    end_with(lifeline)


class Workers:
    """Processes that try candidates and write bundles."""

    def __init__(self, pool: ProcessPoolExecutor, setting: Setting) -> None:
        """Take a pool of them, and what all candidates have in common."""
        self._pool, self._setting = pool, setting

    def evaluate(self, blocks: Sequence[Block]) -> list[Outcome]:
        """Return the outcomes of blocks, in order."""
        return list(self._pool.map(partial(try_block, self._setting), blocks))

    def write_bundles(self, found: dict[str, Found], folder: Path) -> Iterator[tuple[str, Bundle]]:
        """Write the bundle of each monitor's worst candidate; yield them with their monitors."""
        candidates = [each.candidate for each in found.values()]
        write = partial(write_peak, self._setting)
        return zip(found, self._pool.map(write, found, candidates, repeat(folder)), strict=True)


@contextmanager
def workers(setting: Setting, number: int) -> Iterator[Workers]:
    """Yield worker processes for a setting.

    Raises:
        RuntimeError: one of them died.
    """
    with processes(number) as pool:
        try:
            yield Workers(pool, setting)
        except BrokenProcessPool as e:
            raise RuntimeError("a worker of the attack died") from e


@contextmanager
def processes(number: int) -> Iterator[ProcessPoolExecutor]:
    """Yield a pool of processes, which end at once when this one fails or is interrupted."""
    with Lifeline() as lifeline:
        pool = _Pool(number, get_context("spawn"), _begin, (lifeline.end,))
        try:
            yield pool
        except BaseException:
            lifeline.cut()
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        pool.shutdown(cancel_futures=True)
