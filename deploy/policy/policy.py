"""The policy: ONNX Runtime behind a contract that was checked before anything could move."""

from pathlib import Path
from typing import Self

import numpy as np
import onnxruntime as ort

from deploy.policy.compatibility import check_contract
from deploy.policy.onnx_graph import shortened
from deploy.policy.policy_file import INPUT, MEMORY, NEXT, OUTPUT, PolicyFile, read_policy_file
from deploy.stage import Stage
from robots.arrays import Bools, Float32s
from robots.errors import ContractError
from robots.spec import RobotSpec

AGREEMENT = 1e-5  # absolute, in the unit of a raw action
BATCHES = (1, 64)  # one robot, and a shard of a soak


class Policy(Stage):
    """One step for every robot. The same bits come out of the same observations and memories at the same B.

    An observation that is not finite spoils its own robot's action, and what it remembers, and no other's.

    Attributes:
        contract: what the numbers mean.
        digest: SHA-256 of the file.
        memory: (B, M) what each robot's policy remembers.
    """

    carried = ("memory",)

    def __init__(self, file: PolicyFile, source: str) -> None:
        self.contract, self.digest, self._source = file.contract, file.digest, source
        self._session = session(file.data, source)
        self.resize(1)

    @classmethod
    def load(cls, path: str | Path, spec: RobotSpec) -> Self:
        """Read a policy for a robot and let it prove itself.

        Raises:
            ContractError: the file, its contract, or what it computes is not what this robot needs.
        """
        file = read_policy_file(Path(path))
        check_contract(file.contract, spec, f"{path}: contract")
        policy = cls(file, str(path))
        for batch in BATCHES:
            policy.prove(file, batch)
        policy.resize(1)
        return policy

    def step(self, observation: Float32s) -> Float32s:
        """(B, N) observations to (B, A) raw actions: a view that holds until the next step.

        With another B than before every robot begins anew.

        Raises:
            ContractError: the observation has another width than the contract says.
        """
        if observation.shape != self._observation.shape:
            self._refit(observation.shape)
        np.copyto(self._observation, observation)
        self._session.run_with_iobinding(self._binding)
        np.copyto(self.memory, self._next)
        return self._action

    def reset(self, ids: Bools) -> None:
        """Robots where `ids` (B,) holds remember nothing."""
        self.memory[ids] = 0.0

    def replay(self, observation: Float32s, batch: int) -> Float32s:
        """Observations (K, N) to actions (K, A) of a policy without memory, `batch` at a time; the last is padded."""
        rows = np.arange(-(-len(observation) // batch) * batch) % len(observation)
        actions = [self.step(observation[chunk]).copy() for chunk in rows.reshape(-1, batch)]
        return np.concatenate(actions)[: len(observation)]

    def rehearse(self, observation: Float32s, batch: int) -> Float32s:
        """Observations (T, N) one after the other, from the beginning, to so many robots alike: actions (T, B, A)."""
        self.resize(batch)
        return np.stack([self.step(np.repeat(row[None], batch, axis=0)).copy() for row in observation])

    def _refit(self, shape: tuple[int, ...]) -> None:
        size = self.contract.observation_size
        if len(shape) != 2 or shape[0] < 1 or shape[1] != size:
            raise ContractError(f"{self._source}: observation: found shape {shape}, expected (B, {size})")
        self.resize(shape[0])

    def resize(self, robots: int) -> None:
        """Be the policy of so many robots, each at its beginning; steps then allocate nothing."""
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

    def prove(self, file: PolicyFile, batch: int) -> None:
        """Every golden pair once at this batch."""
        try:
            if self.contract.memory:
                action, expected = self.rehearse(file.observation, batch), file.action[:, None]
            else:
                action, expected = self.replay(file.observation, batch), file.action
        except Exception as e:  # ONNX Runtime's errors share no base
            raise ContractError(f"{self._source}: cannot be run at batch {batch}: {shortened(e)}") from e
        worst = float(np.abs(action - expected).max())
        if not worst <= AGREEMENT:
            raise ContractError(
                f"{self._source}: golden pairs: found a deviation of {worst:.3g} at batch {batch}, "
                f"expected at most {AGREEMENT:g}"
            )


def session(data: bytes, source: str) -> ort.InferenceSession:
    """ONNX Runtime with one model, on one thread; `source` names it in messages.

    Raises:
        ContractError: it refuses the model.
    """
    options = ort.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # what goes wrong is raised, not logged
    try:
        return ort.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except Exception as e:  # ONNX Runtime's errors share no base
        raise ContractError(f"{source}: ONNX Runtime refuses it: {shortened(e)}") from e
