"""Joint estimates from a recorded motion, beside those of the latest packets alone."""

from dataclasses import dataclass

import numpy as np

from deploy.estimation.estimator import Estimator
from deploy.state import Setpoint, State
from eval.bench.estimation.recorded_motion import Motion, replay
from robots.arrays import Floats
from robots.spec import RobotSpec


@dataclass(frozen=True, slots=True, kw_only=True)
class JointEstimates:
    """Angles and speeds without and with the estimator, (T, B, n), rad and rad/s.

    Attributes:
        raw: latest packet. differenced: difference of the last two packets over the time between their stamps.
        q, qd: of the estimator. nees: its normalised estimation error squared.
    """

    raw: Floats
    differenced: Floats
    q: Floats
    qd: Floats
    nees: Floats


def initial_estimator(spec: RobotSpec, motion: Motion) -> Estimator:
    """Return an estimator that starts at the first setpoints of a motion."""
    estimator, zeros = Estimator(spec, motion.robots), np.zeros((motion.robots, spec.n))
    start = Setpoint(q=motion.sent[0, :, : spec.n], qd=zeros, qdd=zeros)
    estimator.follow(np.ones(motion.robots, dtype=bool), Setpoint(q=zeros, qd=zeros, qdd=zeros), start)
    return estimator


def estimate_motion(spec: RobotSpec, motion: Motion, noise: float | None) -> JointEstimates:
    """Estimate a motion from replayed packets; `noise` rad of the encoders, None as drawn."""
    estimator, rows = initial_estimator(spec, motion), []
    t_last, q_last = np.full(motion.robots, -np.inf), motion.q[0]
    differenced = np.zeros((motion.robots, spec.n))
    for tick, sample, sent in replay(spec, motion, noise):
        state, packet = estimator.step(tick * spec.dt, sample, sent), sample["encoder"]
        new = packet.t > t_last
        step = np.where(new, packet.t - t_last, 1.0)[:, None]
        differenced = np.where(new[:, None], (packet.value - q_last) / step, differenced)
        t_last, q_last = np.where(new, packet.t, t_last), np.where(new[:, None], packet.value, q_last)
        nees = _nees(spec, estimator, state, state.q - motion.q[tick - 1], state.qd - motion.qd[tick - 1])
        rows.append((packet.value.copy(), differenced, state.q, state.qd, nees))
    raw, differences, q, qd, nees = (np.array(column) for column in zip(*rows, strict=True))
    return JointEstimates(raw=raw, differenced=differences, q=q, qd=qd, nees=nees)


@np.errstate(invalid="ignore")  # before its first packet an estimate is infinitely old
def _nees(spec: RobotSpec, estimator: Estimator, state: State, q: Floats, qd: Floats) -> Floats:
    """(B, n) squared errors of angle and speed by their current joint covariance: mean 2 if consistent.

    Source: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), sec. 5.4.
    """
    joints = estimator.joints
    lag, density = state.t - joints.t_sample, spec.joint_array("acceleration_density")
    p00, p11 = state.q_var, joints.p11 + density * lag
    p01 = joints.p01 + lag * joints.p11 + density * lag**2 / 2
    return np.asarray((p11 * q**2 - 2 * p01 * q * qd + p00 * qd**2) / (p00 * p11 - p01**2))
