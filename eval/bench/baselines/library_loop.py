"""Loop of plain library calls for one robot: the baseline of the runtime's batched arrays.

One filterpy filter per joint, one Ruckig, the policy called with `run`, Pinocchio called robot by robot, `mj_step` in a
loop. It has no supervisor, judge or recorder, and so does less than the runtime.
"""

import time
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter
from ruckig import InputParameter, OutputParameter, Ruckig

from deploy.policy.contract import Contract
from deploy.policy.inference import load_session
from robots.arrays import Floats
from robots.models.collisions import collision_pairs
from robots.models.mujoco_model import load_mujoco
from robots.models.nominal_model import load_pinocchio
from robots.spec import RobotSpec


class LibraryLoop:
    """One robot and its control stack, of library calls only."""

    def __init__(self, spec: RobotSpec, contract: Contract, policy: Path) -> None:
        self._spec, self.decimation = spec, contract.control_hz // contract.policy_hz
        self._model = load_mujoco(spec)
        self.data, self._rng = mujoco.MjData(self._model), np.random.default_rng(0)
        self._home = spec.joint_array("q_home")
        self.data.qpos[:] = self._home
        self._gear = self._model.actuator_gear[:, 0]
        self._pin, self._shapes = load_pinocchio(spec)
        for a, b in collision_pairs(self._pin, self._shapes, spec.neighbours):
            self._shapes.addCollisionPair(pin.CollisionPair(a, b))
        self._pin_data, self._shapes_data = self._pin.createData(), self._shapes.createData()
        densities = spec.joint_array("acceleration_density")
        self._filters = [_filter(spec, *joint) for joint in zip(self._home, densities, strict=True)]
        self._session = load_session(policy.read_bytes(), str(policy))
        self._observation = np.zeros((1, contract.observation_size), dtype=np.float32)
        self._otg, self._in, self._out = _smoother(spec, self._home)
        self.target = self._home.copy()

    def tick(self, number: int) -> None:
        """Advance one control tick: sensors, filters, policy, smoother, checks, physics."""
        noise = self._rng.normal(0.0, self._spec.sensors["encoder"].noise, self._spec.n)
        for joint, angle in zip(self._filters, self.data.qpos + noise, strict=True):
            joint.predict()
            joint.update(angle)
        q = np.array([joint.x[0, 0] for joint in self._filters])
        if number % self.decimation == 0:
            self._update_target(q)
        self._in.target_position = self.target
        self._otg.update(self._in, self._out)
        self._out.pass_to_input(self._in)
        self._check_and_send()
        for _ in range(self._spec.rates.physics_hz // self._spec.rates.control_hz):
            mujoco.mj_step(self._model, self.data)

    def _update_target(self, q: Floats) -> None:
        pin.framesForwardKinematics(self._pin, self._pin_data, q)
        self._observation[0, : self._spec.n] = q
        action = self._session.run(None, {"observation": self._observation})[0][0]
        self.target = self._home + 0.3 * np.tanh(action)

    def _check_and_send(self) -> None:
        out = self._out
        q, qd, qdd = (np.array(part) for part in (out.new_position, out.new_velocity, out.new_acceleration))
        tau = pin.rnea(self._pin, self._pin_data, q, qd, qdd)
        jacobian = pin.computeJointJacobians(self._pin, self._pin_data, q)
        np.linalg.det(jacobian)
        pin.computeCollisions(self._pin, self._pin_data, self._shapes, self._shapes_data, q, False)
        control = np.stack([q * self._gear, qd * self._gear, tau / self._gear], axis=1)
        self.data.ctrl[:] = control.ravel()


def _smoother(spec: RobotSpec, q: Floats) -> tuple[Ruckig, InputParameter, OutputParameter]:
    start = InputParameter(spec.n)
    start.current_position = q
    start.max_velocity = spec.margins.speed * spec.joint_array("qd_max")
    start.max_acceleration = spec.joint_array("qdd_max")
    start.max_jerk = spec.joint_array("qddd_max")
    return Ruckig(spec.n, spec.dt), start, OutputParameter(spec.n)


def _filter(spec: RobotSpec, angle: float, density: float) -> KalmanFilter:
    joint = KalmanFilter(dim_x=2, dim_z=1)
    joint.x = np.array([[angle], [0.0]])
    joint.F = np.array([[1.0, spec.dt], [0.0, 1.0]])
    joint.H = np.array([[1.0, 0.0]])
    joint.R *= spec.sensors["encoder"].noise ** 2
    joint.Q = Q_continuous_white_noise(2, spec.dt, density)
    return joint


def library_loop_rate(spec: RobotSpec, contract: Contract, policy: Path, ticks: int) -> float:
    """Return the robot-seconds per core-second of plain library calls."""
    loop = LibraryLoop(spec, contract, policy)
    for number in range(20):
        loop.tick(number)
    began = time.perf_counter()
    for number in range(ticks):
        loop.tick(number)
    return ticks * spec.dt / (time.perf_counter() - began)
