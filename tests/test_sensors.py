import numpy as np
import pytest
from test_spec import SPEC

from deploy.backends.sim.sensors import CHUNK, Sensors
from robots.draws import draw, load_distributions
from robots.randomness import robot_seed

N, DT, COUNT = SPEC.n, SPEC.dt, SPEC.encoder.resolution_rad
WARM = np.full((1, N), 31.4)


def built(robots=(0,), seed=1, **changes):
    """Sensors of some robots of a seed; `changes` set the same lie for all of them."""
    seeds = [robot_seed(seed, robot) for robot in robots]
    drawn = draw(load_distributions(SPEC), N, seeds)
    for name, value in changes.items():
        getattr(drawn, name)[:] = value
    sensors = Sensors(SPEC, drawn, seeds)
    sensors.reset(np.ones(len(seeds), dtype=bool), np.zeros((len(seeds), N)))
    return sensors


def read(sensors):
    robots = len(sensors.q)
    return sensors.read(np.zeros((robots, N)), np.tile(WARM, (robots, 1)))


def play(sensors, ticks, motion=np.sin):
    """Everything read while the joints move; arrays (T, ...)."""
    t, fresh, q = [], [], []
    for tick in range(1, ticks + 1):
        sensors.take(np.full((len(sensors.q), N), motion(tick * DT)))
        sample = read(sensors)
        t.append(sample.t.copy())
        fresh.append(sample.fresh.copy())
        q.append(sample.q.copy())
    return np.array(t), np.array(fresh), np.array(q)


@pytest.mark.parametrize(
    ("delay", "ticks"), [(0.0, 0), (0.0001, 1), (0.005, 1), (0.0051, 2), (0.008, 2), (0.010, 2), (0.0149, 3)]
)
def test_a_packet_arrives_whole_ticks_late_and_says_when_it_was_taken(delay, ticks):
    sensors = built(delay_s=delay, noise_rad=0.0, loss=0.0)
    t, fresh, q = play(sensors, 50)
    assert fresh.all()
    taken = np.arange(1, 51) - ticks
    np.testing.assert_allclose(t[:, 0], taken * DT, rtol=0, atol=1e-12)
    truth = np.where(taken > 0, np.sin(taken * DT), 0.0)
    assert np.abs(q[:, 0, 0] - truth).max() <= COUNT / 2 + 1e-12


def test_angles_are_whole_counts():
    _, _, q = play(built(range(3)), 300)
    counts = q / COUNT
    np.testing.assert_allclose(counts, np.rint(counts), rtol=0, atol=1e-6)
    assert len(np.unique(np.rint(counts))) > 100


def test_noise_has_the_drawn_size_and_no_memory():
    sigma = 0.0015
    _, _, q = play(built(range(8), noise_rad=sigma, loss=0.0), 2000, motion=lambda _: 0.3)
    noise = q[5:] - 0.3
    assert abs(noise.mean()) < 1e-5
    assert noise.std() == pytest.approx(np.hypot(sigma, COUNT / np.sqrt(12)), rel=0.02)
    flat = noise.reshape(len(noise), -1)
    assert np.abs(np.mean(flat[1:] * flat[:-1], axis=0)).max() < 0.12 * sigma**2
    neighbours = np.corrcoef(flat.T) - np.eye(flat.shape[1])
    assert np.abs(neighbours).max() < 0.12


@pytest.mark.parametrize("loss", [0.0, 0.01, 0.3])
def test_loss_has_the_drawn_share_and_repeats_the_last_packet(loss):
    t, fresh, q = play(built(range(20), loss=loss), 1500)
    share = 1 - fresh.mean()
    assert share == pytest.approx(loss, abs=4 * np.sqrt(loss / fresh.size) + 1e-12)
    missing = ~fresh[1:]
    np.testing.assert_array_equal(q[1:][missing], q[:-1][missing])
    np.testing.assert_array_equal(t[1:][missing], t[:-1][missing])
    assert (np.diff(t[5:], axis=0)[fresh[6:]] > 0).all()


def test_what_is_read_is_a_function_of_seed_robot_and_tick():
    """Not of the group, of how often it was read, or of chunks."""
    ticks = 2 * CHUNK + 40
    together = play(built(range(4), delay_s=0.01, loss=0.05), ticks)
    for robot in range(4):
        alone = play(built([robot], delay_s=0.01, loss=0.05), ticks)
        for a, b in zip(alone, together, strict=True):
            np.testing.assert_array_equal(a[:, 0], b[:, robot])
    twice = built([2], delay_s=0.01, loss=0.05)
    for tick in range(1, 60):
        twice.take(np.full((1, N), np.sin(tick * DT)))
        read(twice)
        np.testing.assert_array_equal(read(twice).q[0], together[2][tick - 1, 2])
    assert not np.array_equal(play(built([0], seed=2), 50)[2], play(built([0], seed=1), 50)[2])


@pytest.mark.parametrize("at", [3, CHUNK - 1, CHUNK, CHUNK + 7])
def test_saved_and_restored_goes_on_bit_for_bit(at):
    one, other = built(range(3), loss=0.2), built(range(3), loss=0.2)
    play(one, at)
    other.restore(one.save())
    for a, b in zip(play(one, CHUNK), play(other, CHUNK), strict=True):
        np.testing.assert_array_equal(a, b)


def test_reset_of_a_subset_delivers_only_the_new_place():
    sensors = built(range(3), delay_s=0.01, loss=0.0, noise_rad=0.0)
    play(sensors, 40, motion=lambda _: 1.0)
    sensors.reset(np.array([False, True, False]), np.full((3, N), -0.5))
    for _ in range(5):
        np.testing.assert_allclose(read(sensors).q[:, 0], [1.0, -0.5, 1.0], atol=COUNT)
        sensors.take(np.array([1.0, -0.5, 1.0])[:, None] * np.ones(N))


def test_temperature_comes_in_whole_degrees():
    np.testing.assert_array_equal(read(built()).temperature, np.rint(WARM))
