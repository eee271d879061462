"""Random numbers as a function of seed, robot and counter: no state to save, and independent of grouping."""

from collections.abc import Sequence
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

Keys = NDArray[np.uint64]


SEED_MAX = (1 << 63) - 1
"""Largest seed that a user may give: every library that gets one can hold it."""


class Stream(IntEnum):
    """Independent streams of random numbers of one robot; a number is never reused for another purpose."""

    GOALS = 0
    SENSOR_NOISE = 1
    PUSHES = 2
    PAYLOAD = 3
    PACKETS = 4
    SENSOR_GARBAGE = 5
    FAULTS = 6
    START_POSES = 7
    WAIT_NOISE = 8


DEPLOYED = 2**31
"""Spawn key of robots at work, unlike the number of any robot in training: equal seeds repeat no such robot."""


def robot_seed(seed: int, robot: int) -> np.random.SeedSequence:
    """Return the seed of one robot at work: independent of every other robot and of grouping."""
    return np.random.SeedSequence(seed, spawn_key=(DEPLOYED, robot))


def training_seed(seed: int, robot: int) -> np.random.SeedSequence:
    """Return the seed of one robot in training."""
    return np.random.SeedSequence(seed, spawn_key=(robot,))


def stream_keys(seeds: Sequence[np.random.SeedSequence], stream: Stream) -> Keys:
    """Return (B, 2), one key of the stream for each robot."""
    children = [np.random.SeedSequence(s.entropy, spawn_key=(*s.spawn_key, stream)) for s in seeds]
    return np.stack([child.generate_state(2, np.uint64) for child in children])


def generator_at(key: Keys, counter: int) -> np.random.Generator:
    """Return the generator at position `counter` of the stream `key` (2,).

    Source: Salmon et al., Parallel random numbers: as easy as 1, 2, 3 (2011): Philox.
    """
    return np.random.Generator(np.random.Philox(key=key, counter=[0, 0, 0, counter]))
