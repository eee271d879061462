"""Lost packets: of many streams of packets, the one with the oldest reading of the encoder at a tick."""

import numpy as np

from deploy.backends.sim.packets import Packets
from robots.arrays import Ints
from robots.draws import Draw
from robots.randomness import Keys, Stream, robot_seed, stream_keys
from robots.spec import RobotSpec

STREAMS = 2048
"""Number of streams to choose from."""
ROWS = 128
"""Streams computed at once."""


class LostPackets:
    """Packets of one arm by 2048 streams.

    Attributes:
        keys: (STREAMS, 2) of the streams. age: (STREAMS, T) ticks since the newest reading of the encoder was taken.
    """

    def __init__(self, spec: RobotSpec, arm: Draw, seed: int, ticks: int) -> None:
        """Compute the first `ticks` of all streams, with delays and losses of the first robot of a draw."""
        self.keys = stream_keys([robot_seed(seed, robot) for robot in range(STREAMS)], Stream.PACKETS)
        copies, encoder = arm.rows(np.zeros(ROWS, dtype=np.int64)), list(spec.sensors).index("encoder")
        ages = []
        for first in range(0, STREAMS, ROWS):
            packets = Packets(spec, copies, self.keys[first : first + ROWS])
            chunks = range(-(-ticks // packets.length))
            newest = np.concatenate([packets.arriving(chunk)[:, :, encoder] for chunk in chunks])
            ages.append(_age(newest)[:ticks].T)
        self.age = np.concatenate(ages).astype(np.int16)

    def oldest_at(self, tick: int) -> Keys:
        """Return the key (2,) of the stream whose newest reading is oldest at a tick, at most the last of all."""
        ages = self.age[:, min(tick, self.age.shape[1] - 1)]
        return np.asarray(self.keys[ages.argmax()])


def _age(arrivals: Ints) -> Ints:
    """Return (T, B) ticks since the newest of all that arrived (T, B) was taken; 0 as long as none did."""
    ticks = np.arange(len(arrivals))[:, None]
    newest = np.maximum.accumulate(arrivals, axis=0)
    return np.asarray(np.where(newest < 0, 0, ticks - newest))
