"""Fields as Google's own library wrote them, and bytes that are no message."""

import pytest
from google.protobuf import struct_pb2, type_pb2

from autolights.core.protobuf_wire import BYTES, FIXED64, VARINT, Field, fields, integers


def test_reads_what_the_reference_library_writes() -> None:
    message = type_pb2.Field(kind=9, number=300, name="größe", oneof_index=-1)
    found = {field.number: field for field in fields(memoryview(message.SerializeToString()))}

    assert [found[1].value, found[3].value, found[7].value] == [9, 300, -1]
    assert (found[4].wire_type, str(found[4].content, "utf-8")) == (BYTES, "größe")


def test_fixed_size_fields_are_passed_over() -> None:
    data = struct_pb2.Value(number_value=0.5).SerializeToString()

    (field,) = fields(memoryview(data))
    assert (field.number, field.wire_type, len(field.content)) == (2, FIXED64, 8)


@pytest.mark.parametrize(
    ("field", "wanted"),
    [
        pytest.param(Field(1, BYTES, 0, memoryview(b"\x01\xac\x02")), [1, 300], id="packed"),
        pytest.param(Field(1, BYTES, 0, memoryview(b"")), [], id="packed-empty"),
        pytest.param(Field(1, VARINT, -7, memoryview(b"")), [-7], id="one-by-one"),
    ],
)
def test_repeated_integers(field, wanted) -> None:
    assert list(integers(field)) == wanted


@pytest.mark.parametrize(
    ("data", "message"),
    [
        pytest.param(b"\x08", "cut off", id="no-value"),
        pytest.param(b"\x0a\x05abc", "longer than what is left", id="content-cut-off"),
        pytest.param(b"\x0a\xff\xff\xff\xff\xff\xff\xff\xff\x7f", "longer than what is left", id="absurd-length"),
        pytest.param(b"\x08" + b"\xff" * 11, "longer than 10 bytes", id="endless-number"),
        pytest.param(b"\x0b", "unknown wire type 3", id="group"),
        pytest.param(b"\x00\x01", "field number 0", id="field-zero"),
    ],
)
def test_what_is_no_message(data, message) -> None:
    with pytest.raises(ValueError, match=message):
        list(fields(memoryview(data)))
