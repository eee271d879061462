import re
import shutil
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_spec import ARM, SPEC, copy_of_arm

from robots.draws import Draw, Span, draw, load_distributions
from robots.errors import ConfigError
from robots.randomness import keyed, keys, robot_seed
from robots.spec import load_robot

NAMES = [field.name for field in fields(Draw)]


def drawn(seed, robots):
    return draw(load_distributions(SPEC), SPEC.n, [robot_seed(seed, robot) for robot in robots])


def test_shapes():
    d = drawn(0, range(5))
    per_robot = {"noise_rad", "delay_s", "loss", "ambient_c", "warm_start_k"}
    for name in NAMES:
        assert getattr(d, name).shape == ((5,) if name in per_robot else (5, SPEC.n))


def test_same_seed_same_robots():
    for name in NAMES:
        np.testing.assert_array_equal(getattr(drawn(7, range(20)), name), getattr(drawn(7, range(20)), name))


@settings(max_examples=20, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**63), robots=st.lists(st.integers(0, 5000), min_size=1, max_size=8))
def test_a_robot_does_not_depend_on_its_group(seed, robots):
    together = drawn(seed, robots)
    for place, robot in enumerate(robots):
        alone = drawn(seed, [robot])
        for name in NAMES:
            np.testing.assert_array_equal(getattr(together, name)[place], getattr(alone, name)[0])


def test_robots_and_seeds_differ():
    a, b = drawn(1, range(200)), drawn(2, range(200))
    for name in NAMES:
        assert len(np.unique(getattr(a, name))) == getattr(a, name).size
        assert not np.isin(getattr(a, name), getattr(b, name)).any()


def test_no_robot_is_the_nominal_one():
    """Not one parameter of 500 robots is what `deploy` computes with."""
    d = drawn(0, range(500))
    nominal = {"noise_rad": SPEC.encoder.noise_rad, "delay_s": SPEC.encoder.delay_s}
    for name in NAMES:
        assert not np.isin(nominal.get(name, 1.0), getattr(d, name))


def test_inside_and_filling_their_spans():
    distributions, d = load_distributions(SPEC), drawn(3, range(2000))
    spans = {**dict(distributions.factors), **dict(distributions.sensors), **dict(distributions.climate)}
    assert sorted(spans) == sorted(NAMES)
    for name, span in spans.items():
        values = np.sort(getattr(d, name).ravel())
        assert span.low <= values[0] <= values[-1] <= span.high
        to = np.log if span.log else np.asarray
        share = (to(values) - to(span.low)) / (to(span.high) - to(span.low))
        uniform = (np.arange(len(share)) + 0.5) / len(share)
        assert np.abs(share - uniform).max() < 2.0 / np.sqrt(len(share))  # Kolmogorov, far beyond 99.9 %


def test_a_span_of_one_value_gives_that_value():
    assert Span(low=2.0, high=2.0).sample(np.random.default_rng(0), 3).tolist() == [2.0] * 3


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("mass = .*", "mass = { low = 1.2, high = 0.8 }", ["factors.mass", "low 1.2 is above high 0.8"]),
        ("mass = .*", "mass = { low = 0.0, high = 0.8 }", ["factors.mass", "[0.0, 0.8]", "[0.05, 20.0]"]),
        ("mass = .*", "mass = { low = 0.8, high = 30.0 }", ["factors.mass", "30.0", "20.0"]),
        ("mass = .*", "mass = { low = 0.8 }", ["factors.mass.high", "required"]),
        ("mass = .*", "mass = 1.0", ["factors.mass", "1.0"]),
        ("mass = .*", "mas = { low = 1, high = 1 }", ["factors.mas", "factors.mass"]),
        ("mass = .*", "mass = { low = 0.8, high = 1.2, log = 1 }", ["factors.mass.log", "boolean"]),
        ("mass = .*", "mass = { low = -1.0, high = 1.2, log = true }", ["logarithmic", "-1.0"]),
        ("loss = .*", "loss = { low = 0.0, high = 1.0 }", ["sensors.loss", "[0.0, 1.0]", "[0.0, 0.5]"]),
        ("delay_s = .*", "delay_s = { low = -0.01, high = 0.01 }", ["sensors.delay_s", "-0.01"]),
        ("noise_rad = .*", "noise_rad = { low = 0.0, high = 3.0 }", ["sensors.noise_rad", "3.0", "0.2"]),
        ("ambient_c = .*", "ambient_c = { low = nan, high = 35.0 }", ["climate.ambient_c.low", "nan"]),
        (r"\[climate\]", "[weather]", ["climate", "weather"]),
    ],
)
def test_bad_spans_are_refused(tmp_path, old, new, words):
    folder = tmp_path / "robot"
    shutil.copytree(ARM, folder)
    path = folder / "draws.toml"
    text, count = re.subn(rf"(?m)^{old}$", new, path.read_text(), count=1)
    assert count == 1
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_distributions(load_robot(folder))
    assert str(caught.value).startswith(str(path))
    for word in words:
        assert word in str(caught.value)


def test_missing_draws_file(tmp_path):
    folder = copy_of_arm(tmp_path)
    (folder / "draws.toml").unlink()
    with pytest.raises(ConfigError, match=re.escape(str(folder / "draws.toml"))):
        load_distributions(load_robot(folder))


def test_streams_of_keys_do_not_meet():
    """Other robot, purpose or counter: other numbers; same: same."""
    seeds = [robot_seed(1, robot) for robot in range(3)]
    numbers = {}
    for purpose in (0, 1):
        for robot, key in enumerate(keys(seeds, purpose)):
            for counter in (0, 1, 2**40):
                numbers[purpose, robot, counter] = keyed(key, counter).random(1000)
    everything = np.concatenate(list(numbers.values()))
    assert len(np.unique(everything)) == everything.size
    again = keyed(keys([robot_seed(1, 2)], 1)[0], 2**40).random(1000)
    np.testing.assert_array_equal(again, numbers[1, 2, 2**40])


def test_draw_and_streams_share_no_state():
    """Making keys, drawing, spawning: each robot's seed gives the same draw whatever was done with it before."""
    seed = robot_seed(4, 2)
    before = draw(load_distributions(SPEC), SPEC.n, [seed])
    keys([seed], 0)
    seed.spawn(3)
    np.testing.assert_array_equal(draw(load_distributions(SPEC), SPEC.n, [seed]).mass, before.mass)
