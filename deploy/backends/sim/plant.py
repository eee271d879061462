"""The physics of B robots as they really are: MuJoCo with every robot's own draw, and what MuJoCo leaves out."""

from collections.abc import Mapping, Sequence

import numpy as np
from mujoco import MjLogConfig
from mujoco.batch import Batch, SimulationError
from numpy.typing import NDArray

from deploy.backends.sim import drawn
from deploy.backends.sim.anatomy import Anatomy, build
from deploy.backends.sim.disturbances import Payload, Pushes
from deploy.backends.sim.drives import Drives, Supply
from deploy.backends.sim.heat import Housings, Windings
from deploy.backends.sim.motion import Motion
from deploy.backends.sim.truth import Truth
from deploy.backends.sim.wear import Wear, Worn
from deploy.masks import all_true, any_true
from deploy.motion.drive_law import Gains
from deploy.stage import Stage
from deploy.state import Command
from robots.arrays import Bools, Floats
from robots.distributions import Distributions
from robots.draws import Draw
from robots.sensors import Kind
from robots.spec import RobotSpec

BUS_S = 0.02
"""s, how often the supply's voltage follows what is drawn: about what its capacitors bridge."""
SLOW_S = 1.0
"""s, how often housings warm and joints age: they take minutes to months, so that this step is as good as none."""

_NUMBER = 1
"""Place of the count in MuJoCo's warning statistics; place 0 is the last index that was warned of."""


class Plant(Stage):
    """B simulations of one model.

    MuJoCo's derived fields are one physics step behind after a step and zero after a restore: those that are read are
    copied after each step, and carried.
    """

    carried = ("rows", "tick", "valid", "current", "sensed", "tool", "tool_velocity", "travel", "turned")
    parts = ("drives", "supply", "housings", "windings", "wear", "payload", "pushes")

    def __init__(
        self,
        spec: RobotSpec,
        distributions: Distributions,
        draw: Draw,
        seeds: Sequence[np.random.SeedSequence],
        *,
        gains: Gains | None = None,
        threads: int = 1,
    ) -> None:
        """Build the simulations at the home pose, brakes on; a robot with a base hangs on a gantry until it is powered.

        Args:
            spec: the robot as it should be.
            distributions: of the draw: what its cable is plugged into, and how long a joint lives.
            draw: B robots as they are.
            seeds: B seeds: when each is pushed, and where in its cycle of loads it begins.
            gains: of the drives; None: their own.
            threads: for physics; results do not depend on it.
        """
        _keep_no_log()
        anatomy = build(spec, distributions.cable)
        self.batch = Batch(anatomy.model, draw.robots, nthread=threads)
        drawn.embody(self.batch, anatomy, draw)
        self.motion = Motion(self.batch, anatomy)
        self.drives = Drives(spec, self.batch, draw, gains)
        self.supply = Supply(self.batch, draw, self.drives.gear)
        self.windings, self.housings = Windings(self.batch, draw), Housings(spec, self.batch, draw)
        self.wear = Wear(distributions.wear, self.batch, anatomy, draw)
        self.payload = Payload(self.batch, anatomy, draw, seeds, spec.dt)
        self.pushes = Pushes(self.batch, anatomy, draw, seeds, spec.dt)
        self._dt = spec.dt
        self._bus, self._slow = (max(1, round(s * spec.rates.control_hz)) for s in (BUS_S, SLOW_S))
        self._bind(anatomy)
        self._allocate(draw.robots, spec.n)
        self._readings: dict[Kind, Floats] = {
            "encoder": self._encoder,
            "velocity": self.motion.motor_qd,
            "current": self.current,
            "temperature": self.housings.celsius,
        }
        self._readings |= {kind: self.sensed[:, places] for kind, places in anatomy.sensed.items()}
        self.reset(self.valid.copy(), np.tile(spec.joint_array("q_home"), (draw.robots, 1)))

    def _bind(self, anatomy: Anatomy) -> None:
        bind, self._dofs = self.batch.bind, anatomy.dofs
        self.rows, self._ctrl, self._rise = self.batch.state, bind("ctrl"), bind("act")
        self._force, self._tau = bind("actuator_force"), bind("qfrc_actuator")
        self._site, self._contacts = bind("site_xpos")[:, anatomy.tool], bind("ncon")
        self._sensordata, self._strongest = bind("sensordata"), anatomy.strongest
        self._base, self._held = anatomy.base, bind("eq_active")
        self._damping = self.batch.expand("dof_damping")[:, self._dofs]
        # Of any kind: a simulation that is warned stops in the middle of a rollout, be it for a number that is not
        # finite or for contacts that found no room.
        self._warned = self.batch.warning[:, :, _NUMBER]

    def _allocate(self, robots: int, n: int) -> None:
        self.tick, self.valid = np.zeros(1, dtype=np.int64), np.ones(robots, dtype=bool)
        self.current, self.sensed = np.zeros((robots, n)), np.zeros(self._sensordata.shape)
        self.tool, self.tool_velocity = np.zeros((robots, 3)), np.zeros((robots, 3))
        self.travel, self.turned = np.zeros((robots, n)), np.zeros((robots, n))
        self._encoder, self._speed = np.zeros((robots, n)), np.zeros((robots, n))

    @property
    def q(self) -> Floats:
        """(B, n) rad, the links' angles."""
        return self.motion.q

    @property
    def qd(self) -> Floats:
        """(B, n) rad/s, the links' speeds."""
        return self.motion.qd

    @property
    def braked(self) -> Bools:
        """(B,) brakes on."""
        return self.drives.braked

    @property
    def housing(self) -> Floats:
        """(B, n) °C."""
        return self.housings.celsius

    def reading(self, kind: Kind) -> Floats:
        """(B, channels) what a sensor of `kind` is exposed to; encoders sit on the motor's side and wear."""
        return self._readings[kind]

    def worn(self) -> Worn:
        """What the joints have become."""
        return self.wear.worn()

    def reset(self, ids: Bools, q: Floats) -> None:
        """Rest robots where `ids` (B,) holds at `q` (B, n) rad, brakes on: motors and joints as at the shift's start.

        Loads and pushes go on as they come: they wait for no episode.
        """
        rows = np.flatnonzero(ids)
        self.batch.reset(rows)
        self.motion.place(rows, q)
        self.drives.rest(rows, q)
        self._ctrl[rows] = self.drives.goal[rows]
        self.supply.rest(rows)
        self.housings.reset(rows)
        self.windings.square[rows] = 0.0
        self.wear.reset(rows)
        self.pushes.apply(rows)
        self.travel[rows] = self.turned[rows] = 0.0
        self.valid[rows] = True
        try:
            self.batch.forward(rows)
        except SimulationError as e:
            self.valid[e.ids] = False
        self.current[rows] = 0.0
        self.sensed[rows] = self._sensordata[rows]
        self.tool[rows], self.tool_velocity[rows] = self._site[rows], 0.0
        self._observe()

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Put saved arrays back, bit for bit; torque and contacts read zero until the next step."""
        super().restore(arrays)
        self.drives.apply()
        self.housings.apply()
        self.wear.apply()
        self.payload.follow()
        self.pushes.follow()
        self._warned[:] = 0
        self._observe()

    @np.errstate(over="ignore", invalid="ignore")  # of simulations that have diverged
    def step(self, command: Command) -> None:
        """One control period under a command."""
        tick = int(self.tick[0])
        self.payload.step(tick)
        self.pushes.step(tick)
        if self._base:
            self._held[command.powered, self._base.gantry] = 0
        self._roll(self.drives.follow(command, self.motion.motor_q))
        self.tick[0] = tick = tick + 1
        self._settle()
        if tick % self._bus == 0:
            self.windings.warm(self._rise, self.housing, self._bus, self._dt)
            ohm = self.windings.ohm(self.housing + self._rise)
            self.supply.sink(self.current, self.motion.motor_qd, self.wear.constant, ohm)
        if tick % self._slow == 0:
            self._settle_slowly()

    def warm(self, rise: Floats) -> None:
        """Windings are (B, n) K warmer than their housings."""
        self._rise[:] = rise

    def brake(self, ids: Bools) -> None:
        """Close the brakes of robots where `ids` (B,) holds, on the pose they find."""
        self.drives.brake(ids, self.motion.motor_q)

    def _roll(self, control: Floats) -> None:
        ids = None if all_true(self.valid) else np.flatnonzero(self.valid)
        try:
            self.batch.rollout(
                control.shape[1], control=control if ids is None else control[ids], record=(), ids=ids
            )
        except SimulationError as e:
            self.valid[e.ids] = False
        if any_true(self._warned):
            self.valid &= ~self._warned.any(axis=1)

    def _settle(self) -> None:
        """Read what the physics left."""
        self._observe()
        np.divide(self._force, self.wear.constant, out=self.current)
        if any_true(self.braked):
            self.current[self.braked] = 0.0
        self.windings.square += self.current * self.current
        self.sensed[:] = self._sensordata
        np.subtract(self._site, self.tool, out=self.tool_velocity)
        self.tool_velocity /= self._dt
        self.tool[:] = self._site
        np.abs(self.motion.motor_qd, out=self._speed)
        self.travel += self._speed
        self._speed *= self._speed
        self.turned += self._speed

    def _settle_slowly(self) -> None:
        """Heat and age, for all ticks since the last time; what a diverged simulation says of itself does not count."""
        lost = ~self.valid
        if any_true(lost):
            self.travel[lost] = self.turned[lost] = self.windings.square[lost] = self._rise[lost] = 0.0
        self.travel *= self._dt
        self.turned *= self._dt
        rubbed = self.wear.friction * self.travel + self._damping * self.turned
        self.housings.warm(self._rise, rubbed, self.turned, self._slow * self._dt)
        self.wear.age(self.travel, self.housing + self._rise)
        self.travel[:] = self.turned[:] = 0.0

    def _observe(self) -> None:
        self.motion.observe()
        np.add(self.motion.motor_q, self.wear.encoder_rad, out=self._encoder)

    def truth(self, t: float) -> Truth:
        """What really holds at time `t`, s."""
        return Truth(
            t=t,
            q=self.q,
            qd=self.qd,
            tau=self._tau.take(self._dofs, axis=1),
            tool_position=self.tool,
            tool_velocity=self.tool_velocity,
            self_collision=self._touching(),
            contact_n=self.sensed[:, self._strongest],
            winding_c=self.housing + self._rise,
            housing_c=self.housing,
            valid=self.valid,
            base=self.motion.base,
        )

    def _touching(self) -> Bools:
        if self._base:
            allowed = self.sensed[:, self._base.allowed].sum(axis=1)
            return np.asarray(self.sensed[:, self._base.itself] > allowed)
        return np.asarray(self._contacts > 0)


def _keep_no_log() -> None:
    """MuJoCo writes its warnings into the folder that a user happens to be in: `valid` tells them instead."""
    config = MjLogConfig.get()
    config.logto_file = False
    config.set()
