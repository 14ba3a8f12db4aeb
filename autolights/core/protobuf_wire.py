"""The wire format of protocol buffers, read field by field without copying: to inspect a file before trusting it.

References:
    https://protobuf.dev/programming-guides/encoding/
"""

from collections.abc import Iterator
from typing import NamedTuple

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5
_FIXED_SIZES = {FIXED64: 8, FIXED32: 4}
_MAX_VARINT_BYTES = 10


class Field(NamedTuple):
    """One field of a message.

    Attributes:
        number: In the message's definition.
        wire_type: `VARINT`, `FIXED64`, `BYTES` or `FIXED32`.
        value: Of a varint, as a signed 64-bit integer; else 0.
        content: Of all others: the bytes in place.
    """

    number: int
    wire_type: int
    value: int
    content: memoryview


def fields(message: memoryview) -> Iterator[Field]:
    """The fields of a message in the order of the file.

    Raises:
        ValueError: If the bytes are no message: cut off, a field that is longer than the rest, an unknown wire type.
    """
    nothing = message[:0]
    position, end = 0, len(message)
    while position < end:
        key, position = _varint(message, position)
        number, wire_type = key >> 3, key & 7
        if number == 0:
            raise ValueError(f"field number 0 at byte {position}")
        if wire_type == VARINT:
            value, position = _varint(message, position)
            yield Field(number, wire_type, _signed(value), nothing)
            continue
        if wire_type == BYTES:
            size, position = _varint(message, position)
        elif wire_type in _FIXED_SIZES:
            size = _FIXED_SIZES[wire_type]
        else:
            raise ValueError(f"unknown wire type {wire_type} at byte {position}")
        if size > end - position:
            raise ValueError(f"field {number} at byte {position} is longer than what is left")
        yield Field(number, wire_type, 0, message[position : position + size])
        position += size


def integers(field: Field) -> Iterator[int]:
    """Values of a repeated integer field, packed or one at a time.

    Raises:
        ValueError: If the packed values are cut off.
    """
    if field.wire_type != BYTES:
        yield field.value
        return
    position = 0
    while position < len(field.content):
        value, position = _varint(field.content, position)
        yield _signed(value)


def _varint(message: memoryview, position: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 7 * _MAX_VARINT_BYTES, 7):
        if position >= len(message):
            raise ValueError("cut off in the middle of a number")
        byte = message[position]
        position += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value & 0xFFFF_FFFF_FFFF_FFFF, position
    raise ValueError(f"a number longer than {_MAX_VARINT_BYTES} bytes at byte {position}")


def _signed(value: int) -> int:
    return value - (1 << 64) if value >= 1 << 63 else value
