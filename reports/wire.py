"""Protobuf's wire format, as little of it as the logs need: a few field types out, and back in.

Descriptors are Protobuf messages too, so these functions suffice to describe a channel at run time without generated code.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable

from reports.errors import LogError

_VARINT, _FIXED64, _LENGTH, _FIXED32 = 0, 1, 2, 5


def varint(number: int) -> bytes:
    """`number` ≥ 0 in groups of seven bits, lowest first."""
    out = bytearray()
    while number > 0x7F:
        out.append(number & 0x7F | 0x80)
        number >>= 7
    out.append(number)
    return bytes(out)


def double_tag(number: int) -> bytes:
    """What stands before the eight bytes of a double in field `number`."""
    return varint(number << 3 | _FIXED64)


def double(number: int, value: float) -> bytes:
    """A double field; zeros are written too, so that messages of one kind have one size."""
    return double_tag(number) + struct.pack("<d", value)


def integer(number: int, value: int) -> bytes:
    """A non-negative integer or enumeration field; zero is the default and not written."""
    return varint(number << 3 | _VARINT) + varint(value) if value else b""


def block(number: int, value: bytes | str) -> bytes:
    """A string, bytes or message field; an empty one is written (a message that is present may be empty)."""
    data = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | _LENGTH) + varint(len(data)) + data


def parse(data: bytes) -> dict[int, float | int | bytes]:
    """The fields of a message, the last one of each number; raises `LogError` if `data` is none."""
    fields: dict[int, float | int | bytes] = {}
    position = 0
    try:
        while position < len(data):
            tag, position = _read_varint(data, position)
            kind = tag & 7
            if kind == _VARINT:
                fields[tag >> 3], position = _read_varint(data, position)
            elif kind == _FIXED64:
                (fields[tag >> 3],) = struct.unpack_from("<d", data, position)
                position += 8
            elif kind == _FIXED32:
                (fields[tag >> 3],) = struct.unpack_from("<I", data, position)
                position += 4
            elif kind == _LENGTH:
                length, position = _read_varint(data, position)
                if position + length > len(data):
                    raise IndexError
                fields[tag >> 3] = data[position : position + length]
                position += length
            else:
                raise LogError(f"not a Protobuf message: wire type {kind}")
    except (IndexError, struct.error):
        raise LogError(f"not a Protobuf message: it ends within a field ({len(data)} bytes)") from None
    return fields


def _read_varint(data: bytes, position: int) -> tuple[int, int]:
    number = shift = 0
    while True:
        byte = data[position]
        number |= (byte & 0x7F) << shift
        position += 1
        if byte < 0x80:
            return number, position
        shift += 7


# Field types of descriptor.proto.
DOUBLE, INT64, INT32, FIXED32, STRING, MESSAGE, ENUM = 1, 3, 5, 7, 9, 11, 14


def field(name: str, number: int, kind: int, type_name: str = "", repeated: bool = False) -> bytes:
    """A FieldDescriptorProto; `type_name` (with its leading dot) belongs to messages and enumerations."""
    data = block(1, name) + integer(3, number) + integer(4, 3 if repeated else 1) + integer(5, kind)
    return data + (block(6, type_name) if type_name else b"")


def message(name: str, fields: Iterable[bytes], nested: Iterable[bytes] = (), enums: Iterable[bytes] = ()) -> bytes:
    """A DescriptorProto."""
    parts = [block(1, name), *(block(2, f) for f in fields), *(block(3, n) for n in nested), *(block(4, e) for e in enums)]
    return b"".join(parts)


def enumeration(name: str, values: Iterable[str]) -> bytes:
    """An EnumDescriptorProto whose values count from zero."""
    return block(1, name) + b"".join(block(2, block(1, value) + integer(2, number)) for number, value in enumerate(values))


def file(name: str, package: str, messages: Iterable[bytes], dependencies: Iterable[str] = ()) -> bytes:
    """A FileDescriptorProto in proto3."""
    data = block(1, name) + block(2, package) + b"".join(block(3, d) for d in dependencies)
    return data + b"".join(block(4, m) for m in messages) + block(12, "proto3")


def file_set(*files: bytes) -> bytes:
    """A FileDescriptorSet: what a log's schema record holds."""
    return b"".join(block(1, f) for f in files)
