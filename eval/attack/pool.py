"""Worker processes of an attack: they try candidates, and end with their parent."""

import signal
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, NamedTuple

from deploy.operation.interrupts import ignore_signals, starting_workers
from eval.attack.archive import Found
from eval.attack.arena import Outcome, Setting, try_block
from eval.attack.candidate import Block
from eval.attack.peak import Bundle, write_peak
from robots.child_process import Lifeline, check_not_crowded, end_with
from robots.errors import ResultLostError

Call = Callable[[], Any]


class _Worker(NamedTuple):
    """Process that runs the calls it receives, and the parent's end of the pipe for them and their results."""

    process: BaseProcess
    pipe: Connection

    def kill(self) -> None:
        """End the process, even one that SIGSTOP stopped."""
        self.process.kill()
        self.process.join()
        self.pipe.close()


class Pool:
    """Worker processes that run one call at a time each; signals do not reach them, only their parent handles those.

    The pools of the standard library are not used: they wait for a worker that somebody has stopped, and for a thread
    of their own that has died for want of another.
    """

    def __init__(self, number: int, lifeline: Lifeline) -> None:
        """Start none yet, and at most `number`."""
        self._number, self._lifeline, self._context = number, lifeline, get_context("spawn")
        self._workers: list[_Worker] = []

    def results(self, calls: Sequence[Call]) -> Iterator[Any]:
        """Run calls; yield their results, in order. Workers that run one when this ends early are killed.

        Raises:
            ResultLostError: a worker was killed.
            RuntimeError: a worker failed.
            Exception: that of a call.
        """
        waiting, done = list(enumerate(calls))[::-1], dict[int, Any]()
        busy = dict[_Worker, int]()
        try:
            for number in range(len(calls)):
                while number not in done:
                    while waiting and len(busy) < self._number:
                        self._give(waiting.pop(), busy)
                    for worker in _answered(busy):
                        done[busy[worker]] = _received(worker)
                        del busy[worker]
                yield done.pop(number)
        finally:
            for worker in busy:
                worker.kill()
                self._workers.remove(worker)

    def _give(self, numbered: tuple[int, Call], busy: dict[_Worker, int]) -> None:
        """Send a call to an idle worker, or to a new one."""
        number, call = numbered
        idle = [each for each in self._workers if each not in busy]
        worker = idle[0] if idle else self._start()
        busy[worker] = number
        try:
            worker.pipe.send(call)
        except ConnectionError:
            raise _death(worker) from None

    def _start(self) -> _Worker:
        pipe, end = self._context.Pipe()
        process = self._context.Process(target=_work, args=(self._lifeline.end, end))
        with starting_workers(), end:
            process.start()
            self._workers.append(worker := _Worker(process, pipe))
        return worker

    def end(self) -> None:
        """End all workers."""
        for worker in self._workers:
            worker.kill()


def _answered(busy: dict[_Worker, int]) -> list[_Worker]:
    """Wait for workers; return those that have answered or ended."""
    ready = wait([worker.pipe for worker in busy])
    return [worker for worker in busy if worker.pipe in ready]


def _received(worker: _Worker) -> Any:
    """Return the result of a worker's call, or raise its exception."""
    try:
        result, error = worker.pipe.recv()
    except (EOFError, ConnectionError):
        raise _death(worker) from None
    if error is not None:
        raise error
    return result


def _death(worker: _Worker) -> Exception:
    """Return the error for a worker that has ended by itself."""
    worker.process.join()
    code = worker.process.exitcode or 0
    check_not_crowded(code)
    if code >= 0:
        return RuntimeError(f"a worker of the attack failed, with exit code {code}")
    why = signal.strsignal(-code)
    return ResultLostError(f"a worker of the attack was ended by the system: {why}; what was found is lost")


def _work(lifeline: Connection, pipe: Connection) -> None:
    """Run calls until the parent is gone; send back their results, each beside the exception or None."""
    ignore_signals()
    end_with(lifeline)
    with suppress(EOFError, ConnectionError):
        while True:
            pipe.send(_answer(pipe.recv()))


def _answer(call: Call) -> tuple[Any, Exception | None]:
    try:
        return call(), None
    except Exception as e:  # noqa: BLE001 - the parent raises it
        e.add_note(traceback.format_exc())  # tracebacks themselves cannot be sent
        return None, e


class Workers:
    """Processes that try candidates and write bundles."""

    def __init__(self, pool: Pool, setting: Setting) -> None:
        """Take a pool of them, and what all candidates have in common."""
        self._pool, self._setting = pool, setting

    def evaluate(self, blocks: Sequence[Block]) -> list[Outcome]:
        """Return the outcomes of blocks, in order."""
        return list(self._pool.results([partial(try_block, self._setting, block) for block in blocks]))

    def write_bundles(self, found: dict[str, Found], folder: Path) -> Iterator[tuple[str, Bundle]]:
        """Write the bundle of each monitor's worst candidate; yield them with their monitors."""
        calls = [
            partial(write_peak, self._setting, monitor, each.candidate, folder)
            for monitor, each in found.items()
        ]
        return zip(found, self._pool.results(calls), strict=True)


@contextmanager
def workers(setting: Setting, number: int) -> Iterator[Workers]:
    """Yield worker processes for a setting."""
    with processes(number) as pool:
        yield Workers(pool, setting)


@contextmanager
def processes(number: int) -> Iterator[Pool]:
    """Yield a pool of processes, which end with the block."""
    with Lifeline() as lifeline:
        pool = Pool(number, lifeline)
        try:
            yield pool
        finally:
            pool.end()
