import json
import sys

import numpy as np
import pytest

from deploy.backends.backend import Abilities, Request
from deploy.backends.sim.backend import SimBackend
from deploy.operation.cli import cli
from deploy.simulation import simulate
from robots.errors import ConfigError
from robots.motors.control_mode import ControlMode
from robots.motors.drive_gains import drive_gains
from robots.motors.gains import Gains
from robots.randomness import robot_seed
from robots.spec import load_robot
from support.contracts import arm_contract
from support.modes import mode_contract
from support.policies import policy_model, saved

SPEC = load_robot("arm6")
OUTSIDE = '''
"""A wire to arms that follow every command at once."""
import numpy as np
from deploy.backends.backend import Abilities, Backend
from deploy.state import Packet

OPENED = []

class Arm:
    robots = 1

    def __init__(self, spec):
        self.spec, self.tick, self.calls = spec, 0, []
        self.q, self.qd = spec.joint_array("q_home")[None], np.zeros((1, spec.n))

    def read(self):
        t, fresh = np.full(1, self.tick * self.spec.dt), np.ones(1, dtype=bool)
        values = {"encoder": self.q, "velocity": self.qd, "temperature": np.full_like(self.q, 30.0)}
        rest = {k: np.zeros((1, c)) for k, c in self.spec.channels.items()} | values
        noise = 1e-5 * np.sin(self.tick * np.arange(1, self.spec.n + 1))
        rest["encoder"] = rest["encoder"] + noise
        return {kind: Packet(t=t, fresh=fresh, value=rest[kind]) for kind in self.spec.channels}

    def write(self, command):
        self.tick += 1
        if command.powered[0]:
            self.q, self.qd = command.q.copy(), command.qd.copy()
        self.calls.append("write")

    def stop(self, ids):
        self.calls.append("stop")

    def close(self):
        self.calls.append("close")

class Wire(Backend):
    abilities = Abilities(control_hz=(100, 1000), gains=False)

    def open(self, request):
        OPENED.append(Arm(request.spec))
        return OPENED[-1]
'''


@pytest.fixture
def outside(installed):
    """A distribution of somebody else's, installed; its module."""
    installed("echo_wire", OUTSIDE, "backends", "echo = echo_wire:Wire")
    return lambda: sys.modules["echo_wire"]


def test_a_backend_from_another_package_drives_a_robot(outside, call, arm_policy, tmp_path):
    out = tmp_path / "out"
    options = ("--policy", arm_policy, "--backend", "echo", "--speed", "max", "--duration", 1, "--out", out)
    code, *_ = call(cli, *options)
    summary = json.loads((out / "summary.json").read_text())
    assert (code, summary["ended"], summary["backend"]) == (0, "done", "echo")
    (arm,) = outside().OPENED
    assert arm.calls.count("write") == summary["ticks"] > 200
    assert arm.calls[-1] == "close"


@pytest.mark.usefixtures("outside")
@pytest.mark.parametrize("option", [("--view",), ("--draw", "7:1")])
def test_options_of_the_simulation_are_refused_for_other_backends(call, arm_policy, tmp_path, option):
    out = tmp_path / "out"
    code, _, said = call(cli, "--policy", arm_policy, "--backend", "echo", "--out", out, *option)
    expected = f"error: --backend echo: found {option[0]}, which only simulated robots have\n"
    assert (code, said) == (2, expected)
    assert not out.exists()


def test_gains_that_a_backend_cannot_set_are_refused(outside, call, tmp_path):
    own = drive_gains(SPEC)
    soft = arm_contract().action.model_copy(
        update={"kp": tuple((0.95 * own.kp).tolist()), "kd": tuple(own.kd.tolist())}
    )
    policy, out = saved(policy_model(arm_contract(action=soft)), tmp_path), tmp_path / "out"
    code, _, said = call(cli, "--policy", policy, "--backend", "echo", "--out", out)
    assert code == 2
    assert "kp and kd of the policy's contract: found some, expected none" in said
    assert (outside().OPENED, out.exists()) == ([], False)


def test_a_control_rate_beyond_the_abilities_is_refused_by_run_and_soak_alike():
    fast = SPEC.model_copy(update={"rates": SPEC.rates.model_copy(update={"control_hz": 200_000})})
    message, seeds = "control_hz of the robot: found 200000, expected 1 to 100000", [robot_seed(3, 0)]
    with pytest.raises(ConfigError, match=message):
        SimBackend().check(Request(spec=fast, seeds=seeds))
    with pytest.raises(ConfigError, match=message):
        simulate(fast, arm_contract(), seeds)


def test_the_simulation_sets_gains_and_every_mode():
    gains = Gains(np.full(SPEC.n, 400.0), np.full(SPEC.n, 40.0))
    for mode in ControlMode:
        SimBackend().check(Request(spec=SPEC, seeds=[robot_seed(3, 0)], gains=gains, mode=mode))


def test_torque_mode_without_gains_that_can_be_set_is_refused():
    class Fixed(SimBackend):
        abilities = Abilities(control_hz=(1, 1000), gains=False, modes=tuple(ControlMode))

    seeds = [robot_seed(3, 0)]
    with pytest.raises(
        ConfigError, match=r"action\.mode of the policy's contract: found torque, expected pos"
    ):
        Fixed().check(Request(spec=SPEC, seeds=seeds, mode=ControlMode.TORQUE))
    Fixed().check(Request(spec=SPEC, seeds=seeds, mode=ControlMode.VELOCITY))


def test_a_mode_that_a_backend_lacks_is_refused(outside, call, tmp_path):
    policy, out = saved(policy_model(mode_contract("velocity")), tmp_path), tmp_path / "out"
    code, _, said = call(cli, "--policy", policy, "--backend", "echo", "--out", out)
    assert code == 2
    assert "--backend: action.mode of the policy's contract: found velocity, expected position" in said
    assert (outside().OPENED, out.exists()) == ([], False)
