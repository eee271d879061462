"""Number of the fields of an encoded ONNX model, counted before it is decoded.

An empty message of two bytes takes up to 200 when it is decoded: a file of 100 MB of them took 10 GB. The encoding is
that of Protocol Buffers: https://protobuf.dev/programming-guides/encoding/
"""

from collections.abc import Iterator

from google.protobuf.descriptor import FieldDescriptor  # type: ignore[import-untyped]
from onnx import ModelProto

VARINT, LENGTH = 0, 2
"""Wire types of a number of any length, and of text, messages and lists, which begin with their length."""
WIDTHS = {1: 8, 5: 4}
"""Bytes of a number, by its wire type."""
VARINT_BYTES_MAX = 10
VARINTS = (
    FieldDescriptor.TYPE_BOOL,
    FieldDescriptor.TYPE_ENUM,
    FieldDescriptor.TYPE_INT32,
    FieldDescriptor.TYPE_INT64,
    FieldDescriptor.TYPE_UINT64,
)
"""Types whose lists may hold a number in each byte; decoded, each takes four or eight."""


def count_fields(data: bytes, most: int) -> int:
    """Return a sum: the fields in all messages of an encoded model, and the bytes of its lists of integers.

    Args:
        data: encoded `ModelProto`.
        most: the count ends as soon as the sum is beyond it.

    Raises:
        ValueError: the data are no protocol buffer.
    """
    found, messages = 0, [(ModelProto.DESCRIPTOR, 0, len(data))]
    while messages:
        message, begin, end = messages.pop()
        for number, first, last in _fields(data, begin, end):
            field = message.fields_by_number.get(number)
            found += 1
            if field is not None and first < last and field.type in VARINTS:
                found += last - first
            elif field is not None and field.message_type is not None:
                messages.append((field.message_type, first, last))
            if found > most:
                return found
    return found


def _fields(data: bytes, place: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Yield number, first byte and end of the content of each field in data[place:end]; (number, 0, 0) without length.

    Raises:
        ValueError: they are no fields.
    """
    while place < end:
        begin = place
        tag, place = _varint(data, place, end)
        number, wire = tag >> 3, tag & 7
        first = 0
        if wire == VARINT:
            _, place = _varint(data, place, end)
        elif wire == LENGTH:
            length, first = _varint(data, place, end)
            place = first + length
        elif wire in WIDTHS:
            place += WIDTHS[wire]
        else:
            raise ValueError(f"wire type {wire} at byte {begin}")
        if not number:
            raise ValueError("a field of number 0")
        if place > end:
            raise ValueError(f"field {number} ends at byte {place}, beyond its message")
        yield number, first, place if first else 0


def _varint(data: bytes, place: int, end: int) -> tuple[int, int]:
    """Return the number of any length at a place, and the place after it.

    Raises:
        ValueError: it has no end.
    """
    value = 0
    for shift, byte in enumerate(data[place : min(place + VARINT_BYTES_MAX, end)]):
        value |= (byte & 0x7F) << (7 * shift)
        if byte < 0x80:
            return value, place + shift + 1
    raise ValueError(f"no end of the number at byte {place}")
