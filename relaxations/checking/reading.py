"""Reading a certificate: canonical bytes, a right digest, exactly the members of the schema, every real number exact."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from flint import fmpq, fmpz

LARGEST_FILE, LONGEST_NUMBER, LARGEST_EXPONENT = 16 * 2**20, 2000, 1100
MOST_POLES, MOST_SEGMENTS, MOST_CONTACTS, MOST_ZEROS, MOST_OUTPUTS = 200, 100_000, 10_000, 20, 50

_DECIMAL = re.compile(r"(?!-0$)-?(0|[1-9][0-9]*)(\.[0-9]*[1-9])?")
_RATIO = re.compile(r"(-?[1-9][0-9]*)/([1-9][0-9]*)")
_HEXADECIMAL = re.compile(r"(-?0x1)(?:\.([0-9a-f]{0,12}[1-9a-f]))?p(\+0|[+-][1-9][0-9]{0,3})")
_ZERO = re.compile(r"zero\[[1-9][0-9]{0,2}\]")
MOVED = re.compile(r"mode\[[1-9][0-9]{0,2}\]\.(frequency|damping)|zero\[[1-9][0-9]{0,2}\]")
_MODE = re.compile(r"(mode|real)\[[1-9][0-9]{0,2}\]")


class Malformed(Exception):
    """The file is no certificate: not canonical, not complete, of no sense, or with a wrong digest."""


class Refuted(Exception):
    """An inequality that the claim rests on is proven false for the given witness."""


class Undecided(Exception):
    """Neither proved nor refuted: at this precision, or with the work that a check may cost."""


def require(holds: bool, sentence: str) -> None:
    """Raise `Malformed` unless `holds`."""
    if not holds:
        raise Malformed(sentence)


def real(data: Any, where: str = "a number") -> fmpq:
    """An exact number: decimal without trailing zeros, p/q in lowest terms, or a hexadecimal float as C writes it."""
    require(isinstance(data, str) and len(data) <= LONGEST_NUMBER, f"{where} is a string of at most {LONGEST_NUMBER} characters")
    if _DECIMAL.fullmatch(data):
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


def natural(data: Any, where: str) -> int:
    """A whole number from 0 on; JSON's true is none."""
    require(type(data) is int and data >= 0, f"{where} is a whole number from 0 on, not {data!r:.80}")
    return data


def flag(data: Any, where: str) -> bool:
    """JSON's true or false."""
    require(data is True or data is False, f"{where} is true or false, not {data!r:.80}")
    return data


def counts(data: Any, where: str) -> dict[str, int]:
    """Further zeros by the name of a mode."""
    require(isinstance(data, dict) and len(data) <= MOST_POLES and all(map(_MODE.fullmatch, data)), f"{where} names mode[i] and real[i]")
    require(all(natural(n, where) <= MOST_ZEROS for n in data.values()), f"{where} counts from 0 to {MOST_ZEROS}")
    return data


def name(data: Any, where: str) -> str:
    """A short printable name."""
    require(isinstance(data, str) and 0 < len(data) <= 80 and data.isprintable(), f"{where} is a short name")
    return data


def sensitivities(data: Any, where: str) -> dict[str, tuple[fmpq, fmpq]]:
    """Shift and residual by the name of a zero."""
    require(isinstance(data, dict) and len(data) <= MOST_POLES and all(map(_ZERO.fullmatch, data)), f"{where} names zero[i]")
    pairs = {name: shaped(pair, {"shift": real, "residual": real}, f"{where}.{name}") for name, pair in data.items()}
    return {name: (pair.shift, pair.residual) for name, pair in pairs.items()}


def by_name(shape: Any) -> Callable[[Any, str], dict[str, Any]]:
    """What is given of outputs, each of one shape, by their names."""

    def read(data: Any, where: str) -> dict[str, Any]:
        require(isinstance(data, dict) and len(data) <= MOST_OUTPUTS, f"{where} names at most {MOST_OUTPUTS} outputs")
        return {name(key, where): shaped(value, shape, f"{where}.{key}") for key, value in data.items()}

    return read


# A dictionary is an object of exactly these members, a tuple an array of such items, a list (item, least, most) an array of so many such
# items, a set a choice; a pair with None may be null.
PAIR = (real, real)
POLYNOMIAL: list[Any] = [real, 1, MOST_POLES + 1]  # the highest power of s first
PLANT = {"numerator": POLYNOMIAL, "denominator": POLYNOMIAL, "outputs": by_name(POLYNOMIAL), "zeros": counts}
LENGTH = {"time": real, "within": real}  # seconds after the move, and a fraction
# The input's limits are absolute; fuel is what the move may use; with a sample time h the input is constant on each [kh, (k+1)h)
LIMITS = {
    "input": PAIR,
    "fuel": (None, real),
    "deflection": by_name(real),
    "rate": (None, PAIR),
    "pulse_width": (None, real),  # [s] of pieces whose level is not the initial input
    "pulses": (None, natural),  # how many of them there may be
    "held": (None, {"positive, then negative", "negative, then positive"}),  # the sides of the first rest on which the input is
    "sample_time": (None, real),
    "tail_length": (None, LENGTH),
    "zero_sensitivity": sensitivities,
}
# Plants whose coefficients are polynomials in parameters: sums of terms, a number and the power of each parameter. Every plant of the box,
# the one written (nominal values) among them, may keep a residual of `tolerance` times the displacement.
TERMS: list[Any] = [(real, [natural, 1, 8]), 0, 1000]
# Where no such polynomials are known they are empty, and the box is the plants listed instead; without these too parameters are named after
# roots of the plant (mode[i].frequency, mode[i].damping, zero[i]), which they move. The final rest values of all may be off
# the target by `final_tolerance` times the displacement (null: by any amount).
COEFFICIENTS: list[Any] = [TERMS, 0, MOST_POLES + 1]  # the highest power of s first
PARAMETER = {"name": name, "nominal": (None, real), "low": real, "high": real}
LISTED = {"place": [real, 1, 8], "numerator": POLYNOMIAL, "denominator": POLYNOMIAL, "outputs": by_name(POLYNOMIAL)}
FORM = {"numerator": COEFFICIENTS, "denominator": COEFFICIENTS, "outputs": by_name(COEFFICIENTS), "plants": [LISTED, 0, 1000]}
BOX = {"parameters": [PARAMETER, 1, 8], **FORM, "tolerance": real, "final_tolerance": (None, real)}
# A plant that varies instead: matrices at instants, the first 0, linear between them and constant after the last.
MOST_STATES, MOST_INSTANTS = 50, 1000
VECTORS: list[Any] = [[real, 1, MOST_STATES], 1, MOST_INSTANTS]
MATRICES = {
    "A": [[[real, 1, MOST_STATES], 1, MOST_STATES], 1, MOST_INSTANTS],
    "B": VECTORS,
    "C": VECTORS,
    "D": [real, 1, MOST_INSTANTS],
}
MEMBER = {"place": [real, 1, 8], **MATRICES}
SCHEDULE = {
    "instants": [real, 1, MOST_INSTANTS],
    **MATRICES,
    "outputs": by_name(VECTORS),  # rows for every instant
    "members": [MEMBER, 0, 100],  # of a box: the same matrices of every plant, the nominal one among them
}
TASK = {
    "plants": [PLANT, 0, 1],
    "schedule": (None, SCHEDULE),
    "box": (None, BOX),
    "displacement": real,
    # where a plant that is not at rest begins: D(d/dt) ξ = u, y = N(d/dt) ξ, here ξ and its derivatives, the highest not among them
    "initial_state": (None, [real, 1, MOST_POLES]),
    "rest": {"state", "output"},
    "limits": LIMITS,
    "initial_input": real,
}
# coefficients c_k of `Re Σ c_k s^k/k! e^{ps}` at the root p nearest to a point
CHAINS: list[Any] = [{"near": PAIR, "coefficients": [PAIR, 0, MOST_POLES]}, 0, MOST_POLES]
# a costate for each plant, and the multipliers μ⁺ and μ⁻ of the tail's limits so many seconds after the move
CONTACTS: list[Any] = [{"time": real, "upper": real, "lower": real}, 0, MOST_CONTACTS]
# … of outputs over times to go, and of the slope
PRESSES: list[Any] = [{"output": name, "begin": real, "end": real, "weight": real}, 0, MOST_CONTACTS]
RAMPS: list[Any] = [{"edges": [real, 2, 1000], "levels": [real, 1, 1000]}, 0, MOST_CONTACTS]
# … of what a tail does to the input's slope (null) or to an output, so many seconds after the move
AFTER: list[Any] = [{"output": (None, name), "time": real, "upper": real, "lower": real}, 0, MOST_CONTACTS]
# … of the residual and of outputs, in the course of the move and after it, of plants at places in the box
SAMPLES: list[Any] = [{"place": [real, 1, 8], "residual": CONTACTS, "deflection": PRESSES, "after": AFTER}, 0, 1000]
STEPS: list[Any] = [real, 0, MOST_SEGMENTS]  # of the input's changes from sample to sample, the last change first
# … of inputs of a form: a costate and a price of the fuel for changes of sign at these times to go
CHANGES: list[Any] = [{"at": real, "costate": [CHAINS, 1, 1], "fuel": real}, 0, 5000]
# … of pulses: trees, their nodes in the order of the first visit; prices of the widths, a number for each pulse
SPLIT = {"pulse": natural, "edge": {"begin", "end", "sign"}, "at": real}
LEAF = {"costate": [CHAINS, 1, 1], "widths": [real, 0, 200], "fuel": real}
PULSES: list[Any] = [{"split": (None, SPLIT), "leaf": (None, LEAF)}, 0, 50_000]
LOWER = {
    "costate": [CHAINS, 1, 1],
    "changes": CHANGES,
    "tail": CONTACTS,
    "after": AFTER,
    "samples": SAMPLES,
    "fuel": real,
    "deflection": PRESSES,
    "ramps": RAMPS,
    "steps": STEPS,
    "pulses": PULSES,
}
# A command near an exact solution: absolute levels from their starts on, then a tail. `free` names its unknowns, each within `radius` of
# what is written: ["time", 0, 0], ["start" or "level", i, 0] of segment i, ["re" or "im", i, k] of coefficient k of the tail's chain i.
# A mirrored command is its own image about the middle of the move: the instants of its second half are those of its first.
SEGMENTS = [{"start": real, "level": real}, 0, MOST_SEGMENTS]
FREE = [({"time", "start", "level", "re", "im"}, natural, natural), 0, 2 * MOST_POLES]
UPPER = {"maneuver_time": real, "segments": SEGMENTS, "tail": CHAINS, "free": FREE, "radius": real, "mirrored": flag}
# sides of the least maneuver time [s] (null: not claimed), or the criterion by which the task is impossible
CRITERIA = {"face", "remainder", "fuel", "final", "overshoot"}
CLAIM = {"lower": (None, real), "upper": (None, real), "impossible": (None, CRITERIA)}
SCHEMA = {"format": {"slewcert-certificate/1"}, "task": TASK, "claim": CLAIM, "lower": (None, LOWER), "upper": (None, UPPER)}
# Of the cost `T + price ∫ |u| dt` instead: sides of its least value [s], and for maneuver times from 0 on a costate each
PIECES: list[Any] = [{"begin": real, "end": real, "costate": [CHAINS, 1, 1]}, 0, 5000]
SIDES = {"lower": (None, real), "upper": (None, real)}
COST = {"format": {"slewcert-cost/1"}, "task": TASK, "price": real, "claim": SIDES, "lower": (None, PIECES), "upper": (None, UPPER)}


def shaped(data: Any, shape: Any, where: str) -> Any:
    """A piece of JSON as its schema says: objects become namespaces, arrays tuples."""
    match shape:
        case None, inner:
            return None if data is None else shaped(data, inner, where)
        case dict():
            require(isinstance(data, dict) and data.keys() == shape.keys(), f"{where} is an object of exactly {', '.join(shape)}")
            return SimpleNamespace(**{name: shaped(data[name], member, f"{where}.{name}") for name, member in shape.items()})
        case [item, int(least), int(most)]:
            require(isinstance(data, list) and least <= len(data) <= most, f"{where} is an array of {least} to {most} items")
            return tuple(shaped(entry, item, f"{where}[{i}]") for i, entry in enumerate(data))
        case tuple():
            require(isinstance(data, list) and len(data) == len(shape), f"{where} is an array of {len(shape)} items")
            return tuple(shaped(entry, item, f"{where}[{i}]") for i, (entry, item) in enumerate(zip(data, shape, strict=True)))
        case set():
            require(isinstance(data, str) and data in shape, f"{where} is one of {', '.join(sorted(shape))}")
            return data
    return shape(data, where)


def sensible(task: Any) -> None:
    """What the schema cannot say of a task; raises `Malformed`."""
    for plant in task.plants:
        numerator, denominator = plant.numerator, plant.denominator
        fine = len(numerator) <= len(denominator) and denominator[0] == 1 and numerator[0] != 0 != numerator[-1]
        require(fine, "a plant is proper and monic, its leading coefficients not 0, and has no zero at the origin: else there is no rest")
    (low, high), length = task.limits.input, task.limits.tail_length
    require(
        low < high and (task.displacement != 0 or task.initial_state is not None),
        "limits ascend, and the displacement is not 0 unless the plant begins elsewhere",
    )
    fine = length is None or (task.rest == "output" and length.time >= 0 and 0 < length.within <= 1)
    require(fine, "a tail length belongs to an output rest: a time from 0 on, a fraction from 0 to 1")
    start = task.initial_state
    fine = (
        start is None
        or task.schedule is not None
        or any(task.box is None and not plant.zeros and len(start) == len(plant.denominator) - 1 for plant in task.plants)
    )
    require(fine, "an initial state has as many numbers as the plant has poles, and goes without further zeros or a box")
    limits, plain = task.limits, task.rest == "state" and task.limits.sample_time is None
    fine = (limits.pulse_width is None and limits.pulses is None) or (plain and limits.pulse_width != 0 and limits.pulses != 0)
    require(fine and (limits.pulse_width or 1) > 0, "pulses have a width or number of more than 0, under state rest without samples")
    fine = task.limits.sample_time is None or (task.rest == "state" and task.limits.sample_time > 0)
    require(fine, "a sample time belongs to a state rest, and is more than 0")
    fine = all(task.rest == "output" and shift > 0 <= residual for shift, residual in task.limits.zero_sensitivity.values())
    require(fine, "sensitivity to a zero belongs to an output rest: a shift of more than 0, a residual of 0 or more")
    require(task.limits.fuel is None or task.limits.fuel > 0, "a budget of fuel is more than 0")


def witnessed(task: Any, claim: Any, lower: Any, upper: Any) -> None:
    """What the schema cannot say of a claim and its witnesses; raises `Malformed`."""
    sides = [side for side in (claim.lower, claim.upper) if side is not None]
    require(bool(sides) != (claim.impossible is not None), "a claim has sides, or says that the task is impossible")
    require(all(side >= 0 for side in sides), "a maneuver time is not negative")
    require(bool(lower or not claim.lower) and bool(upper or claim.upper is None), "a side that is claimed has no witness")
    samples = lower.samples if lower else ()
    require(all(c.output is not None for sample in samples for c in sample.after), "no plant of a box has a slope of its own")
    for contact in (*lower.after, *(contact for sample in samples for contact in sample.after)) if lower else ():
        known = task.limits.rate is not None if contact.output is None else contact.output in task.limits.deflection
        require(
            known and min(contact.time, contact.upper, contact.lower) >= 0, "multipliers after the move are of limits, and not negative"
        )
    contacts = [*lower.tail, *(contact for sample in lower.samples for contact in sample.residual)] if lower else []
    require(
        all(x >= 0 for contact in contacts for x in vars(contact).values()),
        "times and multipliers of the tail are not negative, nor those of samples",
    )
    require(task.box is not None or not lower or not lower.samples, "samples of a box that the task does not have")
    require(task.box is None or not lower or not lower.deflection, "multipliers of outputs are those of the box's plants")
    for press in (*lower.deflection, *(press for sample in samples for press in sample.deflection)) if lower else ():
        require(press.output in task.limits.deflection, f"a multiplier of the output {press.output}, which is not limited")
        require(0 <= press.begin <= press.end, "the multiplier of an output acts over times to go from 0 on, that ascend")
    fine = not lower or lower.fuel == 0 or (task.limits.fuel is not None and lower.fuel > 0)
    require(fine, "the multiplier of the fuel is not negative, and belongs to a budget")
    commanded(task, upper)


def commanded(task: Any, upper: Any) -> None:
    """What the schema cannot say of a command, if there is one; raises `Malformed`."""
    if upper is None:
        return
    begins = upper.segments[0].start == 0 < upper.maneuver_time if upper.segments else upper.maneuver_time == 0
    require(begins and upper.radius > 0, "a move with segments begins at 0 and lasts longer than 0, and the radius is positive")
    plain = task.rest == "state" and task.schedule is None and task.box is None and task.initial_state is None
    require(plain or not upper.mirrored, "a mirrored command leads one plant from rest to state rest")


def canonical(data: Any) -> bytes:
    """RFC 8785 for what a certificate may hold: ASCII strings, small whole numbers, null, arrays, objects."""
    return json.dumps(data, ensure_ascii=False, sort_keys=True, separators=(",", ":")).encode()


def read(content: bytes) -> SimpleNamespace:
    """Parse and validate: the members of the schema, and what the file holds as `written`. Raises `Malformed` with a sentence."""
    require(len(content) <= LARGEST_FILE, "larger than 16 MiB")
    try:
        data = json.loads(content.decode("ascii"))
        same = isinstance(data, dict) and canonical(data) == content
    except (ValueError, RecursionError) as problem:
        raise Malformed(f"no canonical JSON: {str(problem)[:200]}") from None
    require(same, "no object in canonical form (RFC 8785)")
    digest = hashlib.sha256(canonical({name: value for name, value in data.items() if name != "digest"})).hexdigest()
    require(data.get("digest") == digest, "the digest does not belong to the content")
    priced = data.get("format") == "slewcert-cost/1"
    certificate = shaped(data, {**(COST if priced else SCHEMA), "digest": {digest}}, "certificate")
    sensible(certificate.task)
    if priced:
        commanded(certificate.task, certificate.upper)
    else:
        witnessed(certificate.task, certificate.claim, certificate.lower, certificate.upper)
    return SimpleNamespace(**{"price": None, **vars(certificate)}, written=data)
