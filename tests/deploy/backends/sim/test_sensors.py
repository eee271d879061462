import numpy as np
import pytest

from support.arm6 import SPEC, copy_of_arm

pytest.importorskip("mujoco")

from deploy.backends.sim.packets import CHUNK
from deploy.backends.sim.sensor_faults import BLINK_S, LATE_S, SLOW, WRONG, Failure, Fault, silent
from deploy.backends.sim.sensors import Sensors
from robots.distributions import load_distributions
from robots.draws import draw
from robots.errors import ConfigError
from robots.randomness import robot_seed
from robots.sensors import BUFFER_S
from robots.spec import load_robot

N, DT, DISTRIBUTIONS = SPEC.n, SPEC.dt, load_distributions(SPEC)
KINDS, ENCODER = list(SPEC.sensors), SPEC.sensors["encoder"]
WIDTH = sum(SPEC.channels.values())
HONEST = {
    f"sensors.{name}": 0.0
    for name in ("noise", "bias", "drift", "drift_per_k", "delay", "jitter", "hold", "loss", "repeat")
}


def built(robots=(0,), seed=1, faults=(), spec=SPEC, **lies):
    """Sensors of some robots of a seed; `lies` are the same for all of them, "sensors.NAME" by NAME."""
    seeds = [robot_seed(seed, robot) for robot in robots]
    drawn = draw(DISTRIBUTIONS, spec, seeds)
    sensors = Sensors(spec, drawn.replaced({f"sensors.{n}": v for n, v in lies.items()}), seeds, faults)
    sensors.reset(np.ones(len(seeds), dtype=bool), np.zeros((len(seeds), WIDTH)))
    return sensors


def honest(robots=(0,), faults=(), spec=SPEC, **but):
    """Sensors without any lie but some."""
    return built(
        robots, faults=faults, spec=spec, **{name.partition(".")[2]: x for name, x in HONEST.items()} | but
    )


def play(sensors, ticks, motion=np.sin, kind="encoder"):
    """All packets of a sensor while everything true is `motion` of the time; arrays (T, ...)."""
    t, fresh, value = [], [], []
    for _ in range(ticks):
        now = motion(DT * (sensors.tick[0] + 1))
        sensors.sample(np.zeros(sensors.value.shape) + now)
        packet = sensors.read()[kind]
        t.append(packet.t.copy())
        fresh.append(packet.fresh.copy())
        value.append(packet.value.copy())
    return np.array(t), np.array(fresh), np.array(value)


@pytest.mark.parametrize(
    ("delay", "ticks"), [(0.0, 0), (0.0001, 1), (0.005, 1), (0.0051, 2), (0.008, 2), (0.010, 2), (0.0149, 3)]
)
def test_packets_are_delayed_by_whole_ticks_and_stamped_at_sampling(delay, ticks):
    t, fresh, q = play(honest(delay=delay / ENCODER.delay_s), 300)
    assert fresh.all()
    taken = np.arange(1, 301) - ticks
    np.testing.assert_allclose(t[:, 0], taken * DT, rtol=0, atol=1e-12)
    truth = np.where(taken > 0, np.sin(taken * DT), 0.0)
    assert np.abs(q[:, 0, 0] - truth).max() <= ENCODER.resolution / 2 + 1e-12


@pytest.mark.parametrize("hz", [504, 508, 1000, 2000])
def test_fast_bus_delivers_packets_in_flight(tmp_path, hz):
    """Its buffer of a quarter of a second holds more ticks than are worked out at once on a slow one."""
    rates = [("control_hz = 200", f"control_hz = {hz}"), ("physics_hz = 1000", f"physics_hz = {hz}")]
    late = round(BUFFER_S * hz) - 1
    sensors = honest(spec=load_robot(copy_of_arm(tmp_path, toml=rates)), delay=late / hz / ENCODER.delay_s)
    for tick in range(1, 3 * CHUNK + 2 * late):
        sensors.sample(np.full((1, WIDTH), tick / hz))
        packet = sensors.read()["encoder"]
        if packet.fresh[0] and tick > late + 1:
            np.testing.assert_allclose(packet.value[0], packet.t[0], rtol=0, atol=ENCODER.resolution)
            assert tick - late == pytest.approx(packet.t[0] * hz)
    assert packet.t[0] > BUFFER_S


def test_readings_are_quantized_and_clipped_to_the_range():
    for kind, sensor in SPEC.sensors.items():
        _, _, value = play(built(range(3)), 300, lambda t, s=sensor: 2.0 * s.range * np.sin(5 * t), kind)
        steps = value / sensor.resolution
        np.testing.assert_allclose(steps, np.rint(steps), rtol=0, atol=1e-6)
        assert len(np.unique(np.rint(steps))) > 20
        assert np.abs(value).max() == pytest.approx(sensor.range, abs=sensor.resolution)


def test_each_sensor_has_its_own_rate_and_even_time_stamps():
    for kind, sensor in SPEC.sensors.items():
        t, fresh, value = play(honest(), 2000, np.cos, kind)
        assert fresh.sum() == pytest.approx(sensor.rate_hz * 2000 * DT, abs=1)
        stamps = t[fresh[:, 0], 0]
        np.testing.assert_allclose(np.diff(stamps), 1 / sensor.rate_hz, rtol=0, atol=DT)
        wanted = np.where(stamps > 0, np.cos(stamps), 0.0)
        error = np.abs(value[fresh[:, 0], 0, 0] - wanted).max()
        assert error <= sensor.resolution / 2 + 1e-12


def test_noise_has_the_drawn_variance_and_is_white():
    factor, sensor = 1.5, ENCODER
    _, _, q = play(honest(range(8), noise=factor), 2000, lambda _: 0.3)
    noise = q[5:] - 0.3
    assert abs(noise.mean()) < 1e-5
    sigma = np.hypot(factor * sensor.noise, sensor.resolution / np.sqrt(12))
    assert noise.std() == pytest.approx(sigma, rel=0.02)
    flat = noise.reshape(len(noise), -1)
    assert np.abs(np.mean(flat[1:] * flat[:-1], axis=0)).max() < 0.12 * sigma**2
    neighbours = np.corrcoef(flat.T) - np.eye(flat.shape[1])
    assert np.abs(neighbours).max() < 0.12


def test_noise_differs_from_robot_to_robot_as_drawn():
    sensors = built(range(30), bias=0.0, drift=0.0)
    _, _, q = play(sensors, 1500, lambda _: 0.3)
    factors = draw(DISTRIBUTIONS, SPEC, [robot_seed(1, i) for i in range(30)])["sensors.noise"][:, 0]
    expected = np.hypot(factors * ENCODER.noise, ENCODER.resolution / np.sqrt(12))
    np.testing.assert_allclose(q[60:].std(axis=(0, 2)), expected, rtol=0.1)


def test_bias_is_constant_per_channel():
    _, _, q = play(built(range(10), noise=0.0, drift=0.0, delay=0.0, jitter=0.0), 200, lambda _: 0.3)
    error = q[60:] - 0.3
    np.testing.assert_allclose(error, np.broadcast_to(error[0], error.shape), rtol=0, atol=1e-12)
    assert np.abs(error).max() <= ENCODER.bias + ENCODER.resolution
    assert np.abs(error).max() > ENCODER.bias / 2


@pytest.mark.slow
def test_drift_is_a_random_walk():
    sensors = honest(range(200), drift=1.0)
    steps = 40
    for _ in range(steps * CHUNK):
        sensors.sample(np.zeros(sensors.value.shape))
    hours = steps * CHUNK * DT / 3600
    for kind, sensor in SPEC.sensors.items():
        walked = sensors.bias_walk[:, sensors.columns[kind]]
        assert walked.std() == pytest.approx(sensor.drift * np.sqrt(hours), rel=0.12, abs=1e-15)


def test_force_sensor_drifts_with_the_temperature_of_the_last_motor():
    """Each robot and each axis in a way of its own."""
    factors = np.array([[1.0, -0.5, 0.2], [-1.0, 0.7, 0.4]])
    force = honest().columns["force"]
    per_k = np.zeros((2, WIDTH))
    per_k[:, force] = factors
    sensors, warm = honest(range(2), drift_per_k=per_k), np.zeros((2, WIDTH))
    warm[:, sensors.columns["temperature"]] = np.arange(N) * 10.0
    for _ in range(CHUNK + 10):
        sensors.sample(warm)
        packet = sensors.read()["force"]
    expected = factors * SPEC.sensors["force"].drift_per_k * (N - 1) * 10.0
    np.testing.assert_allclose(
        packet.value, expected, rtol=0, atol=SPEC.sensors["force"].resolution / 2 + 1e-9
    )


@pytest.mark.parametrize("burst", [1.0, 4.0])
@pytest.mark.parametrize("loss", [0.0, 0.01, 0.3])
def test_packet_loss_has_the_drawn_rate_and_comes_in_bursts(loss, burst):
    sensors = honest(range(40), loss=loss / ENCODER.loss, burst=burst)
    _, fresh, q = play(sensors, 2 * CHUNK, lambda t: t)
    share = 1 - fresh.mean()
    assert share == pytest.approx(loss, rel=0.15 if burst == 1 else 0.25, abs=1e-12)
    missing = ~fresh[1:]
    np.testing.assert_array_equal(q[1:][missing], q[:-1][missing])
    if loss == 0.01:
        begins = (missing[1:] & ~missing[:-1]).sum()
        assert missing[1:].sum() / begins == pytest.approx(burst, rel=0.3)


def test_jitter_holds_and_changes_and_lets_packets_overtake():
    """A delay of 8 to 24 ms that holds nine times of ten; packets then also come after ones taken later."""
    sensors = honest(range(20), delay=1.0, jitter=2.0, hold=0.9)
    t, fresh, _ = play(sensors, 4 * CHUNK)
    lag = np.arange(1, 4 * CHUNK + 1)[:, None] - np.rint(t / DT).astype(int)
    seen = lag[fresh]
    assert seen.min() == 2
    assert seen.max() == 5
    steps = np.diff(np.where(fresh, lag, -1), axis=0)
    both = fresh[1:] & fresh[:-1]
    assert 0.7 < (steps[both] == 0).mean() < 0.97
    assert (np.diff(t, axis=0) < 0).any()


def test_packets_are_duplicated():
    t, fresh, _ = play(honest(range(20), repeat=0.1), 2 * CHUNK)
    again = fresh[1:] & (np.diff(t, axis=0) == 0)
    assert again.mean() == pytest.approx(0.1, rel=0.2)


def test_readings_depend_on_seed_robot_and_tick_only():
    """Not of the group, of how often it was read, or of chunks."""
    ticks = 2 * CHUNK + 40
    for kind in KINDS:
        together = play(built(range(4)), ticks, kind=kind)
        alone = play(built([2]), ticks, kind=kind)
        for a, b in zip(alone, together, strict=True):
            np.testing.assert_array_equal(a[:, 0], b[:, 2])
    twice = built([2])
    for tick in range(1, 60):
        twice.sample(np.full((1, WIDTH), np.sin(tick * DT)))
        first = [np.copy(part) for part in twice.read()[kind]]
        for a, b in zip(first, twice.read()[kind], strict=True):
            np.testing.assert_array_equal(a, b)
    assert not np.array_equal(play(built([0], seed=2), 50)[2], play(built([0], seed=1), 50)[2])


@pytest.mark.parametrize("at", [3, CHUNK - 1, CHUNK, CHUNK + 7])
def test_saved_and_restored_goes_on_bit_for_bit(at):
    one, other = built(range(3)), built(range(3))
    play(one, at)
    other.restore(one.save())
    for a, b in zip(play(one, 2 * CHUNK), play(other, 2 * CHUNK), strict=True):
        np.testing.assert_array_equal(a, b)


def test_reset_of_a_subset_delivers_the_new_position_at_once():
    sensors = honest(range(3), delay=1.0)
    play(sensors, 40, motion=lambda _: 1.0)
    place = np.array([1.0, -0.5, 1.0])[:, None] + np.zeros((3, WIDTH))
    sensors.reset(np.array([False, True, False]), place)
    for tick in range(60):
        for packet in sensors.read().values():
            assert packet.fresh[1] or tick
            np.testing.assert_allclose(packet.value, place[:, : packet.value.shape[1]], atol=0.5)
        np.testing.assert_allclose(sensors.read()["encoder"].value, place[:, :N], atol=ENCODER.resolution)
        sensors.sample(place)


FAILS = {"robot": 1, "sensor": "encoder", "begins": 300, "ends": 500}


def failing(what, channel=None):
    """Two robots, of which the second fails from tick 300 to 500; what both say (T, ...)."""
    fault = Fault(**FAILS, what=what, channel=channel)
    t, fresh, q = play(honest(range(2), [fault], noise=1.0), 700)
    clean = play(honest(range(2), noise=1.0), 700)
    for part, other in zip((t, fresh, q), clean, strict=True):
        np.testing.assert_array_equal(part[:, 0], other[:, 0])
        np.testing.assert_array_equal(part[:299, 1], other[:299, 1])
        np.testing.assert_array_equal(part[530:, 1], other[530:, 1])
    during = slice(299, 499)
    return t[during, 1], fresh[during, 1], q[during, 1], clean[2][during, 1]


def test_fault_off():
    _, fresh, _, _ = failing(Failure.OFF)
    assert not fresh.any()
    _, fresh, q, clean = failing(Failure.OFF, channel=3)
    assert fresh.all()
    assert np.isnan(q[:, 3]).all()
    np.testing.assert_array_equal(np.delete(q, 3, axis=1), np.delete(clean, 3, axis=1))


def test_fault_stuck():
    _, fresh, q, clean = failing(Failure.STUCK, channel=2)
    assert fresh.all()
    assert len(np.unique(q[:, 2])) == 1
    assert len(np.unique(clean[:, 2])) > 100
    np.testing.assert_array_equal(np.delete(q, 2, axis=1), np.delete(clean, 2, axis=1))


def test_fault_garbage():
    _, _, q, _ = failing(Failure.GARBAGE)
    assert q.std() == pytest.approx(2 * ENCODER.range / np.sqrt(12), rel=0.1)
    assert len(np.unique(q)) > 0.9 * q.size


def test_fault_wrong():
    _, _, q, clean = failing(Failure.WRONG, channel=0)
    np.testing.assert_allclose(q[:, 0] - clean[:, 0], WRONG * ENCODER.range, rtol=0, atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_fault_slow(kind):
    """One packet of so many remains, however seldom the sensor sends them."""
    fault = Fault(robot=0, sensor=kind, begins=0, ends=4000, what=Failure.SLOW)
    _, fresh, _ = play(honest(faults=[fault]), 4000, kind=kind)
    assert fresh.sum() == pytest.approx(SPEC.sensors[kind].rate_hz * 4000 * DT / SLOW, abs=1)


def test_fault_delayed():
    t, fresh, _, _ = failing(Failure.DELAYED)
    lag = (np.arange(300, 500) * DT - t)[fresh]
    np.testing.assert_allclose(lag[30:], LATE_S, rtol=0, atol=1e-9)


def test_fault_intermittent():
    _, fresh, _, _ = failing(Failure.INTERMITTENT)
    silent = round(BLINK_S / DT)
    np.testing.assert_array_equal(fresh, np.arange(200) // silent % 2 == 1)
    _, _, q, _ = failing(Failure.INTERMITTENT, channel=5)
    np.testing.assert_array_equal(np.isnan(q[:, 5]), np.arange(200) // silent % 2 == 0)


def test_slow_bus_delivers_at_every_other_tick():
    fault = Fault(**FAILS | {"begins": 0, "ends": 6}, what=Failure.INTERMITTENT)
    assert silent(fault, np.arange(8), 0.5).tolist() == [True, False] * 3 + [False] * 2


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"sensor": "gyro"}, "sensor gyro: unknown; known: encoder, current"),
        ({"robot": 2}, "found 2 robots and 6 channels"),
        ({"channel": 6}, "found 2 robots and 6 channels"),
        ({"channel": -1}, "found 2 robots and 6 channels"),
        ({"channel": 0, "what": Failure.SLOW}, "slow happens to all channels"),
    ],
)
def test_faults_of_missing_sensors_are_refused(change, words):
    fault = Fault(**{**FAILS, "what": Failure.OFF} | change)
    with pytest.raises(ConfigError, match=words):
        honest(range(2), [fault])
