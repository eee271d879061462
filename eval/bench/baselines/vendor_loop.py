"""Bare control loop as robot vendors publish it, for one walking robot.

It uses the true state, sends the policy's targets as steps to ideal gains without backlash, and has no filter,
smoother, safety check or judge.
"""

import time

import mujoco
import numpy as np

from deploy.policy.policy import Policy
from deploy.sources.floating_base import phase_numbers
from deploy.truth import BaseTruth
from eval.judge.falls import FallCriterion
from robots.arrays import Floats
from robots.capabilities import required
from robots.models.nominal_model import torque_max
from robots.motors.gains import Gains
from robots.spec import RobotSpec


class VendorLoop:
    """One robot in MuJoCo, stepped in a loop with the contract's gains."""

    def __init__(self, spec: RobotSpec, policy: Policy, gains: Gains) -> None:
        self._model = _compile_model(spec)
        self._data, self._policy, self._gains = mujoco.MjData(self._model), policy, gains
        self._data.qpos[7:] = spec.joint_array("q_home")
        self._torque_max, self._spec = torque_max(spec), spec
        self._last_action = np.zeros(spec.n)
        policy.resize(1)

    def tick(self, number: int, command: Floats) -> None:
        """Advance one control tick under a velocity command (3,)."""
        contract, spec, data = self._policy.contract, self._spec, self._data
        if number % (contract.control_hz // contract.policy_hz) == 0:
            observation = self._observation(number * spec.dt, command)
            self._last_action = self._policy.step(observation.astype(np.float32))[0].astype(float)
        q_des = np.array(contract.action.offset) + np.array(contract.action.scale) * self._last_action
        for _ in range(spec.rates.physics_hz // spec.rates.control_hz):
            tau = self._gains.kp * (q_des - data.qpos[7:]) - self._gains.kd * data.qvel[6:]
            data.qfrc_applied[6:] = np.clip(tau, -self._torque_max, self._torque_max)
            mujoco.mj_step(self._model, data)

    def _observation(self, t: float, command: Floats) -> Floats:
        contract = self._policy.contract
        phase = 2 * np.pi * t / contract.period_s + 2 * np.pi * np.array(contract.phase_offsets)
        sources = self._sources(phase, command)
        terms = [
            (sources[term.source] - np.array(term.offset or 0.0)) / term.scale
            for term in contract.observation
        ]
        return np.concatenate(terms)[None]

    def _sources(self, phase: Floats, command: Floats) -> dict[str, Floats]:
        data, velocity = self._data, np.zeros(3)
        w, x, y, z = data.qpos[3:7]
        up = np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
        mujoco.mju_rotVecQuat(velocity, data.qvel[:3], np.array([w, -x, -y, -z]))
        return {
            "base_linear_velocity": velocity,
            "base_orientation": data.qpos[3:7],
            "base_angular_velocity": data.qvel[3:6],
            "projected_gravity": -up,
            "velocity_command": command,
            "joint_position": data.qpos[7:],
            "joint_velocity": data.qvel[6:],
            "last_action": self._last_action,
            "gait_phase": phase_numbers(phase[None], self._policy.contract.gait_layout)[0],
        }

    def forward_speed(self) -> float:
        """Return the speed over the ground in the robot's heading, m/s."""
        w, x, y, z = self._data.qpos[3:7]
        heading = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        return float(self._data.qvel[0] * np.cos(heading) + self._data.qvel[1] * np.sin(heading))

    def base(self) -> BaseTruth:
        """Return the state of the base."""
        data = self._data
        numbers = data.qpos[:3], data.qpos[3:7], data.qvel[:3], data.qvel[3:6], np.array([0.0, 0.0, 1.0])
        return BaseTruth(*(number[None] for number in numbers))


def _compile_model(spec: RobotSpec) -> mujoco.MjModel:
    """Return the robot's model on a plane, with the drives' armature where the model has none of its own."""
    mjcf = mujoco.MjSpec.from_file(str(spec.model_path))
    mjcf.option.timestep = 1.0 / spec.rates.physics_hz
    mjcf.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0])
    # A spec without drives: the model has its own armature.
    for name, drive in zip(spec.joint_names, spec.drives, strict=False):
        joint = mjcf.joint(name)
        joint.armature = joint.armature or drive.armature
    return mjcf.compile()


def run_vendor_loop(
    spec: RobotSpec, policy: Policy, gains: Gains, seconds: float
) -> tuple[float, bool, float]:
    """Return mean forward speed in m/s at full command, whether the robot fell, robot-seconds per core-second."""
    base, loop = required(spec.base), VendorLoop(spec, policy, gains)
    began, forward, ticks = time.perf_counter(), 0.0, round(seconds * spec.rates.control_hz)
    for tick in range(ticks):
        loop.tick(tick, np.array(base.command_max))
        forward += loop.forward_speed()
    rate = seconds / (time.perf_counter() - began)
    return forward / ticks, bool(FallCriterion(spec).measure(loop.base()).fallen[0]), rate
