"""Catalogue of the fault classes that are injected into simulated robots: one declaration for each fault.

Faults of sensors are seven failures of each kind, and bursts of lost encoder packets. Those of the bus, of controllers
and of the computer are in communication_faults.py.
"""

from collections.abc import Collection, Iterable
from functools import partial

import numpy as np

from deploy.backends.sim.sensor_faults import OF_PACKETS, Failure
from eval.faults import communication_effects, plant_effects
from eval.faults.combined import pairs
from eval.faults.communication_faults import COMMUNICATION_FAULTS, reboots
from eval.faults.fault_class import (
    JOINT,
    ROBOT,
    SOON_S,
    ActionFault,
    FaultClass,
    PolicyFault,
    SensorFault,
    StopCategory,
)
from eval.faults.plant_effects import PlantFault
from robots.errors import ConfigError
from robots.robot_file import IMU_SENSORS
from robots.sensors import NEEDED, Kind
from robots.spec import RobotSpec

NOT_INJECTED = (
    "Ticks late by less than a control period: late ticks are late by whole slots.",
    "A start pose far away: robots start where they stand; tests check that arming is refused.",
    "An encoder that slipped while brakes were closed: it agrees with itself, and nothing measures where the joint is.",
    "A policy of wrong shape or digest: refused before any motion; tested with the policy file.",
    "Loss of log or disk: a soak records nothing; tests fill the recorder's disk.",
    "A diverged covariance: it has no cause of its own but follows from sensor failures, which are injected.",
    "Limits of joints, workspace and collisions: checked in every tick; runaway policies drive towards them.",
    "Three faults at once.",
)
"""Faults that are in no table of injections, and the reasons."""
ENCODER: Kind = "encoder"
BURSTS = {3: StopCategory.NO_STOP, 10: StopCategory.CATEGORY_2, 25: StopCategory.CATEGORY_1}
"""Numbers of packets lost in a row, and their answers."""
LONGER_S: dict[tuple[Kind, str], float] = {("current", Failure.STUCK): 5.0}
"""Durations of faults that deploy detects later, s: it counts repeats of a current before it drops the sensor."""
_MEANINGS = {
    Failure.OFF: "sends nothing",
    Failure.STUCK: "repeats its last value",
    Failure.GARBAGE: "sends random values within its range",
    Failure.WRONG: "is off by a tenth of its range",
    Failure.SLOW: "sends one packet of ten",
    Failure.DELAYED: "sends every packet 0.1 s late",
    Failure.INTERMITTENT: "is silent for 0.2 s, active for 0.2 s",
}
JUMP = 1e6
"""Action far beyond the contract's clip."""


def _set(call: ActionFault, value: float) -> None:
    call.action[call.channel] = value


def _stall(call: ActionFault) -> None:
    call.action[:] = call.last


def _jump(call: ActionFault) -> None:
    call.action[:] = JUMP if call.call % 2 else -JUMP


POLICY_FAULTS = (
    PolicyFault(
        failure_mode="nan",
        per_joint=True,
        meaning="one number of the action is NaN",
        effect=partial(_set, value=np.nan),
    ),
    PolicyFault(
        failure_mode="infinite",
        per_joint=True,
        meaning="one number of the action is infinite",
        effect=partial(_set, value=np.inf),
    ),
    PolicyFault(
        failure_mode="stalls",
        answer=StopCategory.CATEGORY_2,
        meaning="repeats its last action",
        effect=_stall,
    ),
    PolicyFault(
        failure_mode="jumps",
        answer=StopCategory.CATEGORY_2,
        meaning="outputs ±1e6 for every joint, with the other sign in each call",
        effect=_jump,
    ),
    PolicyFault(
        failure_mode="runs away",
        per_joint=True,
        answer=StopCategory.CATEGORY_2,
        meaning="drives one joint towards its limit",
        effect=partial(_set, value=JUMP),
    ),
)
PLANT_FAULTS = (
    PlantFault(
        component=JOINT,
        failure_mode="housing hot",
        lasts_s=12.0,
        meaning="warmed by 6 K/s from outside",
        effect=plant_effects.heat_housing,
    ),
    PlantFault(
        component=JOINT,
        failure_mode="winding short",
        lasts_s=8.0,
        meaning="a short between turns warms the winding by 15 K/s while it has power",
        effect=plant_effects.short_winding,
    ),
    PlantFault(
        component=JOINT,
        failure_mode="blocked",
        meaning="cannot be moved",
        effect=plant_effects.block,
    ),
    PlantFault(
        component=JOINT,
        failure_mode="drive dead",
        meaning="its amplifier gives no voltage",
        effect=partial(plant_effects.supply, share=plant_effects.NO_VOLTAGE),
    ),
    PlantFault(
        component=ROBOT,
        failure_mode="brakes close",
        meaning="without a command, with 1.5 times the joints' torque",
        effect=plant_effects.close_brakes,
    ),
    PlantFault(
        component=ROBOT,
        failure_mode="cable caught",
        meaning="pulls with 200 N per metre",
        effect=plant_effects.catch_cable,
    ),
    PlantFault(
        component=ROBOT,
        failure_mode="supply sags",
        meaning="to 60 % of its voltage",
        effect=partial(plant_effects.supply, share=plant_effects.SAG),
    ),
    PlantFault(
        component=ROBOT,
        failure_mode="supply drops",
        lasts_s=0.3,
        meaning="to no voltage: drives trip and brakes close; then it waits until power is given anew",
        effect=communication_effects.disable_drives,
    ),
)

BODY_FAULTS = (
    PlantFault(
        component=ENCODER,
        failure_mode="slips",
        per_joint=True,
        meaning="turns on its shaft by 0.1 to 0.3 rad, which its drive follows; comes back after 3 s",
        effect=plant_effects.slip_encoder,
    ),
    PlantFault(
        component=ROBOT,
        failure_mode="tool changed",
        meaning="for one that is heavier by a tenth of the robot's links",
        effect=plant_effects.change_tool,
    ),
)


def catalogue(spec: RobotSpec, read: Collection[Kind]) -> tuple[FaultClass, ...]:
    """Return all fault classes of a robot, in the order of the report; of its sensors, those of the kinds in `read`."""
    others = (*POLICY_FAULTS, *PLANT_FAULTS, *BODY_FAULTS, *COMMUNICATION_FAULTS, *reboots(spec, read))
    single = (*_sensor_faults(spec, read), *(fault.of_robot(spec) for fault in others))
    return (*single, *pairs(single))


def check_names(names: Iterable[str], spec: RobotSpec, read: Collection[Kind], field: str) -> None:
    """Check that classes of these names are in the catalogue; `read` as in `catalogue`.

    Raises:
        ConfigError: one is not; it names the `field` that the names are from.
    """
    known = [each.name for each in catalogue(spec, read)]
    for name in names:
        if name not in known:
            raise ConfigError(f"{field}: found {name!r:.80}, expected some of: {', '.join(known)}")


def not_injected(spec: RobotSpec, read: Collection[Kind]) -> tuple[str, ...]:
    """Return the faults that are not in the catalogue, and the reasons; `read` as in `catalogue`."""
    unread = (
        f"Failures of the sensor {kind} ({len(_MEANINGS)} classes): not read by the runtime with this policy; whatever"
        " it sends, nothing changes."
        for kind in spec.sensors
        if kind not in read
    )
    return (*unread, *NOT_INJECTED)


def _sensor_faults(spec: RobotSpec, read: Collection[Kind]) -> tuple[SensorFault, ...]:
    """Return the classes of the sensors of a robot that are read.

    Without a sensor that it needs, a robot may stop and wait for its operator.
    """
    needed = (*NEEDED, *(IMU_SENSORS if "floating_base" in spec.capabilities else ()))
    failures = (
        SensorFault(
            component=kind,
            failure_mode=failure,
            failure=failure,
            channels=(None,) if failure in OF_PACKETS else (None, *range(channels)),
            lasts_s=LONGER_S.get((kind, failure), SOON_S),
            answer=StopCategory.CATEGORY_1 if kind in needed else StopCategory.CATEGORY_2,
            meaning=meaning,
        )
        for kind, channels in spec.channels.items()
        if kind in read
        for failure, meaning in _MEANINGS.items()
    )
    bursts = (
        SensorFault(
            component=ENCODER,
            failure_mode=f"burst of {packets}",
            failure=Failure.OFF,
            lasts_s=packets / spec.sensors[ENCODER].rate_hz,
            answer=answer,
            meaning=f"{packets} packets in a row are lost",
        )
        for packets, answer in BURSTS.items()
    )
    return (*failures, *bursts)
