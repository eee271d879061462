"""Lost packets: ages of readings by stream, and the stream that is chosen."""

import numpy as np
import pytest

pytest.importorskip("mujoco")

from eval.attack import lost_packets
from eval.attack.lost_packets import LostPackets
from robots.distributions import load_distributions
from robots.draws import median_draw
from robots.randomness import Stream, robot_seed, stream_keys
from support.arm6 import SPEC

SEED, TICKS = 4, 130


def sensors(delay_ticks=0.0, loss=0.0):
    """A robot whose encoder has one delay, loses packets one by one, and repeats none."""
    robot, encoder = median_draw(load_distributions(SPEC), SPEC, 1), SPEC.sensors["encoder"]
    factors = {"delay": delay_ticks * SPEC.dt / encoder.delay_s, "loss": loss / encoder.loss}
    values = {f"sensors.{name}": factor for name, factor in factors.items()}
    return robot.replaced(values | {"sensors.jitter": 0.0, "sensors.burst": 1.0, "sensors.repeat": 0.0})


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """Fewer streams."""
    monkeypatch.setattr(lost_packets, "STREAMS", lost_packets.ROWS)


def test_readings_are_as_old_as_their_delay_where_no_packet_is_lost():
    age = LostPackets(SPEC, sensors(delay_ticks=2.0), SEED, TICKS).age
    assert age.shape == (lost_packets.ROWS, TICKS)
    assert (age[:, 10:] == 2).all()


def test_reading_gets_older_by_a_tick_with_each_packet_that_is_lost():
    age = LostPackets(SPEC, sensors(loss=0.1), SEED, TICKS).age[:, 1:].astype(int)
    change = np.diff(age, axis=1)
    assert ((change == 1) | (age[:, 1:] == 0)).all()
    assert (age > 0).mean() == pytest.approx(0.1, abs=0.03)


def test_chosen_stream_is_the_one_of_the_oldest_reading_at_a_tick():
    packets = LostPackets(SPEC, sensors(loss=0.3), SEED, TICKS)
    streams = stream_keys([robot_seed(SEED, robot) for robot in range(lost_packets.ROWS)], Stream.PACKETS)
    for tick in (40, 77):
        (row,) = np.flatnonzero((streams == packets.oldest_at(tick)).all(axis=1))
        assert packets.age[row, tick] == packets.age[:, tick].max() > 1


def test_tick_after_the_end_is_the_last_one():
    packets = LostPackets(SPEC, sensors(loss=0.1), SEED, TICKS)
    np.testing.assert_array_equal(packets.oldest_at(TICKS + 50), packets.oldest_at(TICKS - 1))
