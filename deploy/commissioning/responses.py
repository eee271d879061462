"""Response of all encoders and motor currents to a small motion of one joint."""

from typing import NamedTuple

import numpy as np

from deploy.commissioning.packet_log import PacketLog
from robots.arrays import Floats

SETTLED = 0.6
"""Share of a rest, at its end, in which late packets of the motion before it have arrived."""
MOTION_SPEED = 1e-3
"""rad/s of the setpoint, above which a joint is under way."""


class Span(NamedTuple):
    """Ticks from `begin` to before `end`."""

    begin: int
    end: int


class Nudge(NamedTuple):
    """Motion of one joint forwards and backwards, with a rest after each.

    Attributes:
        joint: number of the joint.
        up, high, down, low: ticks of the motion forwards, of the rest there, of the motion back, and of that rest.
    """

    joint: int
    up: Span
    high: Span
    down: Span
    low: Span


class Response(NamedTuple):
    """Response to a motion of one joint.

    Attributes:
        encoder: (n,) rad that each encoder moved for each rad of the setpoint. noise: (n,) its standard deviation.
        current: (n,) A that each motor took forwards, less those backwards. current_noise: (n,) A.
    """

    encoder: Floats
    noise: Floats
    current: Floats
    current_noise: Floats


def response(log: PacketLog, nudge: Nudge) -> Response:
    """Compare the rests and the two directions of a nudge."""
    sent = log.column("q_sent")[:, nudge.joint]
    distance = sent[nudge.high.end - 1] - sent[nudge.low.end - 1]
    high, low = (_at_rest(log, "encoder", rest) for rest in (nudge.high, nudge.low))
    up, down = (_under_way(log, nudge.joint, motion) for motion in (nudge.up, nudge.down))
    still = _at_rest(log, "current", nudge.low).std(
        axis=0
    )  # under way, currents change with the acceleration
    return Response(
        encoder=(high.mean(axis=0) - low.mean(axis=0)) / distance,
        noise=np.hypot(_standard_error(high), _standard_error(low)) / abs(distance),
        current=(up.mean(axis=0) - down.mean(axis=0)) * np.sign(distance),
        current_noise=still * np.sqrt(1.0 / len(up) + 1.0 / len(down)),
    )


def _at_rest(log: PacketLog, kind: str, rest: Span) -> Floats:
    """Return the packets (P, n) of a kind in the last part of a rest."""
    begin = rest.end - max(2, round(SETTLED * (rest.end - rest.begin)))
    return log.packets(kind, begin, rest.end)[2]


def _under_way(log: PacketLog, joint: int, motion: Span) -> Floats:
    """Return the currents (P, n) that were measured while a joint was under way."""
    begin, end = motion
    moving = np.abs(log.column("qd_sent", begin, end)[:, joint]) > MOTION_SPEED
    t = log.column("t", begin, end)[moving]
    _, taken, current = log.packets("current", begin, end + (end - begin))
    return np.asarray(current[(taken >= t[0]) & (taken <= t[-1])])


def _standard_error(values: Floats) -> Floats:
    return np.asarray(values.std(axis=0) / np.sqrt(max(len(values) - 1, 1)))
