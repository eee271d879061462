"""Sensors that are declared as read are those that the runtime takes packets of, and no others."""

import pytest

from deploy.policy.compatibility import sensors_read
from robots.randomness import robot_seed
from robots.spec import load_robot
from support.arm6 import SPEC
from support.contracts import arm_contract, term
from support.runtimes import built
from support.walking import CONTACT_SENSORS, QUADRUPED, changed, simulate, walking_contract


class Watched(dict):
    """A sample that notes which packets are taken."""

    def __init__(self, sample, taken):
        super().__init__(sample)
        self.taken = taken

    def __getitem__(self, kind):
        self.taken.add(kind)
        return super().__getitem__(kind)


def taken(runtime, ticks=30):
    kinds, read = set(), runtime.robot.read
    runtime.robot.read = lambda: Watched(read(), kinds)
    for _ in range(ticks):
        runtime.sense()
        runtime.act(None)
    return kinds


def test_the_arms_policy_reads_all_but_the_force_sensor():
    read = sensors_read(arm_contract(), SPEC)
    assert read == {"encoder", "current", "temperature", "goal"}
    assert taken(built(1)) == read


@pytest.mark.parametrize("source", ["tool_force", "goal_position", "joint_position"])
def test_a_term_reads_its_sensor(source):
    """The camera is taken by its task in any case, and matters to nothing but the task's sources."""
    contract = arm_contract(observation=(term(source, 6 if source == "joint_position" else 3),))
    read = sensors_read(contract, SPEC)
    assert taken(built(1, contract=contract)) - {"goal"} == read - {"goal"}
    assert ("force" in read, "goal" in read) == (source == "tool_force", source == "goal_position")


def test_a_base_reads_imu_and_feet(tmp_path):
    spec = load_robot(changed(tmp_path, CONTACT_SENSORS))
    contract = walking_contract(spec, observation=(term("joint_position", 12),))
    read = sensors_read(contract, spec)
    assert read == {"encoder", "current", "temperature", "gyro", "accelerometer", "contact"}
    assert taken(simulate(spec, contract, [robot_seed(1, 0)])[0]) == read
    assert "contact" not in sensors_read(walking_contract(), QUADRUPED)
