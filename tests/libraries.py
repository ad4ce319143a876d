"""Shared libraries of Linux, Windows and macOS, read without the tools of these systems: what they are for, export and need."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass


@dataclass(frozen=True)
class Library:
    """`machine` as FMI 3.0 names it ("x86_64-linux"); `needs`: the libraries that it loads."""

    machine: str
    exports: frozenset[str]
    needs: frozenset[str]
    signed: bool = False


def read_library(content: bytes) -> Library:
    if content[:4] == b"\x7fELF":
        return _elf(content)
    if content[:2] == b"MZ":
        return _pe(content)
    if content[:4] == struct.pack("<I", 0xFEEDFACF):
        return _mach_o(content)
    raise AssertionError(f"no library: it begins with {content[:4].hex()}")


def slices(content: bytes) -> list[bytes]:
    """The libraries in one for several processors of a Mac."""
    magic, count = struct.unpack(">II", content[:8])
    assert magic == 0xCAFEBABE
    found = []
    for i in range(count):
        kind, _, offset, size, alignment = struct.unpack_from(">5I", content, 8 + 20 * i)
        assert offset % (1 << alignment) == 0
        library = content[offset : offset + size]
        assert struct.unpack_from("<I", library, 4)[0] == kind, "the table names the processor that the library is for"
        found.append(library)
    return found


def highest_glibc(content: bytes) -> tuple[int, ...]:
    """The newest version of GNU's C library that it asks for."""
    return max(tuple(int(n) for n in version.split(b".")) for version in re.findall(rb"GLIBC_([0-9.]+)", content))


def _text(content: bytes, offset: int) -> str:
    return content[offset : content.index(b"\0", offset)].decode()


def _elf(content: bytes) -> Library:
    machine = {62: "x86_64", 183: "aarch64"}[struct.unpack_from("<H", content, 18)[0]]
    (start,) = struct.unpack_from("<Q", content, 40)
    size, count = struct.unpack_from("<HH", content, 58)
    sections = [struct.unpack_from("<IIQQQQIIQQ", content, start + i * size) for i in range(count)]
    exports, needs = set(), set()
    for _, kind, _, _, offset, length, link, _, _, width in sections:
        if kind == 11:  # dynamic symbols
            for at in range(offset, offset + length, width):
                name, info, _, section = struct.unpack_from("<IBBH", content, at)
                if section and info >> 4 == 1:  # defined here, and global
                    exports.add(_text(content, sections[link][4] + name))
        if kind == 6:  # what the loader is told
            for at in range(offset, offset + length, width):
                tag, value = struct.unpack_from("<qQ", content, at)
                if tag == 1:
                    needs.add(_text(content, sections[link][4] + value))
    return Library(f"{machine}-linux", frozenset(exports), frozenset(needs))


def _pe(content: bytes) -> Library:
    (head,) = struct.unpack_from("<I", content, 0x3C)
    assert content[head : head + 4] == b"PE\0\0"
    kind, count = struct.unpack_from("<HH", content, head + 4)
    (optional,) = struct.unpack_from("<H", content, head + 20)
    sections = [struct.unpack_from("<IIII", content, head + 24 + optional + 40 * i + 8) for i in range(count)]

    def place(address: int) -> int:
        return next(address - at + offset for size, at, raw, offset in sections if at <= address < at + max(size, raw))

    directory = struct.unpack_from("<4I", content, head + 24 + 112)
    table = place(directory[0])
    names = struct.unpack_from("<I", content, table + 24)[0]
    where = place(struct.unpack_from("<I", content, table + 32)[0])
    exports = {_text(content, place(struct.unpack_from("<I", content, where + 4 * i)[0])) for i in range(names)}
    needs, at = set(), place(directory[2])
    while name := struct.unpack_from("<I", content, at + 12)[0]:
        needs.add(_text(content, place(name)))
        at += 20
    return Library({0x8664: "x86_64"}[kind] + "-windows", frozenset(exports), frozenset(needs))


def _mach_o(content: bytes) -> Library:
    kind, _, form, count = struct.unpack_from("<IIII", content, 4)
    assert form == 6, "a dynamic library"
    exports, needs, signed, at = set(), set(), False, 32
    for _ in range(count):
        command, size = struct.unpack_from("<II", content, at)
        if command == 2:  # symbols
            symbols, n, texts, _ = struct.unpack_from("<4I", content, at + 8)
            for i in range(n):
                name, flags, section = struct.unpack_from("<IBB", content, symbols + 16 * i)
                if flags & 0x0F == 0x0F and section:  # defined here, and external
                    exports.add(_text(content, texts + name).removeprefix("_"))
        if command == 0xC:
            needs.add(_text(content, at + struct.unpack_from("<I", content, at + 8)[0]))
        signed |= command == 0x1D
        at += size
    return Library({0x01000007: "x86_64", 0x0100000C: "aarch64"}[kind] + "-darwin", frozenset(exports), frozenset(needs), signed)
