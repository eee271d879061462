"""Content of a policy's ONNX file: contract, inputs and outputs, golden pairs."""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from onnx import GraphProto, ModelProto, TensorProto, ValueInfoProto
from pydantic import Field, model_validator

from deploy.policy.contract import Contract
from deploy.policy.contract_term import Number
from deploy.policy.onnx_graph import read_model, type_name
from deploy.policy.policy_names import CONTRACT_KEY, GOLDEN_KEY, INPUT, MEMORY, NEXT, OUTPUT
from robots.arrays import Float32s
from robots.errors import ContractError
from robots.files import read_file
from robots.strict import Many, Strict, parse, read_json

FILE_BYTES_MAX = 256 << 20
GOLDEN_CHARACTERS_MAX = 16 << 20
PAIRS_MAX = 64
"""Golden pairs: four times as many as exports write; all are run at each load."""

FLOAT32_MAX = float(np.finfo(np.float32).max)

Rows = Annotated[Many[Many[Number]], Field(min_length=1, max_length=PAIRS_MAX)]


class Golden(Strict):
    """Observation-action pairs that the policy must reproduce before it may move anything.

    A policy with memory must reproduce them in order, from its reset.

    Attributes:
        observation: (G, N) float32 values. action: (G, A) float32 values, as torch computed them.
    """

    observation: Rows
    action: Rows

    @model_validator(mode="after")
    def _paired(self) -> Self:
        if len(self.observation) != len(self.action):
            raise ValueError(f"{len(self.observation)} observations but {len(self.action)} actions")
        return self


@dataclass(frozen=True, slots=True, kw_only=True)
class PolicyFile:
    """Policy file that has passed every check that needs no robot.

    Attributes:
        data: the checked bytes, so that no others are run.
        digest: SHA-256 of `data`.
        observation: (G, N) golden observations. action: (G, A) expected actions.
    """

    data: bytes
    digest: str
    contract: Contract
    observation: Float32s
    action: Float32s


def read_policy_file(path: Path) -> PolicyFile:
    """Read one policy file and check all of it.

    Raises:
        ContractError: names the file, the part, the found and the expected value.
    """
    data = read_file(path, FILE_BYTES_MAX, ContractError, "expected an ONNX policy")
    model = read_model(data, str(path))
    contract = Contract.from_json(_metadata(model, CONTRACT_KEY, path), f"{path}: {CONTRACT_KEY}")
    _check_inputs_and_outputs(model.graph, contract, path)
    observation, action = _golden(model, contract, path)
    digest = hashlib.sha256(data).hexdigest()
    return PolicyFile(data=data, digest=digest, contract=contract, observation=observation, action=action)


def _metadata(model: ModelProto, key: str, path: Path) -> str:
    for entry in model.metadata_props:
        if entry.key == key:
            return str(entry.value)
    found = ", ".join(repr(entry.key) for entry in model.metadata_props) or "none"
    raise ContractError(
        f"{path}: metadata {key}: missing, found keys: {found:.200}; expected a file written by policy-export or"
        " policy-import"
    )


def _check_inputs_and_outputs(graph: GraphProto, contract: Contract, path: Path) -> None:
    weights = {tensor.name for tensor in graph.initializer}
    inputs = [value for value in graph.input if value.name not in weights]
    before, after = {INPUT: contract.observation_size}, {OUTPUT: contract.action_size}
    if contract.memory:
        before[MEMORY] = after[NEXT] = contract.memory
    _check_tensors("input", inputs, before, path)
    _check_tensors("output", list(graph.output), after, path)


def _check_tensors(
    kind: Literal["input", "output"], found: list[ValueInfoProto], sizes: dict[str, int], path: Path
) -> None:
    """Compare the inputs or outputs of the graph with the expected tensors (batch, size), in order."""
    wanted = " and ".join(f"{name!r} float32 (batch, {size})" for name, size in sizes.items())
    expected = f"expected {'one' if len(sizes) == 1 else 'two'}, {wanted} with a batch of any size"
    if [value.name for value in found] != list(sizes):
        raise ContractError(f"{path}: {kind}: found {[value.name for value in found]!r:.200}, {expected}")
    for value, (name, size) in zip(found, sizes.items(), strict=True):
        _check_tensor(value, size, f"{path}: {kind} {name!r}", expected)


def _check_tensor(value: ValueInfoProto, size: int, source: str, expected: str) -> None:
    tensor = value.type.tensor_type
    dims = [dim.dim_value if dim.HasField("dim_value") else dim.dim_param or "?" for dim in tensor.shape.dim]
    fits = len(dims) == 2 and isinstance(dims[0], str) and dims[1] == size
    if tensor.elem_type != TensorProto.FLOAT or not fits:
        raise ContractError(f"{source}: found {type_name(tensor.elem_type)} {dims!r:.100}, {expected}")


def _golden(model: ModelProto, contract: Contract, path: Path) -> tuple[Float32s, Float32s]:
    source = f"{path}: {GOLDEN_KEY}"
    data = read_json(_metadata(model, GOLDEN_KEY, path), source, GOLDEN_CHARACTERS_MAX, ContractError)
    golden = parse(data, Golden, source=source, error=ContractError)
    return (
        _matrix(golden.observation, contract.observation_size, f"{source}: observation"),
        _matrix(golden.action, contract.action_size, f"{source}: action"),
    )


def _matrix(rows: Rows, width: int, source: str) -> Float32s:
    if widths := {len(row) for row in rows} - {width}:
        raise ContractError(f"{source}: found a row of {widths.pop()} numbers, expected {width}")
    exact = np.array(rows)
    for row, column in np.argwhere(np.abs(exact) > FLOAT32_MAX):
        found = f"found {exact[row, column]:g}, expected at most {FLOAT32_MAX:g} either way"
        raise ContractError(f"{source}.{row}.{column}: {found}: single precision")
    return exact.astype(np.float32)
