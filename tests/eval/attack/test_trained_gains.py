"""Attacks with the drive gains of a policy."""

import json

import numpy as np
import pytest

pytest.importorskip("mujoco")

from deploy.policy.compatibility import check_contract
from eval.attack.adversaries import ADVERSARIES
from eval.attack.archive import Archive, Found
from eval.attack.arena import Arena, Setting
from eval.attack.candidate import Candidate, Case, read_case
from eval.attack.policy_graph import attack_contract, policy_file
from eval.attack.report import case_of, make_report
from eval.attack.suite import run_suite
from eval.attack.trained_gains import TrainedGains, extreme_gains, find_gains
from robots.errors import ConfigError, ContractError
from robots.motors.control_mode import ControlMode
from robots.motors.drive_gains import drive_gains
from robots.spec import load_robot
from support.arm6 import copy_of_arm
from support.quadruped import QUADRUPED

POSITION = ControlMode.POSITION
GAINS = TrainedGains(*(tuple((0.8 * each).tolist()) for each in drive_gains(QUADRUPED)))
PUSH = ADVERSARIES["push"].first(QUADRUPED.n)
CASE = {"robot": "quadruped", "mode": "position", "faults": [], "monitor": "torque", "worst": 0.5}
CASE |= {"adversary": "push", "seed": 3, "weights": {name: list(numbers) for name, numbers in PUSH.items()}}


def test_adversaries_have_the_gains_of_a_policy(tmp_path):
    path = tmp_path / "walk.onnx"
    path.write_bytes(policy_file(QUADRUPED, POSITION, [PUSH], GAINS).data)
    found = find_gains(str(path), QUADRUPED, POSITION)
    assert found == GAINS
    runtime = Arena(Setting(robot=QUADRUPED.folder, mode=POSITION, gains=found), 3)._shard.runtime
    assert runtime.springs is not None
    np.testing.assert_array_equal(runtime.drives.policy.kp[0], GAINS.kp)
    np.testing.assert_array_equal(runtime.drives.policy.kd[0], GAINS.kd)


@pytest.mark.parametrize("name", ["arm6", "planar3", "planar4"])
@pytest.mark.parametrize("mode", [POSITION, ControlMode.VELOCITY])
def test_extreme_gains_are_the_last_that_a_contract_may_have(name, mode):
    spec = load_robot(name)
    soft, stiff = (find_gains(name, spec, mode) for name in ("softest", "stiffest"))
    for gains in (soft, stiff):
        check_contract(attack_contract(spec, mode, gains), spec, name)
    for gains, kp, kd in ((soft, 0.99, 1.0), (soft, 1.0, 0.99), (stiff, 1.02, 1.0), (stiff, 1.0, 1.01)):
        beyond = TrainedGains(tuple(kp * x for x in gains.kp), tuple(kd * x for x in gains.kd))
        with pytest.raises(ContractError, match=r"action\.k[pd]: "):
            check_contract(attack_contract(spec, mode, beyond), spec, name)


def test_where_no_gains_are_allowed_there_are_no_extreme_ones(tmp_path):
    narrow = copy_of_arm(tmp_path, toml=[("q_soft_rad = 0.03", "q_soft_rad = 1e-6")])
    for robot, mode in (("arm6", ControlMode.TORQUE), (narrow, POSITION)):
        assert not extreme_gains(load_robot(robot), mode)
        with pytest.raises(
            ConfigError, match=r"--gains: found 'stiffest', expected none: a contract for arm6 in"
        ):
            find_gains("stiffest", load_robot(robot), mode)


def test_a_policy_without_gains_has_none_to_take(tmp_path):
    path = tmp_path / "own.onnx"
    path.write_bytes(policy_file(QUADRUPED, POSITION, [PUSH]).data)
    with pytest.raises(ConfigError, match=r"--gains: .*own\.onnx: found no kp and kd in its contract"):
        find_gains(str(path), QUADRUPED, POSITION)


def test_gains_of_another_robot_are_refused(tmp_path):
    path = tmp_path / "walk.onnx"
    path.write_bytes(policy_file(QUADRUPED, POSITION, [PUSH], GAINS).data)
    with pytest.raises(ContractError, match=r"--gains: .*walk\.onnx: contract"):
        find_gains(str(path), load_robot("planar3"), POSITION)


def test_gains_of_another_mode_are_refused(tmp_path):
    path = tmp_path / "walk.onnx"
    path.write_bytes(policy_file(QUADRUPED, POSITION, [PUSH], GAINS).data)
    with pytest.raises(ConfigError, match="found mode 'position', expected that of --mode"):
        find_gains(str(path), QUADRUPED, ControlMode.VELOCITY)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"kp": GAINS.kp[1:]}, "kp has 11 numbers, size is 12"),
        ({"kp": (0.0, *GAINS.kp[1:])}, "kp: found 0 in mode 'position'"),
    ],
)
def test_gains_that_suit_no_action_are_named(change, complaint):
    with pytest.raises(ConfigError, match=complaint):
        attack_contract(QUADRUPED, POSITION, GAINS._replace(**change))


def test_report_and_case_have_the_gains(tmp_path):
    setting, archive = (
        Setting(robot=QUADRUPED.folder, mode=POSITION, gains=GAINS),
        Archive(QUADRUPED, POSITION),
    )
    assert make_report(QUADRUPED, setting, 3, archive, {}).gains == GAINS
    case = case_of(QUADRUPED, setting, "torque", Found(0.5, Candidate("push", PUSH, 3)))
    case.write(tmp_path / "a.json")
    assert read_case(tmp_path / "a.json") == case == Case.model_validate(case.model_dump())
    assert case.gains == GAINS


def test_a_case_without_gains_has_no_such_field(tmp_path):
    (tmp_path / "a.json").write_text(json.dumps(CASE))
    case = read_case(tmp_path / "a.json")
    assert case.gains is None
    assert "gains" not in case.model_dump()


def test_gains_of_a_case_that_drives_cannot_bear_are_refused(tmp_path):
    gains = [[1e6] * QUADRUPED.n, list(GAINS.kd)]
    (tmp_path / "a.json").write_text(json.dumps(CASE | {"gains": gains}))
    with pytest.raises(ContractError, match=r"a\.json: action\.kp: FR_hip_joint: found 1e\+06, expected"):
        list(run_suite(tmp_path))
