"""Joint state from late, noisy and missing samples, with the motors' heat and the external torque.

The filter estimates each joint's deviation from its setpoint at the time when its newest sample was taken. `State` is
the present setpoint plus that deviation, predicted to now.
"""

from typing import ClassVar

import numpy as np

from deploy.estimation.external_torque import ExternalTorque
from deploy.estimation.fault_detection import StuckDetection
from deploy.estimation.joint_filter import JointFilter
from deploy.estimation.late_ticks import LateTicks
from deploy.estimation.oscillation import OscillationDetection
from deploy.estimation.sample_count import sample_count
from deploy.estimation.setpoint_history import SetpointHistory
from deploy.estimation.winding_observer import WindingObserver
from deploy.masks import any_true
from deploy.reasons import Reason
from deploy.stage import Stage
from deploy.state import Packet, Sample, Setpoint, State
from robots.arrays import Bools, Floats
from robots.motors.gains import Gains
from robots.sensors import Kind
from robots.spec import RobotSpec

LOOK_S = 0.02
"""s between two evaluations of the fault detections."""
MOVING_SPEED, MOVING_STD = 0.05, 6.0
"""rad/s that a joint at rest may have, plus this many standard deviations of its speed. Six are three where sensors are
twice as noisy as their data sheet says."""


class Estimator(Stage):
    """Filter, setpoint history, fault detections and heat of B × n joints.

    Attributes:
        fault: (B,) bit set of `Reason`, found at the last evaluation.
    """

    sensors: ClassVar[tuple[Kind, ...]] = ("encoder", "velocity", "current", "temperature")
    """Sensors that it reads, of those that the robot has."""
    carried: ClassVar[tuple[str, ...]] = ("fault",)
    parts = (
        *("joints", "setpoints", "stuck_detection", "oscillation"),
        *("windings", "external_torque", "late_ticks"),
    )

    def __init__(self, spec: RobotSpec, robots: int, *, springs: Gains | None = None) -> None:
        """Allocate; `springs` are the gains of soft drives, None if drives hold joints at their setpoints."""
        self._look = sample_count(LOOK_S, spec.dt)
        look_s, encoder = self._look * spec.dt, spec.sensors["encoder"]
        self.joints = JointFilter(spec, robots)
        self.setpoints = SetpointHistory(spec, robots)
        # Packets of an encoder slower than the control rate could always arrive between two looks.
        self._stuck_look = self._look if encoder.rate_hz == spec.rates.control_hz else 1
        stuck_look_s = look_s if self._stuck_look > 1 else 1.0 / encoder.rate_hz
        self.stuck_detection = StuckDetection(spec, robots, stuck_look_s, springs)
        self.oscillation = OscillationDetection(spec, robots, look_s)
        self.windings = WindingObserver(spec, robots)
        self.external_torque = ExternalTorque(spec, robots, look_s)
        self.late_ticks = LateTicks(spec, robots)
        self.fault = np.zeros(robots, dtype=np.int64)
        self._stiff, self.dt, self._zero = springs is None, spec.dt, np.zeros((robots, spec.n))
        # Errors that no sample shows: a constant one, uniform in ± bias, and the link's place in its play.
        self._hidden_var = encoder.bias**2 / 3.0 + spec.joint_array("play") ** 2 / 12.0

    def reset(self, ids: Bools, sent: Setpoint) -> None:
        """Forget robots `ids` (B,), whose setpoint has long been `sent`; their next sample initializes them."""
        self.joints.initialized[ids], self.joints.accepted[ids] = False, 0
        self.follow(ids, sent, sent)
        self.oscillation.reset(ids)
        self.windings.reset(ids)
        self.external_torque.reset(ids)
        self.late_ticks.ticks[ids] = 0

    def follow(self, ids: Bools, old: Setpoint, new: Setpoint) -> None:
        """Replace the setpoint of robots `ids` (B,) by another one; the joints have not moved."""
        self.joints.e[ids] += self._origin(old.q - new.q)[ids]
        self.joints.ed[ids] += self._origin(old.qd - new.qd)[ids]
        self.setpoints.fill(ids, new)
        self.stuck_detection.setpoint[ids] = new.q[ids]

    def follow_joints(self, ids: Bools, t: float, *, speeds: bool) -> None:
        """Move the setpoint history of joints `ids` (B, n) onto their estimated angles at `t` s: they deviate by 0.

        For drives that hold no angle: their next setpoint is planned from the estimate, not from the setpoint before.
        With `speeds` the history gets the estimated speeds, too; else they go on to deviate in speed.
        """
        if not any_true(ids):
            return
        joints = self.joints
        age = t - joints.t_sample
        now = np.where(ids, joints.e + joints.ed * age, 0.0)
        ed = np.where(ids, joints.ed, 0.0) if speeds else self._zero
        self.setpoints.shift(now, ed, round(t / self.dt))
        self.stuck_detection.setpoint += now
        joints.e -= now - ed * age
        joints.ed -= ed

    @np.errstate(over="ignore")  # squares of large readings are infinite, and refused
    def step(self, t: float, sample: Sample, sent: Setpoint) -> State:
        """Fuse the packets that arrived and predict to now.

        Ignored are packets from more than a period in the future (they would stay fresh for ever) or from before the
        setpoint history, and angles that are not finite, not newer than the last, or outside the gate. The age of a
        robot is infinite until all of its filters are confirmed. `t` s is now, a whole number of periods; `sent` the
        setpoint that the drives should have reached by now.
        """
        tick, packet, joints = round(t / self.dt), self._packet(sample, "encoder"), self.joints
        self.setpoints.append(tick, sent)
        self.late_ticks.step(joints)
        usable, setpoint, _ = self.setpoints.at(packet, t)
        waiting = ~joints.initialized
        fused = joints.fuse(packet, usable, self._origin(setpoint))
        if any_true(waiting):
            started = waiting & joints.initialized
            self.stuck_detection.repeats[started], self.fault[started] = 0, 0
        if "velocity" in sample:
            packet_of_speeds = self._packet(sample, "velocity")
            usable, _, speed = self.setpoints.at(packet_of_speeds, t)
            joints.fuse_speeds(packet_of_speeds, usable, self._origin(speed))
        if tick % self._stuck_look == 0:
            self.stuck_detection.look(packet.value, setpoint, fused)
        if tick % self._look == 0:
            self._detect_faults(sample["current"], sent)
        self.windings.step(t, sample)
        return self._state(t, sample, sent)

    def _packet(self, sample: Sample, kind: Kind) -> Packet:
        """Return a packet in the types that kernels take.

        Raises:
            ValueError: it has not a value for each joint.
        """
        t, fresh, value = sample[kind]
        if np.shape(value) != self._zero.shape:
            raise ValueError(
                f"sensor {kind}: found values of shape {np.shape(value)}, expected {self._zero.shape}"
            )
        return Packet(np.asarray(t, np.float64), np.asarray(fresh, np.bool_), np.asarray(value, np.float64))

    def _origin(self, setpoint: Floats) -> Floats:
        """Return the angles or speeds (B, n) that deviations are measured from: the setpoint, 0 on soft drives."""
        return setpoint if self._stiff else self._zero

    def _detect_faults(self, current: Packet, sent: Setpoint) -> None:
        self.fault[:] = 0
        if any_true(self.stuck_detection.repeated):
            self.fault[self.stuck.any(axis=1)] |= np.int64(Reason.STUCK)
        if any_true(diverged := self.diverged):
            self.fault[diverged.any(axis=1) & self.joints.initialized] |= np.int64(Reason.DIVERGED)
        if any_true(oscillating := self.oscillation.step(self._speed(sent))):
            self.fault[oscillating.any(axis=1)] |= np.int64(Reason.OSCILLATION)
        self.fault[self.external_torque.look(current)] |= np.int64(Reason.LOAD)

    @property
    def moving(self) -> Bools:
        """(B, n) joints that move relative to their setpoint by more than the estimate's uncertainty."""
        return np.asarray(np.abs(self.joints.ed) > MOVING_SPEED + MOVING_STD * np.sqrt(self.joints.p11))

    @property
    def stuck(self) -> Bools:
        """(B, n) joints whose encoder repeats its value although the setpoint moved."""
        return self.stuck_detection.stuck(self.setpoints.q)

    @property
    def diverged(self) -> Bools:
        """(B, n) joints whose filter has diverged."""
        return self.joints.diverged

    def _speed(self, sent: Setpoint) -> Floats:
        """(B, n) rad/s, estimated now."""
        return np.asarray(self._origin(sent.qd) + self.joints.ed)

    def _state(self, t: float, sample: Sample, sent: Setpoint) -> State:
        q, qd, q_var, age = self.joints.predict(t, self._origin(sent.q), self._origin(sent.qd))
        return State(
            t=t,
            q=q,
            qd=qd,
            q_var=q_var + self._hidden_var,
            age=age,
            nis=self.joints.nis,
            housing_c=sample["temperature"].value,
            winding_c=self.windings.winding,
            hottest_c=self.windings.hottest,
            current_share=self.windings.foldback.current_share,
            fault=self.fault,
        )
