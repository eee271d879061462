"""Inference of shapes and of the values that shapes are computed from, node by node and within bounds.

ONNX infers the shapes of a whole graph in one call, which a file of 1 kB can let run for hours: values that double
with every node are listed one by one. Here every result is looked at before the next node is.
"""

import math
from collections.abc import Mapping, MutableMapping
from dataclasses import dataclass
from typing import Self

import numpy as np
import onnx
from onnx import GraphProto, NodeProto, TensorProto, TypeProto, helper, numpy_helper

from robots.errors import ContractError, printable

RANK_MAX = 64
"""Dimensions of a tensor."""
VALUES_MAX = 1 << 10
"""Elements of a tensor whose values are known beforehand, such as those of a shape."""
NUMBERS = frozenset(helper.get_all_tensor_dtypes()) - {TensorProto.STRING}
"""Types of elements that have a fixed size."""
_COMPUTED = (
    "Abs Add And Cast Concat Constant ConstantOfShape Div Equal Expand Flatten Gather Greater Identity Less Max Min Mod"
    " Mul Neg Not Or Range ReduceMax ReduceMin ReduceProd ReduceSum Reshape Slice Split Squeeze Sub Tile Transpose"
    " Unsqueeze Where"
)
COMPUTED = frozenset(_COMPUTED.split())
"""Operators whose values are computed beforehand if all of their inputs are known: they look at each element once."""


@dataclass(frozen=True, slots=True)
class Tensor:
    """Type of a tensor, by default of one that is left out; and its values, if they are known and few.

    Attributes:
        kind: type of its elements, of `NUMBERS`.
        constant: its values are stored in the file, as a weight or in a Constant node.
    """

    kind: int = TensorProto.FLOAT
    dims: tuple[int, ...] = (0,)
    values: TensorProto | None = None
    constant: bool = False

    @classmethod
    def weight(cls, tensor: TensorProto) -> Self:
        """Return the tensor of a weight."""
        few = math.prod(tensor.dims) <= VALUES_MAX
        return cls(tensor.data_type, tuple(tensor.dims), tensor if few else None, constant=True)

    @property
    def elements(self) -> int:
        """Number of elements."""
        return math.prod(self.dims)

    @property
    def bytes(self) -> int:
        """Size of all elements."""
        return self.elements * int(helper.tensor_dtype_to_np_dtype(self.kind).itemsize)


Known = MutableMapping[str, Tensor]
"""Tensors by name."""


def add_weights(graph: GraphProto, known: Known, where: str) -> None:
    """Add the weights of a graph to `known`."""
    for tensor in graph.initializer:
        if tensor.data_type not in NUMBERS:
            raise ContractError(
                f"{where}: {tensor.name!r:.100}: found no numbers, expected a tensor of numbers"
            )
        known[tensor.name] = Tensor.weight(tensor)


def infer_outputs(node: NodeProto, known: Known, opset: int, where: str) -> list[Tensor]:
    """Return the outputs of a node that has no graph of its own.

    Raises:
        ContractError: the shape of an output does not follow from the shapes of the inputs and from weights.
    """
    for attribute in node.attribute:  # inference would make a list of as many outputs
        if attribute.name == "num_outputs" and attribute.i != len(node.output):
            raise ContractError(f"{where}: num_outputs: found {attribute.i}, expected {len(node.output)}")
    values = {name: known[name].values for name in node.input if name}
    given = {name: tensor for name, tensor in values.items() if tensor is not None}
    types = {name: helper.make_tensor_type_proto(known[name].kind, known[name].dims) for name in values}
    opsets = [helper.make_opsetid("", opset)]
    try:
        schema = onnx.defs.get_schema(node.op_type, opset, "")
        found = onnx.shape_inference.infer_node_outputs(schema, node, types, given, opset_imports=opsets)
    except Exception as e:  # shapes of unknown origin can fail in any way
        message = printable(" ".join(str(e).split()))
        raise ContractError(f"{where}: shapes cannot be inferred: {message:.300}") from e
    outputs = [_tensor(found[name], name, where) if name else Tensor() for name in node.output]
    few = all(tensor.elements <= VALUES_MAX for tensor in outputs)
    if node.op_type == "Shape" or (few and len(given) == len(values) and node.op_type in COMPUTED):
        computed = _compute(node, known, given, opset)
        constant = node.op_type == "Constant"
        outputs = [_with_values(*each, constant=constant) for each in zip(outputs, computed, strict=True)]
    return outputs


def _tensor(found: TypeProto, name: str, where: str) -> Tensor:
    """Return a tensor of a known shape."""
    kind = found.tensor_type
    if not found.HasField("tensor_type") or kind.elem_type not in NUMBERS:
        raise ContractError(f"{where}: {name!r:.100}: found no numbers, expected a tensor of numbers")
    dims = kind.shape.dim
    if not kind.HasField("shape") or not all(dim.HasField("dim_value") for dim in dims):
        expected = "expected one that follows from the shapes of the inputs"
        raise ContractError(f"{where}: found an output {name!r:.100} of unknown shape, {expected}")
    if len(dims) > RANK_MAX:
        raise ContractError(f"{where}: found {len(dims)} dimensions, expected at most {RANK_MAX}")
    return Tensor(kind.elem_type, tuple(dim.dim_value for dim in dims))


def _with_values(tensor: Tensor, values: np.ndarray | None, *, constant: bool) -> Tensor:
    """Return a tensor with computed values, if they have its shape."""
    if values is None or values.shape != tensor.dims:
        return tensor
    return Tensor(tensor.kind, tensor.dims, numpy_helper.from_array(values), constant)


def _compute(
    node: NodeProto, known: Known, given: Mapping[str, TensorProto], opset: int
) -> list[np.ndarray | None]:
    """Return the values of a node's outputs; None if the reference implementation cannot compute them."""
    if node.op_type == "Shape":
        part = {attribute.name: attribute.i for attribute in node.attribute}
        dims = known[node.input[0]].dims[part.get("start", 0) : part.get("end")]
        return [np.array(dims, dtype=np.int64)]
    from onnx.reference import ReferenceEvaluator  # takes a tenth of a second

    starts, ends = (list(map(helper.make_empty_tensor_value_info, names)) for names in (given, node.output))
    graph = helper.make_graph([node], "node", starts, ends)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)])
    try:
        with np.errstate(all="ignore"):
            feeds = {name: numpy_helper.to_array(tensor) for name, tensor in given.items()}
            return [np.asarray(each) for each in ReferenceEvaluator(model).run(None, feeds)]
    except Exception:  # noqa: BLE001 - ONNX Runtime will refuse it
        return [None] * len(node.output)
