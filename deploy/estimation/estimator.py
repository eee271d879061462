"""Joint state from late, noisy, missing samples: one Kalman filter per joint, all in one pass, and heat beside it.

What is estimated is how far each joint is from where it was SENT, which changes far less than where it is: angle and
speed of that deviation, under white-noise acceleration, at the time its newest sample was TAKEN. `State` is what was
sent by now plus the deviation carried forward to now. The same filter with the setpoint's motion as its known input.
A joint on a soft drive does not go where it is sent: of such it is angle and speed themselves.
filterpy gives the process noise and is the oracle of the tests.
"""

from typing import ClassVar

import numpy as np
from filterpy.common import Q_continuous_white_noise

from deploy.estimation.external_torque import Load
from deploy.estimation.heat import Heat
from deploy.masks import all_true, any_true
from deploy.motion.drive_law import Gains
from deploy.stage import Stage
from deploy.state import Packet, Reason, Sample, Setpoint, State
from robots.arrays import Bools, Floats
from robots.models.fleet import torque_max
from robots.spec import RobotSpec

SPEED_STD = 1.0
"""rad/s, how unsure the speed is when a filter is seeded from one sample."""
REMEMBERED_S = 0.2
"""s of setpoints kept: a sample that is older says nothing any more."""
GATE = 8.0
"""Standard deviations of an innovation beyond which a sample is left out: a gross error, not noise."""
STUCK_S, STUCK_STD, STUCK_SHARE = 0.1, 10.0, 0.3
"""A sensor that says the very same for so long, in which it was sent away by so many standard deviations, is stuck;
on a soft drive, by so much that this share of the joint's torque comes or goes: less need not move a standing leg."""
LOOK_S = 0.02
"""s between two looks at what the sensors and the filters have been saying."""
MEMORY, DIVERGED = 50.0, 9.0
"""Samples of the running mean of squared innovations, and the mean above which a filter does not know what it does."""
CONFIRMED, REFUSED = 10, 20
"""Samples within the gate, from the first on, until which a filter is not believed: before that one beyond the gate
takes the place of the first. And samples in a row beyond the gate after which a filter begins anew."""
RESTS, DOUBT = 0.05, 6.0
"""rad/s below which a joint may be said to rest, and standard deviations of its speed beyond that: three where sensors
are twice as noisy as their data sheet says."""


class Estimator(Stage):
    """Deviation and its speed of B × n joints; on soft drives that from an angle of 0.

    Attributes:
        e, ed: (B, n) rad and rad/s, and p00, p01, p11 (B, n) their covariance, at t_sample (B, n) s.
        t_speed: (B,) s, when the last measured speeds were taken.
        nis: (B, n) running mean of the squared innovations, in variances: 1 if they are as large as they should be.
        many, refused: (B, n) samples fused since the filter began, and samples in a row beyond the gate.
        sent: (B, ticks, 2n) setpoints remembered, angles and speeds.
        said: (B, n) rad, the sample at the last look. moved: (B, n) rad, the setpoint when it was first said.
            same: (B, n) looks since. fault: (B,) what was found at the last look.
        heat: what knows the motors. load: what knows whether they work against something.
    """

    carried: ClassVar[tuple[str, ...]] = (
        *("e", "ed", "p00", "p01", "p11", "t_sample", "t_speed", "nis", "many", "refused", "seeded"),
        *("sent", "said", "moved", "same", "fault"),
    )
    parts = ("heat", "load")

    def __init__(self, spec: RobotSpec, robots: int, *, springs: Gains | None = None) -> None:
        """Allocate.

        Args:
            spec: encoder noise and joint restlessness.
            robots: B.
            springs: gains of soft drives; None: drives hold joints where they are sent.
        """
        shape, encoder = (robots, spec.n), spec.sensors["encoder"]
        self.e, self.ed, self.nis, self.said, self.moved = np.zeros((5, *shape))
        self.p00, self.p01, self.p11 = np.zeros((3, *shape))
        self.t_sample, self.t_speed = np.zeros(shape), np.full(robots, -np.inf)
        self.seeded = np.zeros(robots, dtype=bool)
        self.same, self.many, self.refused = np.zeros((3, *shape), dtype=np.int64)
        self.fault = np.zeros(robots, dtype=np.int64)
        self.heat, self.load = Heat(spec, robots), Load(spec, robots)
        self._stiff, self._dt, self._depth = springs is None, spec.dt, round(REMEMBERED_S / spec.dt)
        self.sent = np.zeros((robots, self._depth, 2 * spec.n))
        self._nothing = np.zeros(shape)
        self._row, self._n = np.arange(robots) * self._depth, spec.n
        # numpy is quickest where every shape is the same.
        self._wide, self._r = np.zeros(shape), np.full(shape, encoder.variance)
        self._r_speed = spec.sensors["velocity"].variance if "velocity" in spec.sensors else np.inf
        # Errors that nobody can see: a constant one, uniform in ± bias, and where in its play a link lies.
        self._unseen_var = encoder.bias**2 / 3.0 + spec.joint_array("play") ** 2 / 12.0
        self._stuck_rad = np.full(spec.n, STUCK_STD * np.sqrt(encoder.variance))
        if springs:
            self._stuck_rad = STUCK_SHARE * torque_max(spec) / springs.kp
        self._look, self._stuck_many = max(1, round(LOOK_S / spec.dt)), round(STUCK_S / LOOK_S)
        density = np.tile(spec.joint_array("acceleration_density"), (robots, 1))
        unit = Q_continuous_white_noise(dim=2, dt=1.0, spectral_density=1.0)
        self._g00, self._g01, self._g11 = (density * unit[place] for place in ((0, 0), (0, 1), (1, 1)))

    def reset(self, ids: Bools, sent: Setpoint) -> None:
        """Forget robots where `ids` (B,) holds, sent to rest at `sent` for long; their next sample seeds them."""
        self.seeded[ids], self.many[ids] = False, 0
        self.follow(ids, sent, sent)
        self.heat.reset(ids)
        self.load.reset(ids)

    def follow(self, ids: Bools, old: Setpoint, new: Setpoint) -> None:
        """Robots where `ids` (B,) holds are sent elsewhere from now on, and have not moved for that."""
        here = np.concatenate((new.q, new.qd), axis=1)[ids]
        self.e[ids] += self._expected(old.q - new.q)[ids]
        self.ed[ids] += self._expected(old.qd - new.qd)[ids]
        self.sent[ids], self.moved[ids] = here[:, None], new.q[ids]

    def step(self, t: float, sample: Sample, sent: Setpoint) -> State:
        """Fuse what arrived and carry the belief to now.

        A packet from the future by more than a period (it would look fresh for ever) or older than is remembered, and
        an angle that is not finite or older than the last, is left out, as if it had never arrived. So is one beyond
        the gate. A robot is infinitely stale until every joint's filter is confirmed.

        Args:
            t: s, now, a whole number of periods.
            sample: the newest packets.
            sent: the setpoint that the drives should have reached by now.
        """
        tick = round(t / self._dt)
        self._place = tick % self._depth
        self.sent[:, self._place] = np.concatenate((sent.q, sent.qd), axis=1)
        packet = sample["encoder"]
        there = self._there(t, packet)
        reference, _ = self._sent_at(packet.t, there, tick)
        deviation, finite = packet.value - self._expected(reference), np.isfinite(packet.value)
        if not all_true(self.seeded):
            self._seed(~self.seeded & there & finite.all(axis=1), packet, deviation)
        new = (packet.t[:, None] > self.t_sample) & (there & self.seeded)[:, None] & finite
        fused = self._fuse(packet, deviation, new)
        if "velocity" in sample:
            self._fuse_speed(t, sample["velocity"], tick)
        if tick % self._look == 0:
            self._listen(packet.value, reference, fused)
            self.fault[self.load.look(sample["current"])] |= np.int64(Reason.LOAD)
        self.heat.step(t, sample)
        return self._now(t, sample, sent)

    @property
    def moving(self) -> Bools:
        """(B,) whether a joint moves while its drive is off."""
        return np.asarray(self.strays.any(axis=1))

    @property
    def strays(self) -> Bools:
        """(B, n) joints that move away from their setpoint by more than the estimate's own doubt."""
        return np.asarray(np.abs(self.ed) > RESTS + DOUBT * np.sqrt(self.p11))

    @property
    def stuck(self) -> Bools:
        """(B, n) joints whose encoders say the same again and again, though they were sent away."""
        away = np.abs(self.sent[:, self._place, : self._n] - self.moved) > self._stuck_rad
        return np.asarray((self.same >= self._stuck_many) & away)

    @property
    def diverged(self) -> Bools:
        """(B, n) joints whose filters do not know what they do."""
        return np.asarray(~((self.nis <= DIVERGED) & np.isfinite(self.p00 + self.p11)))

    def _expected(self, setpoint: Floats) -> Floats:
        """What a joint does by itself for a setpoint (B, n)."""
        return setpoint if self._stiff else self._nothing

    def _there(self, t: float, packet: Packet) -> Bools:
        """(B,) whether a packet arrived that may count."""
        recent = (packet.t <= t + self._dt) & (packet.t > t - (self._depth - 1) * self._dt)
        return np.asarray(packet.fresh & recent)

    def _sent_at(self, t: Floats, there: Bools, tick: int) -> tuple[Floats, Floats]:
        """(B, n) rad and rad/s, where the joints were sent for the times t (B,), and how fast; now is `tick`."""
        ticks = (t if all_true(there) else np.where(there, t, 0.0)) / self._dt
        whole = np.minimum(np.rint(ticks), tick)
        place = self._row + whole.astype(np.int64) % self._depth
        sent = self.sent.reshape(-1, 2 * self._n).take(place, axis=0)
        q, qd = sent[:, : self._n], sent[:, self._n :]
        return q + qd * ((ticks - whole) * self._dt)[:, None], qd

    def _seed(self, ids: Bools, packet: Packet, deviation: Floats) -> None:
        """Begin robots `ids` (B,) with their first packet."""
        self._begin_anew(np.repeat(ids[:, None], self._n, axis=1), packet, deviation)
        self.seeded[ids], self.nis[ids], self.same[ids], self.fault[ids] = True, 1.0, 0, 0

    def _begin_anew(self, joints: Bools, packet: Packet, deviation: Floats) -> None:
        """Believe the sample of `joints` (B, n), at the speed that was sent."""
        if not any_true(joints):
            return
        self.e[joints], self.ed[joints] = deviation[joints], 0.0
        self.p00[joints], self.p01[joints], self.p11[joints] = self._r[joints], 0.0, SPEED_STD**2
        self.many[joints], self.refused[joints] = 1, 0
        np.copyto(self.t_sample, packet.t[:, None], where=joints)

    def _fuse(self, packet: Packet, deviation: Floats, new: Bools) -> Bools:
        """Predict to the packet and correct; a sample left out counts as the expected one with infinite variance."""
        dt = self._each_joint(packet.t) - self.t_sample
        if not all_true(new):
            dt[~new] = 0.0
        e, p00 = self.e + self.ed * dt, self._q_var(dt)
        residual, variance = deviation - e, p00 + self._r
        square = residual * residual / variance
        fused: Bools = np.asarray(new & (square <= GATE**2))
        self.many += fused
        if all_true(fused):
            self.nis += (square - self.nis) / MEMORY
            self.refused[:] = 0
        else:
            surprise = np.minimum(square, GATE**2) - self.nis
            np.add(self.nis, surprise / MEMORY, out=self.nis, where=new)
            missing = ~fused
            self._refuse(new & missing, fused, packet, deviation)
            e[missing], p00[missing] = self.e[missing], self.p00[missing]
            dt[missing], residual[missing], variance[missing] = 0.0, 0.0, np.inf
        np.copyto(self.t_sample, packet.t[:, None], where=fused)
        p01, p11 = self.p01 + dt * (self.p11 + self._g01 * dt), self.p11 + self._g11 * dt
        k0, k1 = p00 / variance, p01 / variance
        np.add(e, k0 * residual, out=self.e)
        self.ed += k1 * residual
        np.subtract(p00, k0 * p00, out=self.p00)
        np.subtract(p01, k0 * p01, out=self.p01)
        np.subtract(p11, k1 * p01, out=self.p11)
        return fused

    def _refuse(self, beyond: Bools, fused: Bools, packet: Packet, deviation: Floats) -> None:
        """Count samples beyond the gate; a filter that nobody has confirmed, or that refuses all, begins anew."""
        self.refused += beyond
        self.refused[fused] = 0
        lost = (self.many < CONFIRMED) | (self.refused >= REFUSED)
        self._begin_anew(beyond & lost, packet, deviation)

    def _fuse_speed(self, t: float, packet: Packet, tick: int) -> None:
        """Correct by measured speeds, where the robot has any, each once.

        One that was not taken with the belief's own sample counts with the variance that lies between the two times.
        """
        there = self._there(t, packet) & (packet.t > self.t_speed) & self.seeded
        residual = packet.value - self._expected(self._sent_at(packet.t, there, tick)[1]) - self.ed
        apart = np.abs(self._each_joint(packet.t) - self.t_sample)
        variance = self.p11 + self._r_speed + self._g11 * apart
        fused = there[:, None] & (residual * residual <= GATE**2 * variance)
        np.copyto(self.t_speed, packet.t, where=there)
        np.copyto(residual, 0.0, where=~fused)
        np.copyto(variance, np.inf, where=~fused)
        k0, k1 = self.p01 / variance, self.p11 / variance
        self.e += k0 * residual
        self.ed += k1 * residual
        self.p00 -= k0 * self.p01
        self.p01 -= k0 * self.p11
        self.p11 -= k1 * self.p11

    def _each_joint(self, robots: Floats) -> Floats:
        """(B, n) of (B,), until the next call."""
        np.copyto(self._wide, robots[:, None])
        return self._wide

    def _q_var(self, dt: Floats) -> Floats:
        """(B, n) rad², variance of the angle after `dt` (B, n) s without a sample."""
        return np.asarray(self.p00 + dt * (2.0 * self.p01 + dt * (self.p11 + self._g00 * dt)))

    def _listen(self, said: Floats, reference: Floats, fused: Bools) -> None:
        """Look for encoders that say the very same again and again, and for filters that do not know what they do."""
        other = fused & (said != self.said)
        np.copyto(self.said, said, where=other)
        np.copyto(self.moved, reference, where=other)
        self.same += fused
        np.copyto(self.same, 0, where=other)
        self.fault[:] = 0
        if any_true(self.same >= self._stuck_many):
            self.fault[self.stuck.any(axis=1)] |= np.int64(Reason.STUCK)
        if any_true(diverged := self.diverged):
            self.fault[diverged.any(axis=1) & self.seeded] |= np.int64(Reason.DIVERGED)

    def _now(self, t: float, sample: Sample, sent: Setpoint) -> State:
        lag = t - self.t_sample
        age = lag.max(axis=1)
        confirmed = self.many >= CONFIRMED
        if not all_true(confirmed):
            age[~(confirmed.all(axis=1) & self.seeded)] = np.inf
        return State(
            t=t,
            q=self._expected(sent.q) + (self.e + self.ed * lag),
            qd=self._expected(sent.qd) + self.ed,
            q_var=self._q_var(lag) + self._unseen_var,
            age=age,
            nis=self.nis,
            temperature=sample["temperature"].value,
            winding=self.heat.winding,
            hottest=self.heat.hottest,
            fold=self.heat.fold,
            fault=self.fault,
        )
