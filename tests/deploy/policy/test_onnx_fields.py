"""Fields of encoded models: counted as a decoder sees them, and bounded before it decodes them."""

import numpy as np
import onnx
import pytest
from onnx import ModelProto, helper, numpy_helper

from deploy.policy import onnx_graph
from deploy.policy.onnx_fields import count_fields
from deploy.policy.onnx_graph import FIELDS_MAX, decode
from robots.errors import ContractError

ANY, MANY = 1 << 40, 1000


def encoded(number, content):
    """A field with a length."""
    length, size = b"", len(content)
    while size > 127:
        length += bytes([size & 127 | 128])
        size >>= 7
    return bytes([number << 3 | 2]) + length + bytes([size]) + content


def decoded_fields(message):
    """The same count from a decoded message: lists of integers that ONNX declares as packed count by their bytes."""
    count = 0
    for field, value in message.ListFields():
        values = value if field.is_repeated else [value]
        if field.message_type:
            count += sum(1 + decoded_fields(each) for each in values)
        elif field.is_packed:
            integers = field.type not in (field.TYPE_FLOAT, field.TYPE_DOUBLE)
            count += 1 + integers * sum(max(1, -(-int(each).bit_length() // 7)) for each in values)
        else:
            count += len(values)
    return count


def test_count_is_that_of_the_decoded_model(arm_policy):
    data = arm_policy.read_bytes()
    assert count_fields(data, ANY) == decoded_fields(onnx.load_model_from_string(data)) > 50


def test_numbers_of_every_kind_are_counted():
    tensor = helper.make_tensor("w", onnx.TensorProto.INT64, [3], [1, 200, 1 << 40])
    tensor.double_data.extend([1.0, 2.0])
    node = helper.make_node("X", ["a", ""], ["b"], text="t", real=2.5, reals=[1.0, 2.0], whole=-1, t=tensor)
    model = helper.make_model(helper.make_graph([node], "g", [], [], [numpy_helper.from_array(np.ones(4))]))
    assert count_fields(model.SerializeToString(), ANY) == decoded_fields(model)


def test_count_ends_at_its_bound():
    assert count_fields(b"\x3a\x00" * 1000, 10) == 11


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"nothing good", "wire type 6 at byte 0"),
        (b"\x00\x00", "a field of number 0"),
        (b"\x3a\x05\x0a", "field 7 ends at byte 7, beyond its message"),
        (b"\x3a\x02\x0a\x03", "field 1 ends at byte 7, beyond its message"),
        (b"\x0d\x00", "field 1 ends at byte 5, beyond its message"),
        (b"\x08", "no end of the number at byte 1"),
        (b"\x08" + b"\xff" * 11, "no end of the number at byte 1"),
    ],
)
def test_other_data_are_no_model(data, why):
    with pytest.raises(
        ContractError, match=rf"^x: not an ONNX file: its {len(data)} bytes cannot be decoded: {why}$"
    ):
        decode(data, "x")


def nested(depth):
    """Graphs in attributes of nodes."""
    graph = b""
    for _ in range(depth):
        graph = encoded(1, encoded(5, encoded(6, graph)))
    return encoded(7, graph)


def test_what_only_the_decoder_refuses_is_named():
    with pytest.raises(
        ContractError, match=r"^x: not an ONNX file: its \d+ bytes cannot be decoded: Error parsing"
    ):
        decode(nested(200), "x")


@pytest.mark.parametrize(
    "many",
    [
        encoded(7, encoded(1, b"") * MANY),  # nodes
        encoded(7, encoded(1, encoded(5, b"") * MANY)),  # attributes
        encoded(7, encoded(5, encoded(6, b"") * MANY)),  # strings of a tensor
        encoded(7, encoded(5, encoded(7, b"\x01" * MANY))),  # integers of a tensor
        encoded(14, b"") * (MANY + 1),  # metadata
        b"\xf8\x07\x00" * (MANY + 1),  # numbers that ONNX does not know
    ],
    ids=["nodes", "attributes", "strings", "integers", "metadata", "unknown"],
)
def test_many_small_parts_are_refused_before_they_are_decoded(many, monkeypatch):
    monkeypatch.setattr(onnx, "load_model_from_string", lambda _: pytest.fail("was decoded"))
    monkeypatch.setattr(onnx_graph, "FIELDS_MAX", MANY)
    with pytest.raises(ContractError, match=r"^x: found more than 1000 fields and bytes of lists of int"):
        decode(many, "x")


def test_weights_of_single_precision_have_no_such_bound():
    many = 2 * FIELDS_MAX
    tensor = helper.make_tensor("w", onnx.TensorProto.FLOAT, [many], [0.5] * many)
    data = ModelProto(graph=onnx.GraphProto(initializer=[tensor])).SerializeToString()
    assert len(decode(data, "x").graph.initializer[0].float_data) == many
