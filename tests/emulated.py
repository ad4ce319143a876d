"""Libraries of other platforms, run: a processor in software (Unicorn) executes their machine code; what they ask of the system's C library
is done here. Loads ELF, PE and Mach-O as their systems do: segments, relocations, imports. The system itself is not there: no start-up code
runs, and a function that is not known here is an error when it is called.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from typing import Any

unicorn: Any = import_module("unicorn")  # by name: it is there in `make foreign` only, and its types are not looked at
arm: Any = import_module("unicorn.arm64_const")
x86: Any = import_module("unicorn.x86_const")

BASE, HEAP, STUBS, STACK = 0x1000_0000, 0x4000_0000, 0x6000_0000, 0x7000_0000
PAGE, ROOM, MOST = 0x10000, 0x100_0000, 500  # of the heap and of the stack; functions imported
Argument = int | float | bytes


class Emulated:
    """One library. `call` takes whole numbers, addresses, floats and text, in the order of the C function's arguments."""

    def __init__(self, content: bytes) -> None:
        self.names: list[str] = []
        """The functions that it imports."""
        self.called: set[str] = set()
        self._free = HEAP
        if content[:2] == b"MZ":
            self.machine, self.system, load = "x86_64", "windows", self._pe
        elif content[:4] == b"\x7fELF":
            self.machine, self.system, load = {62: "x86_64", 183: "aarch64"}[struct.unpack_from("<H", content, 18)[0]], "linux", self._elf
        else:
            kind = struct.unpack_from("<I", content, 4)[0]
            self.machine, self.system, load = {0x1000007: "x86_64", 0x100000C: "aarch64"}[kind], "darwin", self._mach_o
        self.intel = self.machine == "x86_64"
        self.cpu = unicorn.Uc(*((unicorn.UC_ARCH_X86, unicorn.UC_MODE_64) if self.intel else (unicorn.UC_ARCH_ARM64, unicorn.UC_MODE_ARM)))
        for begin in (HEAP, STACK):
            self.cpu.mem_map(begin, ROOM)
        self.cpu.mem_map(STUBS, PAGE)
        self.cpu.mem_write(STUBS, (b"\xc3".ljust(16, b"\x90") if self.intel else bytes.fromhex("c0035fd6") * 4) * (PAGE // 16))
        if not self.intel:
            self.cpu.reg_write(arm.UC_ARM64_REG_CPACR_EL1, 3 << 20)  # floating point is allowed
        self.cpu.hook_add(unicorn.UC_HOOK_CODE, self._imported, begin=STUBS, end=STUBS + PAGE)
        self.exports: dict[str, int] = {}
        load(content)

    def call(self, name: str, *arguments: Argument) -> int:
        """What the function returns, as a whole number of 64 bits."""
        values = [self.store(a + b"\0") if isinstance(a, bytes) else a for a in arguments]
        stack = STACK + ROOM - 0x1000
        self._pass(values, stack)
        back = STUBS + 16 * MOST
        if self.intel:
            self.cpu.mem_write(stack - 8, struct.pack("<Q", back))
            self.cpu.reg_write(x86.UC_X86_REG_RSP, stack - 8)
        else:
            self.cpu.reg_write(arm.UC_ARM64_REG_SP, stack)
            self.cpu.reg_write(arm.UC_ARM64_REG_LR, back)
        self.cpu.emu_start(self.exports[name], back)
        return int(self.cpu.reg_read(x86.UC_X86_REG_RAX if self.intel else arm.UC_ARM64_REG_X0))

    def store(self, content: bytes) -> int:
        """The address of a copy in its memory."""
        place = self._free
        self._free += (len(content) + 31) // 16 * 16
        assert self._free < HEAP + ROOM
        self.cpu.mem_write(place, content)
        return place

    def import_address(self, name: str) -> int:
        """Where a function of the system is."""
        if name not in self.names:
            self.names.append(name)
            assert len(self.names) < MOST
        return STUBS + 16 * self.names.index(name)

    def _pass(self, values: Sequence[int | float], stack: int) -> None:
        whole, real, above = self._registers()
        if self.system == "windows":  # a register for each place, either kind; room for four on the stack before the others
            for i, value in enumerate(values):
                if i >= 4:
                    self.cpu.mem_write(stack + 8 * i, struct.pack("<d" if isinstance(value, float) else "<Q", value))
                elif isinstance(value, float):
                    self._real(real[i], value)
                else:
                    self.cpu.reg_write(whole[i], value)
            return
        n = {int: 0, float: 0}
        for value in values:
            kind = float if isinstance(value, float) else int
            bank = real if kind is float else whole
            if n[kind] < len(bank):
                self.cpu.reg_write(bank[n[kind]], int.from_bytes(struct.pack("<d", value), "little") if kind is float else value)
                n[kind] += 1
            else:
                self.cpu.mem_write(stack + above, struct.pack("<d" if kind is float else "<Q", value))
                above += 8

    def _registers(self) -> tuple[list[int], list[int], int]:
        """Those of whole numbers and of floats, and where on the stack the others begin."""
        if not self.intel:
            return [arm.UC_ARM64_REG_X0 + i for i in range(8)], [arm.UC_ARM64_REG_D0 + i for i in range(8)], 0
        names = ("RCX", "RDX", "R8", "R9") if self.system == "windows" else ("RDI", "RSI", "RDX", "RCX", "R8", "R9")
        return [getattr(x86, f"UC_X86_REG_{name}") for name in names], [x86.UC_X86_REG_XMM0 + i for i in range(8)], 0

    def _imported(self, cpu: Any, address: int, size: int, data: object) -> None:
        index = (address - STUBS) // 16
        if index >= len(self.names):  # the end of a call
            return
        name = self.names[index]
        whole, real, _ = self._registers()
        self.called.add(name)
        if name in REAL:
            function, count = REAL[name]
            self._real(real[0], function(*(self._given(real[i]) for i in range(count))))
        elif name == "sincos":  # GNU's
            angle = self._given(real[0])
            for register, value in zip(whole, (math.sin(angle), math.cos(angle)), strict=False):
                cpu.mem_write(cpu.reg_read(register), struct.pack("<d", value))
        elif name == "__sincos_stret":  # Apple's
            angle = self._given(real[0])
            self._real(real[0], math.sin(angle))
            self._real(real[1], math.cos(angle))
        else:
            a, b, c = (cpu.reg_read(register) for register in whole[:3])
            value = LIBRARY[name](self, a, b, c) & (2**64 - 1)
            cpu.reg_write(x86.UC_X86_REG_RAX if self.intel else arm.UC_ARM64_REG_X0, value)

    def _given(self, register: int) -> float:
        return float(struct.unpack("<d", (self.cpu.reg_read(register) & (2**64 - 1)).to_bytes(8, "little"))[0])

    def _real(self, register: int, value: float) -> None:
        self.cpu.reg_write(register, int.from_bytes(struct.pack("<d", value), "little"))

    def text(self, address: int) -> bytes:
        """A text that ends with 0."""
        found = b""
        while byte := bytes(self.cpu.mem_read(address + len(found), 1)).rstrip(b"\0"):
            found += byte
        return found

    def _map(self, parts: Sequence[tuple[int, bytes, int]]) -> None:
        """Address in the image, content, size."""
        end = max(at + max(size, len(content)) for at, content, size in parts)
        self.cpu.mem_map(BASE, (end + PAGE - 1) // PAGE * PAGE)
        for at, content, _ in parts:
            self.cpu.mem_write(BASE + at, content)

    def _set(self, at: int, value: int) -> None:
        self.cpu.mem_write(BASE + at, struct.pack("<Q", value))

    def _get(self, layout: str, at: int) -> tuple[Any, ...]:
        return struct.unpack(layout, bytes(self.cpu.mem_read(BASE + at, struct.calcsize(layout))))

    def _elf(self, content: bytes) -> None:
        (start,) = struct.unpack_from("<Q", content, 32)
        size, count = struct.unpack_from("<HH", content, 54)
        heads = [struct.unpack_from("<IIQQQQQQ", content, start + i * size) for i in range(count)]
        self._map([(at, content[offset : offset + stored], whole) for kind, _, offset, at, _, stored, whole, _ in heads if kind == 1])
        (dynamic,) = [(at, stored) for kind, _, _, at, _, stored, _, _ in heads if kind == 2]
        tags: dict[int, int] = {}
        for i in range(dynamic[1] // 16):
            tag, value = self._get("<QQ", dynamic[0] + 16 * i)
            tags[tag] = value
        symbols, texts = tags[6], tags[5]

        def symbol(i: int) -> tuple[str, int]:
            name, _, _, section, value, _ = self._get("<IBBHQQ", symbols + 24 * i)
            text = self.text(BASE + texts + name).decode()
            return text, BASE + value if section else self.import_address(text)

        table, (width, entries) = struct.unpack_from("<Q", content, 40)[0], struct.unpack_from("<HH", content, 58)
        sections = [struct.unpack_from("<IIQQQQ", content, table + width * i) for i in range(entries)]
        for i in range(sum(size // 24 for _, kind, _, _, _, size in sections if kind == 11)):  # dynamic symbols
            if self._get("<IBBH", symbols + 24 * i)[3]:
                name, address = symbol(i)
                self.exports[name] = address
        for table, length in ((tags.get(7, 0), tags.get(8, 0)), (tags.get(23, 0), tags.get(2, 0))):
            for place in range(table, table + length, 24):
                at, info, addend = self._get("<QQq", place)
                kind = info & 0xFFFF_FFFF
                if kind in (8, 1027):  # relative
                    self._set(at, BASE + addend)
                elif kind in (1, 6, 7, 257, 1025, 1026):  # a symbol's address
                    name, address = symbol(info >> 32)
                    weak = name in ("__cxa_finalize", "_ITM_registerTMCloneTable", "_ITM_deregisterTMCloneTable", "__gmon_start__")
                    self._set(at, 0 if weak else address + (addend if kind in (1, 257) else 0))
                else:
                    raise AssertionError(f"relocation {kind}")

    def _pe(self, content: bytes) -> None:
        (head,) = struct.unpack_from("<I", content, 0x3C)
        count, optional = struct.unpack_from("<H", content, head + 6)[0], struct.unpack_from("<H", content, head + 20)[0]
        preferred = struct.unpack_from("<Q", content, head + 24 + 24)[0]
        sections = [struct.unpack_from("<IIII", content, head + 24 + optional + 40 * i + 8) for i in range(count)]
        self._map([(at, content[offset : offset + stored], size) for size, at, stored, offset in sections])
        directory = [struct.unpack_from("<II", content, head + 24 + 112 + 8 * i) for i in range(16)]
        at, end = directory[5][0], sum(directory[5])
        while at < end:  # relocations, page by page
            page, size = self._get("<II", at)
            for (entry,) in (self._get("<H", place) for place in range(at + 8, at + size, 2)):
                if entry >> 12:
                    assert entry >> 12 == 10
                    place = page + (entry & 0xFFF)
                    self._set(place, self._get("<Q", place)[0] - preferred + BASE)
            at += size
        at = directory[1][0]
        while (row := self._get("<IIIII", at))[3]:
            names, table = row[0] or row[4], row[4]
            while entry := self._get("<Q", names)[0]:
                self._set(table, self.import_address(self.text(BASE + entry + 2).decode()))
                names, table = names + 8, table + 8
            at += 20
        number, functions, texts, ordinals = self._get("<IIII", directory[0][0] + 24)
        for i in range(number):
            name = self.text(BASE + self._get("<I", texts + 4 * i)[0]).decode()
            self.exports[name] = BASE + self._get("<I", functions + 4 * self._get("<H", ordinals + 2 * i)[0])[0]

    def _mach_o(self, content: bytes) -> None:
        at: int = 32
        segments: list[tuple[Any, ...]] = []
        info: tuple[Any, ...] = (0,) * 10
        symbols: tuple[Any, ...] = (0, 0, 0, 0)
        for _ in range(struct.unpack_from("<I", content, 16)[0]):
            command, size = struct.unpack_from("<II", content, at)
            if command == 0x19:
                segments.append(struct.unpack_from("<4Q", content, at + 24))
            if command == 0x80000022:
                info = struct.unpack_from("<10I", content, at + 8)
            if command == 2:
                symbols = struct.unpack_from("<4I", content, at + 8)
            at += size
        self._map([(place, content[offset : offset + stored], whole) for place, whole, offset, stored in segments])
        starts = [segment[0] for segment in segments]
        for place, _ in _opcodes(content[info[0] : info[0] + info[1]], starts, rebase=True):
            self._set(place, self._get("<Q", place)[0] + BASE)
        for begin, length in (info[2:4], info[6:8]):
            for place, name in _opcodes(content[begin : begin + length], starts, rebase=False):
                self._set(place, self.import_address(name.removeprefix("_")))
        table, number, texts, _ = symbols
        for i in range(number):
            name, kind, section, _, value = struct.unpack_from("<IBBHQ", content, table + 16 * i)
            if kind & 0x0F == 0x0F and section:
                text = content[texts + name : content.index(b"\0", texts + name)].decode()
                self.exports[text.removeprefix("_")] = BASE + value


def _opcodes(code: bytes, starts: Sequence[int], *, rebase: bool) -> Iterator[tuple[int, str]]:
    """The places that macOS's loader fills, and with what: dyld's byte code of addresses to shift, or of functions to find."""
    at, place, name = 0, 0, ""

    def number() -> int:
        nonlocal at
        value = shift = 0
        while True:
            byte = code[at]
            value, shift, at = value | (byte & 0x7F) << shift, shift + 7, at + 1
            if byte < 0x80:
                return value

    while at < len(code):
        opcode, low = code[at] & 0xF0, code[at] & 0x0F
        at += 1
        times, step = 0, 8
        if rebase:
            if opcode == 0x20:
                place = starts[low] + number()
            elif opcode == 0x30:
                place += number()
            elif opcode == 0x40:
                place += 8 * low
            elif opcode == 0x50:
                times = low
            elif opcode == 0x60:
                times = number()
            elif opcode == 0x70:
                times, step = 1, 8 + number()
            elif opcode == 0x80:
                times = number()
                step = 8 + number()
        elif opcode == 0x20:
            number()
        elif opcode == 0x40:
            end = code.index(b"\0", at)
            name, at = code[at:end].decode(), end + 1
        elif opcode == 0x60:
            number()
        elif opcode == 0x70:
            place = starts[low] + number()
        elif opcode == 0x80:
            place += number()
        elif opcode == 0x90:
            times = 1
        elif opcode == 0xA0:
            times, step = 1, 8 + number()
        elif opcode == 0xB0:
            times, step = 1, 8 + 8 * low
        elif opcode == 0xC0:
            times = number()
            step = 8 + number()
        for _ in range(times):
            yield place, name
            place = (place + step) & (2**64 - 1)


def _copied(own: Emulated, to: int, begin: int, count: int) -> int:
    own.cpu.mem_write(to, bytes(own.cpu.mem_read(begin, count)))
    return to


def _filled(own: Emulated, to: int, byte: int, count: int) -> int:
    own.cpu.mem_write(to, bytes([byte & 0xFF]) * count)
    return to


def _compared(own: Emulated, a: int, b: int, _: int) -> int:
    one, other = own.text(a), own.text(b)
    return (one > other) - (one < other)


def _written(own: Emulated, to: int, begin: int, _: int) -> int:
    own.cpu.mem_write(to, own.text(begin) + b"\0")
    return to


REAL: dict[str, tuple[Callable[..., float], int]] = {
    **{name: (getattr(math, name), 1) for name in ("exp", "expm1", "sin", "cos", "sqrt", "floor", "ceil", "fabs", "log")},
    **{name: (getattr(math, name), 2) for name in ("pow", "fmod", "hypot")},
    "fmax": (max, 2),
    "fmin": (min, 2),
}
"""What of its functions of real numbers."""

LIBRARY: dict[str, Callable[[Emulated, int, int, int], int]] = {
    "calloc": lambda own, n, size, _: own.store(bytes(n * size)),
    "malloc": lambda own, size, *_: own.store(bytes(size)),
    "free": lambda *_: 0,
    "memcpy": _copied,
    "memmove": _copied,
    "memset": _filled,
    "bzero": lambda own, to, count, _: _filled(own, to, 0, count),
    "strcmp": _compared,
    "strcpy": _written,
    "strlen": lambda own, a, *_: len(own.text(a)),
    "logger": lambda *_: 0,
}
"""What of the system's C library is here."""
