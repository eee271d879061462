"""Torque of gravity on the joints, nominal and its spread over robots drawn from draws.toml.

A draw has other masses, centres of mass, motors, a tilted mounting, a payload and a cable. What a motor's current says
of gravity is compared with all of them.
"""

import numpy as np
import pinocchio as pin

from robots.arrays import Floats
from robots.distributions import Distributions
from robots.draws import Draw, draw
from robots.models.nominal_model import load_pinocchio
from robots.models.pinocchio_model import BODY, tool_frame
from robots.spec import RobotSpec

ROBOTS = 100
"""Robots drawn; half of them carry their payload."""


class DrawnGravity:
    """Gravity of the nominal robot and of `ROBOTS` drawn ones."""

    def __init__(self, spec: RobotSpec, distributions: Distributions) -> None:
        """Draw the robots: the same ones each time."""
        self._model, self._cable = load_pinocchio(spec)[0], distributions.cable
        self._data = self._model.createData()
        self._draw = draw(distributions, spec, [np.random.SeedSequence(number) for number in range(ROBOTS)])
        frames = tool_frame(spec, self._model)
        tool = self._model.frames[frames[0]] if frames else None
        self._carrier = tool.parentJoint if tool else self._model.njoints - 1
        self._place = tool.placement if tool else pin.SE3.Identity()
        self._models = [self._drawn(robot) for robot in range(ROBOTS)]

    def nominal(self, q: Floats) -> Floats:
        """Return (n,) N·m at joint angles (n,) rad."""
        return np.array(pin.computeGeneralizedGravity(self._model, self._data, q))

    def drawn(self, q: Floats) -> Floats:
        """Return (ROBOTS, n) N·m at joint angles (n,) rad, as nominal torque constants read it from the currents."""
        torques = np.array([self._torque(robot, q) for robot in range(ROBOTS)])
        return np.asarray(torques / self._draw["drives.torque_constant"])

    def _drawn(self, robot: int) -> pin.Model:
        one: Draw = self._draw.robot(robot)
        model = self._model.copy()
        for joint, (mass, com) in enumerate(zip(one["links.mass"][0], one["links.com_m"][0], strict=True), 1):
            model.inertias[joint].mass *= mass
            model.inertias[joint].lever += com
        if robot % 2:
            ball = pin.Inertia(float(one["payload.mass_kg"][0]), one["payload.com_m"][0], np.zeros((3, 3)))
            model.inertias[self._carrier] += self._place.act(ball)
        about_x, about_y = one["mounting.tilt_rad"][0]
        tilt = pin.rpy.rpyToMatrix(float(about_x), float(about_y), 0.0)
        model.gravity.linear = tilt.T @ self._model.gravity.linear
        return model

    def _torque(self, robot: int, q: Floats) -> Floats:
        model, still = self._models[robot], np.zeros(len(q))
        data, forces = model.createData(), pin.StdVec_Force()
        forces.extend([pin.Force.Zero()] * model.njoints)
        pin.forwardKinematics(model, data, q)
        if model.existFrame(self._cable.link, BODY):
            plugged = model.frames[model.getFrameId(self._cable.link, BODY)].parentJoint
            forces[plugged] = self._cable_pull(robot, data.oMi[plugged], model.inertias[plugged].lever)
        return np.array(pin.rnea(model, data, q, still, still, forces))

    def _cable_pull(self, robot: int, link: pin.SE3, plug: Floats) -> pin.Force:
        """Return the cable's pull on a link, in the frame of its joint; `plug` (3,) m in that frame."""
        one = self._draw.robot(robot)
        anchor = one["cable.anchor_m"][0] + np.array([0.0, 0.0, self._cable.above_m])
        to_anchor = link.actInv(anchor) - plug
        length = float(np.linalg.norm(to_anchor))
        stretch = max(0.0, length - float(one["cable.length_m"][0]))
        force = float(one["cable.stiffness_n_per_m"][0]) * stretch / length * to_anchor
        return pin.Force(force, np.cross(plug, force))
