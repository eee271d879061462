"""Input of all checks: a policy's file, a robot, and simulated runs of the two, computed on first use."""

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

import numpy as np

from deploy.policy.compatibility import mismatches
from deploy.policy.contract_term import Term
from deploy.policy.inference import BATCHES
from deploy.policy.policy import Policy
from deploy.policy.tried_policy import read_tried_policy
from policies.doctor.checks.normalizer import Statistics, normalizer_of
from policies.doctor.simulation.simulated_run import ON_TIME, Delay, SimulatedRun, run_simulation
from robots.arrays import Floats
from robots.errors import FirstshiftError
from robots.spec import load_robot


class NotSimulatedError(FirstshiftError):
    """The policy cannot be simulated on this robot."""


class CheckContext:
    """A policy and a robot under examination.

    Attributes:
        file: contents of the policy's file. policy: the network, ready to run.
    """

    def __init__(self, path: Path, robot: str | Path | None = None) -> None:
        """Read the policy, and the robot of this name or folder; None for the robot named in the contract.

        Raises:
            ContractError: the file is no policy, its contract is unreadable, or its network cannot be run.
            RobotError: the robot is unknown or unreadable.
        """
        self.path, self.file = path, read_tried_policy(path)
        self.contract = self.file.contract
        self.spec = load_robot(robot or self.contract.robot)
        self.policy, self._runs = Policy(self.file, str(path)), dict[Delay, SimulatedRun]()
        for batch in BATCHES:
            self.policy.rehearse(self.file.observation[:1], batch)

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

    @property
    def terms(self) -> Iterator[tuple[Term, slice]]:
        """Terms with their part of the observation: all frames of a history."""
        start = 0
        for term in self.contract.observation:
            end = start + term.size * term.history
            yield term, slice(start, end)
            start = end

    @property
    def training_means(self) -> Iterator[tuple[Term, Floats]]:
        """Terms with their mean (size,) in training, newest frame, in units of the source; empty if unknown."""
        if (training := self.training) is None:
            return
        for term, part in self.terms:
            mean = training.mean[part][-term.size :]
            yield term, np.asarray(mean * np.array(term.scale) + np.array(term.offset or 0.0))

    @property
    def run(self) -> SimulatedRun:
        """Simulated run with actions on time."""
        return self.delayed_run(ON_TIME)

    @property
    def works(self) -> bool:
        """True if the simulated run reaches enough goals; False if it cannot be simulated."""
        try:
            return self.run.works
        except NotSimulatedError:
            return False

    def delayed_run(self, delay: Delay) -> SimulatedRun:
        """Return the simulated run with this delay of actions; NotSimulatedError has the reason why there is none."""
        if self.incompatibilities:
            raise NotSimulatedError("the loader refuses the file, see row loader")
        try:
            if delay not in self._runs:
                self._runs[delay] = run_simulation(self.spec, self.policy, delay)
        except FirstshiftError as e:
            raise NotSimulatedError(str(e)) from e
        return self._runs[delay]
