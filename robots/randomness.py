"""Random numbers that are a function of seed, robot and counter: nothing to save, nothing that grouping can change."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Keys = NDArray[np.uint64]


SHIFT = 2**31
"""Apart from the number of any robot in training: with equal seeds, no robot at work repeats one trained on."""


def robot_seed(seed: int, robot: int) -> np.random.SeedSequence:
    """The seed of one robot at work: independent of every other robot and of how robots are grouped."""
    return np.random.SeedSequence(seed, spawn_key=(SHIFT, robot))


def training_seed(seed: int, robot: int) -> np.random.SeedSequence:
    """The seed of one robot in training."""
    return np.random.SeedSequence(seed, spawn_key=(robot,))


def keys(seeds: Sequence[np.random.SeedSequence], purpose: int) -> Keys:
    """(B, 2) one key for each robot; each purpose gets a stream of its own."""
    children = [np.random.SeedSequence(s.entropy, spawn_key=(*s.spawn_key, purpose)) for s in seeds]
    return np.stack([child.generate_state(2, np.uint64) for child in children])


def keyed(key: Keys, counter: int) -> np.random.Generator:
    """The generator at place `counter` of the stream `key` (2,).

    Source: Salmon et al., Parallel random numbers: as easy as 1, 2, 3 (2011): Philox.
    """
    return np.random.Generator(np.random.Philox(key=key, counter=[0, 0, 0, counter]))
