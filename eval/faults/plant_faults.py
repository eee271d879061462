"""Fault classes of joints, brakes, cable and supply of the simulated robot."""

from eval.faults.fault_class import JOINT, ROBOT, Effect, Injection, PlantFault
from eval.faults.plant_access import PlantAccess

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
SAG = 0.3
"""Share of its voltage that a sagging supply keeps."""


def _heat_housing(access: PlantAccess, injection: Injection, active: bool) -> None:
    """Warm the housing tick by tick, or cool it by all of that. The winding keeps its temperature."""
    place, housings = (injection.robot, injection.channel), access.plant.housings
    ticks = 1 if active else injection.begins - injection.ends
    warmer = HOT_K_PER_S * access.dt * ticks
    housings.celsius[place] += warmer
    access.winding_rise[place] -= warmer
    housings.apply()


def _short_winding(access: PlantAccess, injection: Injection, active: bool) -> None:
    """Warm the winding while it has power; the repaired motor is a new one."""
    place = injection.robot, injection.channel
    if not active:
        access.winding_rise[place] = 0.0
    elif not access.plant.braked[injection.robot]:
        access.winding_rise[place] += SHORT_K_PER_S * access.dt


def _block(access: PlantAccess, injection: Injection, active: bool) -> None:
    friction = access.plant.wear.friction[injection.robot, injection.channel]
    column = access.dofs[injection.channel]
    access.friction_loss[injection.robot, column] = BLOCKED_NM if active else friction


def _close_brakes(access: PlantAccess, injection: Injection, active: bool) -> None:
    robot, friction = injection.robot, access.plant.wear.friction[injection.robot]
    access.friction_loss[robot, access.dofs] = BRAKE_SHARE * access.torque_max if active else friction


def _catch_cable(access: PlantAccess, injection: Injection, active: bool) -> None:
    robot = injection.robot
    if active:
        access.cable_stiffness[robot], access.cable_slack[robot] = CAUGHT_N_PER_M, 0.0
    else:
        access.repair_cables(robot)


def _supply(share: float) -> Effect:
    """Return an effect that leaves a share of its voltage to a joint's drive, or to all drives of the robot."""

    def effect(access: PlantAccess, injection: Injection, active: bool) -> None:
        access.set_voltage(injection.robot, share if active else 1.0, injection.channel)

    return effect


PLANT_FAULTS = (
    PlantFault(
        where=JOINT,
        what="housing hot",
        per_joint=True,
        lasts_s=12.0,
        meaning="warmed by 6 K/s from outside",
        effect=_heat_housing,
    ),
    PlantFault(
        where=JOINT,
        what="winding short",
        per_joint=True,
        lasts_s=8.0,
        meaning="a short between turns warms the winding by 15 K/s while it has power",
        effect=_short_winding,
    ),
    PlantFault(where=JOINT, what="blocked", per_joint=True, meaning="cannot be moved", effect=_block),
    PlantFault(
        where=JOINT,
        what="drive dead",
        per_joint=True,
        meaning="its amplifier gives no voltage",
        effect=_supply(NO_VOLTAGE),
    ),
    PlantFault(
        where=ROBOT,
        what="brakes close",
        meaning="without a command, with 1.5 times the joints' torque",
        effect=_close_brakes,
    ),
    PlantFault(where=ROBOT, what="cable caught", meaning="pulls with 200 N per metre", effect=_catch_cable),
    PlantFault(where=ROBOT, what="supply sags", meaning="to 30 % of its voltage", effect=_supply(SAG)),
    PlantFault(
        where=ROBOT, what="supply drops", lasts_s=0.3, meaning="to no voltage", effect=_supply(NO_VOLTAGE)
    ),
)
