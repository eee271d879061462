"""Stand-ins for single stages of the stack; every other stage, safety included, stays as it is."""

from collections.abc import Callable
from functools import reduce

import numpy as np

from deploy.estimation.estimator import Estimator
from deploy.estimation.winding_observer import WindingObserver
from deploy.motion.smoother import Smoother
from deploy.runtime import Runtime
from deploy.state import STOP_MOMENTS, Sample, Setpoint, State, Stop
from robots.arrays import Bools, Floats
from robots.spec import RobotSpec


class LatestPacketEstimator(Estimator):
    """Angle of the latest packet; speed from the last two packets and their stamps. No filter.

    Ages, faults and heat are those of the estimator.
    """

    carried = (*Estimator.carried, "t_last", "q_last", "qd_last")

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        super().__init__(spec, robots)
        self.t_last = np.full((robots, 1), -np.inf)
        self.q_last, self.qd_last = np.zeros((2, robots, spec.n))

    def step(self, t: float, sample: Sample, sent: Setpoint) -> State:
        """Return the state with the latest angle and the differenced speed."""
        state, packet = super().step(t, sample, sent), sample["encoder"]
        taken = packet.t[:, None]
        new = taken > self.t_last
        np.divide(packet.value - self.q_last, taken - self.t_last, out=self.qd_last, where=new)
        np.copyto(self.q_last, packet.value, where=new)
        np.copyto(self.t_last, taken, where=new)
        return state._replace(q=self.q_last, qd=self.qd_last)


class UncompensatedEstimator(Estimator):
    """Estimates at the time of the latest sample, used as if they were current: no delay compensation."""

    def step(self, t: float, sample: Sample, sent: Setpoint) -> State:
        """Return the state with angle and speed at the time of the latest sample."""
        state = super().step(t, sample, sent)
        history, joints = self.setpoints, self.joints
        tick = np.rint(joints.t_sample / self.dt)
        rows, columns = np.ogrid[: len(tick), : tick.shape[1]]
        place = tick.astype(np.int64) % history.depth
        q, qd = history.ring[rows, place, columns], history.ring[rows, place, columns + tick.shape[1]]
        return state._replace(q=q + qd * (joints.t_sample - tick * self.dt) + joints.e, qd=qd + joints.ed)


class UnlimitedSmoother(Smoother):
    """Targets sent as they are, clamped to the range of angles; a stop holds the present angle.

    Derivatives are backward differences of the targets.
    """

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        super().__init__(spec, robots)
        self._dt = spec.dt

    def next(self, q_target: Floats, stopping: Bools) -> Setpoint:
        """Return the clamped target."""
        q = np.where(stopping[:, None], self.q, np.minimum(np.maximum(q_target, self.q_min), self.q_max))
        qd = (q - self.q) / self._dt
        return Setpoint(q=q, qd=qd, qdd=(qd - self.qd) / self._dt, drive=self.drive)

    def brake(self, start: Setpoint) -> Stop:
        """Return rest at the starting angle, reached within one tick."""
        still = np.zeros_like(start.qd)
        rest = start._replace(qd=still, qdd=-start.qd / self._dt)
        q, stopped = (np.array([each] * STOP_MOMENTS) for each in (start.q, still))
        return Stop(rest, q=q, qd=stopped, qdd=stopped, q_rest=start.q)


class HousingTemperatureObserver(WindingObserver):
    """Winding temperatures equal to those of the housings: no current foldback and no stop for heat."""

    def step(self, t: float, sample: Sample) -> None:
        """Copy the measured housing temperatures."""
        self.winding[:] = self.hottest[:] = sample["temperature"].value


class HeatBlindEstimator(Estimator):
    """Estimator that reports 0 °C for every housing and winding."""

    def __init__(self, spec: RobotSpec, robots: int) -> None:
        super().__init__(spec, robots)
        self.windings = HousingTemperatureObserver(spec, robots)

    def step(self, t: float, sample: Sample, sent: Setpoint) -> State:
        """Return the state with all temperatures at 0 °C."""
        state = super().step(t, sample, sent)
        cold = np.zeros_like(state.housing_c)
        return state._replace(housing_c=cold, winding_c=cold, hottest_c=cold)


Variant = Callable[[Runtime], None]


def keep_stages(runtime: Runtime) -> None:
    """Leave the runtime unchanged."""


def replace_stage(path: str, kind: Callable[[RobotSpec, int], object]) -> Variant:
    """Return a variant that replaces the stage at a dotted attribute path of the runtime by one of `kind`."""
    *owners, name = path.split(".")

    def replace(runtime: Runtime) -> None:
        setattr(reduce(getattr, owners, runtime), name, kind(runtime.spec, runtime.robot.robots))

    return replace


VARIANTS: dict[str, Variant] = {
    "whole stack": keep_stages,
    "no estimator": replace_stage("estimator", LatestPacketEstimator),
    "delays left in": replace_stage("estimator", UncompensatedEstimator),
    "no smoother": replace_stage("smoother", UnlimitedSmoother),
    "no heat guard": replace_stage("estimator.windings", HousingTemperatureObserver),
}
