"""Effects of plant faults on bodies, drives and supplies of simulated robots. `catalogue` declares the faults."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import numpy as np

from deploy.backends.sim.disturbances import Payload
from deploy.backends.sim.model.attachments import CABLE
from deploy.backends.sim.plant import Plant
from eval.faults.fault_class import FaultClass, Injection
from robots.capabilities import required
from robots.models.nominal_model import torque_max
from robots.spec import RobotSpec

HOT_K_PER_S, SHORT_K_PER_S = 6.0, 15.0
"""Warming of a housing from outside, and of a winding by a short between its turns."""
NO_VOLTAGE = 1e-6
"""Share of its voltage that a dead amplifier gives: MuJoCo's motors take 0 V as no limit."""
BLOCKED_NM = 1e5
"""Friction that no torque overcomes, N·m."""
BRAKE_SHARE = 1.5
"""Torque of closed brakes, as a share of the joints' torque."""
CAUGHT_N_PER_M = 200.0
"""Stiffness of a caught cable without slack."""
SAG = 0.6
"""Share of its voltage that a sagging supply keeps: enough for its drives not to trip; estimate."""
SLIPS_RAD = (0.1, -0.2, 0.3, -0.1, 0.2, -0.3)
"""Angles by which encoders slip, in turn."""
TOOL_SHARE = 0.1
"""Weight of a tool that was changed for a heavier one, as a share of the links'."""


class PlantAccess:
    """Write access to the bodies, drives and supplies of B simulated robots.

    Attributes:
        plant: of the simulated robots. dt: s, control period. tick: the coming one.
        friction_loss: (B, nv) N·m, of MuJoCo. dofs: (n,) columns of the joints in it.
        winding_rise: (B, n) K, of the winding over its housing.
        torque_max: (n,) N·m, each actuator's range at the joint.
        cable_stiffness, cable_slack: (B,) N/m and m.
        tool_kg: (B,) by which a changed tool is heavier.
    """

    def __init__(self, spec: RobotSpec, plant: Plant) -> None:
        self.plant, self.dt, self.tick, self.torque_max = plant, spec.dt, 0, torque_max(spec)
        batch, model = plant.batch, plant.batch.model
        self.friction_loss, self.winding_rise = batch.expand("dof_frictionloss"), batch.bind("act")
        self.dofs = np.array([model.jnt_dofadr[model.joint(name).id] for name in spec.joint_names])
        self._voltage, cable = plant.supply.limit.copy(), model.tendon(CABLE).id
        self.cable_stiffness = batch.expand("tendon_stiffness")[:, cable]
        self.cable_slack = batch.expand("tendon_lengthspring")[:, cable, 1]
        self.tool_kg = TOOL_SHARE * batch.expand("body_mass")[:, plant.bodies].sum(axis=1)
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


Effect = Callable[[PlantAccess, Injection, bool], None]
"""Change of the plant for an injection; True while it is active, False once when it has ended."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantFault(FaultClass):
    """Defect of the simulated body, its drives or its supply.

    Attributes:
        effect: applies the defect before each tick of the fault, and repairs it once at the end.
    """

    effect: Effect


def heat_housing(access: PlantAccess, injection: Injection, active: bool) -> None:
    """Warm the housing tick by tick, or cool it by all of that. The winding keeps its temperature."""
    place, housings = (injection.robot, injection.channel), access.plant.housings
    ticks = 1 if active else injection.begins - injection.ends
    warmer = HOT_K_PER_S * access.dt * ticks
    housings.celsius[place] += warmer
    access.winding_rise[place] -= warmer
    housings.apply()


def short_winding(access: PlantAccess, injection: Injection, active: bool) -> None:
    """Warm the winding while it has power; the repaired motor is a new one."""
    place = injection.robot, injection.channel
    if not active:
        access.winding_rise[place] = 0.0
    elif not access.plant.braked[injection.robot]:
        access.winding_rise[place] += SHORT_K_PER_S * access.dt


def block(access: PlantAccess, injection: Injection, active: bool) -> None:
    """Block a joint by friction."""
    friction = access.plant.wear.friction[injection.robot, injection.channel]
    column = access.dofs[injection.channel]
    access.friction_loss[injection.robot, column] = BLOCKED_NM if active else friction


def close_brakes(access: PlantAccess, injection: Injection, active: bool) -> None:
    """Hold all joints with the torque of their brakes."""
    robot, friction = injection.robot, access.plant.wear.friction[injection.robot]
    access.friction_loss[robot, access.dofs] = BRAKE_SHARE * access.torque_max if active else friction


def catch_cable(access: PlantAccess, injection: Injection, active: bool) -> None:
    """Stiffen the cable and take its slack."""
    robot = injection.robot
    if active:
        access.cable_stiffness[robot], access.cable_slack[robot] = CAUGHT_N_PER_M, 0.0
    else:
        access.repair_cables(robot)


def supply(access: PlantAccess, injection: Injection, active: bool, *, share: float) -> None:
    """Leave a share of its voltage to a joint's drive, or to all drives of the robot."""
    access.set_voltage(injection.robot, share if active else 1.0, injection.channel)


def slip_encoder(access: PlantAccess, injection: Injection, active: bool) -> None:
    """Slip an encoder on its shaft. The drive closes its loop over this encoder, and so turns the joint as far back."""
    rad = SLIPS_RAD[injection.slot % len(SLIPS_RAD)] if active else 0.0
    access.plant.drives.slip_encoder(injection.robot, required(injection.channel), rad)


def change_tool(access: PlantAccess, injection: Injection, active: bool) -> None:
    """Change the tool for a heavier one, as a ball at its place."""
    robot = injection.robot
    payload = cast(Payload, access.plant.disturbances["payload"])
    payload.change_tool(robot, access.tool_kg[robot] if active else 0.0)
