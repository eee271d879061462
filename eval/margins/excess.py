"""Excess of simulated robots: how much further they go than the setpoints that they were sent.

Every quantity that has a limit is looked at twice: at the setpoint, by the nominal model, as `deploy` bounds it, and at
the true robot. True values may come later than planned ones, so that each is compared with the largest planned value of
the last `WINDOW_S`:

    excess(t) = true(t) - max over s in [t - WINDOW_S, t] of planned(s)

As long as no planned value is above its bound, no true one is above the bound plus its excess.
"""

import numpy as np

from deploy.backends.sim.plant import Plant
from deploy.runtime import Runtime
from deploy.truth import Truth
from eval.margins.gaps import Gaps
from robots.arrays import Bools, Floats
from robots.capabilities import required
from robots.models.fleet import Fleet
from robots.models.nominal_model import torque_max

WINDOW_S = 0.1
"""s by which a robot may be behind its setpoints: delays of bus and drives, and a period of the drive's ringing."""
MEAN_S = 0.5
"""s, time constant of the mean error of the estimate. What friction of worn joints adds to it lasts: no noise."""
GAP_S = 0.02
"""s between two looks at the distances of shapes."""
SHARES = ("speed", "tau", "tool_speed")
"""Quantities that are shares of a limit. Their excess is kept by the planned share, in `BINS` of equal width, over the
upper end of the bin: a loaded gear has no play, and what happens at half of a limit may be a larger excess."""
BINS = 10

Values = dict[str, Floats]
"""Values (B, columns) by quantity."""


class Excess:
    """Largest excess of B robots. Those without power, or that had none in the window, are left out.

    Attributes:
        largest: (B, bins) by quantity, -inf where nothing was planned: "speed" and "tau" as shares of the joint's
            limits, "tool_speed" as a share of its limit, "angle" in rad beyond the setpoints, "workspace" (lower, or
            further out) and "gap" (nearer) in m.
    """

    largest: Values

    def __init__(self, runtime: Runtime, plant: Plant) -> None:
        """Look at a simulated robot's runtime and plant, as far as it has tool, workspace and shapes that may meet."""
        self._runtime, self._spec, spec = runtime, runtime.spec, runtime.spec
        robots = len(plant.valid)
        self._space = spec.workspace
        self._fleet = Fleet(spec, robots) if self._space else None
        self._gaps = Gaps(spec, plant) if "self_collision" in spec.capabilities else None
        self._qd_max, self._tau_max = spec.joint_array("qd_max"), torque_max(spec)
        self._window, self._gap_ticks = (max(1, round(s / spec.dt)) for s in (WINDOW_S, GAP_S))
        self._planned_gap = self._true_gap = np.zeros((robots, 0))
        self._history: dict[str, Floats] = {}
        self._tick, self._powered, self._counted = 0, *np.zeros((2, robots), dtype=np.int64)
        self._before, self._mean_error, self._squares = np.zeros((3, 2, robots, spec.n))
        self.largest = {}

    def step(self, truth: Truth, pushed: Bools) -> Values:
        """Look at the robots after a tick, (B,) of them pushed, and return the values of the setpoints sent."""
        planned, true = self.planned(), self.true(truth)
        self._powered = np.where(self._runtime.command.powered & truth.valid, self._powered + 1, 0)
        counts = self._powered > self._window
        self._look_at_estimate(truth, counts & ~pushed)
        for name, values in planned.items():
            if name not in self._history:
                self._history[name] = np.tile(values, (self._window, 1, 1))
                self.largest[name] = np.full((len(counts), BINS if name in SHARES else 1), -np.inf)
            history = self._history[name]
            history[self._tick % self._window] = values
            self._keep(self.largest[name], history.max(axis=0), true[name], counts)
        self._tick += 1
        return planned

    def _look_at_estimate(self, truth: Truth, counts: Bools) -> None:
        """Add up squared errors of the estimate, which is for the end of the tick before, around their mean.

        Those in a push are no noise: what they do is part of the excess, as is their mean.
        """
        state = self._runtime.state
        error = self._before - np.stack((state.q, state.qd)) - self._mean_error
        error = np.where(counts[:, None], error, 0.0)
        self._mean_error += error * (self._spec.dt / MEAN_S)
        self._squares += error * error
        self._counted += counts
        self._before[:] = truth.q, truth.qd

    @property
    def estimate_error(self) -> Floats:
        """(2, n) rad and rad/s, standard deviation of the estimate's error without pushes, of the worst robot."""
        variance: Floats = self._squares / np.maximum(self._counted, 1)[:, None]
        return np.sqrt(variance.max(axis=1))

    def _keep(self, largest: Floats, planned: Floats, true: Floats, counts: Bools) -> None:
        """Update the largest excess over the planned value, or of a share over the upper end of its bin."""
        rows, columns = np.nonzero(np.broadcast_to(counts[:, None], planned.shape))
        planned, true = planned[rows, columns], true[rows, columns]
        bins = np.clip(planned * BINS, 0, largest.shape[1] - 1).astype(np.int64)
        if largest.shape[1] == BINS:
            planned = (1.0 + bins) / BINS
        np.maximum.at(largest, (rows, bins), true - planned)

    def planned(self) -> Values:
        """Return the values of the setpoints sent, by the nominal model."""
        sent, tau = self._runtime.setpoint, self._runtime.command.tau
        found = self._of_joints(sent.q, sent.qd, tau)
        if self._fleet:
            kinematics = self._fleet.kinematics(sent.q)
            found |= self._of_tool(kinematics.tool_position, kinematics.tool_velocity(sent.qd))
        if self._gaps:
            if self._tick % self._gap_ticks == 0:
                self._planned_gap = -self._gaps.planned(sent.q)
            found["gap"] = self._planned_gap
        return found

    def true(self, truth: Truth) -> Values:
        """Return the values of the true robots."""
        found = self._of_joints(truth.q, truth.qd, truth.tau)
        if self._fleet:
            found |= self._of_tool(truth.tool_position, truth.tool_velocity)
        if self._gaps:
            if self._tick % self._gap_ticks == 0:
                self._true_gap = -self._gaps.true()
            found["gap"] = self._true_gap
        return found

    def _of_joints(self, q: Floats, qd: Floats, tau: Floats) -> Values:
        return {
            "speed": np.abs(qd) / self._qd_max,
            "tau": np.abs(tau) / self._tau_max,
            "angle": np.concatenate((q, -q), axis=1),
        }

    def _of_tool(self, position: Floats, velocity: Floats) -> Values:
        space = required(self._space)
        radius = np.linalg.norm(position - np.array(space.centre), axis=1)
        return {
            "tool_speed": np.linalg.norm(velocity, axis=1)[:, None] / space.tool_speed_max,
            "workspace": np.stack((radius, -position[:, 2]), axis=1),
        }
