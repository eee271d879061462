"""Plant: the physics of B robots with their own parameters, in MuJoCo, and what MuJoCo leaves out."""

from collections.abc import Mapping, Sequence

import numpy as np
from mujoco import MjLogConfig
from mujoco.batch import Batch, SimulationError
from numpy.typing import NDArray

from deploy.backends.sim.command_bus import CommandBus
from deploy.backends.sim.contacts import Contacts
from deploy.backends.sim.disturbances import DISTURBANCES
from deploy.backends.sim.drives import Drives, Supply
from deploy.backends.sim.heat import Housings, Windings
from deploy.backends.sim.kinematics import Kinematics
from deploy.backends.sim.model.drawn_parameters import write_draw
from deploy.backends.sim.model.plant_model import PlantModel, build
from deploy.backends.sim.wear import Wear
from deploy.masks import all_true, any_true
from deploy.stage import Stage
from deploy.state import Command
from deploy.truth import Truth
from robots.arrays import Bools, Floats, Ints
from robots.distributions import Distributions
from robots.draws import Draw
from robots.models.mujoco_model import not_simulated
from robots.sensors import Kind
from robots.spec import RobotSpec

SUPPLY_S = 0.02
"""s, period of the supply's voltage and of the windings: about what the capacitors of a supply bridge."""
SLOW_S = 1.0
"""s, period of housings and wear, which change over minutes to months."""

_COUNT = 1
"""Place of the count in MuJoCo's warning statistics; place 0 is the last index that was warned of."""


class Plant(Stage):
    """B simulations of one model.

    MuJoCo's derived fields are one physics step behind after a step and zero after a restore: those that are read are
    copied after each step, and carried.

    Attributes:
        q, qd: (B, n) rad and rad/s of the links. braked: (B,) brakes closed. housing: (B, n) °C. All are live views.
        readings: true values (B, channels) by kind of sensor; encoders are on the motor's side and wear.
        disturbances: by name. bus: carries the commands to the drives.
        late: (B,) control periods by which the computer's coming tick is late.
        beam: of the distance sensor, or None.
        base: places of the floating base, or None. on_gantry: (B, equalities) base held, of a robot that has one.
        dofs: (n,) places of the joints in `qvel`. bodies: (n,) ids of the links.
        tool: (B, 3) m, world. tool_velocity: (B, 3) m/s, mean over the last control period.
        current: (B, n) A, of the motors.
        valid: (B,) False from the moment a simulation diverged.
    """

    carried = ("rows", "tick", "valid", "current", "sensed", "tool", "tool_velocity", "travel", "turned")
    parts = ("bus", "drives", "supply", "housings", "windings", "wear", "contacts")

    def __init__(
        self,
        spec: RobotSpec,
        distributions: Distributions,
        draw: Draw,
        seeds: Sequence[np.random.SeedSequence],
        *,
        threads: int = 1,
    ) -> None:
        """Build the simulations at home, brakes closed; a floating base hangs on a gantry until it is powered.

        Args:
            spec: the robot as it should be. draw: B robots as they are.
            distributions: of the draw: link of the cable, and life of a joint.
            seeds: B seeds of pushes and of the cycle of loads.
            threads: for physics; results do not depend on it.

        Raises:
            RobotError, ConfigError: as `build`, or MuJoCo has no room to simulate the robot.
        """
        _disable_log_file()
        model = build(spec, distributions.cable)
        self.batch = Batch(model.model, draw.robots, nthread=threads)
        write_draw(self.batch, model, draw)
        self.kinematics = Kinematics(self.batch, model)
        self.bus, self.drives = CommandBus(spec, draw.robots), Drives(spec, self.batch, draw)
        self.supply = Supply(self.batch, draw, self.drives.gear)
        self.windings, self.housings = Windings(spec, self.batch, draw), Housings(spec, self.batch, draw)
        self.wear = Wear(distributions.wear, self.batch, model, draw)
        self.disturbances = {d.name: d(self.batch, model, draw, seeds, spec.dt) for d in DISTURBANCES}
        self.q, self.qd, self.braked = self.kinematics.q, self.kinematics.qd, self.drives.braked
        self.housing, self._dt, self._path = self.housings.celsius, spec.dt, spec.model_path
        self._supply_ticks, self._slow_ticks = (
            max(1, round(s * spec.rates.control_hz)) for s in (SUPPLY_S, SLOW_S)
        )
        self._bind(model)
        self._allocate(draw.robots, spec.n)
        self.contacts = Contacts(self.batch, model, self.sensed)
        self.readings = self._readings_of(model)
        self.reset(self.valid.copy(), np.tile(spec.joint_array("q_home"), (draw.robots, 1)))

    def _bind(self, model: PlantModel) -> None:
        bind, self.dofs, self.bodies = self.batch.bind, model.dofs, model.bodies
        self.rows, self._ctrl, self._rise = self.batch.state, bind("ctrl"), bind("act")
        self._force, self._tau = bind("actuator_force"), bind("qfrc_actuator")
        self._site = bind("site_xpos")[:, model.tool]
        self._sensordata = bind("sensordata")
        self.beam = model.beam
        self.base, self.on_gantry = model.base, bind("eq_active")
        self._damping = self.batch.expand("dof_damping")[:, self.dofs]
        # Of any kind: a simulation that is warned stops in the middle of a rollout, be it for a number that is not
        # finite or for contacts that found no room.
        self._warnings = self.batch.warning[:, :, _COUNT]

    def _allocate(self, robots: int, n: int) -> None:
        self.tick, self.valid = np.zeros(1, dtype=np.int64), np.ones(robots, dtype=bool)
        self.late = np.zeros(robots, dtype=np.int64)
        self.current, self.sensed = np.zeros((robots, n)), np.zeros(self._sensordata.shape)
        self.tool, self.tool_velocity = np.zeros((robots, 3)), np.zeros((robots, 3))
        self.travel, self.turned = np.zeros((robots, n)), np.zeros((robots, n))
        self._encoder, self._speed = np.zeros((robots, n)), np.zeros((robots, n))

    def _readings_of(self, model: PlantModel) -> dict[Kind, Floats]:
        readings: dict[Kind, Floats] = {
            "encoder": self._encoder,
            "velocity": self.kinematics.motor_qd,
            "current": self.current,
            "temperature": self.housings.celsius,
        }
        return readings | {kind: self.sensed[:, places] for kind, places in model.site_sensors.items()}

    def stages(self) -> dict[str, Stage]:
        """Stages inside, disturbances included."""
        return {**super().stages(), **self.disturbances}

    def reset(self, ids: Bools, q: Floats) -> None:
        """Rest robots where `ids` (B,) holds at `q` (B, n) rad, brakes closed, motors and joints as at the start.

        Disturbances keep their own schedule: they do not restart with an episode.
        """
        rows = np.flatnonzero(ids)
        self._reset_batch(rows)
        self.contacts.reset(rows)
        self.kinematics.place(rows, q)
        self.drives.rest(rows, q)
        self._ctrl[rows] = self.drives.command[rows]
        self.supply.rest(rows)
        self.housings.reset(rows)
        self.windings.square[rows] = 0.0
        self.wear.reset(rows)
        for disturbance in self.disturbances.values():
            disturbance.reset(rows)
        self.travel[rows] = self.turned[rows] = 0.0
        self._set_drive_resistance(rows)
        self._forward(rows)
        self.current[rows] = 0.0
        self.sensed[rows] = self._sensordata[rows]
        self.tool[rows], self.tool_velocity[rows] = self._site[rows], 0.0
        self._update_kinematics()

    def _reset_batch(self, rows: Ints) -> None:
        try:
            self.batch.reset(rows)
        except SimulationError as e:
            raise not_simulated(self._path, self.batch.error(int(e.ids[0]))) from e

    def _forward(self, rows: np.ndarray) -> None:
        self.valid[rows] = True
        try:
            self.batch.forward(rows)
        except SimulationError as e:
            self.valid[e.ids] = False

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Restore saved arrays, bit for bit; torque and contacts read zero until the next step."""
        super().restore(arrays)
        self.housings.apply()
        self.wear.apply()
        for disturbance in self.disturbances.values():
            disturbance.apply_all()
        self._warnings[:] = 0
        self._update_kinematics()

    @np.errstate(over="ignore", invalid="ignore")  # of simulations that have diverged
    def step(self, command: Command) -> None:
        """Advance one control period under a command."""
        tick = int(self.tick[0])
        command = self.bus.deliver(command, tick)
        for disturbance in self.disturbances.values():
            disturbance.step(tick)
        if self.base:
            self.on_gantry[command.powered, self.base.gantry] = 0
        valid = None if all_true(self.valid) else np.flatnonzero(self.valid)
        control = self.drives.step(command, self.kinematics.motor_q, self.current)
        self._roll(control if valid is None else control[valid], valid)
        self.tick[0] = tick = tick + 1
        self._read_physics()
        if tick % self._supply_ticks == 0:
            self.windings.warm(self._rise, self.housing, self._supply_ticks, self._dt)
            ohm = self.windings.ohm(self.housing + self._rise)
            self.supply.update(self.current, self.kinematics.motor_qd, self.wear.constant, ohm)
            self.windings.set_drive_resistance(slice(None), ohm)
        if tick % self._slow_ticks == 0:
            self._step_slowly()

    @np.errstate(over="ignore", invalid="ignore")
    def wait(self, robot: int) -> None:
        """Advance one robot a control period under the command that its drives have, because nobody sends one.

        Disturbances, supply, heat of the housings and wear keep to the ticks: they change slowly, and a wait is short.
        """
        if not self.valid[robot]:
            return
        self.bus.wait(robot)
        if not self.bus.enabled[robot]:
            self.brake(np.arange(len(self.valid)) == robot)
        self._roll(self.drives.wait(robot), np.array([robot]))
        self._read_physics(slice(robot, robot + 1))

    def brake(self, ids: Bools) -> None:
        """Close the brakes of robots where `ids` (B,) holds, at once."""
        self.drives.brake(ids, self.kinematics.motor_q, self.current)

    def warm(self, rise: Floats) -> None:
        """Set the windings (B, n) K above their housings."""
        self._rise[:] = rise
        self._set_drive_resistance(slice(None))

    def _set_drive_resistance(self, rows: np.ndarray | slice) -> None:
        self.windings.set_drive_resistance(rows, self.windings.ohm(self.housing + self._rise))

    def _roll(self, control: Floats, ids: Ints | None) -> None:
        """Advance robots `ids`, by default all, under controls (ids, substeps, controls)."""
        try:
            self.batch.rollout(control.shape[1], control=control, record=(), ids=ids)
        except SimulationError as e:
            self.valid[e.ids] = False
        if any_true(self._warnings):
            self.valid &= ~self._warnings.any(axis=1)

    def _read_physics(self, rows: slice = slice(None)) -> None:
        self._update_kinematics()
        current, speed, velocity = self.current[rows], self._speed[rows], self.tool_velocity[rows]
        np.divide(self._force[rows], self.wear.constant[rows], out=current)
        if any_true(self.braked):
            self.current[self.braked] = 0.0
        self.windings.square[rows] += current * current
        self.sensed[rows] = self._sensordata[rows]
        np.subtract(self._site[rows], self.tool[rows], out=velocity)
        velocity /= self._dt
        self.tool[rows] = self._site[rows]
        np.abs(self.kinematics.motor_qd[rows], out=speed)
        self.travel[rows] += speed
        speed *= speed
        self.turned[rows] += speed

    def _step_slowly(self) -> None:
        """Advance heat and wear by the ticks since the last time; numbers of a diverged simulation do not count."""
        lost = ~self.valid
        if any_true(lost):
            self.travel[lost] = self.turned[lost] = self.windings.square[lost] = self._rise[lost] = 0.0
        self.travel *= self._dt
        self.turned *= self._dt
        friction_j = self.wear.friction * self.travel + self._damping * self.turned
        self.housings.warm(self._rise, friction_j, self.turned, self._slow_ticks * self._dt)
        self.wear.step(self.travel, self.housing + self._rise)
        self.travel[:] = self.turned[:] = 0.0

    def _update_kinematics(self) -> None:
        self.kinematics.update()
        np.add(self.kinematics.motor_q, self.wear.encoder_rad, out=self._encoder)
        self._encoder += self.drives.slip

    def truth(self, t: float) -> Truth:
        """Return the ground truth at time `t`, s."""
        return Truth(
            t=t,
            q=self.q,
            qd=self.qd,
            tau=self._tau.take(self.dofs, axis=1),
            tool_position=self.tool,
            tool_velocity=self.tool_velocity,
            self_collision=self.contacts.collision,
            contact_n=self.contacts.strongest_n,
            allowed_contact_n=self.contacts.allowed_n,
            winding_c=self.housing + self._rise,
            housing_c=self.housing,
            valid=self.valid,
            base=self.kinematics.base,
        )


def _disable_log_file() -> None:
    """Keep MuJoCo from writing warnings into the current folder: `valid` reports them."""
    config = MjLogConfig.get()
    config.logto_file = False
    config.set()
