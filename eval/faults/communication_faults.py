"""Fault classes of the bus that carries the commands, of the controllers at its end, and of the computer.

Sources: packets lost in a row as Franka Control Interface counts them (20 end the motion); watchdogs of drives and what
they do after a reboot as in `deploy.backends.sim.command_bus`; late ticks as in `late_ticks`. Durations are estimates.
"""

from collections.abc import Collection
from functools import partial

from deploy.backends.sim.sensor_faults import Failure
from eval.faults import communication_effects as effects
from eval.faults import plant_effects
from eval.faults.combined import CombinedFault
from eval.faults.fault_class import JOINT, FaultClass, SensorFault, StopCategory
from eval.faults.plant_effects import PlantFault
from robots.sensors import AT_JOINTS, Kind
from robots.spec import RobotSpec

BUS, CONTROLLER, COMPUTER = "bus", "controller", "computer"
REBOOT_S = 0.5
"""s for which what reboots gives no torque, takes no commands and sends nothing."""
COMMUNICATION_FAULTS = (
    PlantFault(
        component=BUS,
        failure_mode="loses 25 ms",
        lasts_s=0.025,
        answer=StopCategory.NO_STOP,
        meaning="the commands of 25 ms in a row are lost; drives keep the last one",
        effect=effects.lose_commands,
    ),
    PlantFault(
        component=BUS,
        failure_mode="loses 75 ms",
        lasts_s=0.075,
        meaning="the commands of 75 ms in a row are lost",
        effect=effects.lose_commands,
    ),
    PlantFault(
        component=BUS,
        failure_mode="silent",
        meaning="all commands are lost; after 0.1 s drives close the brakes",
        effect=effects.lose_commands,
    ),
    PlantFault(
        component=BUS,
        failure_mode="loses every second",
        meaning="every second command is lost",
        effect=partial(effects.lose_commands, of=2),
    ),
    PlantFault(
        component=BUS,
        failure_mode="repeats",
        meaning="one command of five is that of 25 ms before",
        effect=effects.repeat_commands,
    ),
    PlantFault(
        component=BUS,
        failure_mode="delays",
        meaning="every command arrives 50 ms late",
        effect=effects.delay_commands,
    ),
    PlantFault(
        component=COMPUTER,
        failure_mode="stalls",
        answer=StopCategory.NO_STOP,
        meaning="one tick comes 50 ms late; drives keep the last command",
        effect=partial(effects.hang, late_s=0.05),
    ),
    PlantFault(
        component=COMPUTER,
        failure_mode="hangs",
        meaning="one tick comes 0.3 s late; after 0.1 s drives close the brakes",
        effect=partial(effects.hang, late_s=0.3),
    ),
    PlantFault(
        component=COMPUTER,
        failure_mode="late",
        meaning="ticks come as late as those of a loaded computer did",
        effect=effects.run_late,
    ),
)


_LIMP = PlantFault(
    component=JOINT,
    failure_mode="drive off",
    lasts_s=REBOOT_S,
    meaning="its amplifier gives no voltage",
    effect=partial(plant_effects.supply, share=plant_effects.NO_VOLTAGE),
)
_DOWN = PlantFault(
    component=CONTROLLER,
    failure_mode="down",
    lasts_s=REBOOT_S,
    meaning="brakes close and commands are ignored",
    effect=effects.disable_drives,
)


def reboots(spec: RobotSpec, read: Collection[Kind]) -> tuple[FaultClass, ...]:
    """Return the reboots of one drive and of the controller of all; sensors that are `read` are silent meanwhile."""
    silent = tuple(_silent(kind) for kind in spec.sensors if kind in AT_JOINTS and kind in read)
    return (
        CombinedFault(
            component=JOINT,
            failure_mode="drive reboots",
            lasts_s=REBOOT_S,
            meaning="no torque and no packets of the joint for 0.5 s; then it goes on",
            effects=(_LIMP, *silent),
        ),
        CombinedFault(
            component=CONTROLLER,
            failure_mode="reboots",
            lasts_s=REBOOT_S,
            meaning="brakes close, no packets for 0.5 s; then it waits until power is given anew",
            effects=(_DOWN, *silent),
        ),
    )


def _silent(kind: Kind) -> SensorFault:
    return SensorFault(
        component=kind,
        failure_mode=Failure.OFF,
        failure=Failure.OFF,
        lasts_s=REBOOT_S,
        meaning="sends nothing",
    )
