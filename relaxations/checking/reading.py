"""Reading a certificate: canonical bytes, a right digest, exactly the members of the schema, every real number exact."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from flint import fmpq

FORMAT = "slewcert-certificate/1"
LARGEST_FILE, LONGEST_NUMBER, LARGEST_EXPONENT = 64 * 2**20, 2000, 1100
MOST_POLES, MOST_SEGMENTS = 400, 200_000

_DECIMAL = re.compile(r"-?(0|[1-9][0-9]*)(\.[0-9]*[1-9])?")
_RATIO = re.compile(r"(-?[1-9][0-9]*)/([1-9][0-9]*)")
_HEXADECIMAL = re.compile(r"(-?)0x1(?:\.([0-9a-f]{1,13}))?p([+-][0-9]{1,4})")


class Malformed(Exception):
    """The file is no certificate: not canonical, not complete, or with a wrong digest."""


@dataclass(frozen=True, slots=True)
class PlantData:
    """One plant as written: polynomial coefficients from the lowest power of s up, and further zeros by mode name."""

    numerator: tuple[fmpq, ...]
    denominator: tuple[fmpq, ...]
    zeros: dict[str, int]


@dataclass(frozen=True, slots=True)
class Task:
    """The task as written; inputs absolute."""

    plants: tuple[PlantData, ...]
    displacement: fmpq
    output_rest: bool
    lower_limit: fmpq
    upper_limit: fmpq
    initial_input: fmpq
    tail_length: tuple[fmpq, fmpq] | None


@dataclass(frozen=True, slots=True)
class Chain:
    """Coefficients c_k of `Re Σ c_k s^k/k! e^{ps}` for the root nearest to `near`."""

    near: tuple[fmpq, fmpq]
    coefficients: tuple[tuple[fmpq, fmpq], ...]


@dataclass(frozen=True, slots=True)
class TailMultiplier:
    """μ+ and μ- at `time` after the end of the move."""

    time: fmpq
    upper: fmpq
    lower: fmpq


@dataclass(frozen=True, slots=True)
class LowerWitness:
    """A costate for each plant, and multipliers of the tail's limits."""

    costate: tuple[tuple[Chain, ...], ...]
    tail: tuple[TailMultiplier, ...]


@dataclass(frozen=True, slots=True)
class UpperWitness:
    """A command near an exact solution: `free` names the unknowns that are solved for, each within `radius` of what is written."""

    maneuver_time: fmpq
    starts: tuple[fmpq, ...]
    levels: tuple[fmpq, ...]
    tail: tuple[Chain, ...]
    free: tuple[tuple[str, int, int], ...]
    radius: fmpq


@dataclass(frozen=True, slots=True)
class Certificate:
    """A certificate as written. A side that is not claimed is None; `impossible` names the form of an impossibility, or is None."""

    task: Task
    lower: fmpq | None
    upper: fmpq | None
    impossible: str | None
    lower_witness: LowerWitness | None
    upper_witness: UpperWitness | None
    digest: str
    written: dict[str, Any]


def real(text: Any) -> fmpq:
    """An exact number: decimal without trailing zeros, p/q in lowest terms, or a hexadecimal float as C writes it."""
    if not isinstance(text, str) or len(text) > LONGEST_NUMBER:
        raise Malformed("a number is a string of at most 2000 characters")
    if _DECIMAL.fullmatch(text):
        whole, _, digits = text.partition(".")
        value = fmpq(int(whole + digits), 10 ** len(digits))
        if text.startswith("-") and value == 0:
            raise Malformed("zero has no sign")
        return value
    if ratio := _RATIO.fullmatch(text):
        numerator, denominator = int(ratio[1]), int(ratio[2])
        value = fmpq(numerator, denominator)
        if denominator == 1 or int(value.q) != denominator:
            raise Malformed(f"not in lowest terms: {text[:60]}")
        return value
    if match := _HEXADECIMAL.fullmatch(text):
        digits, exponent = match[2] or "", int(match[3])
        if abs(exponent) > LARGEST_EXPONENT or digits.endswith("0") or match[3] != f"{exponent:+d}":
            raise Malformed(f"no hexadecimal float in its shortest form: {text[:60]}")
        shift = exponent - 4 * len(digits)
        mantissa = int(match[1] + "1" + digits, 16)
        return fmpq(mantissa * 2**shift) if shift >= 0 else fmpq(mantissa, 2**-shift)
    raise Malformed(f"no exact number: {text[:60]!r}")


def canonical(data: Any) -> bytes:
    """RFC 8785 for what a certificate holds: strings, whole numbers, null, true, false, arrays, objects with ASCII names."""
    return json.dumps(data, ensure_ascii=False, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def read(content: bytes) -> Certificate:
    """Parse and validate; raises `Malformed` with a sentence."""
    if len(content) > LARGEST_FILE:
        raise Malformed("larger than 64 MiB")
    try:
        data = json.loads(content.decode("ascii"), parse_float=_no_floats, parse_constant=_no_floats, parse_int=_small)
        same = canonical(data) == content
    except (ValueError, RecursionError) as problem:
        raise Malformed(f"no canonical JSON: {str(problem)[:200]}") from None
    if not same:
        raise Malformed("not in canonical form (RFC 8785)")
    found = _members(data, "certificate", "format", "task", "claim", "lower", "upper", "digest")
    if found["format"] != FORMAT:
        raise Malformed(f'"format" is not "{FORMAT}"')
    digest = hashlib.sha256(canonical({name: value for name, value in data.items() if name != "digest"})).hexdigest()
    if found["digest"] != digest:
        raise Malformed("the digest does not belong to the content")
    claim = _members(found["claim"], "claim", "lower", "upper", "impossible")
    if claim["impossible"] not in (None, "face", "remainder"):
        raise Malformed('claim.impossible is null, "face" or "remainder"')
    certificate = Certificate(
        task=_task(found["task"]),
        lower=None if claim["lower"] is None else real(claim["lower"]),
        upper=None if claim["upper"] is None else real(claim["upper"]),
        impossible=claim["impossible"],
        lower_witness=None if found["lower"] is None else _lower(found["lower"]),
        upper_witness=None if found["upper"] is None else _upper(found["upper"]),
        digest=digest,
        written=data,
    )
    if certificate.lower is None and certificate.upper is None and certificate.impossible is None:
        raise Malformed("nothing is claimed")
    if any(side is not None and side < 0 for side in (certificate.lower, certificate.upper)):
        raise Malformed("a maneuver time is not negative")
    return certificate


def _no_floats(text: str) -> Any:
    raise ValueError(f"a real number is a string, not {text[:40]}")


def _small(text: str) -> int:
    if len(text) > 6:
        raise ValueError("a whole number of more than six digits")
    return int(text)


def _members(data: Any, where: str, *names: str) -> dict[str, Any]:
    if not isinstance(data, dict) or set(data) != set(names):
        raise Malformed(f"{where} is an object with exactly the members {', '.join(names)}")
    return data


def _list(data: Any, where: str, most: int) -> list[Any]:
    if not isinstance(data, list) or len(data) > most:
        raise Malformed(f"{where} is an array of at most {most} items")
    return data


def _count(value: Any, where: str, most: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= most:
        raise Malformed(f"{where} is a whole number from 0 to {most}")
    return value


def _task(data: Any) -> Task:
    found = _members(data, "task", "plants", "displacement", "rest", "limits", "initial_input")
    if found["rest"] not in ("state", "output"):
        raise Malformed('task.rest is "state" or "output"')
    limits = _members(found["limits"], "task.limits", "input", "tail_length")
    length: tuple[fmpq, fmpq] | None = None
    if limits["tail_length"] is not None:
        entry = _members(limits["tail_length"], "task.limits.tail_length", "time", "within")
        length = real(entry["time"]), real(entry["within"])
        if found["rest"] != "output" or length[0] < 0 or not 0 < length[1] <= 1:
            raise Malformed("a tail length (time from 0 on, fraction from 0 to 1) belongs to an output rest")
    pair = _list(limits["input"], "task.limits.input", 2)
    plants = tuple(_plant(item) for item in _list(found["plants"], "task.plants", 1))
    if len(pair) != 2 or not plants:
        raise Malformed("task.limits.input has two numbers, task.plants one plant")
    task = Task(
        plants, real(found["displacement"]), found["rest"] == "output", real(pair[0]), real(pair[1]), real(found["initial_input"]), length
    )
    if not task.lower_limit < task.upper_limit or task.displacement == 0:
        raise Malformed("limits ascend, and the displacement is not 0")
    return task


def _plant(data: Any) -> PlantData:
    found = _members(data, "plant", "numerator", "denominator", "zeros")
    numerator, denominator = (
        tuple(real(c) for c in reversed(_list(found[name], name, MOST_POLES + 1))) for name in ("numerator", "denominator")
    )
    if not numerator or not denominator or numerator[-1] == 0 or denominator[-1] != 1 or len(numerator) > len(denominator):
        raise Malformed("a plant is proper, its denominator monic, its leading coefficients not 0")
    if not isinstance(found["zeros"], dict):
        raise Malformed("plant.zeros counts further zeros by the name of a mode")
    zeros = {name: _count(value, f"zeros.{name}", 20) for name, value in found["zeros"].items()}
    return PlantData(numerator, denominator, zeros)


def _pair(data: Any) -> tuple[fmpq, fmpq]:
    pair = _list(data, "a complex number", 2)
    if len(pair) != 2:
        raise Malformed("a complex number is [re, im]")
    return real(pair[0]), real(pair[1])


def _chains(data: Any, where: str) -> Iterator[Chain]:
    for item in _list(data, where, MOST_POLES):
        found = _members(item, where, "near", "coefficients")
        yield Chain(_pair(found["near"]), tuple(_pair(c) for c in _list(found["coefficients"], where, MOST_POLES)))


def _lower(data: Any) -> LowerWitness:
    found = _members(data, "lower", "costate", "tail")
    costate = tuple(tuple(_chains(plant, "lower.costate")) for plant in _list(found["costate"], "lower.costate", MOST_POLES))
    tail = []
    for item in _list(found["tail"], "lower.tail", 10_000):
        entry = _members(item, "lower.tail", "time", "upper", "lower")
        multiplier = TailMultiplier(real(entry["time"]), real(entry["upper"]), real(entry["lower"]))
        if multiplier.time < 0 or multiplier.upper < 0 or multiplier.lower < 0:
            raise Malformed("times and multipliers of the tail are not negative")
        tail.append(multiplier)
    return LowerWitness(costate, tuple(tail))


def _upper(data: Any) -> UpperWitness:
    found = _members(data, "upper", "maneuver_time", "segments", "tail", "free", "radius")
    segments = [_members(s, "a segment", "start", "level") for s in _list(found["segments"], "upper.segments", MOST_SEGMENTS)]
    starts, levels = tuple(real(s["start"]) for s in segments), tuple(real(s["level"]) for s in segments)
    tail = tuple(_chains(found["tail"], "upper.tail"))
    time, radius = real(found["maneuver_time"]), real(found["radius"])
    free = tuple(_free(item, len(segments), tail) for item in _list(found["free"], "upper.free", 4 * MOST_POLES))
    if len(set(free)) != len(free):
        raise Malformed("upper.free names an unknown twice")
    if radius <= 0 or time < 0 or bool(segments) != (time > 0) or (segments and starts[0] != 0):
        raise Malformed("the move begins at 0 and lasts longer than 0 if it has segments; the radius is positive")
    return UpperWitness(time, starts, levels, tail, free, radius)


def _free(item: Any, segments: int, tail: tuple[Chain, ...]) -> tuple[str, int, int]:
    """An unknown: ["time", 0, 0], ["start", i, 0] (i > 0), ["level", i, 0], ["re" or "im", zero, power]."""
    kind, first, second = _list(item, "upper.free", 3) if isinstance(item, list) and len(item) == 3 else ("", 0, 0)
    first, second = _count(first, "upper.free", MOST_SEGMENTS), _count(second, "upper.free", MOST_SEGMENTS)
    known = {
        "time": first == second == 0 and segments > 0,
        "start": 0 < first < segments and second == 0,
        "level": first < segments and second == 0,
        "re": first < len(tail) and second < len(tail[first].coefficients) if tail else False,
        "im": first < len(tail) and second < len(tail[first].coefficients) if tail else False,
    }
    if not isinstance(kind, str) or not known.get(kind, False):
        raise Malformed(f"upper.free names no unknown: {item!r:.80}")
    return kind, first, second
