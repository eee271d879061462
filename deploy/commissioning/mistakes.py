"""Probable mistakes in the wiring or the settings of drives and encoders, named from what the joints did.

Possible mistakes: commands of two joints are exchanged, their encoders, or both; the sign of a joint's commands, of its
encoder, or of both; the scale of either. What encoders show of the two single ones is the same, but currents differ.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from deploy.commissioning.moves import OTHERS, OWN
from deploy.commissioning.responses import Response
from robots.arrays import Floats
from robots.spec import RobotSpec

SEEN = 4.0
"""Standard deviations at which a current counts as other than 0."""
CLEARLY = 1.5
"""Ratio of two such numbers of standard deviations, of which the larger one is taken for the motor that works."""
HOME_RAD = 0.1
"""rad from home at which a robot that cannot be armed may have a wrong encoder."""
ZERO_RAD = 0.05
"""rad from 0 at which a wrong sign or scale of a command can move a joint so far that it is noticed."""
Named = tuple[int, str]
"""Number of a joint, and a mistake in words."""


def outside_range(spec: RobotSpec, q: Floats) -> list[Named]:
    """Return joints whose encoders (n,) rad show a place outside their working range, before anything has moved."""
    low, high = spec.joint_array("q_min"), spec.joint_array("q_max")
    outside = np.flatnonzero((q < low) | (q > high)).tolist()
    return [(joint, _outside(spec, q, joint, low, high)) for joint in outside]


def _outside(spec: RobotSpec, q: Floats, joint: int, low: Floats, high: Floats) -> str:
    partners = [spec.joint_names[k] for k in _exchangeable(q, low, high, joint)]
    guesses = [f"exchanged with {' or '.join(partners)}"] if partners else []
    if low[joint] <= -q[joint] <= high[joint]:
        guesses.append("its sign reversed")
    where = f"encoder reads {q[joint]:+.3f} rad, outside [{low[joint]:.3f}, {high[joint]:.3f}]"
    return f"{where}: {', or '.join(guesses) or 'its zero or its scale is wrong'}"


def _exchangeable(q: Floats, low: Floats, high: Floats, joint: int) -> Iterator[int]:
    for other in range(len(q)):
        fits = low[joint] <= q[other] <= high[joint] and low[other] <= q[joint] <= high[other]
        if other != joint and fits:
            yield other


def away_from_home(spec: RobotSpec, q: Floats) -> list[Named]:
    """Return joints whose encoders (n,) rad do not show the home pose."""
    home = spec.joint_array("q_home")
    away = np.flatnonzero(np.abs(q - home) > HOME_RAD).tolist()
    return [(j, f"encoder reads {q[j]:+.3f} rad, {home[j]:+.3f} at home: zero, scale or pose?") for j in away]


def jump(names: Sequence[str], q: Floats, moved: Floats, current: Floats) -> list[Named]:
    """Return mistakes that make joints move when power comes on, each towards a command that is not its own.

    Args:
        names: of the joints. q: (n,) rad that encoders showed before. moved: (n,) rad since then.
        current: (n,) A, the largest of each motor meanwhile, with its sign.
    """
    return [(joint, _jump(names, q, moved, current, joint)) for joint in np.flatnonzero(moved).tolist()]


def _jump(names: Sequence[str], q: Floats, moved: Floats, current: Floats, joint: int) -> str:
    where = f"moved {moved[joint]:+.3f} rad when power came on"
    partners = [names[k] for k in range(len(q)) if k != joint and _towards_each_other(q, moved, joint, k)]
    own = bool(current[joint] * moved[joint] > 0)
    if partners:
        return f"{where}: {'commands' if own else 'encoders'} exchanged with {' or '.join(partners)}"
    if abs(q[joint]) > ZERO_RAD and moved[joint] * q[joint] < 0:
        commands = "sign of commands reversed, or scale of commands or encoder below 1"
        return f"{where}: {commands if own else 'sign of encoder reversed'}"
    if abs(q[joint]) > ZERO_RAD and own:
        return f"{where}: scale of commands or encoder above 1"
    return f"{where}: its motor does not hold it"


def _towards_each_other(q: Floats, moved: Floats, joint: int, other: int) -> bool:
    apart = q[other] - q[joint]
    return bool(moved[joint] * apart > 0 and moved[other] * apart < 0)


def nudged(names: Sequence[str], joint: int, answer: Response) -> str | None:
    """Return the mistake that the response to a joint's nudge shows, or None."""
    share, strongest = answer.encoder, int(np.argmax(np.abs(answer.encoder)))
    seen = np.abs(share) > np.maximum(OTHERS, SEEN * answer.noise)
    if not seen.any():
        return "does not move: drive, brake or encoder"
    if seen[joint] and np.delete(seen, joint).any():
        others = ", ".join(names[k] for k in np.flatnonzero(seen).tolist() if k != joint)
        return f"moves {others} too: coupled joints, or commands that reach several drives"
    if strongest != joint:
        what = _where_exchanged(joint, strongest, answer)
        reversed_ = ", one of them with its sign reversed" if share[strongest] < 0 else ""
        return f"encoder of {names[strongest]} moves instead: {what} exchanged{reversed_}"
    if share[joint] < 0:
        what = {1: "encoder", -1: "commands"}.get(_sign(answer, joint), "commands or encoder")
        return f"moves the wrong way: sign of {what} reversed{_scale(-share[joint])}"
    return None if OWN[0] < share[joint] < OWN[1] else _wrong_scale(float(share[joint]))


def _wrong_scale(scale: float) -> str:
    return f"moves {scale:.2f} times as far: scale of commands or encoder"


def _scale(scale: float) -> str:
    return "" if OWN[0] < scale < OWN[1] else f", and moves {scale:.2f} times as far"


def _where_exchanged(joint: int, other: int, answer: Response) -> str:
    """Return whose wires are exchanged: the motor that works is the one that got the command."""
    own, its = (float(np.abs(answer.current[k]) / answer.current_noise[k]) for k in (joint, other))
    if max(own, its) < SEEN or max(own, its) < CLEARLY * min(own, its):
        return "commands or encoders"
    return "encoders" if own > its else "commands"


def _sign(answer: Response, joint: int) -> int:
    """Return the sign of a motor's current in the direction commanded; 0 if it is lost in noise."""
    current = float(answer.current[joint])
    return int(np.sign(current)) if abs(current) > SEEN * answer.current_noise[joint] else 0
