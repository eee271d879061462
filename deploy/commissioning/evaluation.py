"""Evaluation of a check: what its motions say of each joint, and which mistakes explain that."""

import numpy as np

from deploy.commissioning.bounds import Bounds, Measured
from deploy.commissioning.findings import QUANTITIES, Findings, JointFindings
from deploy.commissioning.mistakes import away_from_home, jump, nudged, outside_range
from deploy.commissioning.moves import OTHERS, CheckMoves, JointMotion
from deploy.commissioning.sweeps import Sweep, measure
from deploy.commissioning.whole_drives import whole_drive_mistakes
from robots.arrays import Floats
from robots.models.fleet import Fleet
from robots.spec import RobotSpec


class Evaluation:
    """Evaluation of a finished run.

    Attributes:
        findings: of every joint.
    """

    def __init__(self, spec: RobotSpec, moves: CheckMoves, bounds: Bounds, refused: str) -> None:
        """Evaluate; `refused`: reason in words why the robot did not arm, empty if it did."""
        self._spec, self._moves, self._bounds, self._names = spec, moves, bounds, spec.joint_names
        self.findings = Findings([JointFindings(name) for name in self._names], refused or moves.stopped)
        if len(moves.log.packets("encoder", 0, moves.powered)[0]):
            self._before_power() if moves.powered is None else self._with_power()

    def _before_power(self) -> None:
        q = self._q_before_power
        self._add(outside_range(self._spec, q))
        if self.findings.stopped and self._unexplained:
            self._add(away_from_home(self._spec, q))

    def _with_power(self) -> None:
        moves, fleet = self._moves, Fleet(self._spec, 1)
        self._at_power_on()
        for joint, (motion, found) in enumerate(zip(moves.joints, self.findings.joints, strict=True)):
            self._nudge(joint, motion, found)
            if motion.passes:
                constant, dt = self._bounds.constant, self._spec.dt
                sweep = measure(moves.log, joint, motion.passes, fleet, constant, dt)
                self._passes(joint, sweep, found)
        self._whole_drives()

    @property
    def _q_before_power(self) -> Floats:
        return np.asarray(self._moves.log.packets("encoder", 0, self._moves.powered)[2].mean(axis=0))

    @property
    def _unexplained(self) -> bool:
        return not any(joint.mistakes for joint in self.findings.joints)

    def _add(self, mistakes: list[tuple[int, str]]) -> None:
        for joint, mistake in mistakes:
            self.findings.joints[joint].mistakes.append(mistake)

    def _at_power_on(self) -> None:
        moves, q = self._moves, self._q_before_power
        current = moves.log.packets("current", moves.powered or 0, moves.first_motion)[2]
        strongest = current[np.abs(current).argmax(axis=0), np.arange(self._spec.n)]
        moved = np.where(moves.jumped, moves.displacement, 0.0)
        self._add(jump(self._names, q, moved, strongest))
        if moves.stopped and self._unexplained:
            self._at_rest(q, current[len(current) // 2 :].mean(axis=0) * self._bounds.constant)

    def _at_rest(self, q: Floats, torque: Floats) -> None:
        """Compare torques (n,) N·m of motors that hold joints at `q` (n,) rad, of which friction may hold a part."""
        low, high = self._bounds.gravity_range(q)
        friction = self._bounds.friction_at_rest
        for joint in np.flatnonzero((torque < low - friction) | (torque > high + friction)).tolist():
            span = f"{low[joint] - friction[joint]:.2f} to {high[joint] + friction[joint]:.2f}"
            self._add([(joint, f"motor holds {torque[joint]:.2f} N·m at rest, expected {span}")])
        self._name_whole_drives(q, torque, friction)

    def _nudge(self, joint: int, motion: JointMotion, found: JointFindings) -> None:
        if (answer := motion.response) is not None:
            strongest = int(np.abs(answer.encoder).argmax())
            if abs(answer.encoder[strongest]) > OTHERS:
                found.order, found.sign = self._names[strongest], int(np.sign(answer.encoder[strongest]))
            if mistake := nudged(self._names, joint, answer):
                found.mistakes.append(mistake)
        if motion.stopped:
            found.mistakes.append(motion.stopped)

    def _passes(self, joint: int, sweep: Sweep, found: JointFindings) -> None:
        bounds, q = self._bounds, self._moves.log.column("q_hat", self._moves.joints[joint].begin or 0)[0]
        found.measured = {
            "scale": bounds.scale(sweep),
            "delay": bounds.delay(joint, sweep),
            "age": bounds.age(sweep),
            "friction": bounds.friction(joint, sweep),
            "gravity": bounds.gravity(joint, sweep, q),
            "tracking": bounds.tracking(sweep),
        }
        for quantity in QUANTITIES:
            if not (measured := found.measured[quantity.name]).inside:
                shown = Measured(*(number / quantity.size for number in measured))
                found.mistakes.append(quantity.wrong.format(**shown._asdict()))

    def _whole_drives(self) -> None:
        """Name whole drives that explain wrong torques against gravity, or those that right ones cannot exclude."""
        found = [joint.measured.get("gravity") for joint in self.findings.joints]
        torque = np.array([each.value if each else np.nan for each in found])
        still = np.zeros(self._spec.n)
        if any(each and not each.inside for each in found):
            self._name_whole_drives(self._q_before_power, torque, still)
        elif self.findings.passed:
            mistakes = whole_drive_mistakes(self._spec, self._bounds, self._q_before_power)
            self.findings.unverified = [
                each.text(self._names) for each in mistakes if each.fits(torque, still)
            ]

    def _name_whole_drives(self, q: Floats, torque: Floats, error: Floats) -> None:
        for mistake in whole_drive_mistakes(self._spec, self._bounds, q):
            if mistake.fits(torque, error):
                self._add([(joint, f"would fit: {mistake.text(self._names)}") for joint in mistake.joints])
