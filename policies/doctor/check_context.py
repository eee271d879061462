"""What the doctor looks at: a policy's file, a robot that it may not fit, and how the two lived together."""

from functools import cached_property
from pathlib import Path

from deploy.policy.compatibility import mismatches
from deploy.policy.onnx_graph import shortened
from deploy.policy.policy import BATCHES, Policy
from deploy.policy.policy_file import read_policy_file
from policies.doctor.checks.normalizer import Statistics, normalizer_of
from policies.doctor.simulation.simulated_run import HALF, JITTERING, LATE, PUNCTUAL, Life, live
from robots.errors import ContractError, FirstshiftError
from robots.spec import load_robot


class UntriedError(FirstshiftError):
    """There is no life to look at."""


class Case:
    """A policy before a robot. The lives are lived when they are first asked for, and once.

    Attributes:
        file: what is in it: sound, whether it fits the robot or not. policy: the network, ready to run.
    """

    def __init__(self, path: Path, robot: str | Path | None = None) -> None:
        """Read both.

        Args:
            path: the policy's file. robot: name or folder; without it the robot that the contract names.

        Raises:
            ContractError: the file is no policy, its contract cannot be read, or its network cannot be run.
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
    def misfits(self) -> tuple[str, ...]:
        """Why no runtime of this robot could run this contract."""
        same = {"robot": self.spec.name, "robot_digest": self.spec.digest}
        return tuple(mismatches(self.contract.model_copy(update=same), self.spec))

    @cached_property
    def normalizer(self) -> Statistics | None:
        """What the graph subtracts and divides by before its first weights."""
        return normalizer_of(self.file)

    @property
    def training(self) -> Statistics | None:
        """What observations were like in training, as the network or else the contract tells."""
        if self.normalizer is not None or self.contract.observed is None:
            return self.normalizer
        return Statistics.of(self.contract.observed)

    @cached_property
    def life(self) -> Life:
        """As it should be."""
        return self._live(PUNCTUAL)

    @property
    def works(self) -> bool:
        """Whether it works as it is; not where nothing can be lived."""
        try:
            return self.life.works
        except UntriedError:
            return False

    @cached_property
    def late(self) -> Life:
        """Every action a policy period late."""
        return self._live(LATE)

    @cached_property
    def half_late(self) -> Life:
        """Every action half a policy period late."""
        return self._live(HALF)

    @cached_property
    def jittered(self) -> Life:
        """Each action late by a time of its own, up to a policy period."""
        return self._live(JITTERING)

    def _live(self, lateness: tuple[float, float]) -> Life:
        """Raises: UntriedError: nothing can be lived, and why."""
        if self.misfits:
            raise UntriedError("the loader refuses it, see its row")
        try:
            return live(self.spec, self.policy, lateness)
        except FirstshiftError as e:
            raise UntriedError(str(e)) from e
