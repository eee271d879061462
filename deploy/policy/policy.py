"""Policy inference by ONNX Runtime, behind a contract that is checked at load."""

from pathlib import Path
from typing import Self

import numpy as np

from deploy.policy.actor import Actor
from deploy.policy.compatibility import check_contract
from deploy.policy.graph_bounds import check_bounds
from deploy.policy.inference import BATCHES, load_session
from deploy.policy.onnx_graph import decode, shortened
from deploy.policy.policy_file import PolicyFile, read_policy_file
from deploy.policy.policy_names import INPUT, MEMORY, NEXT, OUTPUT
from robots.arrays import Bools, Float32s
from robots.errors import ContractError
from robots.spec import RobotSpec

AGREEMENT = 1e-5  # absolute, in the unit of a raw action


class Policy(Actor):
    """Policy of B robots. Results are bit-identical for the same observations and memory at the same B.

    A non-finite observation affects the action and memory of its own robot only.

    Attributes:
        contract: meaning of the numbers.
        digest: SHA-256 of the file.
        memory: (B, M) recurrent state.
    """

    carried = ("memory",)

    def __init__(self, file: PolicyFile, source: str) -> None:
        self.contract, self.digest, self._source = file.contract, file.digest, source
        self._session, self._data, self._bounded = load_session(file.data, source), file.data, {*BATCHES}
        self.resize(1)

    @classmethod
    def load(cls, path: str | Path, spec: RobotSpec) -> Self:
        """Read a policy for a robot and verify its golden pairs.

        Raises:
            ContractError: the file, its contract or its results do not fit this robot.
        """
        return cls.verified(read_policy_file(Path(path)), str(path), spec)

    @classmethod
    def verified(cls, file: PolicyFile, source: str, spec: RobotSpec) -> Self:
        """Build the policy of a file for a robot and verify its golden pairs; `source` names the file.

        Raises:
            ContractError: its contract or its results do not fit this robot.
        """
        check_contract(file.contract, spec, f"{source}: contract")
        policy = cls(file, source)
        for batch in BATCHES:
            policy.verify(file, batch)
        policy.resize(1)
        return policy

    def step(self, observation: Float32s) -> Float32s:
        """Return raw actions (B, A) for observations (B, N): a view that is valid until the next step.

        Another B than before resets the memory of every robot. Where the graph fails, an index out of range for
        example, all actions are NaN, so that robots stop, and memory stays.

        Raises:
            ContractError: the observation has another width than the contract.
        """
        if observation.shape != self._observation.shape:
            self._refit(observation.shape)
        try:
            return self._run(observation)
        except (RuntimeError, MemoryError) as e:  # as a run with bound tensors fails
            self.failure = shortened(e)
            self._action[:] = np.nan
            return self._action

    def _run(self, observation: Float32s) -> Float32s:
        np.copyto(self._observation, observation)
        self._session.run_with_iobinding(self._binding)
        np.copyto(self.memory, self._next)
        return self._action

    def reset(self, ids: Bools) -> None:
        """Clear the memory of robots where `ids` (B,) holds."""
        self.memory[ids] = 0.0

    def replay(self, observation: Float32s, batch: int) -> Float32s:
        """Return actions (K, A) for observations (K, N) of a policy without memory, `batch` at a time.

        Raises:
            ContractError: the network cannot be run at this batch.
        """
        rows = np.arange(-(-len(observation) // batch) * batch) % len(observation)
        self.resize(batch)
        actions = [self._tried(observation[chunk]) for chunk in rows.reshape(-1, batch)]
        return np.concatenate(actions)[: len(observation)]

    def rehearse(self, observation: Float32s, batch: int) -> Float32s:
        """Return actions (T, B, A) of B identical robots for a sequence of observations (T, N), from reset.

        Raises:
            ContractError: the network cannot be run at this batch.
        """
        self.resize(batch)
        return np.stack([self._tried(np.repeat(row[None], batch, axis=0)) for row in observation])

    def _tried(self, observation: Float32s) -> Float32s:
        """Return a copy of the actions of a step that may fail."""
        try:
            return self._run(observation).copy()
        except Exception as e:  # ONNX Runtime's errors share no base
            batch = len(observation)
            raise ContractError(f"{self._source}: cannot be run at batch {batch}: {shortened(e)}") from e

    def _refit(self, shape: tuple[int, ...]) -> None:
        size = self.contract.observation_size
        if len(shape) != 2 or shape[0] < 1 or shape[1] != size:
            raise ContractError(f"{self._source}: observation: found shape {shape}, expected (B, {size})")
        self.resize(shape[0])

    def resize(self, robots: int) -> None:
        """Resize to B robots, reset their memory and preallocate buffers.

        Raises:
            ContractError: a step of so many robots may need too much memory or work.
        """
        if robots not in self._bounded:
            check_bounds(decode(self._data, self._source), (robots,), self._source)
            self._bounded.add(robots)
        contract = self.contract
        self._observation = np.zeros((robots, contract.observation_size), np.float32)
        self._action = np.zeros((robots, contract.action_size), np.float32)
        self.memory, self._next = np.zeros((2, robots, contract.memory), np.float32)
        self._binding = binding = self._session.io_binding()
        ends = [(binding.bind_input, INPUT, self._observation), (binding.bind_output, OUTPUT, self._action)]
        if contract.memory:
            ends += [(binding.bind_input, MEMORY, self.memory), (binding.bind_output, NEXT, self._next)]
        for bind, name, array in ends:
            bind(name, "cpu", 0, np.float32, array.shape, array.ctypes.data)

    def verify(self, file: PolicyFile, batch: int) -> None:
        """Verify every golden pair at a batch size."""
        if self.contract.memory:
            action, expected = self.rehearse(file.observation, batch), file.action[:, None]
        else:
            action, expected = self.replay(file.observation, batch), file.action
        worst = float(np.abs(action - expected).max())
        if not worst <= AGREEMENT:
            raise ContractError(
                f"{self._source}: golden pairs: found a deviation of {worst:.3g} at batch {batch}, "
                f"expected at most {AGREEMENT:g}"
            )
