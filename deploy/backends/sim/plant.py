"""The physics of B robots as they really are: MuJoCo with every robot's own draw, and the heat of its motors."""

from collections.abc import Mapping

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError
from numpy.typing import NDArray

from deploy.backends.sim.truth import Truth
from deploy.flags import every, some
from deploy.stage import Stage
from deploy.state import Bools, Command, Floats
from robots.draws import Draw
from robots.model_mujoco import INPUTS, load_mujoco
from robots.spec import RobotSpec

_R, _K, _KP, _KD = 0, 1, 4, 6
"""Places of resistance, motor constant and drive gains in a dcmotor's `gainprm`."""
_RWH, _AMBIENT = 2, 4
"""Places of winding-to-housing resistance and of ambient temperature in a dcmotor's `dynprm`."""
_NUMBER = 1
"""Place of the count in MuJoCo's warning statistics; place 0 is the last index that was warned of."""


class Plant(Stage):
    """B simulations of one model.

    MuJoCo's `dcmotor` holds the winding's node, as a rise over an ambient; that ambient is the housing, whose node
    is integrated here.
    """

    carried = ("rows", "housing", "held", "braked", "tool", "tool_velocity", "valid")

    def __init__(self, spec: RobotSpec, draw: Draw, *, threads: int = 1) -> None:
        """Build the simulations at the home pose, brakes on.

        Args:
            spec: the robot as it should be.
            draw: B robots as they are.
            threads: for physics; results do not depend on it.
        """
        model = load_mujoco(spec)
        # A diverged simulation must be seen, not silently put back to its start.
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        robots, n = draw.mass.shape
        self.batch = Batch(model, robots, nthread=threads)
        substeps = spec.rates.physics_hz // spec.rates.control_hz
        self._way = np.arange(1, substeps + 1)[:, None] / substeps
        self._dt = spec.dt
        self._apply(draw, model)
        self._range, self._current = self.batch.expand("actuator_forcerange"), np.ones((robots, n))
        bind = self.batch.bind
        self.rows, self.q, self.qd = self.batch.state, bind("qpos"), bind("qvel")
        self._ctrl, self._lines = bind("ctrl"), np.zeros((robots, substeps, n * INPUTS))
        self._q, self._qd, self._feed = self._ctrl.reshape(robots, n, INPUTS).transpose(2, 0, 1)
        self._rise = bind("act")
        self._force, self._tau = bind("actuator_force"), bind("qfrc_actuator")
        self._site, self._contacts = bind("site_xpos")[:, model.site(spec.tool).id], bind("ncon")
        # Of any kind: a simulation that is warned stops in the middle of a rollout, be it for a number that is not
        # finite or for contacts that found no room.
        self._warned = self.batch.warning[:, :, _NUMBER]
        # numpy is quickest where every shape is the same.
        each = np.ones((robots, n))
        self._gear = each * model.actuator_gear[:, 0]
        self._ambient = each * draw.ambient_c[:, None]
        self._to_housing = each * model.actuator_dynprm[:, _RWH]
        self._to_ambient = each * spec.motor_array("housing_resistance_k_per_w")
        self._kelvin_per_watt = each * (self._dt / spec.motor_array("housing_capacity_j_per_k"))
        self._warm = self._ambient + draw.warm_start_k[:, None]
        self.housing = self._warm.copy()
        self.held, self.braked = np.zeros((robots, n)), np.ones(robots, dtype=bool)
        self.tool, self.tool_velocity = np.zeros((robots, 3)), np.zeros((robots, 3))
        self.valid = np.ones(robots, dtype=bool)
        self.reset(np.ones(robots, dtype=bool), np.tile(spec.joint_array("q_home"), (robots, 1)))

    def _apply(self, draw: Draw, model: mujoco.MjModel) -> None:
        """Write every robot's own parameters; mass and inertia move together."""
        expand, links = self.batch.expand, model.jnt_bodyid
        expand("body_mass")[:, links] *= draw.mass
        expand("body_inertia")[:, links] *= draw.mass[:, :, None]
        expand("dof_frictionloss")[:] *= draw.friction
        expand("dof_damping")[:] *= draw.damping
        expand("dof_armature")[:] *= draw.armature
        gain = expand("actuator_gainprm")
        gain[:, :, _R] *= draw.resistance
        gain[:, :, _K] *= draw.torque_constant
        gain[:, :, _KP] *= draw.kp
        gain[:, :, _KD] *= draw.kd
        self._motor_constant = gain[:, :, _K].copy()
        self._node = expand("actuator_dynprm")[:, :, _AMBIENT]
        self.batch.set_const()

    def reset(self, ids: Bools, q: Floats) -> None:
        """Rest robots where `ids` (B,) holds at `q` (B, n) rad: motors as at the start of the shift, brakes on."""
        rows = np.flatnonzero(ids)
        self.batch.reset(rows)
        self.q[rows], self.held[rows], self.braked[rows] = q[rows], q[rows], True
        self.housing[rows] = self._warm[rows]
        self._node[rows] = self.housing[rows]
        self._hold(rows)
        self.batch.forward(rows)
        self.tool[rows], self.tool_velocity[rows] = self._site[rows], 0.0
        self.valid[rows] = True

    def restore(self, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Put saved arrays back, bit for bit; torque, current and contacts read zero until the next step."""
        super().restore(arrays)
        self._node[:] = self.housing
        self._warned[:] = 0

    def step(self, command: Command) -> None:
        """One control period under a command."""
        drives = self._drive(command)
        ids = None if every(self.valid) else np.flatnonzero(self.valid)
        try:
            self.batch.rollout(
                len(self._way),
                control=drives if ids is None else drives[ids],
                record=(),
                ids=ids,
            )
        except SimulationError as e:
            self.valid[e.ids] = False
        if some(self._warned):
            self.valid &= ~self._warned.any(axis=1)
        self._heat()
        np.subtract(self._site, self.tool, out=self.tool_velocity)
        self.tool_velocity /= self._dt
        self.tool[:] = self._site

    def _drive(self, command: Command) -> Floats:
        """(B, substeps, controls), motor side: what the drives follow, in straight lines from the last command to this.

        Drives interpolate what a bus sends; taken as steps it would saturate the motors at every tick. Brakes are the
        drive holding the pose that they closed on.
        """
        last = self._ctrl.copy()
        np.multiply(command.q, self._gear, out=self._q)
        np.multiply(command.qd, self._gear, out=self._qd)
        np.divide(command.tau, self._gear, out=self._feed)
        if not every(command.current == self._current):
            self._current[:] = command.current
            self._range[:] = self.batch.model.actuator_forcerange * self._current[:, :, None]
        off = ~command.powered
        self.braked &= off
        if some(off):
            self.brake(off)
            last[off] = self._ctrl[off]
        np.multiply(self._way, (self._ctrl - last)[:, None], out=self._lines)
        self._lines += last[:, None]
        return self._lines

    def brake(self, ids: Bools) -> None:
        """Close the brakes of robots where `ids` (B,) holds, on the pose they find."""
        closing = ids & ~self.braked
        self.held[closing] = self.q[closing]
        self.braked |= ids
        self._hold(np.flatnonzero(self.braked))

    def _hold(self, rows: np.ndarray) -> None:
        self._q[rows] = (self.held * self._gear)[rows]
        self._qd[rows] = self._feed[rows] = 0.0

    def _heat(self) -> None:
        """Housing node, Source: see `robots.motor`; the winding keeps its temperature when its ambient moves."""
        flow = self._rise / self._to_housing - (self.housing - self._ambient) / self._to_ambient
        warming = flow * self._kelvin_per_watt
        self.housing += warming
        self._rise -= warming
        self._node[:] = self.housing

    @property
    def current(self) -> Floats:
        """(B, n) A, motor current."""
        return np.asarray(self._force / self._motor_constant)

    def truth(self, t: float) -> Truth:
        """What really holds at time `t`, s."""
        return Truth(
            t=t,
            q=self.q,
            qd=self.qd,
            tau=self._tau,
            tool_position=self.tool,
            tool_velocity=self.tool_velocity,
            self_collision=self._contacts > 0,
            winding_c=self.housing + self._rise,
            housing_c=self.housing,
            valid=self.valid,
        )
