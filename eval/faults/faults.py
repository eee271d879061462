"""The classes of faults that are injected into simulated robots, and the most severe answer to each that is right.

Source of classes and answers: PX4 Autopilot, failure injection (sensors); Franka Control Interface, 20 missed packets
(bursts); stop categories of IEC 60204-1. Sizes and durations are estimates.
"""

from dataclasses import dataclass
from enum import IntEnum

from deploy.backends.sim.packets import ON_THE_WAY, Failure
from robots.sensors import NEEDED, Kind
from robots.spec import INERTIAL, RobotSpec


class Answer(IntEnum):
    """What a robot did about a fault, in the order of severity."""

    WENT_ON = 0
    HELD = 1
    STOPPED = 2
    CUT = 3


WORDS = {
    Answer.WENT_ON: "go on",
    Answer.HELD: "category 2",
    Answer.STOPPED: "category 1",
    Answer.CUT: "category 0",
}
"""Answers as IEC 60204-1 calls them."""

SOON_S, BURSTS = 3.0, {3: Answer.WENT_ON, 10: Answer.HELD, 25: Answer.STOPPED}
"""s that most faults last, longer than the timers that wait for them; missed packets in a row, and their answers."""
LONGER_S: dict[tuple[Kind, str], float] = {("current", Failure.STUCK): 5.0}
"""s that faults of sensors last which deploy hears of later: it counts repeats of a current, and then holds it deaf."""
POLICY, JOINT, ROBOT = "policy", "joint", "robot"
BURST = "burst"


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultClass:
    """One thing that can go wrong somewhere.

    Attributes:
        where: a kind of sensor, the policy, a joint or the whole robot. what: goes wrong there.
        channels: those it can befall: numbers of channels or joints, None for all at once.
        lasts_s: s, from the first sign to the last.
        answer: the most severe one that is right; a gentler one is too, as long as nothing is hurt.
        meaning: for the reader of the report.
    """

    where: str
    what: str
    channels: tuple[int | None, ...] = (None,)
    lasts_s: float = SOON_S
    answer: Answer = Answer.STOPPED
    meaning: str

    @property
    def name(self) -> str:
        """Of the class, among all."""
        return f"{self.where} {self.what}"

    @property
    def failure(self) -> Failure | None:
        """What happens to packets; None where it is no sensor that fails."""
        if self.where in {POLICY, JOINT, ROBOT}:
            return None
        return Failure.OFF if self.what.startswith(BURST) else Failure(self.what)


_SENSORS = {
    Failure.OFF: "says nothing",
    Failure.STUCK: "says what it said last, again and again",
    Failure.GARBAGE: "says anything inside its range",
    Failure.WRONG: "is off by a tenth of its range",
    Failure.SLOW: "sends one packet of ten",
    Failure.DELAYED: "sends every packet 0.1 s late",
    Failure.INTERMITTENT: "is silent for 0.2 s, there for 0.2 s",
}

NOT_INJECTED = (
    "Tick overrun: simulated time waits for the computer; tests make late ticks by a clock of their own.",
    "A start pose that is far away: robots start where they stand; arming is refused in tests.",
    "A policy of wrong shape or digest: refused before anything moves, by tests of the policy's file.",
    "Loss of log or disk: a soak records nothing; tests fill the recorder's disk.",
    "A diverged covariance: no cause of its own; it follows from sensors that fail, which are injected.",
    "Limits of joints, workspace and collisions: guards are asked on every tick; runaway policies drive at them.",
    "Two faults at once, and a fault while another is being answered.",
)
"""Faults of which a table of injections says nothing, and why."""


def catalogue(spec: RobotSpec) -> tuple[FaultClass, ...]:
    """Every class that a robot can be given, in the order of the report."""
    return (*_of_sensors(spec), *_of_policies(spec), *_of_drives(spec))


def _of_sensors(spec: RobotSpec) -> list[FaultClass]:
    """Without a sensor that is needed nobody can hold: such a robot may stop for its operator."""
    needed = (*NEEDED, *(INERTIAL if spec.base else ()))
    classes = [
        FaultClass(
            where=kind,
            what=failure,
            channels=(None,) if failure in ON_THE_WAY else (None, *range(many)),
            lasts_s=LONGER_S.get((kind, failure), SOON_S),
            answer=Answer.STOPPED if kind in needed else Answer.HELD,
            meaning=meaning,
        )
        for kind, many in spec.channels.items()
        for failure, meaning in _SENSORS.items()
    ]
    encoder: Kind = "encoder"
    return classes + [
        FaultClass(
            where=encoder,
            what=f"{BURST} of {ticks}",
            lasts_s=ticks / spec.sensors[encoder].rate_hz,
            answer=answer,
            meaning=f"{ticks} packets in a row are lost",
        )
        for ticks, answer in BURSTS.items()
    ]


def _of_policies(spec: RobotSpec) -> list[FaultClass]:
    one, held = tuple(range(spec.n)), Answer.HELD
    return [
        FaultClass(where=POLICY, what="nan", channels=one, meaning="one number is none"),
        FaultClass(where=POLICY, what="infinite", channels=one, meaning="one number is infinite"),
        FaultClass(where=POLICY, what="stalls", answer=held, meaning="says what it said last, on and on"),
        FaultClass(
            where=POLICY,
            what="jumps",
            answer=held,
            meaning="says ±1e6, the other way every time, on every joint",
        ),
        FaultClass(
            where=POLICY, what="runs away", channels=one, answer=held, meaning="drives one joint at its limit"
        ),
    ]


def _of_drives(spec: RobotSpec) -> list[FaultClass]:
    one = tuple(range(spec.n))
    return [
        FaultClass(
            where=JOINT,
            what="housing hot",
            channels=one,
            lasts_s=12.0,
            meaning="warmed by 6 K/s from outside",
        ),
        FaultClass(
            where=JOINT,
            what="winding short",
            channels=one,
            lasts_s=8.0,
            meaning="a short between turns warms the winding by 15 K/s while it has power",
        ),
        FaultClass(where=JOINT, what="blocked", channels=one, meaning="nothing moves it"),
        FaultClass(where=JOINT, what="drive dead", channels=one, meaning="its amplifier gives no voltage"),
        FaultClass(
            where=ROBOT, what="brakes close", meaning="by themselves, at 1.5 times the joints' torque"
        ),
        FaultClass(where=ROBOT, what="cable caught", meaning="pulls with 200 N per metre of its way"),
        FaultClass(where=ROBOT, what="supply sags", meaning="to 30 % of its voltage"),
        FaultClass(where=ROBOT, what="supply drops", lasts_s=0.3, meaning="to nothing"),
    ]
