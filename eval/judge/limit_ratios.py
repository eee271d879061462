"""From what was seen to loads: every channel of every tick as a fraction of its limit.

Speed, acceleration and jerk of the commands are backward differences of the angles sent. On a continuous
trajectory each is a mean of the true derivative, weighted by a B-spline, so it stays within what the
trajectory keeps to. Source: de Boor, A Practical Guide to Splines (1978), ch. IX.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deploy.policy.contract import Observed
from deploy.state import Mode
from eval.judge.counts import BINS, JOINT_MONITORS, PER_LOAD, ROBOT_MONITORS
from eval.judge.limits import Limits
from eval.judge.singularity import Axes
from eval.judge.tick_buffer import PAST, TOGETHER, Ticks
from robots.arrays import Floats
from robots.spec import RobotSpec

# Rounding, and the 1e-8 rad/s by which a planner may nudge its state: 2e-6 of the jerk limit at 200 Hz.
SENT_TOLERANCE = 1e-4
# A drive cannot exceed its range, it saturates at the end of it: that is the event.
TORQUE_FULL = 0.999
# Manipulability, as a share of its limit, below which a robot counts as in a singularity, or beyond it.
SINGULAR = 1e-3
# What a base that falls at 3 rad/s turns while its IMU's packets are 50 ms late, and some error of what is believed.
FALLING_RAD = 0.2
# Of what is measured in differences that are not yet divided by dt: its power.
_DIFFERENCES = {"torque_rate": 1, "velocity_sent": 1, "acceleration": 2, "jerk": 3}


class Block(NamedTuple):
    """Loads of T ticks of R robots, all in one row; 0 where a channel cannot tell.

    Attributes:
        everything: (channels × T × R,) of which the others are views.
        joints: (monitors, T, R × n). robots: (monitors, T, R).
    """

    everything: Floats
    joints: Floats
    robots: Floats

    def peak(self) -> Floats:
        """(R, C) the highest load of each channel."""
        many, _, wide = self.joints.shape
        robots = self.robots.shape[2]
        joints = self.joints.max(axis=1).reshape(many, robots, wide // robots)
        whole = self.robots.max(axis=1)
        return np.concatenate((joints.swapaxes(0, 1).reshape(robots, -1), whole.T), axis=1)


class Loads:
    """Brings everything to a fraction of its limit.

    Attributes:
        limits: (C,) in the units of the monitors; positions are from the middle of the working range.
    """

    def __init__(
        self, spec: RobotSpec, torque_max: Floats, limits: Limits, observed: Observed | None, robots: int
    ) -> None:
        """Allocate for R robots."""
        self._n, self._robots, self._arming_rad = spec.n, robots, limits.arming_rad
        joint, robot = _joint_limits(spec, torque_max, limits), _robot_limits(spec, limits, observed)
        self.limits = np.concatenate([*joint.values(), [*robot.values()]])
        raw = {name: limit * spec.dt ** _DIFFERENCES.get(name, 0) for name, limit in joint.items()}
        for name in ("command_jump", *_DIFFERENCES):
            raw[name] = raw[name] * (1 + SENT_TOLERANCE)
        self._of_joints = np.stack([np.tile(1.0 / limit, robots) for limit in raw.values()])[:, None]
        self._of_robots = 1.0 / np.array([*robot.values()])[:, None, None]
        self._middle = (spec.joint_array("q_max") + spec.joint_array("q_min")) / 2
        space = spec.workspace
        self._centre = np.array(space.centre) if space else np.zeros(3)
        self._depth = space.radius_max + space.z_min if space else -np.inf
        self._axes, self._least = Axes(spec) if space else None, (limits.manipulability or 0.0) * SINGULAR
        self._mean, self._deviation = (
            np.array(values if observed else (), dtype=np.float32)
            for values in ((observed.mean, observed.deviation) if observed else ((), ()))
        )
        self._make_room()

    def _make_room(self) -> None:
        """Where a full block goes, and its bins."""
        many = len(self.limits) * TOGETHER * self._robots
        self._room, self._scaled, self._bins = np.zeros(many), np.zeros(many), np.zeros(many, dtype=np.intp)
        offset = np.arange(len(self.limits), dtype=float) * BINS
        joints = offset[: len(JOINT_MONITORS) * self._n].reshape(-1, 1, self._n)
        self._offset_joints = np.tile(joints, self._robots)
        self._offset_robots = offset[-len(ROBOT_MONITORS) :, None, None]

    def _block(self, room: Floats, ticks: int) -> Block:
        wide = self._robots * self._n
        first = len(JOINT_MONITORS) * ticks * wide
        everything = room[: first + len(ROBOT_MONITORS) * ticks * self._robots]
        return Block(
            everything=everything,
            joints=everything[:first].reshape(len(JOINT_MONITORS), ticks, wide),
            robots=everything[first:].reshape(len(ROBOT_MONITORS), ticks, self._robots),
        )

    def of(self, seen: Ticks) -> Block:
        """All of what was seen, until the next call."""
        block = self._block(self._room, len(seen.q) - PAST)
        joints = block.joints.reshape(*block.joints.shape[:2], self._robots, self._n)
        place = {monitor.name: values for monitor, values in zip(JOINT_MONITORS, joints, strict=True)}
        whole = {m.name: values for m, values in zip(ROBOT_MONITORS, block.robots, strict=True)}
        self._true(seen, place)
        self._sent(seen, place)
        _believed(seen, place["estimate"])
        np.sum(place["power"], axis=2, out=whole["robot_power"])
        self._robot(seen, whole)
        self._policy(seen, whole)
        if not (valid := seen.valid[PAST:]).all():
            joints[:, ~valid], block.robots[:, ~valid] = 0.0, 0.0
        np.abs(block.everything, out=block.everything)
        np.multiply(block.joints, self._of_joints, out=block.joints)
        np.multiply(block.robots, self._of_robots, out=block.robots)
        return block

    def tally(self, block: Block) -> NDArray[np.int64]:
        """(C, BINS) how many loads of a block lie in each bin."""
        scaled = self._block(self._scaled, block.robots.shape[1])
        np.multiply(block.everything, PER_LOAD, out=scaled.everything)
        np.minimum(scaled.everything, BINS - 1, out=scaled.everything)
        np.add(scaled.joints, self._offset_joints, out=scaled.joints)
        np.add(scaled.robots, self._offset_robots, out=scaled.robots)
        bins = self._bins[: len(scaled.everything)]
        np.copyto(bins, scaled.everything, casting="unsafe")
        return np.bincount(bins, minlength=len(self.limits) * BINS).reshape(-1, BINS)

    def _true(self, seen: Ticks, place: dict[str, Floats]) -> None:
        """What the joints really do, and what the policy asks of them."""
        q, qd, tau = seen.q[PAST:], seen.qd[PAST:], seen.tau[PAST:]
        np.subtract(seen.target[PAST:], self._middle, out=place["position_requested"])
        _clear(
            place["position_requested"], seen.powered[PAST:]
        )  # nobody asks anything of a robot without power
        np.subtract(q, self._middle, out=place["position_soft"])
        place["position_hard"][:] = place["position_soft"]
        place["velocity"][:], place["torque"][:] = qd, tau
        np.multiply(tau, qd, out=place["power"])
        place["heat_soft"][:] = place["heat_hard"][:] = seen.winding_c[PAST:]

    def _sent(self, seen: Ticks, place: dict[str, Floats]) -> None:
        """Differences of what was sent, 0 where one looks at a tick without power."""
        on = seen.powered & seen.valid
        np.subtract(seen.q[PAST:], seen.sent[PAST:], out=place["tracking"])
        _clear(place["tracking"], on[PAST:])
        step, whole = np.diff(seen.sent, axis=0), on[1:] & on[:-1]
        self._jump(seen, on, step, place["command_jump"])
        np.subtract(seen.tau_sent[PAST:], seen.tau_sent[PAST - 1 : -1], out=place["torque_rate"])
        _clear(place["torque_rate"], whole[PAST - 1 :])
        for late, name in enumerate(("velocity_sent", "acceleration", "jerk"), start=1):
            place[name][:] = step[PAST - late :]
            _clear(place[name], whole[PAST - late :])
            step, whole = np.diff(step, axis=0), whole[1:] & whole[:-1]

    def _jump(self, seen: Ticks, on: NDArray[np.bool_], step: Floats, to: Floats) -> None:
        """In the first two ticks of power: away from where the joint truly stands, and from rest."""
        to[:] = 0.0
        if on[PAST - 2 :].all():
            return
        now, before = on[PAST:], on[PAST - 1 : -1]
        begins = now & ~before & seen.valid[PAST - 1 : -1]
        missed = np.abs(seen.sent[PAST:] - seen.q[PAST - 1 : -1]) - self._arming_rad
        to[begins] = np.maximum(missed, 0.0)[begins]
        second = now & before & ~on[PAST - 2 : -2]
        to[second] = step[PAST - 1 :][second]

    def _robot(self, seen: Ticks, whole: dict[str, Floats]) -> None:
        position, speed = seen.tool_position[PAST:], seen.tool_velocity[PAST:]
        whole["self_collision"][:], whole["contact_force"][:] = (
            seen.self_collision[PAST:],
            seen.contact_n[PAST:],
        )
        away = position - self._centre
        np.sqrt(np.einsum("tbi,tbi->tb", away, away), out=whole["workspace"])
        np.maximum(whole["workspace"], self._depth - position[:, :, 2], out=whole["workspace"])
        np.sqrt(np.einsum("tbi,tbi->tb", speed, speed), out=whole["tool_speed"])
        whole["tilt"][:] = whole["fallen"][:] = seen.tilt[PAST:]
        _clear(whole["fallen"], seen.mode[PAST:] == int(Mode.RUNNING))
        whole["singularity"][:] = 0.0
        if self._axes:
            found = self._axes.manipulability(seen.q[PAST:].reshape(-1, self._n)).reshape(position.shape[:2])
            np.divide(1.0, np.maximum(found, self._least), out=whole["singularity"])

    def _policy(self, seen: Ticks, whole: dict[str, Floats]) -> None:
        """What the policy was shown and what it said, where somebody followed it."""
        running = seen.mode[PAST:] == int(Mode.RUNNING)
        # Whoever minds stops by the next tick.
        whole["action_finite"][:] = running & ~seen.sound[PAST - 1 : -1] & seen.powered[PAST - 1 : -1]
        whole["observation"][:] = 0.0
        if self._mean.size:
            strange = np.abs((seen.observation[PAST:] - self._mean) / self._deviation)
            whole["observation"][:] = strange.max(axis=2)
            _clear(whole["observation"], running)


def _clear(values: Floats, where_not: NDArray[np.bool_]) -> None:
    if not where_not.all():
        values[~where_not] = 0.0


def _believed(seen: Ticks, to: Floats) -> None:
    """Normalized squared error of the angle, whose belief is of the moment at which the last tick ended.

    Source: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), 5.4.
    """
    np.subtract(seen.q_hat[PAST:], seen.q[PAST - 1 : -1], out=to)
    to *= to
    to /= seen.q_var[PAST:]
    _clear(to, np.isfinite(seen.age[PAST:]) & seen.valid[PAST - 1 : -1])


def _joint_limits(spec: RobotSpec, torque_max: Floats, limits: Limits) -> dict[str, Floats]:
    """(n,) of each joint monitor, in order."""
    half = (spec.joint_array("q_max") - spec.joint_array("q_min")) / 2
    speed, acceleration = spec.joint_array("qd_max"), spec.joint_array("qdd_max")
    found = {
        "position_requested": half,
        "position_soft": half - spec.margins.q_soft_rad,
        "position_hard": half,
        "velocity": speed,
        "torque": TORQUE_FULL * torque_max,
        "power": limits.motor_array("power_w", spec),
        "heat_soft": spec.motor_array("winding_soft_c"),
        "heat_hard": spec.motor_array("winding_max_c"),
        "tracking": np.full(spec.n, spec.margins.tracking_rad),
        "estimate": np.full(spec.n, limits.nees),
        "torque_rate": limits.motor_array("torque_rate", spec),
        "command_jump": acceleration * spec.dt**2,
        "velocity_sent": speed,
        "acceleration": acceleration,
        "jerk": spec.joint_array("qddd_max"),
    }
    return {monitor.name: found[monitor.name] for monitor in JOINT_MONITORS}


def _robot_limits(spec: RobotSpec, limits: Limits, observed: Observed | None) -> dict[str, float]:
    """Of each monitor of the whole robot, in order; infinite where nothing says it."""
    found = {
        "self_collision": 0.5,
        "contact_force": limits.contact_n,
        "workspace": spec.workspace.radius_max if spec.workspace else np.inf,
        "singularity": 1.0 / limits.manipulability if limits.manipulability else np.inf,
        "tool_speed": spec.workspace.tool_speed_max if spec.workspace else np.inf,
        "tilt": spec.base.tilt_max_rad if spec.base else np.inf,
        "fallen": spec.base.tilt_max_rad + FALLING_RAD if spec.base else np.inf,
        "robot_power": limits.power_w,
        "observation": limits.deviations if observed else np.inf,
        "action_finite": 0.5,
    }
    return {monitor.name: found[monitor.name] for monitor in ROBOT_MONITORS}
