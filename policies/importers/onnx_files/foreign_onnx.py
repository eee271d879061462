"""Reader of ONNX files of other libraries: finds observation, action and memory, and tests for a batch axis."""

import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from onnx import ModelProto, NodeProto, TensorProto, ValueInfoProto

from deploy.policy.contract_term import SIZE_MAX
from deploy.policy.inference import load_session
from deploy.policy.onnx_graph import check_model, decode, graphs, shortened, tensors, type_name
from deploy.policy.policy import AGREEMENT
from deploy.policy.step_trial import try_step
from policies.importers.onnx_files.metadata import known_from
from policies.importers.reference_policy import Memory, PolicyFacts, ReferencePolicy
from policies.importers.untrusted.zip_archive import BYTES_MAX, read_bytes
from robots.arrays import Float32s
from robots.errors import ContractError

OBSERVATIONS = ("obs", "observation", "observations", "actor_obs", "policy")
ACTIONS = ("actions", "action", "output", "continuous_actions", "mean")
MEMORIES = {"h_in": "h_out", "c_in": "c_out", "state_ins": "state_outs"}
"""Names used by exporters of rsl_rl, Isaac Lab, mjlab, holosoma, brax, Stable-Baselines3 and Godot."""

EXPECTED = "expected ONNX"


def load_onnx(path: Path) -> tuple[ModelProto, tuple[Path, ...]]:
    """Return a graph without forbidden operators, and the files beside it from which its external weights are."""
    model, budget = decode(read_bytes(path, EXPECTED), str(path)), BYTES_MAX
    files = set()
    for graph in graphs(model):
        for tensor in tensors(graph):
            if tensor.data_location == TensorProto.EXTERNAL:
                weights_path, size = _embed_external_data(tensor, path, budget)
                files.add(weights_path)
                budget -= size
    _remove_unused_opsets(model)
    check_model(model, str(path))
    return model, tuple(sorted(files))


def _remove_unused_opsets(model: ModelProto) -> None:
    """Remove operator sets that no node uses; tf2onnx lists ai.onnx.ml in every file."""
    used = {node.domain for graph in graphs(model) for node in graph.node}
    kept = [opset for opset in model.opset_import if opset.domain in used | {"", "ai.onnx"}]
    del model.opset_import[:]
    model.opset_import.extend(kept)


def _embed_external_data(tensor: TensorProto, path: Path, budget: int) -> tuple[Path, int]:
    """Copy external data into the tensor, at most `budget` bytes; return their file and number.

    The budget is for all tensors: several may refer to the same bytes.
    """
    source, entries = f"{path}: tensor {tensor.name!r:.100}", {e.key: e.value for e in tensor.external_data}
    location = str(entries.get("location", ""))
    weights_path = path.parent / location
    if location != Path(location).name or os.path.islink(weights_path) or not os.path.isfile(weights_path):
        found = f"found its weights in {location!r:.100}"
        raise ContractError(f"{source}: {found}, expected a file beside {path.name}")
    try:
        start, size = int(entries.get("offset", 0)), int(entries.get("length", weights_path.stat().st_size))
        with weights_path.open("rb") as stream:
            stream.seek(start)
            data = stream.read(size) if 0 <= size <= budget else b""
    except (ValueError, OSError, OverflowError) as e:
        expected = f"expected offset and length in {location!r}"
        raise ContractError(f"{source}: found {shortened(e)}, {expected}") from e
    if len(data) != size:
        found = f"found {len(data)} bytes in {location!r}"
        raise ContractError(f"{source}: {found}, expected {size}, {budget} at most")
    tensor.raw_data = data
    tensor.data_location = TensorProto.DEFAULT
    del tensor.external_data[:]
    return weights_path, size


def read_onnx(model: ModelProto, source: str) -> ReferencePolicy:
    """Find observation, action and memory of a checked graph; `source` names the file in error messages.

    Parts that the action does not depend on are removed: critics, reference motions, unused states.
    """
    outputs = {value.name: value for value in model.graph.output}
    observation = _find_name(_inputs(model), OBSERVATIONS, f"{source}: input")
    action = _find_name(outputs, ACTIONS, f"{source}: output")
    recurrent = [name for name in _inputs(_subgraph(model, [action])) if name in MEMORIES]
    model = _subgraph(model, [action, *(MEMORIES[name] for name in recurrent if MEMORIES[name] in outputs)])
    inputs, outputs = _inputs(model), {value.name: value for value in model.graph.output}
    _check_inputs(inputs, outputs, observation, action, source)
    shapes = {name: _shape(inputs[name], source) for name in recurrent}
    memory = tuple(Memory(input_name=n, output_name=MEMORIES[n], shape=shape) for n, shape in shapes.items())
    facts = PolicyFacts(
        kind="ONNX" + (" with memory" if memory else ""),
        observations=_size(inputs[observation], source),
        actions=_size(outputs[action], source),
        known=known_from({entry.key: entry.value for entry in model.metadata_props}, source),
    )
    runner = _OnnxRunner(model, observation, action, memory, source)
    fields: dict[str, Any] = {"observation": observation, "action": action, "memory": memory}
    reference = ReferencePolicy(facts=facts, model=model, batched=False, run=runner.run, **fields)
    return allow_any_batch(reference, source)


def _check_inputs(
    inputs: Mapping[str, ValueInfoProto],
    outputs: Mapping[str, ValueInfoProto],
    observation: str,
    action: str,
    source: str,
) -> None:
    if observation not in inputs:
        found = f"output {action!r}: does not depend on {observation!r}"
        raise ContractError(f"{source}: {found}, expected an action computed from the observation")
    for name in inputs:
        if name != observation and MEMORIES.get(name) not in outputs:
            pairs = ", ".join(f"{before} with {after}" for before, after in MEMORIES.items())
            expected = f"expected {observation!r} and recurrent states: {pairs}"
            raise ContractError(f"{source}: input {name!r}: unknown, {expected}")


def allow_any_batch(reference: ReferencePolicy, source: str) -> ReferencePolicy:
    """Mark the graph as batched if a batch of three gives the same actions as three single runs."""
    if reference.memory:
        return reference
    batched = ModelProto()
    batched.CopyFrom(reference.model)
    for value in (*batched.graph.input, *batched.graph.output):
        if value.name in (reference.observation, reference.action):
            value.type.tensor_type.shape.dim[0].dim_param = "batch"
    same = _accepts_batch(batched, reference, source)
    return replace(reference, model=batched, batched=True) if same else reference


def _inputs(model: ModelProto) -> dict[str, ValueInfoProto]:
    weights = {tensor.name for tensor in model.graph.initializer}
    return {value.name: value for value in model.graph.input if value.name not in weights}


def _find_name(found: Mapping[str, ValueInfoProto], known: Iterable[str], source: str) -> str:
    names = [name for name in known if name in found] or (list(found) if len(found) == 1 else [])
    if len(names) != 1:
        expected = f"expected exactly one of {', '.join(known)}"
        raise ContractError(f"{source}: found {list(found)!r:.200}, {expected}")
    return names[0]


def _subgraph(model: ModelProto, outputs: list[str]) -> ModelProto:
    """Return the part of a model that these outputs depend on."""
    wanted: set[str] = set(outputs)
    nodes: list[NodeProto] = []
    for node in reversed(model.graph.node):  # a valid graph is sorted
        if wanted.intersection(node.output):
            nodes.insert(0, node)
            bodies = [inner for attribute in node.attribute for inner in attribute.g.node]
            wanted.update(name for part in (node, *bodies) for name in part.input)
    part = ModelProto()
    part.CopyFrom(model)
    graph, whole = part.graph, model.graph
    for field in (graph.node, graph.initializer, graph.input, graph.output, graph.value_info):
        del field[:]
    graph.node.extend(nodes)
    graph.initializer.extend(tensor for tensor in whole.initializer if tensor.name in wanted)
    graph.input.extend(value for value in whole.input if value.name in wanted)
    graph.output.extend(value for value in whole.output if value.name in outputs)
    return part


def _shape(value: ValueInfoProto, source: str) -> tuple[int, ...]:
    """Return the shape for one robot; a named dimension is the batch."""
    tensor = value.type.tensor_type
    shape = tuple(d.dim_value if d.HasField("dim_value") else 1 for d in tensor.shape.dim)
    fits = all(0 < d <= SIZE_MAX for d in shape) and np.prod(shape) <= SIZE_MAX
    if tensor.elem_type != TensorProto.FLOAT or not fits:
        found = f"{value.name!r}: found {type_name(tensor.elem_type)} {shape}"
        raise ContractError(f"{source}: {found}, expected FLOAT with 1 to {SIZE_MAX} numbers per robot")
    return shape


def _size(value: ValueInfoProto, source: str) -> int:
    shape = _shape(value, source)
    if len(shape) != 2 or shape[0] != 1:
        raise ContractError(f"{source}: {value.name!r}: found shape {shape}, expected (batch, size)")
    return shape[1]


class _OnnxRunner:
    """Run the original model with ONNX Runtime, for one robot."""

    def __init__(
        self, model: ModelProto, observation: str, action: str, memory: tuple[Memory, ...], source: str
    ) -> None:
        data = model.SerializeToString()
        try_step(data, source, batches=(1,))
        self._session = load_session(data, source, batches=(1,))
        self._observation, self._memory, self._source = observation, memory, source
        self._outputs = [action, *(piece.output_name for piece in memory)]
        (self._shape,) = (_shape(value, source) for value in model.graph.output if value.name == action)

    def run(self, observations: Float32s, resets: NDArray[np.bool_]) -> Float32s:
        """Return actions, as `reference_policy.RunSequence`.

        Raises:
            ContractError: the model cannot be run, or gives actions of another shape than it declares.
        """
        initial = {piece.input_name: np.zeros(piece.shape, np.float32) for piece in self._memory}
        actions, state = [], initial
        for row, reset in zip(observations, resets, strict=True):
            inputs = {self._observation: row[None], **(initial if reset else state)}
            try:
                action, *next_state = self._session.run(self._outputs, inputs)
            except Exception as e:  # ONNX Runtime's errors share no base
                raise ContractError(f"{self._source}: cannot be run: {shortened(e)}") from e
            state = dict(zip(initial, next_state, strict=True))
            if np.shape(action) != self._shape:
                found = f"found shape {np.shape(action)}, expected {self._shape} as declared"
                raise ContractError(f"{self._source}: {self._outputs[0]!r}: {found}")
            actions.append(action[0])
        return np.array(actions, dtype=np.float32)


def _accepts_batch(batched_model: ModelProto, reference: ReferencePolicy, source: str) -> bool:
    observations = np.random.default_rng(0).normal(size=(3, reference.facts.observations)).astype(np.float32)
    single = reference.run(observations, np.ones(3, dtype=bool))
    try:
        session = load_session(batched_model.SerializeToString(), source, batches=(len(observations),))
        batch = session.run([reference.action], {reference.observation: observations})[0]
    except Exception:  # noqa: BLE001 - a batch size of 1 is built in; ONNX Runtime's errors share no base
        return False
    return batch.shape == single.shape and bool(np.abs(batch - single).max() <= AGREEMENT)
