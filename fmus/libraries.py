"""Shared libraries of Linux, Windows and macOS, read without loading them: what they are for, export and need.

Formats: System V ABI (ELF), Microsoft's PE/COFF specification, Apple's mach-o/loader.h. Whatever the bytes are, nothing but
`LibraryError` is raised: they may be a stranger's.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

from fmus.errors import LibraryError

MOST_ENTRIES = 100_000  # of any table: real libraries export some thousand functions
LONGEST_NAME = 4096
_ELF_MACHINES = {3: "x86", 40: "aarch32", 62: "x86_64", 183: "aarch64", 243: "riscv64", 21: "ppc64", 8: "mips"}
_ELF_FORMS = {1: "an object file", 2: "a program"}
_PE_MACHINES = {0x14C: "x86", 0x8664: "x86_64", 0xAA64: "aarch64", 0x1C4: "aarch32"}
_MACH_MACHINES = {7: "x86", 12: "aarch32", 0x01000007: "x86_64", 0x0100000C: "aarch64"}
_MACH, _MACH_32, _FAT = 0xFEEDFACF, 0xFEEDFACE, 0xCAFEBABE


@dataclass(frozen=True, slots=True)
class Library:
    """`machine` as FMI 3.0 names it ("x86_64-linux"); `exports`: None if its tables do not tell; `needs`: the libraries that it loads."""

    machine: str
    exports: frozenset[str] | None
    needs: frozenset[str]
    signed: bool = False


def read_libraries(content: bytes) -> tuple[Library, ...]:
    """The library in a file, or those for several processors of a Mac; raises `LibraryError` if it holds none that is whole."""
    return tuple(map(read_library, slices(content))) if content[:4] == struct.pack(">I", _FAT) else (read_library(content),)


def read_library(content: bytes) -> Library:
    """The one library in a file; raises `LibraryError` if it is none, or cut off."""
    for begin, read in ((b"\x7fELF", _elf), (b"MZ", _pe), (struct.pack("<I", _MACH), _mach_o), (struct.pack("<I", _MACH_32), _mach_o)):
        if content.startswith(begin):
            try:
                return read(content)
            except (struct.error, IndexError, ValueError, OverflowError, StopIteration):
                raise LibraryError(f"a shared library that is damaged or cut off: {len(content)} bytes") from None
    raise LibraryError(_words(content))


def slices(content: bytes) -> list[bytes]:
    """The libraries in one for several processors of a Mac; raises `LibraryError` if it is none, or contradicts itself."""
    found = []
    try:
        magic, count = struct.unpack_from(">II", content)
        if magic != _FAT or not 1 <= count <= 20:  # Java's classes begin with the same bytes
            raise LibraryError(_words(content))
        for i in range(count):
            kind, _, offset, size, alignment = struct.unpack_from(">5I", content, 8 + 20 * i)
            library = content[offset : offset + size]
            if offset % (1 << alignment) or len(library) != size or struct.unpack_from("<I", library, 4)[0] != kind:
                raise LibraryError(f"a universal library whose table of processors is wrong at entry {i + 1}")
            found.append(library)
    except (struct.error, OverflowError):
        raise LibraryError(f"a universal library that is damaged or cut off: {len(content)} bytes") from None
    return found


def _words(content: bytes) -> str:
    if not content:
        return "an empty file"
    head = content[:40]
    if all(byte in b"\t\n\r" or 32 <= byte < 127 for byte in head):
        line = head.decode("ascii").splitlines()[0]
        return f"text, not a shared library: it begins with {line!r}"
    return f"no shared library of Linux, Windows or macOS: it begins with the bytes {head[:8].hex(' ')}"


def _text(content: bytes, offset: int) -> str:
    return content[offset : content.index(b"\0", offset, offset + LONGEST_NAME)].decode()


def _few(count: int) -> int:
    if count > MOST_ENTRIES:
        raise ValueError(count)
    return count


def _rows(offset: int, length: int, width: int, least: int) -> Iterator[int]:
    """Where the entries of a table lie."""
    if width < least:
        raise ValueError(width)
    return iter(range(offset, offset + width * _few(length // width), width))


def _elf(content: bytes) -> Library:
    wide, order = content[4] == 2, "<" if content[5] == 1 else ">"
    form, machine = struct.unpack_from(f"{order}HH", content, 16)
    if form != 3:
        raise LibraryError(f"no shared library but {_ELF_FORMS.get(form, 'an ELF file of another type')}")
    start = struct.unpack_from(f"{order}Q" if wide else f"{order}I", content, 40 if wide else 32)[0]
    size, count = struct.unpack_from(f"{order}HH", content, 58 if wide else 46)
    layout, symbol, dynamic = ("IIQQQQIIQQ", "IBBH", "qQ") if wide else ("10I", "I8xBBH", "iI")
    sections = [struct.unpack_from(order + layout, content, start + i * size) for i in range(count)]
    exports, needs, told = set[str](), set[str](), False
    for _, kind, _, _, offset, length, link, _, _, width in sections:
        if kind == 11:  # dynamic symbols
            told = True
            for at in _rows(offset, length, width, 24 if wide else 16):
                name, info, _, section = struct.unpack_from(order + symbol, content, at)
                if section and info >> 4 in (1, 2):  # defined here, and global or weak
                    exports.add(_text(content, sections[link][4] + name))
        if kind == 6:  # what the loader is told
            for at in _rows(offset, length, width, 16 if wide else 8):
                tag, value = struct.unpack_from(order + dynamic, content, at)
                if tag == 1:
                    needs.add(_text(content, sections[link][4] + value))
    name = f"{_ELF_MACHINES.get(machine, f'machine {machine}')}-linux"
    return Library(name, frozenset(exports) if told else None, frozenset(needs))


def _pe(content: bytes) -> Library:
    (head,) = struct.unpack_from("<I", content, 0x3C)
    if content[head : head + 4] != b"PE\0\0":
        raise LibraryError("a program of DOS, not a library of Windows")
    kind, count = struct.unpack_from("<HH", content, head + 4)
    optional, flags = struct.unpack_from("<HH", content, head + 20)
    if not flags & 0x2000:
        raise LibraryError("a program of Windows, not a library")
    sections = [struct.unpack_from("<IIII", content, head + 24 + optional + 40 * i + 8) for i in range(count)]
    if any(offset + raw > len(content) for _, _, raw, offset in sections):
        raise ValueError("cut off")
    wide = struct.unpack_from("<H", content, head + 24)[0] == 0x20B

    def place(address: int) -> int:
        return next(address - at + offset for size, at, raw, offset in sections if at <= address < at + max(size, raw))

    directory = struct.unpack_from("<4I", content, head + 24 + (112 if wide else 96))
    exports, needs = set[str](), set[str]()
    if directory[0]:
        table = place(directory[0])
        names = _few(struct.unpack_from("<I", content, table + 24)[0])
        where = place(struct.unpack_from("<I", content, table + 32)[0]) if names else 0
        exports = {_text(content, place(struct.unpack_from("<I", content, where + 4 * i)[0])) for i in range(names)}
    at = place(directory[2]) if directory[2] else None
    while at is not None and (name := struct.unpack_from("<I", content, at + 12)[0]):
        needs.add(_text(content, place(name)))
        at += 20
    machine = _PE_MACHINES.get(kind, f"machine {kind:#x}")
    return Library(f"{machine}-windows", frozenset(exports), frozenset(needs))


def _mach_o(content: bytes) -> Library:
    wide = struct.unpack_from("<I", content)[0] == _MACH
    kind, _, form, count = struct.unpack_from("<IIII", content, 4)
    if form not in (6, 8):
        raise LibraryError("a file of macOS that is neither a dynamic library nor a bundle")
    exports, needs, told, signed, at = set[str](), set[str](), False, False, 32 if wide else 28
    for _ in range(_few(count)):
        command, size = struct.unpack_from("<II", content, at)
        if size < 8:
            raise ValueError(size)
        if command == 2:  # symbols
            told = True
            symbols, n, texts, _ = struct.unpack_from("<4I", content, at + 8)
            for i in range(_few(n)):
                name, flags, section = struct.unpack_from("<IBB", content, symbols + (16 if wide else 12) * i)
                if flags & 0x0F == 0x0F and section:  # defined here, and external
                    exports.add(_text(content, texts + name).removeprefix("_"))
        if command == 0xC:
            needs.add(_text(content, at + struct.unpack_from("<I", content, at + 8)[0]))
        signed |= command == 0x1D
        at += size
    machine = _MACH_MACHINES.get(kind, f"machine {kind:#x}")
    return Library(f"{machine}-darwin", frozenset(exports) if told else None, frozenset(needs), signed)
