"""File written by a thread of its own, so that no disk can delay a tick."""

import errno
import os
from pathlib import Path
from queue import SimpleQueue
from threading import Event, Thread

from robots.files import is_missing

BACKLOG = 256
"""Chunks that may wait for the disk before it counts as failed."""
WAIT_S = 5.0


class DiskWriter:
    """Binary file whose `write` never blocks; after the first error nothing more is written.

    Attributes:
        error: the first error of the disk, or None; one, too, if the file is no longer at its place at the end.
    """

    _opened: os.stat_result  # set by the thread, unless there is an error

    def __init__(self, path: Path) -> None:
        self.error: OSError | None = None
        self._path, self._position = path, 0
        self._queue: SimpleQueue[bytes | Event | None] = SimpleQueue()
        self._thread = Thread(target=self._work, daemon=True)
        self._thread.start()

    def write(self, data: bytes | bytearray) -> int:
        """Queue a chunk."""
        if self._queue.qsize() > BACKLOG:
            self._give_up()
        if self.error is None:
            self._queue.put(bytes(data))
        self._position += len(data)
        return len(data)

    def seek(self, _offset: int, _whence: int = 0) -> int:
        """Return the position: the MCAP writer asks for nothing else."""
        return self._position

    def flush(self) -> None:
        """Do nothing: the thread flushes after each chunk."""

    def settle(self) -> None:
        """Wait until all chunks so far are written, or have failed: a disk that takes longer than `WAIT_S` has."""
        reached = Event()
        self._queue.put(reached)
        if not reached.wait(WAIT_S):
            self._give_up()

    def end(self) -> None:
        """Close the file after the chunks so far, without waiting."""
        self._queue.put(None)

    def wait(self, seconds: float = WAIT_S) -> None:
        """Wait so long until the file is closed, and look whether it is kept."""
        self._thread.join(seconds)
        if self._thread.is_alive():
            self._give_up()
        elif self.error is None:
            self._check_kept()

    def _give_up(self) -> None:
        self.error = self.error or OSError(errno.ETIMEDOUT, f"the disk took longer than {WAIT_S:g} s")

    def _check_kept(self) -> None:
        """Note as an error that the path no longer leads to all that was written: no write reports such a loss."""
        try:
            if is_missing(self._path) or not self._is_whole(self._path.stat()):
                self.error = FileNotFoundError(errno.ENOENT, "it was deleted, moved or replaced")
        except OSError as e:
            self.error = e

    def _is_whole(self, found: os.stat_result) -> bool:
        """Return whether a file is the one that was opened, and as long: a new one may have the number of a former."""
        return os.path.samestat(self._opened, found) and found.st_size == self._position

    def _work(self) -> None:
        try:
            with self._path.open("wb") as file:
                self._opened = os.fstat(file.fileno())
                while (item := self._queue.get()) is not None:
                    if isinstance(item, Event):
                        item.set()
                    elif self.error is None:
                        file.write(item)
                        file.flush()
        except OSError as e:
            self.error = self.error or e
            while (item := self._queue.get()) is not None:
                if isinstance(item, Event):
                    item.set()
