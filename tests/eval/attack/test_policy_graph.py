"""Adversaries as ONNX files: what the graph computes, and that a crowd computes the same."""

import numpy as np
import pytest

from deploy.policy.policy import Policy
from eval.attack.adversaries import ADVERSARIES
from eval.attack.crowd import Crowd
from eval.attack.policy_graph import attack_contract, policy_file
from eval.attack.weights import DELAY_MAX, WEIGHTS, arrays
from eval.shard.job import WIDTH
from robots.motors.control_mode import ControlMode
from robots.spec import load_robot
from support.arm6 import SPEC

STEPS = 40
MODES = tuple(ControlMode)


def random_weights(name, seed, joints=SPEC.n):
    adversary = ADVERSARIES[name]
    shares = np.random.default_rng(seed).random(len(adversary.shares(adversary.first(joints))))
    return adversary.weights(shares, joints)


def observations(seed, joints=SPEC.n):
    return np.random.default_rng(seed).normal(size=(STEPS, WIDTH, 2 * joints)).astype(np.float32)


def by_numpy(weights, observed, home, dt, follows):
    """The oracle: float64, one robot, as the docstring of weights.py says. Return (T, n)."""
    w = {name: each[0] for name, each in arrays([weights], len(home)).items()}
    follow, commands, targets = w["follow"] * follows, [], []
    for step, row in enumerate(observed.astype(float)):
        q, v, t = row[: len(home)], row[len(home) :], step * dt
        late = step - int(w["delay"])
        delayed = commands[late] if late >= 0 else np.zeros(len(home))
        wave = np.sin(2 * np.pi * (w["wave_hz"] * t + w["chirp"] * t * t / 2 + w["wave_turns"]))
        swing = np.sin(2 * np.pi * (w["swing_hz"] * t + w["swing_turns"]))
        hidden = np.tanh(np.concatenate((q - home, v, delayed)) @ w["inward"] + w["bias"])
        drive = w["damping"] * v + w["dither"] * np.sin(w["dither_rate"] * q) + w["wave"] * wave
        drive += w["swing"] * swing + w["push"] + w["replay"] * delayed + hidden @ w["outward"]
        drive += w["step"] * np.sign(t - w["step_s"]) + w["spring"] * (home - q) * (1 - follows)
        commands.append(np.tanh(w["sharpness"] * drive))
        targets.append(follow * q + (1 - follow) * home * follows + w["reach"] * commands[-1])
        if abs(t - w["refused_s"]) < dt / 2:
            targets[-1] = np.full(len(home), np.nan)
    return np.array(targets)


@pytest.mark.parametrize("name", ADVERSARIES)
@pytest.mark.parametrize("mode", [ControlMode.POSITION, ControlMode.TORQUE])
def test_graph_computes_what_its_docstring_says(name, mode):
    """A blunt drive: errors of single precision in fast sines stay small."""
    weights = random_weights(name, 1) | {"sharpness": (1.0,), "dither_rate": (20.0,)}
    if "refused_s" in weights:
        weights["refused_s"] = (22 * SPEC.dt,)
    crowd, observed = Crowd(policy_file(SPEC, mode, [weights] * WIDTH)), observations(2)
    said = np.stack([crowd.step(row) for row in observed])
    home = SPEC.joint_array("q_home")
    expected = by_numpy(weights, observed[:, 3], home, SPEC.dt, float(mode is ControlMode.POSITION))
    np.testing.assert_allclose(said[:, 3], expected, atol=1e-3)
    assert np.isnan(said[:, 3]).any() == ("refused_s" in weights)


@pytest.mark.parametrize("name", ADVERSARIES)
def test_robots_of_a_crowd_do_what_the_files_of_their_policies_would_do_bit_for_bit(name):
    rows, observed = [random_weights(name, seed) for seed in range(WIDTH)], observations(3)
    crowd = Crowd(policy_file(SPEC, ControlMode.POSITION, rows))
    policies = [Policy(policy_file(SPEC, ControlMode.POSITION, [row]), "") for row in rows[:3]]
    for step in observed:
        said = crowd.step(step)
        for robot, policy in enumerate(policies):
            assert policy.step(step)[robot].tobytes() == said[robot].tobytes()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("robot", ["arm6", "planar3"])
def test_every_adversary_is_a_small_file_that_any_user_could_write(robot, mode, tmp_path):
    spec = load_robot(robot)
    if mode not in spec.control_modes:
        pytest.skip(f"{robot} has no such drives")
    for name, adversary in ADVERSARIES.items():
        path = tmp_path / f"{name}.onnx"
        path.write_bytes(policy_file(spec, mode, [adversary.first(spec.n)]).data)
        assert Policy.load(path, spec).contract == attack_contract(spec, mode)
        assert path.stat().st_size < 8192


def test_crowd_forgets_robots_that_are_reset():
    rows, observed = [random_weights("replay", 4) | {"sharpness": (1.0,)}] * WIDTH, observations(5)
    crowd = Crowd(policy_file(SPEC, ControlMode.POSITION, rows))
    first = crowd.step(observed[0]).copy()
    crowd.step(observed[1])
    crowd.reset(np.arange(WIDTH) < 2)
    again = crowd.step(observed[0])
    np.testing.assert_array_equal(again[:2], first[:2])
    assert (again[2:] != first[2:]).any(axis=1).all()
    assert crowd.memory.shape == (WIDTH, 1 + DELAY_MAX * SPEC.n)


@pytest.mark.parametrize("name", ADVERSARIES)
def test_shares_of_weights_lead_back_to_the_same_weights(name):
    adversary, weights = ADVERSARIES[name], random_weights(name, 6)
    assert adversary.weights(adversary.shares(weights), SPEC.n) == weights
    for key, values in weights.items():
        assert all(WEIGHTS[key].low <= x <= WEIGHTS[key].high for x in values)


@pytest.mark.parametrize("name", ADVERSARIES)
def test_searches_start_where_the_library_says(name):
    adversary = ADVERSARIES[name]
    first = adversary.first(SPEC.n)
    assert {key: first[key][0] for key in adversary.start} == dict(adversary.start)
    assert {*adversary.searched} <= {*first}
