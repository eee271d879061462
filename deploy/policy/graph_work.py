"""Work of one node of an ONNX graph, from the shapes of its inputs and outputs."""

import math
from collections.abc import Sequence

from onnx import NodeProto

from deploy.policy.shape_inference import Tensor

NODE_WORK = 1 << 10
"""Multiply-adds in the time that ONNX Runtime takes to start a node."""
_ONCE = (
    "Abs Acos Acosh Add And ArgMax ArgMin Asin Asinh Atan Atanh BatchNormalization BitShift BitwiseAnd BitwiseNot"
    " BitwiseOr BitwiseXor Cast CastLike Ceil Celu Clip Concat Constant ConstantOfShape Cos Cosh DepthToSpace"
    " DequantizeLinear Div Dropout DynamicQuantizeLinear Elu Equal Erf Exp Expand EyeLike Flatten Floor Gather"
    " GatherElements GatherND Gelu Greater GreaterOrEqual HardSigmoid HardSwish Hardmax Identity"
    " InstanceNormalization IsInf IsNaN LayerNormalization LeakyRelu Less LessOrEqual Log LogSoftmax Max Mean Min"
    " Mish Mul Neg Not OneHot Or PRelu Pad Pow QuantizeLinear RMSNormalization Range Reciprocal ReduceL1 ReduceL2"
    " ReduceLogSum ReduceLogSumExp ReduceMax ReduceMean ReduceMin ReduceProd ReduceSum ReduceSumSquare Relu Reshape"
    " Round Scan Selu Shape Shrink Sigmoid Sign Sin Sinh Size Slice Softmax Softplus Softsign SpaceToDepth Split Sqrt"
    " Squeeze Sub Sum Swish Tan Tanh ThresholdedRelu Tile Transpose Trilu Unsqueeze Where Xor"
)
MOD_WORK = 1 << 14
"""Multiply-adds that one remainder counts as: it takes a nanosecond, or 1.5 µs where exponents are far apart, which a
policy may make them when no trial looks. As many as a step may have then take about 6 ms."""
ONCE = frozenset(_ONCE.split())
"""Operators that look at each element a few times."""
RECURRENT = frozenset({"GRU", "LSTM", "RNN"})


def node_work(node: NodeProto, inputs: Sequence[Tensor], outputs: Sequence[Tensor]) -> int:
    """Return an upper bound of a node's multiply-adds; of a Scan without its body.

    It also bounds the elements of what the node needs for itself: of an unknown operator, every element of the largest
    output may depend on every one of the largest input.
    """
    most_in, most_out = (max((each.elements for each in group), default=0) for group in (inputs, outputs))
    if node.op_type in ONCE:
        work = sum(each.elements for each in (*inputs, *outputs))
    elif node.op_type == "Mod":
        work = most_out * MOD_WORK
    elif node.op_type == "ConvTranspose":  # each input meets the whole kernel, whatever is cut off the output
        work = most_out + inputs[0].elements * (inputs[1].elements // max(1, inputs[1].dims[0]))
    elif node.op_type in ("MatMul", "Gemm", "Conv"):
        work = most_out * _summands(node.op_type, inputs, outputs[0])
    elif node.op_type in RECURRENT:
        steps = math.prod(inputs[0].dims[:2])
        work = steps * (inputs[1].elements + inputs[2].elements)
    else:
        work = most_out * most_in
    return NODE_WORK + work


def _summands(kind: str, inputs: Sequence[Tensor], output: Tensor) -> int:
    """Return the number of products in each element of the output."""
    first, second = inputs[0], inputs[1]
    if kind == "MatMul":
        return first.dims[-1] if first.dims else 1
    if kind == "Gemm":
        return first.elements // max(1, output.dims[0])
    return second.elements // max(1, second.dims[0])
