"""A quadruped that walks in the tests: its robot, a contract, and runtimes on simulated ones."""

from functools import cache

import numpy as np
import pytest

from deploy.policy.contract import Contract
from deploy.policy.contract_action import ActionSpec
from robots.randomness import robot_seed
from robots.spec import load_robot
from support.contracts import term
from support.paths import TEST_ROBOTS

simulate = pytest.importorskip("deploy.simulation").simulate

QUADRUPED = load_robot(TEST_ROBOTS / "quadruped")
STAND = QUADRUPED.joint_array("q_home")
KP, KD = 150.0, 4.0
ARM_S = 0.5
CONTACT_SENSORS = (
    "[sensors.gyro]",
    """[sensors.contact]
unit = "N"
sites = ["front_left", "front_right", "rear_left", "rear_right"]
rate_hz = 200
resolution = 0.1
range = 500.0
noise = 1.0
bias = 0.0
drift = 0.0
drift_per_k = 0.0
delay_s = 0.0
loss = 0.0
source = "estimate"

[sensors.gyro]""",
)
"""Change of robot.toml that gives it one at each foot, for `changed`."""
TERMS = (
    term("base_angular_velocity", 3),
    term("base_linear_velocity", 3),
    term("base_orientation", 4),
    term("projected_gravity", 3),
    term("velocity_command", 3),
    term("gait_phase", 2, period_s=0.4),
    term("joint_position", 12, offset=tuple(STAND)),
    term("joint_velocity", 12),
    term("last_action", 12),
)
PLACES = dict(
    zip(
        (t.name for t in TERMS),
        (slice(end - t.size, end) for t, end in zip(TERMS, np.cumsum([t.size for t in TERMS]), strict=True)),
        strict=True,
    )
)
"""Where each term is in an observation."""


def walking_contract(spec=QUADRUPED, **changes):
    """Targets of legs around the stand, on soft drives."""
    action = ActionSpec(
        mode="position",
        size=12,
        offset=tuple(STAND),
        scale=(1.0,) * 12,
        clip=(-1.0, 1.0),
        kp=(KP,) * 12,
        kd=(KD,) * 12,
    )
    fields = {
        "robot": spec.name,
        "robot_digest": spec.digest,
        "joint_names": spec.joint_names,
        "policy_hz": 50,
        "control_hz": spec.rates.control_hz,
        "task": "velocity",
        "observation": TERMS,
        "action": action,
        "trained": {},
    }
    return Contract(**(fields | changes))


def walker(robots=2, seed=3, *, contract=None, faults=()):
    """A runtime without a policy, and its robots on their gantries, not armed."""
    contract = contract or walking_contract()
    seeds = [robot_seed(seed, robot) for robot in range(robots)]
    return simulate(QUADRUPED, contract, seeds, faults=faults)[0]


def live(runtime, ticks, action=None):
    """Ticks under one action for all, by default to stand; the observation that came last."""
    robots = runtime.robot.robots
    action = np.zeros((robots, 12)) if action is None else np.broadcast_to(action, (robots, 12))
    last = None
    for _ in range(ticks):
        observation = runtime.sense()
        runtime.act(None if observation is None else action)
        last = observation if observation is not None else last
    return last


def standing(robots=2, faults=()):
    """The same, armed and on their feet for a second."""
    runtime = walker(robots, faults=faults)
    if faults:
        _stand_up(runtime)
    else:
        state, body = _on_their_feet(robots)
        runtime.restore(state)
        runtime.robot.restore(body)
    live(runtime, 1)
    return runtime


@cache
def _on_their_feet(robots):
    """State of runtime and robots a tick earlier, simulated once in a process."""
    runtime = walker(robots)
    _stand_up(runtime)
    return runtime.save(), runtime.robot.save()


def _stand_up(runtime):
    live(runtime, round(ARM_S / QUADRUPED.dt))
    assert not runtime.arm(np.ones(runtime.robot.robots, dtype=bool)).any()
    live(runtime, round(1.0 / QUADRUPED.dt) - 1)


def changed(tmp_path, *changes, file="robot.toml"):
    folder = tmp_path / "quadruped"
    folder.mkdir()
    for each in QUADRUPED.folder.iterdir():
        text = each.read_text()
        for old, new in changes if each.name == file else ():
            assert old in text
            text = text.replace(old, new)
        (folder / each.name).write_text(text)
    return folder
