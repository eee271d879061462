"""Fault classes of sensors: seven failures of each kind, and bursts of lost encoder packets."""

from deploy.backends.sim.sensor_faults import OF_PACKETS, Failure
from eval.faults.fault_class import SOON_S, Answer, SensorFault
from robots.sensors import NEEDED, Kind
from robots.spec import IMU_SENSORS, RobotSpec

ENCODER: Kind = "encoder"
BURSTS = {3: Answer.WENT_ON, 10: Answer.HELD, 25: Answer.STOPPED}
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


def sensor_faults(spec: RobotSpec) -> tuple[SensorFault, ...]:
    """Return the classes of all sensors of a robot.

    Without a sensor that it needs, a robot may stop and wait for its operator.
    """
    needed = (*NEEDED, *(IMU_SENSORS if "floating_base" in spec.capabilities else ()))
    failures = (
        SensorFault(
            where=kind,
            what=failure,
            failure=failure,
            channels=(None,) if failure in OF_PACKETS else (None, *range(channels)),
            lasts_s=LONGER_S.get((kind, failure), SOON_S),
            answer=Answer.STOPPED if kind in needed else Answer.HELD,
            meaning=meaning,
        )
        for kind, channels in spec.channels.items()
        for failure, meaning in _MEANINGS.items()
    )
    bursts = (
        SensorFault(
            where=ENCODER,
            what=f"burst of {packets}",
            failure=Failure.OFF,
            lasts_s=packets / spec.sensors[ENCODER].rate_hz,
            answer=answer,
            meaning=f"{packets} packets in a row are lost",
        )
        for packets, answer in BURSTS.items()
    )
    return (*failures, *bursts)
