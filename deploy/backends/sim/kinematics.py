"""Kinematics of B plants: angles and speeds on both sides of every gear, and the pose of a floating base."""

import numpy as np
from mujoco.batch import Batch

from deploy.backends.sim.model.plant_model import PlantModel
from deploy.truth import BaseTruth
from robots.arrays import Floats


class Kinematics:
    """The motor's side is the joint of model.xml; the link is behind the backlash.

    Attributes:
        q, qd: (B, n) rad and rad/s of the links, by joint.
        motor_q, motor_qd: (B, n) of the motors, behind their gears: joint angles and speeds too.
        base: live views, of robots with a floating base.
    """

    def __init__(self, batch: Batch, plant: PlantModel) -> None:
        self._qpos, self._backlash = batch.bind("qpos"), plant.model.jnt_qposadr[plant.backlash]
        self._joints = plant.model.jnt_qposadr[plant.joints]
        self.base, self._base_start = _base(batch, plant)
        self._rows = batch.state.reshape(-1)
        # One gather finds all: (side, angle or speed, robot, joint).
        addresses = plant.addresses[:, :, None, :] + np.arange(batch.nsim)[:, None] * batch.nstate
        for kind, name in enumerate(("qpos", "qvel")):
            offset = batch.bind(name).ctypes.data - batch.state.ctypes.data
            addresses[:, kind] += offset // batch.state.itemsize
        self._addresses = addresses
        self._sides = np.zeros(addresses.shape)
        self._links = np.zeros(addresses.shape[1:])
        self.q: Floats = self._links[0]
        self.qd: Floats = self._links[1]
        self.motor_q: Floats = self._sides[0, 0]
        self.motor_qd: Floats = self._sides[0, 1]

    def update(self) -> None:
        """Read the state of the simulations."""
        self._rows.take(self._addresses, out=self._sides, mode="clip")
        np.add(self._sides[0], self._sides[1], out=self._links)

    def place(self, rows: np.ndarray, q: Floats) -> None:
        """Put robots `rows` at `q` (B, n) rad, in the middle of their backlash."""
        self._qpos[rows[:, None], self._joints] = q[rows]
        self._qpos[rows[:, None], self._backlash] = 0.0
        if self._base_start is not None:
            self._qpos[rows, : len(self._base_start)] = self._base_start


def _base(batch: Batch, plant: PlantModel) -> tuple[BaseTruth | None, Floats | None]:
    """Return views of the base in the state, and the pose (7,) that it starts with."""
    base = plant.base
    if base is None:
        return None, None
    qpos, qvel = batch.bind("qpos")[:, base.qpos], batch.bind("qvel")[:, base.qvel]
    start = plant.model.qpos0[base.qpos].copy()
    start[:3] = 0.0, 0.0, base.stands_m
    gravity = batch.expand("opt.gravity")
    up = -gravity / np.linalg.norm(gravity, axis=1, keepdims=True)
    return BaseTruth(qpos[:, :3], qpos[:, 3:], qvel[:, :3], qvel[:, 3:], up), start
