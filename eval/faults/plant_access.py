"""Arrays of the simulated plant that faults change, and their values without a fault."""

import numpy as np

from deploy.backends.sim.model.attachments import CABLE
from deploy.backends.sim.plant import Plant
from robots.models.nominal_model import torque_max
from robots.spec import RobotSpec


class PlantAccess:
    """Write access to the bodies, drives and supplies of B simulated robots.

    Attributes:
        plant: of the simulated robots. dt: s, control period.
        friction_loss: (B, nv) N·m, of MuJoCo. dofs: (n,) columns of the joints in it.
        winding_rise: (B, n) K, of the winding over its housing.
        torque_max: (n,) N·m, each actuator's range at the joint.
        cable_stiffness, cable_slack: (B,) N/m and m.
    """

    def __init__(self, spec: RobotSpec, plant: Plant) -> None:
        """Look up the arrays of a new plant."""
        self.plant, self.dt, self.torque_max = plant, spec.dt, torque_max(spec)
        batch, model = plant.batch, plant.batch.model
        self.friction_loss, self.winding_rise = batch.expand("dof_frictionloss"), batch.bind("act")
        self.dofs = np.array([model.jnt_dofadr[model.joint(name).id] for name in spec.joint_names])
        self._voltage, cable = plant.supply.limit.copy(), model.tendon(CABLE).id
        self.cable_stiffness = batch.expand("tendon_stiffness")[:, cable]
        self.cable_slack = batch.expand("tendon_lengthspring")[:, cable, 1]
        self._cable = self.cable_stiffness.copy(), self.cable_slack.copy()

    def repair_cables(self, robots: int | slice = slice(None)) -> None:
        """Restore stiffness and slack."""
        stiffness, slack = self._cable
        self.cable_stiffness[robots], self.cable_slack[robots] = stiffness[robots], slack[robots]

    def set_voltage(self, robot: int, share: float, joint: int | None = None) -> None:
        """Supply the drives of a robot, or one of them, with a share of their voltage.

        Simulated brakes are drives that hold, so that a braked robot keeps its full voltage.
        """
        if self.plant.braked[robot]:
            share = 1.0
        joints = slice(None) if joint is None else joint
        self.plant.supply.limit[robot, joints] = share * self._voltage[robot, joints]
