import itertools

import numpy as np

from deploy.state import Packet
from robots.motors.windings import nominal_windings
from support.arm6 import SPEC

N, DT = SPEC.n, SPEC.dt
SOFT, HARD = SPEC.motor_array("winding_soft_c"), SPEC.motor_array("winding_max_c")
LIMIT, FOLD_MIN, PACE_MIN = HARD - SPEC.margins.winding_k, SPEC.margins.fold_min, SPEC.margins.pace_min
"""°C at which a winding that is no warmer than its housing stops the robot; and what is left of a folded motor."""
NOMINAL = nominal_windings(SPEC)
THERMAL = (r'thermal="1.0 40 0 0.0039 25 25"', r'thermal="2.0 12 0 0.0039 25 25"')
WAVERS = itertools.count()


def sample(current, housing, robots=1):
    """What the bus says. No current stands quite still: that would be a stuck sensor."""
    current = current + 1e-9 * (next(WAVERS) % 997)
    t, fresh, rest = np.zeros(robots), np.ones(robots, dtype=bool), np.zeros((robots, N))
    values = {"encoder": rest, "current": rest + current, "temperature": rest + housing}
    return {kind: Packet(t=t, fresh=fresh, value=value) for kind, value in values.items()}


def live(heat, packets):
    """The next tick of an observer's life, at which the packets were taken."""
    tick = heat.lived = getattr(heat, "lived", -1) + 1
    heat.step(tick * DT, {kind: packet._replace(t=packet.t + tick * DT) for kind, packet in packets.items()})
