"""Reading a certificate: canonical bytes, a right digest, exactly the members of the schema, every real number exact.

The schema stands at the end: readers (of a value and the place where it stands) that are put together as the file is.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from flint import fmpq, fmpz

LARGEST_FILE, LONGEST_NUMBER, LARGEST_EXPONENT = 16 * 2**20, 2000, 1100
MOST_POLES, MOST_SEGMENTS, MOST_CONTACTS, MOST_ZEROS = 200, 100_000, 10_000, 20

_DECIMAL = re.compile(r"-?(0|[1-9][0-9]*)(\.[0-9]*[1-9])?")
_RATIO = re.compile(r"(-?[1-9][0-9]*)/([1-9][0-9]*)")
_HEXADECIMAL = re.compile(r"(-?0x1)(?:\.([0-9a-f]{0,12}[1-9a-f]))?p(\+0|[+-][1-9][0-9]{0,3})")

Complex = tuple[fmpq, ...]
Chain = tuple[Complex, tuple[Complex, ...]]
"""A point (re, im), and coefficients c_k of `Re Σ c_k s^k/k! e^{ps}` for the root p nearest to it."""
T = TypeVar("T")
Reader = Callable[[Any, str], T]


class Malformed(Exception):
    """The file is no certificate: not canonical, not complete, of no sense, or with a wrong digest."""


def require(holds: bool, sentence: str) -> None:
    """Raise `Malformed` unless `holds`."""
    if not holds:
        raise Malformed(sentence)


@dataclass(frozen=True, slots=True)
class PlantData:
    """One plant as written: coefficients, the highest power of s first, and further zeros of the command by the name of a mode."""

    numerator: tuple[fmpq, ...]
    denominator: tuple[fmpq, ...]
    zeros: dict[str, int]

    def __post_init__(self) -> None:
        proper = len(self.numerator) <= len(self.denominator) and self.denominator[0] == 1 and self.numerator[0] != 0
        require(proper, "a plant is proper, its denominator monic, its leading coefficients not 0")
        require(self.numerator[-1] != 0, "the plant has a zero at the origin: there is no rest state")


@dataclass(frozen=True, slots=True)
class Task:
    """The task as written: rest of the "state" or the "output", absolute limits of the input, and of the tail (time [s], fraction) or None."""

    plants: tuple[PlantData, ...]
    displacement: fmpq
    rest: str
    limits: tuple[tuple[fmpq, ...], tuple[fmpq, fmpq] | None]
    initial_input: fmpq

    def __post_init__(self) -> None:
        (lower, upper), length = self.limits
        require(lower < upper and self.displacement != 0, "limits ascend, and the displacement is not 0")
        sensible = length is None or (self.rest == "output" and length[0] >= 0 and 0 < length[1] <= 1)
        require(sensible, "a tail length belongs to an output rest: a time from 0 on, a fraction from 0 to 1")


@dataclass(frozen=True, slots=True)
class Lower:
    """A costate for each plant, and multipliers of the tail's limits: seconds after the move, μ⁺, μ⁻."""

    costate: tuple[tuple[Chain, ...], ...]
    tail: tuple[tuple[fmpq, fmpq, fmpq], ...]

    def __post_init__(self) -> None:
        require(all(min(contact) >= 0 for contact in self.tail), "times and multipliers of the tail are not negative")


@dataclass(frozen=True, slots=True)
class Upper:
    """A command near an exact solution: segments (start, level), then a tail. `free` names the unknowns, each within `radius` of what is written:
    ["time", 0, 0], ["start", i, 0] or ["level", i, 0] of segment i, ["re", i, k] or ["im", i, k] of coefficient k of the tail's chain i."""

    maneuver_time: fmpq
    segments: tuple[tuple[fmpq, fmpq], ...]
    tail: tuple[Chain, ...]
    free: tuple[tuple[str, int, int], ...]
    radius: fmpq

    def __post_init__(self) -> None:
        begins = self.segments[0][0] == 0 < self.maneuver_time if self.segments else self.maneuver_time == 0
        require(begins and self.radius > 0, "a move with segments begins at 0 and lasts longer than 0, and the radius is positive")
        for kind, i, k in self.free:
            of_tail = i < len(self.tail) and k < len(self.tail[i][1])
            of_segment = k == 0 and (i == 0 < len(self.segments) if kind == "time" else (kind == "start") <= i < len(self.segments))
            require(of_tail if kind in ("re", "im") else of_segment, f"upper.free names no unknown: {[kind, i, k]}")
        require(len(set(self.free)) == len(self.free), "upper.free names an unknown twice")


@dataclass(frozen=True, slots=True)
class Certificate:
    """A certificate: `claim` holds the lower and the upper side [s] (None: not claimed) and the criterion of an impossible task (or None);
    `written` is the object in the file."""

    format: str
    task: Task
    claim: tuple[fmpq | None, fmpq | None, str | None]
    lower: Lower | None
    upper: Upper | None
    digest: str
    written: dict[str, Any]

    def __post_init__(self) -> None:
        lower, upper, impossible = self.claim
        sides = [side for side in (lower, upper) if side is not None]
        require(bool(sides) != (impossible is not None), "a claim has sides, or says that the task is impossible")
        require(all(side >= 0 for side in sides), "a maneuver time is not negative")
        require(
            (self.lower is not None or not lower) and (self.upper is not None or upper is None), "a side that is claimed has no witness"
        )


def record(build: Callable[..., T], **members: Reader[Any]) -> Reader[T]:
    """An object with exactly these members."""

    def read(data: Any, where: str) -> T:
        require(isinstance(data, dict) and data.keys() == members.keys(), f"{where} is an object of exactly {', '.join(members)}")
        return build(**{name: member(data[name], f"{where}.{name}") for name, member in members.items()})

    return read


def fields(**members: Reader[Any]) -> Reader[Any]:
    """An object with exactly these members, as a tuple."""
    return record(lambda **found: tuple(found.values()), **members)


def array(item: Reader[T], most: int, least: int = 0) -> Reader[tuple[T, ...]]:
    """`least` to `most` items."""

    def read(data: Any, where: str) -> tuple[T, ...]:
        require(isinstance(data, list) and least <= len(data) <= most, f"{where} is an array of {least} to {most} items")
        return tuple(item(entry, where) for entry in data)

    return read


def optional(item: Reader[T]) -> Reader[T | None]:
    """Null, or an item."""
    return lambda data, where: None if data is None else item(data, where)


def choice(*values: str) -> Reader[str]:
    """One of these strings."""

    def read(data: Any, where: str) -> str:
        require(isinstance(data, str) and data in values, f"{where} is one of {', '.join(values)}")
        return data

    return read


def count(data: Any, where: str) -> int:
    """A whole number; JSON's true is none."""
    require(type(data) is int and data >= 0, f"{where} is a whole number")
    return data


def real(data: Any, where: str = "a number") -> fmpq:
    """An exact number: decimal without trailing zeros, p/q in lowest terms, or a hexadecimal float as C writes it."""
    require(isinstance(data, str) and len(data) <= LONGEST_NUMBER, f"{where} is a string of at most {LONGEST_NUMBER} characters")
    if _DECIMAL.fullmatch(data) and data != "-0":
        whole, _, digits = data.partition(".")
        return fmpq(fmpz(whole + digits), fmpz(10) ** len(digits))
    if match := _RATIO.fullmatch(data):
        value = fmpq(fmpz(match[1]), fmpz(match[2]))
        require(value.q == fmpz(match[2]) != 1, f"{where} is not in lowest terms: {data[:60]}")
        return value
    match = _HEXADECIMAL.fullmatch(data)
    if match is None or abs(int(match[3])) > LARGEST_EXPONENT:
        raise Malformed(f"{where} is no exact number: {data[:60]!r}")
    digits = match[2] or ""
    return fmpq(int(match[1] + digits, 16)) * fmpq(2) ** (int(match[3]) - 4 * len(digits))


def unknown(data: Any, where: str) -> tuple[str, int, int]:
    """The name of an unknown."""
    require(isinstance(data, list) and len(data) == 3, f"{where} holds arrays of three")
    return choice("time", "start", "level", "re", "im")(data[0], where), count(data[1], where), count(data[2], where)


def further(data: Any, where: str) -> dict[str, int]:
    """Counts of further zeros by the name of a mode."""
    require(isinstance(data, dict) and len(data) <= MOST_POLES, f"{where} is an object")
    require(all(count(value, where) <= MOST_ZEROS for value in data.values()), f"{where} counts to {MOST_ZEROS}")
    return data


COMPLEX = array(real, 2, 2)
CHAINS = array(fields(near=COMPLEX, coefficients=array(COMPLEX, MOST_POLES)), MOST_POLES)
POLYNOMIAL = array(real, MOST_POLES + 1, 1)
PLANT = record(PlantData, numerator=POLYNOMIAL, denominator=POLYNOMIAL, zeros=further)
LIMITS = fields(input=array(real, 2, 2), tail_length=optional(fields(time=real, within=real)))
CERTIFICATE: dict[str, Reader[Any]] = {
    "format": choice("slewcert-certificate/1"),
    "task": record(Task, plants=array(PLANT, 1, 1), displacement=real, rest=choice("state", "output"), limits=LIMITS, initial_input=real),
    "claim": fields(lower=optional(real), upper=optional(real), impossible=optional(choice("face", "remainder"))),
    "lower": optional(record(Lower, costate=array(CHAINS, 1, 1), tail=array(fields(time=real, upper=real, lower=real), MOST_CONTACTS))),
    "upper": optional(
        record(
            Upper,
            maneuver_time=real,
            segments=array(fields(start=real, level=real), MOST_SEGMENTS),
            tail=CHAINS,
            free=array(unknown, 2 * MOST_POLES),
            radius=real,
        )
    ),
}


def canonical(data: Any) -> bytes:
    """RFC 8785 for what a certificate holds: ASCII strings, small whole numbers, null, true, false, arrays, objects."""
    return json.dumps(data, ensure_ascii=False, sort_keys=True, separators=(",", ":")).encode()


def read(content: bytes) -> Certificate:
    """Parse and validate; raises `Malformed` with a sentence."""
    require(len(content) <= LARGEST_FILE, "larger than 16 MiB")
    try:
        data = json.loads(content.decode("ascii"), parse_float=_refused, parse_constant=_refused, parse_int=_small)
        same = isinstance(data, dict) and canonical(data) == content
    except (ValueError, RecursionError) as problem:
        raise Malformed(f"no canonical JSON: {str(problem)[:200]}") from None
    require(same, "no object in canonical form (RFC 8785)")
    digest = hashlib.sha256(canonical({name: value for name, value in data.items() if name != "digest"})).hexdigest()
    require(data.get("digest") == digest, "the digest does not belong to the content")
    return record(lambda **found: Certificate(**found, written=data), **CERTIFICATE, digest=choice(digest))(data, "certificate")


def _refused(text: str) -> Any:
    raise ValueError(f"a real number is a string, not {text[:40]}")


def _small(text: str) -> int:
    return int(text) if len(text) <= 6 else _refused(text)
