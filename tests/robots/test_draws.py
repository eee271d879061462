import json
import re
import shutil

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robots.distributions import load_distributions
from robots.draws import draw, load_draw, shape
from robots.errors import ConfigError
from robots.randomness import generator_at, robot_seed, stream_keys
from robots.spans import Span
from robots.spec import load_robot
from support.arm6 import ARM, SPEC, copy_of_arm

DISTRIBUTIONS = load_distributions(SPEC)
QUANTITIES = {name: (quantity, span) for name, quantity, span in DISTRIBUTIONS.spans()}


def drawn(seed, robots):
    return draw(DISTRIBUTIONS, SPEC, [robot_seed(seed, robot) for robot in robots])


def assert_same(one, other):
    assert list(one) == list(other)
    for name in one:
        np.testing.assert_array_equal(one[name], other[name])


def test_everything_that_is_declared_is_drawn():
    d = drawn(0, range(5))
    assert set(d) == set(QUANTITIES)
    assert d.robots == 5
    for name, values in d.items():
        assert values.shape == (5, *shape(QUANTITIES[name][0], SPEC))
    assert d["links.mass"].shape == (5, SPEC.n)
    assert d["links.com_m"].shape == (5, SPEC.n, 3)
    assert d["sensors.noise"].shape == (5, len(SPEC.sensors))
    assert d["sensors.bias"].shape == (5, sum(SPEC.channels.values()))
    assert d["sensors.drift_per_k"].shape == d["sensors.bias"].shape
    assert d["climate.ambient_c"].shape == (5,)


def test_same_seed_same_robots():
    assert_same(drawn(7, range(20)), drawn(7, range(20)))


@settings(max_examples=20)
@given(seed=st.integers(0, 2**63), robots=st.lists(st.integers(0, 5000), min_size=1, max_size=8))
def test_a_robot_does_not_depend_on_its_group(seed, robots):
    together = drawn(seed, robots)
    for place, robot in enumerate(robots):
        for name, values in drawn(seed, [robot]).items():
            np.testing.assert_array_equal(together[name][place], values[0])


def test_a_quantity_does_not_depend_on_the_others(tmp_path):
    """One that is drawn otherwise, or is new, leaves every other number of every robot as it was."""
    path = copy_of_arm(tmp_path) / "draws.toml"
    path.write_text(path.read_text().replace("mass = { low = 0.8,", "mass = { low = 0.7,"))
    spec = load_robot(path.parent)
    changed = draw(load_distributions(spec), spec, [robot_seed(3, robot) for robot in range(4)])
    for name, values in drawn(3, range(4)).items():
        assert np.array_equal(values, changed[name]) == (name != "links.mass"), name


def test_every_number_has_a_source_or_is_called_an_estimate():
    """At its own line or at that of its table."""
    sources = re.compile("estimate|course unit|Isaac Lab|Playground")
    table, without, lines = "", [], (ARM / "draws.toml").read_text().splitlines()
    for line in lines:
        table = line if line.startswith("[") else table
        if re.match(r"\w+ = [-{\d]", line) and not sources.search(line + table):
            without.append(line)
    assert not without
    assert sum(bool(re.match(r"\w+ = ", line)) for line in lines) == len(QUANTITIES) + len(
        DISTRIBUTIONS.fixed
    )


def test_robots_seeds_and_quantities_differ():
    a, b = drawn(1, range(200)), drawn(2, range(200))
    for name, values in a.items():
        assert len(np.unique(values)) == values.size
        assert not np.isin(values, b[name]).any()
    shares = {name: (a[name].ravel()[:200] - s.low) / (s.high - s.low) for name, (_, s) in QUANTITIES.items()}
    assert len({share[0] for share in shares.values()}) == len(shares)


def test_no_robot_is_the_nominal_one():
    """Not one parameter of 500 robots is what `deploy` computes with: factors of 1, errors of 0."""
    for name, values in drawn(0, range(500)).items():
        assert not np.isin([0.0, 1.0], values).any(), name


@pytest.mark.slow
def test_draws_fill_their_spans():
    d = drawn(3, range(2000))
    for name, (_, span) in QUANTITIES.items():
        values = np.sort(d[name].ravel())
        assert span.low <= values[0] <= values[-1] <= span.high
        to = np.log if span.log else np.asarray
        share = (to(values) - to(span.low)) / (to(span.high) - to(span.low))
        uniform = (np.arange(len(share)) + 0.5) / len(share)
        assert np.abs(share - uniform).max() < 2.0 / np.sqrt(len(share))  # Kolmogorov, far beyond 99.9 %


def test_a_span_of_one_value_gives_that_value():
    assert Span(low=2.0, high=2.0).sample(np.random.default_rng(0), (3,)).tolist() == [2.0] * 3


def test_a_stored_draw_is_the_same_robots(tmp_path):
    path, d = tmp_path / "draw.json", drawn(5, range(7))
    path.write_text(d.to_json(5, DISTRIBUTIONS, SPEC))
    seed, found = load_draw(path, DISTRIBUTIONS, SPEC)
    assert seed == 5
    assert_same(found, d)
    assert_same(found.robot(3), drawn(5, [3]))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"links.mass": None}, ["links.mass: missing"]),
        ({"seed": -1}, ["seed", "greater than or equal to 0", "-1"]),
        ({"robot": "f" * 64}, ["robot", "'ffff", "expected"]),
        (
            {"fixed": {**DISTRIBUTIONS.fixed, "wear.life_rad": 15.0}},
            ["fixed.wear.life_rad", "found 15.0", "15000.0"],
        ),
        ({"fixed": {"cable.link": "base"}}, ["fixed.cable.link", "found 'base'", "forearm_link"]),
        ({"sensors.delay": [[5.0] * 5] * 2}, ["sensors.delay and sensors.jitter", "temperature", "0.25"]),
        ({"sensors.loss": [[20.0] * 4 + [60.0]] * 2}, ["sensors.loss", "found 60", "[0, 20]"]),
        ({"links.colour": [[1.0]]}, ["links.colour: unknown"]),
        ({"links.mass": [[1.0] * 5] * 2}, ["links.mass", "found shape (2, 5)", "(B, 6)"]),
        ({"links.mass": [[1.0] * 6] * 3}, ["robots", "same for every quantity"]),
        ({"links.mass": [[1.0] * 5 + [0.01]] * 2}, ["links.mass", "found 0.01", "[0.05, 20]"]),
        ({"links.mass": [[1.0] * 5 + [float("nan")]] * 2}, ["links.mass", "found nan"]),
        ({"sensors.noise": [[-1.0] * 5] * 2}, ["sensors.noise", "found -1", "[0, 20]"]),
        ({"links.mass": [["heavy"] * 6] * 2}, ["links.mass", "not an array of numbers"]),
        ({"links.mass": [["1.0"] * 6] * 2}, ["links.mass", "not an array of numbers"]),
        ({"climate.ambient_c": [True, False]}, ["climate.ambient_c", "not an array of numbers"]),
        ({"climate.ambient_c": ["x" * 20_000] + [""] * 20_000}, ["climate.ambient_c", "not an array"]),
        ({"climate.ambient_c": 20.0}, ["climate.ambient_c", "found shape ()"]),
        ({"links.mass": [[1.0] * 6, [1.0]]}, ["links.mass", "not an array of numbers"]),
        ({"links.mass": [[10**400] * 6] * 2}, ["found the number 10000000000000000000… of 401 digits"]),
        ({"climate.ambient_c": []}, ["climate.ambient_c", "found shape (0,)"]),
    ],
)
def test_implausible_stored_draw_is_refused(tmp_path, change, words):
    path, data = tmp_path / "draw.json", json.loads(drawn(5, range(2)).to_json(5, DISTRIBUTIONS, SPEC))
    numbers = {name: values for name, values in (data["draw"] | change).items() if values is not None}
    data |= {name: value for name, value in change.items() if name in data}
    path.write_text(json.dumps({**data, "draw": {n: v for n, v in numbers.items() if n not in data}}))
    with pytest.raises(ConfigError) as caught:
        load_draw(path, DISTRIBUTIONS, SPEC)
    for word in [str(path), *words]:
        assert word in str(caught.value)


def test_stored_draws_of_many_robots_are_read_and_other_long_files_refused(tmp_path, monkeypatch):
    path, d = tmp_path / "draw.json", drawn(5, range(10))
    path.write_text(d.rows(np.arange(3000) % 10).to_json(5, DISTRIBUTIONS, SPEC))
    assert load_draw(path, DISTRIBUTIONS, SPEC)[1].robots == 3000
    monkeypatch.setattr("robots.draws.FILE_MAX", 1000)
    path.write_text(" " * 1001)
    with pytest.raises(ConfigError, match=r"draw\.json: found 1001 bytes, at most 1000"):
        load_draw(path, DISTRIBUTIONS, SPEC)
    monkeypatch.undo()
    path.write_text("[" + "[]," * 200_000 + "[]]")
    with pytest.raises(
        ConfigError, match=r"draw\.json: found 200002 lists and objects of JSON, expected at most"
    ):
        load_draw(path, DISTRIBUTIONS, SPEC)


@pytest.mark.parametrize("text", ["", "[1]", "{", "[" * 50_000])
def test_malformed_stored_draw_is_refused(tmp_path, text):
    path = tmp_path / "draw.json"
    path.write_text(text)
    with pytest.raises(ConfigError, match=re.escape(str(path))):
        load_draw(path, DISTRIBUTIONS, SPEC)
    with pytest.raises(ConfigError, match="cannot be read"):
        load_draw(tmp_path / "nothing", DISTRIBUTIONS, SPEC)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("mass = .*", "mass = { low = 1.2, high = 0.8 }", ["links.mass", "low 1.2 is above high 0.8"]),
        ("mass = .*", "mass = { low = 0.0, high = 0.8 }", ["links.mass", "[0.0, 0.8]", "[0.05, 20.0]"]),
        ("mass = .*", "mass = { low = 0.8, high = 30.0 }", ["links.mass", "30.0", "20.0"]),
        ("mass = .*", "mass = { low = 0.8 }", ["links.mass.high", "required"]),
        ("mass = .*", "mass = 1.0", ["links.mass", "1.0"]),
        ("mass = .*", "mas = { low = 1, high = 1 }", ["links.mas", "links.mass"]),
        ("mass = .*", "mass = { low = 0.8, high = 1.2, log = 1 }", ["links.mass.log", "boolean"]),
        ("mass = .*", "mass = { low = -1.0, high = 1.2, log = true }", ["logarithmic", "-1.0"]),
        ("hold = .*", "hold = { low = 0.0, high = 1.1 }", ["sensors.hold", "[0.0, 1.1]", "[0.0, 1.0]"]),
        ("delay = .*", "delay = { low = -0.01, high = 0.01 }", ["sensors.delay", "-0.01"]),
        ("noise = .*", "noise = { low = -0.5, high = 2.0 }", ["sensors.noise", "-0.5", "[0.0, 20.0]"]),
        ("noise = .*", "noise = { low = 0.5, high = 30.0 }", ["sensors.noise", "30.0", "20.0"]),
        ("delay_s = .*", "delay_s = { low = 0.0, high = 0.01 }", ["drives.delay_s", "0.01", "0.005"]),
        (
            "jitter = .*",
            "jitter = { low = 0.0, high = 9.0 }",
            ["sensors.delay and sensors.jitter", "temperature", "0.25"],
        ),
        ("tilt_rad = .*", "tilt_rad = { low = -1.0, high = 1.0 }", ["mounting.tilt_rad", "[-0.5, 0.5]"]),
        (
            "torque_constant = { low = -.*",
            "torque_constant = { low = -1.0, high = 0 }",
            ["wear.torque_constant", "-0.9"],
        ),
        ("life_rad = .*", "life_rad = 0.0", ["wear.life_rad", "greater than or equal to 1", "0.0"]),
        ("life_c = .*", "life_c = -273.0", ["wear.life_c", "greater than or equal to -50", "-273.0"]),
        ("life_c = .*", "life_c = 301.0", ["wear.life_c", "less than or equal to 300", "301.0"]),
        ("above_m = .*", "above_m = -11.0", ["cable.above_m", "greater than or equal to -10", "-11.0"]),
        ("above_m = .*", "above_m = 11.0", ["cable.above_m", "less than or equal to 10", "11.0"]),
        (
            "friction = { low = 0.0, .*",
            "friction = { low = 0.0, high = 21.0 }",
            ["wear.friction", "21.0", "[0.0, 20.0]"],
        ),
        ("above_m = .*", "above_m = '1'", ["cable.above_m", "'1'"]),
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


def test_streams_of_keys_do_not_overlap():
    """Other robot, purpose or counter: other numbers; same: same."""
    seeds = [robot_seed(1, robot) for robot in range(3)]
    numbers = {}
    for purpose in (0, 1):
        for robot, key in enumerate(stream_keys(seeds, purpose)):
            for counter in (0, 1, 2**40):
                numbers[purpose, robot, counter] = generator_at(key, counter).random(1000)
    everything = np.concatenate(list(numbers.values()))
    assert len(np.unique(everything)) == everything.size
    again = generator_at(stream_keys([robot_seed(1, 2)], 1)[0], 2**40).random(1000)
    np.testing.assert_array_equal(again, numbers[1, 2, 2**40])


def test_draw_and_streams_share_no_state():
    """Making keys, drawing, spawning: each robot's seed gives the same draw whatever was done with it before."""
    seed = robot_seed(4, 2)
    before = draw(DISTRIBUTIONS, SPEC, [seed])
    stream_keys([seed], 0)
    seed.spawn(3)
    assert_same(draw(DISTRIBUTIONS, SPEC, [seed]), before)
