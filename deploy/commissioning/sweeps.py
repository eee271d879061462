"""Measurements of one joint that goes to and fro at constant speed: raw packets against the setpoint."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deploy.commissioning.packet_log import PacketLog
from deploy.commissioning.responses import Span
from robots.arrays import Floats
from robots.models.fleet import Fleet

DELAYS_S = np.arange(-0.02, 0.1201, 0.0005)
"""s by which the setpoint is shifted to fit the encoder."""
CONSTANT_SPEED = 0.9
"""Share of the largest speed of the setpoint, above which it counts as constant."""


class Sweep(NamedTuple):
    """Measurements of one joint.

    Attributes:
        scale: rad of the encoder for each rad of the setpoint. scale_error: its standard error.
        others: (n,) the same of all encoders, of other joints too.
        delay_s: s by which the encoder follows the setpoint that drives should have reached, by the packets' times.
        age_s: s from a packet's time to its arrival, median.
        tracking_rad: largest distance of a raw packet from the setpoint at its time.
        speed: rad/s of the passes.
        friction: N·m, half of the difference between the motor's torques forwards and backwards. gravity: N·m, their
            mean, less the torque of the nominal model. torque_error: N·m, standard error of both.
    """

    scale: float
    scale_error: float
    others: Floats
    delay_s: float
    age_s: float
    tracking_rad: float
    speed: float
    friction: float
    gravity: float
    torque_error: float


def measure(
    log: PacketLog, joint: int, passes: Sequence[Span], fleet: Fleet, constant: Floats, dt: float
) -> Sweep:
    """Measure the passes of a joint.

    Args:
        log: of the run. joint: number of the joint. passes: in alternating directions.
        fleet: nominal model. constant: (n,) N·m/A at the joints. dt: s, control period.
    """
    begin, end = passes[0].begin, passes[-1].end
    rows, t, value = log.packets("encoder", begin, end)
    reached = log.column("t", max(begin - round(DELAYS_S[-1] / dt), 0), end) + dt
    sent = log.column("q_sent", end - len(reached), end)[:, joint]
    delay = _delay(t, value[:, joint], reached, sent)
    slopes, error = _slopes(np.interp(t - delay, reached, sent), value)
    friction, gravity, torque_error = _torques(log, joint, passes, fleet, constant)
    return Sweep(
        scale=float(slopes[joint]),
        scale_error=float(error[joint]),
        others=slopes,
        delay_s=delay,
        age_s=float(np.median(log.column("t", begin, end)[rows - begin] - t)),
        tracking_rad=float(np.abs(value[:, joint] - np.interp(t, reached, sent)).max()),
        speed=float(np.abs(log.column("qd_sent", begin, end)[:, joint]).max()),
        friction=friction,
        gravity=gravity,
        torque_error=torque_error,
    )


def _delay(t: Floats, value: Floats, reached: Floats, sent: Floats) -> float:
    """Return the delay, s, at which the setpoint fits the encoder best: where their cross-correlation is largest."""
    correlation = np.array([np.corrcoef(value, np.interp(t - d, reached, sent))[0, 1] for d in DELAYS_S])
    best = int(np.clip(np.nanargmax(correlation), 1, len(DELAYS_S) - 2))
    before, at, after = correlation[best - 1 : best + 2]
    curvature = before - 2.0 * at + after
    shift = 0.5 * (before - after) / curvature if curvature < 0 else 0.0
    return float(DELAYS_S[best] + np.clip(shift, -1.0, 1.0) * (DELAYS_S[1] - DELAYS_S[0]))


def _slopes(sent: Floats, value: Floats) -> tuple[Floats, Floats]:
    """Return the slopes (n,) of values (P, n) over the setpoint (P,), by least squares, and their standard errors."""
    x, y = sent - sent.mean(), value - value.mean(axis=0)
    slopes = x @ y / (x @ x)
    rest = (y - np.outer(x, slopes)).std(axis=0)
    return np.asarray(slopes), np.asarray(rest / np.sqrt(x @ x))


def _torques(
    log: PacketLog, joint: int, passes: Sequence[Span], fleet: Fleet, constant: Floats
) -> tuple[float, float, float]:
    """Return friction, gravity beyond the nominal, and their standard error, N·m.

    Both are medians over pairs of passes, one after the other: a load that comes or goes spoils few of them.
    """
    residuals, directions, errors = zip(
        *(_residual(log, joint, span, fleet, constant) for span in passes), strict=True
    )
    residual, direction = np.array(residuals), np.array(directions)
    friction = np.median(direction[:-1] * (residual[:-1] - residual[1:]) / 2.0)
    gravity = np.median((residual[:-1] + residual[1:]) / 2.0)
    return float(friction), float(gravity), float(np.median(errors))


def _residual(
    log: PacketLog, joint: int, span: Span, fleet: Fleet, constant: Floats
) -> tuple[float, float, float]:
    """Return the motor's mean torque less gravity's by the nominal model, the direction, and the standard error."""
    speed = log.column("qd_sent", *span)[:, joint]
    steady = np.flatnonzero(np.abs(speed) > CONSTANT_SPEED * np.abs(speed).max())
    first, last = (float(log.column("t")[span.begin + steady[end]]) for end in (0, -1))
    _, t, current = log.packets("current", span.begin, span.end)
    inside = (t >= first) & (t <= last)
    q = log.column("q_hat")[np.searchsorted(log.column("t"), t[inside] - 1e-9)]
    still = np.zeros((1, q.shape[1]))
    nominal = np.array([fleet.torque(pose[None], still, still)[0, joint] for pose in q])
    residual = constant[joint] * current[inside, joint] - nominal
    error = residual.std() / np.sqrt(max(len(residual) - 1, 1))
    return float(residual.mean()), float(np.sign(speed[steady].sum())), float(error)
