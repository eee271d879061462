"""Skipped slots of several loops, against a list of slots for each."""

import numpy as np

from deploy.operation.overrun import OVERRUN_SHARE, Overrun

HZ, LOOPS = 200, 5


def test_overrun_equals_a_count_over_the_slots_of_the_last_second():
    rng, loops = np.random.default_rng(0), Overrun(LOOPS, HZ)
    skipped = [[] for _ in range(LOOPS)]
    found, expected = [], []
    for _ in range(1500):
        missed = rng.poisson(np.linspace(0.0, 0.2, LOOPS))
        loops.step(missed)
        for slots, lost in zip(skipped, missed, strict=True):
            slots.extend([True] * lost + [False])
        # The slots skipped before a tick count as skipped at that tick's slot.
        expected.append([recent(slots) > OVERRUN_SHARE * HZ for slots in skipped])
        found.append(loops.overrun)
    np.testing.assert_array_equal(found, expected)
    assert 0.2 < np.mean(found) < 0.8
    assert not np.any(np.array(found)[:, 0])


def recent(slots):
    """Slots skipped before those ticks that used one of the last `HZ` slots."""
    begin = max(0, len(slots) - HZ)
    while begin > 0 and slots[begin - 1] and begin < len(slots):
        begin -= 1
    return sum(slots[begin:])


def test_a_saved_count_goes_on():
    one, other = Overrun(2, HZ), Overrun(2, HZ)
    one.step(np.array([0, 21]))
    other.restore(one.save())
    assert other.overrun.tolist() == [False, True]
    for _ in range(HZ):
        other.step(np.zeros(2, dtype=np.int64))
    assert not other.overrun.any()
