"""Simulated robots whose drives and encoders are connected or set wrongly."""

from dataclasses import dataclass, field

import numpy as np

from deploy.backends.sim.robot import SimRobot
from support.arm6 import SPEC


@dataclass(frozen=True, kw_only=True)
class Wiring:
    """Mistakes between the runtime and the drives of a robot.

    Attributes:
        commands, encoders, currents: by joint of the runtime, the joint of the robot that it is connected to.
        command_scale, encoder_scale, current_scale: by joint of the runtime; negative where the sign is reversed.
        late: control periods by which commands come too late.
    """

    commands: tuple[int, ...] | None = None
    encoders: tuple[int, ...] | None = None
    currents: tuple[int, ...] | None = None
    command_scale: dict[int, float] = field(default_factory=dict)
    encoder_scale: dict[int, float] = field(default_factory=dict)
    current_scale: dict[int, float] = field(default_factory=dict)
    late: int = 0


def exchanged(one, other, n=SPEC.n):
    """Order of joints with two of them exchanged."""
    order = list(range(n))
    order[one], order[other] = other, one
    return tuple(order)


def miswired(wiring, base=SimRobot):
    """A class of simulated robots with such a wiring; several robots at a time have the same."""

    class Miswired(base):
        def __init__(self, *args, **how):
            super().__init__(*args, **how)
            self._waiting = []

        def read(self):
            sample = dict(super().read())
            encoder, current = sample["encoder"], sample["current"]
            angles = _joints(encoder.value, wiring.encoders, wiring.encoder_scale)
            sample["encoder"] = encoder._replace(value=angles)
            amps = _joints(current.value, wiring.currents, wiring.current_scale)
            sample["current"] = current._replace(value=amps)
            return sample

        def write(self, command):
            if wiring.late and command.powered.any():
                self._waiting.append(command)
                command = self._waiting[max(0, len(self._waiting) - 1 - wiring.late)]
            inverse = None if wiring.commands is None else tuple(np.argsort(wiring.commands).tolist())
            scaled = command._replace(
                q=_scaled(command.q, wiring.command_scale),
                qd=_scaled(command.qd, wiring.command_scale),
                tau=_scaled(command.tau, {j: np.sign(s) for j, s in wiring.command_scale.items()}),
            )
            if inverse is not None:
                order = list(inverse)
                scaled = scaled._replace(
                    q=scaled.q[:, order], qd=scaled.qd[:, order], tau=scaled.tau[:, order]
                )
            super().write(scaled)

    return Miswired


def _joints(values, order, scales):
    values = values if order is None else values[:, list(order)]
    return _scaled(values, scales)


def _scaled(values, scales):
    values = values.copy()
    for joint, scale in scales.items():
        values[:, joint] *= scale
    return values
