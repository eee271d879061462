"""File written by a thread of its own, so that no disk can delay a tick."""

import errno
from pathlib import Path
from queue import SimpleQueue
from threading import Event, Thread

BACKLOG = 256
"""Chunks that may wait for the disk before it counts as failed."""
WAIT_S = 5.0


class DiskWriter:
    """Binary file whose `write` never blocks; after the first error nothing more is written.

    Attributes:
        error: the first error of the disk, or None.
    """

    def __init__(self, path: Path) -> None:
        self.error: OSError | None = None
        self._position = 0
        self._queue: SimpleQueue[bytes | Event | None] = SimpleQueue()
        self._thread = Thread(target=self._work, args=(path,), daemon=True)
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
        """Wait so long until the file is closed."""
        self._thread.join(seconds)
        if self._thread.is_alive():
            self._give_up()

    def _give_up(self) -> None:
        self.error = self.error or OSError(errno.ETIMEDOUT, f"the disk took longer than {WAIT_S:g} s")

    def _work(self, path: Path) -> None:
        try:
            with path.open("wb") as file:
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
