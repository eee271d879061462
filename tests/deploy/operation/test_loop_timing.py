import numpy as np
import pytest

from deploy.operation.loop_timing import LoopTiming, RateLimited, Unpaced, WallClock
from support.deploy.fake_time import FakeTime


@pytest.fixture
def time():
    return FakeTime()


def wall(time, period=0.005):
    return WallClock(period, now=time.now, sleep=time.sleep)


def test_slots_lie_on_an_absolute_grid(time):
    clock, rng = wall(time), np.random.default_rng(0)
    for k in range(1000):
        clock.wait()
        assert time.t == pytest.approx(100.0 + k * 0.005, abs=1e-9)
        time.t += rng.uniform(0, 0.0049)  # the work of a tick
    assert clock.skipped == 0


def test_the_first_slot_is_now(time):
    assert wall(time).wait() == 0.0
    assert time.slept == []


def test_a_late_tick_is_not_made_up_for(time):
    clock = wall(time)
    clock.wait()
    time.t += 0.0176  # past the slots at 5, 10 and 15 ms: one is used, two are lost
    assert clock.wait() == pytest.approx(0.0126)
    assert clock.skipped == 2
    clock.wait()
    assert time.t == pytest.approx(100.020)
    assert clock.skipped == 2


def test_used_and_skipped_slots_are_all_slots(time):
    clock, rng = wall(time), np.random.default_rng(1)
    for _ in range(2000):
        clock.wait()
        time.t += rng.exponential(0.004)
    clock.wait()
    slots = 1 + int((time.t - 100.0) / 0.005 + 1e-6)
    assert 2001 + clock.skipped == slots
    assert clock.skipped > 100


def test_oversleeping_is_lateness(time):
    clock = WallClock(0.005, now=time.now, sleep=lambda s: time.sleep(s + 0.0003))
    clock.wait()
    assert [clock.wait() for _ in range(5)] == pytest.approx([0.0003] * 5)


def test_unpaced_clock_never_waits():
    clock = Unpaced()
    assert (clock.wait(), clock.skipped) == (0.0, 0)


class Scripted:
    """A clock that is late as told, (s late, slots skipped) for each wait."""

    def __init__(self, script):
        self.skipped, self._script = 0, iter(script)

    def wait(self):
        late, missed = next(self._script)
        self.skipped += missed
        return late


def paced(script):
    script = list(script)
    timing = LoopTiming(Scripted(script), 200, now=lambda: 0.0)
    for _ in script:
        timing.wait()
    return timing


def test_lateness_quantiles_equal_numpy():
    late = np.random.default_rng(2).exponential(0.0005, 20_000)
    found = paced((x, 0) for x in late).lateness
    assert found.p50_us == pytest.approx(np.percentile(late, 50) * 1e6, abs=2)
    assert found.p99_us == pytest.approx(np.percentile(late, 99) * 1e6, abs=2)
    assert found.max_us == pytest.approx(late.max() * 1e6)


def test_lateness_beyond_all_bins_is_counted():
    found = paced([(0.0, 0), (7.0, 0), (7.0, 0)]).lateness
    assert found.p50_us == 19_999
    assert found.max_us == 7e6


def test_no_ticks_no_lateness():
    timing = paced([])
    assert (timing.lateness.p50_us, timing.lateness.max_us, timing.rate, timing.elapsed) == (0, 0, 0, 0)


@pytest.mark.parametrize(("missed", "overrun"), [(20, False), (21, True)])
def test_overrun_of_a_tenth_of_a_second_is_too_much(missed, overrun):
    assert paced([(0.0, 0), (0.1, missed)]).overrun is overrun


def test_the_slots_skipped_before_a_tick_are_told():
    timing = LoopTiming(Scripted([(0.0, 0), (0.017, 3), (0.0, 0)]), 200, now=lambda: 0.0)
    assert [timing.wait() for _ in range(3)] == [0, 3, 0]


def test_single_misses_add_up_within_a_second():
    often, seldom = [(0.0, 0)] * 7 + [(0.005, 1)], [(0.0, 0)] * 9 + [(0.005, 1)]
    assert paced(often * 100).overrun  # 22 in a second
    assert not paced(seldom * 100).overrun  # 18


def test_an_overrun_is_forgotten_after_a_second():
    assert paced([(0.0, 0), (0.1, 30)] + [(0.0, 0)] * 199).overrun
    assert not paced([(0.0, 0), (0.1, 30)] + [(0.0, 0)] * 200).overrun


def test_loop_rates(time):
    timing = LoopTiming(wall(time), 200, now=time.now)
    for _ in range(400):
        timing.wait()
    assert timing.rate == pytest.approx(200)
    assert timing.recent_rate() == 0.0
    for _ in range(10):
        time.t += 0.2  # 40 slots, one of them used
        timing.wait()
        recent = timing.recent_rate()
    assert recent == pytest.approx(5, rel=0.25)
    assert timing.clock.skipped == 10 * 39
    assert timing.rate == pytest.approx(409 / (399 * 0.005 + 2.0), rel=0.01)


def test_time_after_the_last_tick_counts_for_no_rate(time):
    timing = LoopTiming(wall(time), 200, now=time.now)
    for _ in range(401):
        timing.wait()
    time.t += 3.0  # for a console and a disk
    assert (timing.elapsed, timing.rate) == (pytest.approx(2.0), pytest.approx(200))


def test_rate_limited_call_runs_at_most_once_per_period(time):
    called = []
    limited = RateLimited(0.2, called.append, now=time.now)
    for k in range(100):
        limited(k)
        time.t += 0.0625
    assert called[:4] == [0, 4, 8, 12]
    assert len(called) == 25
