"""What breaks in simulated robots, between the policy and the plant: nothing of `deploy` knows of it.

Sensors fail by themselves, in `deploy.backends.sim`, once they are told the schedule.
"""

from collections.abc import Callable, Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from deploy.backends.sim.anatomy import CABLE
from deploy.backends.sim.plant import Plant
from deploy.stage import Stage
from eval.faults.faults import POLICY
from eval.faults.schedule import Injection, Schedule
from robots.arrays import Float32s, Floats
from robots.models.fleet import torque_max
from robots.spec import RobotSpec

HOT_K_PER_S, SHORT_K_PER_S = 6.0, 15.0
"""How fast a housing is warmed from outside, and a winding by a short between its turns."""
NOTHING = 1e-6
"""Share of its voltage that a dead amplifier gives: to MuJoCo's motors, 0 V is no limit at all."""
BLOCKED_NM, BRAKE = 1e5, 1.5
"""N·m of friction that nothing overcomes, and what brakes hold as a share of the joints' torque."""
CAUGHT_N_PER_M, SAG = 200.0, 0.3
"""Stiffness of a cable that is caught, without any slack; and share of its voltage that a sagging supply keeps."""
JUMP = 1e6
"""What a policy says that jumps: the contract clips it."""

_NEVER = -1


class Injector(Stage):
    """Breaks what the schedule says, tick by tick, and mends it again.

    Attributes:
        last: (B, A) what policies said last, faults included.
    """

    carried: ClassVar[tuple[str, ...]] = ("last",)

    def __init__(self, spec: RobotSpec, schedule: Schedule, plant: Plant, actions: int) -> None:
        """Find the places.

        Args:
            spec: the robot. schedule: of faults.
            plant: of the simulated robots, new. actions: A, how many numbers a policy says.
        """
        self._schedule, self._plant, self._dt = schedule, plant, spec.dt
        batch, model = plant.batch, plant.batch.model
        self._loss, self._rise = batch.expand("dof_frictionloss"), batch.bind("act")
        self._dofs = np.array([model.jnt_dofadr[model.joint(name).id] for name in spec.joint_names])
        self._brake, self._volts = BRAKE * torque_max(spec), plant.supply.limit.copy()
        cable = model.tendon(CABLE).id
        self._pull, self._slack = (
            batch.expand("tendon_stiffness")[:, cable],
            batch.expand("tendon_lengthspring")[:, cable, 1],
        )
        self._hangs = self._pull.copy(), self._slack.copy()
        self.last = np.zeros((plant.batch.nsim, actions), dtype=np.float32)
        self._active: list[Injection] = []
        self._next = _NEVER
        self._what: dict[str, Callable[[Injection, bool], None]] = {
            "housing hot": self._hot,
            "winding short": self._short,
            "blocked": self._blocked,
            "drive dead": self._dead,
            "brakes close": self._braked,
            "cable caught": self._caught,
            "supply sags": self._sags,
            "supply drops": self._drops,
        }

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Put saved arrays back; what is broken then is broken again by the next step."""
        super().restore(arrays)
        self._pull[:], self._slack[:] = self._hangs
        self._next = _NEVER

    def step(self, tick: int) -> None:
        """Break and mend bodies, before the tick is lived."""
        schedule = self._schedule
        ending = schedule.ending(tick)
        if tick != self._next or ending or schedule.beginning(tick):
            self._active = schedule.during(tick)
        self._next = tick + 1
        for faults, broken in ((ending, False), (self._active, True)):
            for each in faults:
                act = self._what.get(each.fault.what)
                if act is not None:
                    act(each, broken)

    def said(self, action: Float32s, turn: int) -> Float32s:
        """What a policy that said `action` (B, A) is heard to say; `turn` is even or odd in turns."""
        heard = action.copy()
        for each in self._active:
            if each.fault.where == POLICY:
                self._say(each, turn, heard)
        self.last[:] = heard
        return heard

    def _say(self, each: Injection, turn: int, heard: Float32s) -> None:
        row, what = heard[each.robot], each.fault.what
        if what == "stalls":
            row[:] = self.last[each.robot]
        elif what == "jumps":
            row[:] = JUMP if turn % 2 else -JUMP
        else:
            row[each.channel] = {"nan": np.nan, "infinite": np.inf, "runs away": JUMP}[what]

    def _hot(self, each: Injection, broken: bool) -> None:
        """A winding keeps its temperature when its housing is warmed."""
        place, housings = (each.robot, each.channel), self._plant.housings
        ticks = 1 if broken else each.begins - each.ends
        warmer = HOT_K_PER_S * self._dt * ticks
        housings.celsius[place] += warmer
        self._rise[place] -= warmer
        housings.apply()

    def _short(self, each: Injection, broken: bool) -> None:
        """Mended, the motor is a new one."""
        if not broken:
            self._rise[each.robot, each.channel] = 0.0
        elif not self._plant.braked[each.robot]:
            self._rise[each.robot, each.channel] += SHORT_K_PER_S * self._dt

    def _blocked(self, each: Injection, broken: bool) -> None:
        friction = BLOCKED_NM if broken else self._plant.wear.friction[each.robot, each.channel]
        self._loss[each.robot, self._dofs[each.channel]] = friction

    def _braked(self, each: Injection, broken: bool) -> None:
        self._loss[each.robot, self._dofs] = self._brake if broken else self._plant.wear.friction[each.robot]

    def _caught(self, each: Injection, broken: bool) -> None:
        row = each.robot
        stiffness, length = (hangs[row] for hangs in self._hangs)
        self._pull[row], self._slack[row] = (CAUGHT_N_PER_M, 0.0) if broken else (stiffness, length)

    def _dead(self, each: Injection, broken: bool) -> None:
        self._give(each, NOTHING if broken else 1.0, each.channel)

    def _sags(self, each: Injection, broken: bool) -> None:
        self._give(each, SAG if broken else 1.0)

    def _drops(self, each: Injection, broken: bool) -> None:
        self._give(each, NOTHING if broken else 1.0)

    def _give(self, each: Injection, share: float, joint: int | None = None) -> None:
        """A share of its voltage to a robot's drives. Brakes need none to hold: simulated ones are drives that do."""
        if self._plant.braked[each.robot]:
            share = 1.0
        joints = slice(None) if joint is None else joint
        limit: Floats = self._plant.supply.limit
        limit[each.robot, joints] = share * self._volts[each.robot, joints]
