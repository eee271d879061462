"""Input of all checks: a policy's file, a robot, and simulated runs of the two, computed on first use."""

from functools import cached_property
from pathlib import Path

from deploy.policy.compatibility import mismatches
from deploy.policy.onnx_graph import shortened
from deploy.policy.policy import BATCHES, Policy
from deploy.policy.policy_file import read_policy_file
from policies.doctor.checks.normalizer import Statistics, normalizer_of
from policies.doctor.simulation.simulated_run import (
    HALF_PERIOD_LATE,
    JITTERED,
    ON_TIME,
    PERIOD_LATE,
    SimulatedRun,
    run_simulation,
)
from robots.errors import ContractError, FirstshiftError
from robots.spec import load_robot


class NotSimulatedError(FirstshiftError):
    """The policy cannot be simulated on this robot."""


class CheckContext:
    """A policy and a robot under examination.

    Attributes:
        file: contents of the policy's file. policy: the network, ready to run.
    """

    def __init__(self, path: Path, robot: str | Path | None = None) -> None:
        """Read the policy and the robot.

        Args:
            path: the policy's file. robot: name or folder; None for the robot named in the contract.

        Raises:
            ContractError: the file is no policy, its contract is unreadable, or its network cannot be run.
            RobotError: the robot is unknown or unreadable.
        """
        self.path, self.file = path, read_policy_file(path)
        self.contract = self.file.contract
        self.spec = load_robot(robot or self.contract.robot)
        self.policy = Policy(self.file, str(path))
        try:
            for batch in BATCHES:
                self.policy.rehearse(self.file.observation[:1], batch)
        except Exception as e:  # ONNX Runtime's errors share no base
            raise ContractError(f"{path}: cannot be run at batch {batch}: {shortened(e)}") from e

    @cached_property
    def incompatibilities(self) -> tuple[str, ...]:
        """Reasons why this robot's runtime refuses the contract."""
        same = {"robot": self.spec.name, "robot_digest": self.spec.digest}
        return tuple(mismatches(self.contract.model_copy(update=same), self.spec))

    @cached_property
    def normalizer(self) -> Statistics | None:
        """Normalizer found in the graph, or None."""
        return normalizer_of(self.file)

    @property
    def training(self) -> Statistics | None:
        """Observation statistics of training, from the graph or else the contract; None if unknown."""
        if self.normalizer is not None or self.contract.observed is None:
            return self.normalizer
        return Statistics.of(self.contract.observed)

    @cached_property
    def run(self) -> SimulatedRun:
        """Simulated run with actions on time."""
        return self._simulate(ON_TIME)

    @property
    def works(self) -> bool:
        """True if the simulated run reaches enough goals; False if it cannot be simulated."""
        try:
            return self.run.works
        except NotSimulatedError:
            return False

    @cached_property
    def late_run(self) -> SimulatedRun:
        """Simulated run with every action one policy period late."""
        return self._simulate(PERIOD_LATE)

    @cached_property
    def half_late_run(self) -> SimulatedRun:
        """Simulated run with every action half a policy period late."""
        return self._simulate(HALF_PERIOD_LATE)

    @cached_property
    def jittered_run(self) -> SimulatedRun:
        """Simulated run with a random delay of each action, up to one policy period."""
        return self._simulate(JITTERED)

    def _simulate(self, delay_periods: tuple[float, float]) -> SimulatedRun:
        """Raises: NotSimulatedError: with the reason."""
        if self.incompatibilities:
            raise NotSimulatedError("the loader refuses the file, see row loader")
        try:
            return run_simulation(self.spec, self.policy, delay_periods)
        except FirstshiftError as e:
            raise NotSimulatedError(str(e)) from e
