"""ONNX files of other people: which end is which, and whether they take more than one robot."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from onnx import ModelProto, NodeProto, TensorProto, ValueInfoProto

from deploy.policy.observation_terms import SIZE_MAX
from deploy.policy.onnx_graph import check_model, decode, graphs, shortened, tensors
from deploy.policy.policy import AGREEMENT, session
from policies.importers.onnx_files.metadata import known_from
from policies.importers.reference_policy import Facts, Memory, Original
from policies.importers.untrusted.zip_archive import BYTES_MAX, read_bytes
from robots.arrays import Float32s
from robots.errors import ContractError

OBSERVATIONS = ("obs", "observation", "observations", "actor_obs", "policy")
ACTIONS = ("actions", "action", "output", "continuous_actions", "mean")
MEMORIES = {"h_in": "h_out", "c_in": "c_out", "state_ins": "state_outs"}
"""Names in the field: exporters of rsl_rl, Isaac Lab, mjlab, holosoma, brax, Stable-Baselines3 and Godot."""

EXPECTED = "expected ONNX"


def load_onnx(path: Path) -> ModelProto:
    """Read a graph, and the weights that its exporter put into a file beside it.

    Raises:
        ContractError: it is no ONNX, its weights are somewhere else, or it holds what a policy may not.
    """
    model, left = decode(read_bytes(path, EXPECTED), str(path)), BYTES_MAX
    for graph in graphs(model):
        for tensor in tensors(graph):
            left -= _bring(tensor, path, left)
    _forget_unused(model)
    check_model(model, str(path))
    return model


def _forget_unused(model: ModelProto) -> None:
    """Sets of operators that are named and not used, as tf2onnx names ai.onnx.ml in every file."""
    used = {node.domain for graph in graphs(model) for node in graph.node}
    kept = [opset for opset in model.opset_import if opset.domain in used | {"", "ai.onnx"}]
    del model.opset_import[:]
    model.opset_import.extend(kept)


def _bring(tensor: TensorProto, path: Path, left: int) -> int:
    """External data into the tensor itself, at most so many bytes: many may claim the same; returns how many."""
    if tensor.data_location != TensorProto.EXTERNAL:
        return 0
    source, told = f"{path}: tensor {tensor.name!r:.100}", {e.key: e.value for e in tensor.external_data}
    where = str(told.get("location", ""))
    beside = path.parent / where
    if where != Path(where).name or beside.is_symlink() or not beside.is_file():
        raise ContractError(
            f"{source}: found its weights in {where!r:.100}, expected a file beside {path.name}"
        )
    try:
        start, size = int(told.get("offset", 0)), int(told.get("length", beside.stat().st_size))
        with beside.open("rb") as stream:
            stream.seek(start)
            data = stream.read(size) if 0 <= size <= left else b""
    except (ValueError, OSError, OverflowError) as e:
        raise ContractError(f"{source}: found {shortened(e)}, expected offset and length in {where!r}") from e
    if len(data) != size:
        raise ContractError(
            f"{source}: found {len(data)} bytes in {where!r}, expected {size}, {left} at most"
        )
    tensor.raw_data = data
    tensor.data_location = TensorProto.DEFAULT
    del tensor.external_data[:]
    return size


def read_onnx(model: ModelProto, source: str) -> Original:
    """Find the ends of a graph that was read and checked; `source` names the file in messages.

    What the action does not depend on is left out: critics, references, a state that is only handed through.

    Raises:
        ContractError: it has no such ends, or one that nobody could supply.
    """
    outputs = {value.name: value for value in model.graph.output}
    observation = _one(_inputs(model), OBSERVATIONS, f"{source}: input")
    action = _one(outputs, ACTIONS, f"{source}: output")
    remembered = [name for name in _inputs(_only(model, [action])) if name in MEMORIES]
    model = _only(model, [action, *(MEMORIES[name] for name in remembered if MEMORIES[name] in outputs)])
    inputs, outputs = _inputs(model), {value.name: value for value in model.graph.output}
    if observation not in inputs:
        found = f"output {action!r}: found none of {observation!r} in it"
        raise ContractError(f"{source}: {found}, expected an action that depends on it")
    for name in inputs:
        if name != observation and MEMORIES.get(name) not in outputs:
            raise ContractError(
                f"{source}: input {name!r}: nobody could supply it, expected {observation!r} and what is"
                f" remembered: {', '.join(f'{before} with {after}' for before, after in MEMORIES.items())}"
            )
    memory = tuple(
        Memory(before=name, after=MEMORIES[name], shape=_shape(inputs[name], source)) for name in remembered
    )
    original = Original(
        facts=Facts(
            kind="ONNX" + (" that remembers" if memory else ""),
            observations=_size(inputs[observation], source),
            actions=_size(outputs[action], source),
            known=known_from({entry.key: entry.value for entry in model.metadata_props}, source),
        ),
        model=model,
        observation=observation,
        action=action,
        memory=memory,
        batched=False,
        play=_Player(model, observation, action, memory, source).play,
    )
    return widened(original, source)


def widened(original: Original, source: str) -> Original:
    """For any batch, where its graph turns out to take one: what is asked of three robots at once is what each says."""
    wide = _any_batch(original)
    if original.memory or not _takes_many(wide, original, source):
        return original
    return replace(original, model=wide, batched=True)


def _inputs(model: ModelProto) -> dict[str, ValueInfoProto]:
    weights = {tensor.name for tensor in model.graph.initializer}
    return {value.name: value for value in model.graph.input if value.name not in weights}


def _one(found: Mapping[str, ValueInfoProto], known: Iterable[str], source: str) -> str:
    names = [name for name in known if name in found] or (list(found) if len(found) == 1 else [])
    if len(names) != 1:
        raise ContractError(f"{source}: found {list(found)!r:.200}, expected just one of {', '.join(known)}")
    return names[0]


def _only(model: ModelProto, outputs: list[str]) -> ModelProto:
    """The part of a model that some of its outputs depend on."""
    wanted: set[str] = set(outputs)
    nodes: list[NodeProto] = []
    for node in reversed(model.graph.node):  # a valid graph is sorted
        if wanted.intersection(node.output):
            nodes.insert(0, node)
            wanted.update(node.input)
            wanted.update(
                name for attribute in node.attribute for inner in attribute.g.node for name in inner.input
            )
    part = ModelProto()
    part.CopyFrom(model)
    graph = part.graph
    for field, kept in (
        (graph.node, nodes),
        (graph.initializer, [tensor for tensor in model.graph.initializer if tensor.name in wanted]),
        (graph.input, [value for value in model.graph.input if value.name in wanted]),
        (graph.output, [value for value in model.graph.output if value.name in outputs]),
        (graph.value_info, []),
    ):
        del field[:]
        field.extend(kept)
    return part


def _shape(value: ValueInfoProto, source: str) -> tuple[int, ...]:
    """For one robot: whatever has a name instead of a size is the batch."""
    tensor = value.type.tensor_type
    shape = tuple(d.dim_value if d.HasField("dim_value") else 1 for d in tensor.shape.dim)
    if (
        tensor.elem_type != TensorProto.FLOAT
        or not all(0 < d <= SIZE_MAX for d in shape)
        or np.prod(shape) > SIZE_MAX
    ):
        kind = TensorProto.DataType.Name(tensor.elem_type)
        raise ContractError(
            f"{source}: {value.name!r}: found {kind} {shape}, expected FLOAT and 1 to {SIZE_MAX} numbers a robot"
        )
    return shape


def _size(value: ValueInfoProto, source: str) -> int:
    shape = _shape(value, source)
    if len(shape) != 2 or shape[0] != 1:
        raise ContractError(f"{source}: {value.name!r}: found shape {shape}, expected (batch, size)")
    return shape[1]


class _Player:
    """ONNX Runtime with a foreign model as it is, for one robot."""

    def __init__(
        self, model: ModelProto, observation: str, action: str, memory: tuple[Memory, ...], source: str
    ) -> None:
        self._session = session(model.SerializeToString(), source)
        self._observation, self._memory, self._source = observation, memory, source
        self._outputs = [action, *(piece.after for piece in memory)]

    def play(self, observations: Float32s, forget: NDArray[np.bool_]) -> Float32s:
        """As `original.Play` says."""
        actions = []
        nothing = {piece.before: np.zeros(piece.shape, np.float32) for piece in self._memory}
        known = nothing
        for row, anew in zip(observations, forget, strict=True):
            inputs = {self._observation: row[None], **(nothing if anew else known)}
            try:
                action, *after = self._session.run(self._outputs, inputs)
            except Exception as e:  # ONNX Runtime's errors share no base
                raise ContractError(f"{self._source}: cannot be run: {shortened(e)}") from e
            known = dict(zip(nothing, after, strict=True))
            actions.append(action[0])
        return np.array(actions, dtype=np.float32)


def _any_batch(original: Original) -> ModelProto:
    wide = ModelProto()
    wide.CopyFrom(original.model)
    for value in (*wide.graph.input, *wide.graph.output):
        if value.name in (original.observation, original.action):
            value.type.tensor_type.shape.dim[0].dim_param = "batch"
    return wide


def _takes_many(wide: ModelProto, original: Original, source: str) -> bool:
    observations = np.random.default_rng(0).normal(size=(3, original.facts.observations)).astype(np.float32)
    alone = original.play(observations, np.ones(3, dtype=bool))
    try:
        together = session(wide.SerializeToString(), source).run(
            [original.action], {original.observation: observations}
        )[0]
    except Exception:  # noqa: BLE001 - a size of one that is built in; ONNX Runtime's errors share no base
        return False
    return together.shape == alone.shape and bool(np.abs(together - alone).max() <= AGREEMENT)
