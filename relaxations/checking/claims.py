"""The verdict on a certificate, and the claim in words."""

from __future__ import annotations

import time
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from enum import Enum
from pathlib import Path
from typing import Any

from flint import fmpq

from relaxations.checking import lower, upper
from relaxations.checking.balls import Inconclusive, Refuted, Undecided, budget, precision, system
from relaxations.checking.reading import Certificate, Malformed, read

REST = {
    "state": "the state (of a controllable realisation) stays at rest from T on (state rest)",
    "output": "the output stays at its target from T on, and the input tends to its final rest value (output rest)",
}
IMPOSSIBLE = {"maneuver_time": None, "impossible": True}
BITS = (128, 256, 512, 1024)
WORK, WORK_PER_SIZE = 4e6, 2e3
"""Units of work (about a microsecond each) that a check may cost, and further ones by the size of what it is about."""


class Outcome(Enum):
    """What became of a certificate; the value is how JSON writes it."""

    PROVED = "proved"
    REFUTED = "refuted"
    INCONCLUSIVE = "inconclusive"
    MALFORMED = "malformed"


@dataclass(frozen=True, slots=True)
class Check:
    """Outcome, the reason if it is not PROVED, the certificate (None if malformed), the precision that decided, seconds."""

    outcome: Outcome
    reason: str
    certificate: Certificate | None
    bits: int
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """The object of `check --json` (docs/schemas.md)."""
        record: dict[str, Any] = {"status": self.outcome.value}
        if self.certificate is not None:
            record["task"] = self.certificate.written["task"]
            if self.outcome is Outcome.PROVED:
                lower, upper, impossible = self.certificate.claim
                record |= {"maneuver_time": {"lower": down(lower), "upper": up(upper)}} if not impossible else IMPOSSIBLE
        if self.reason:
            record["reason"] = self.reason
        return record


def check(content: bytes, bits: tuple[int, ...] = BITS) -> Check:
    """Read a certificate and prove every side that it claims, at rising precision; never raises for any content."""
    begun, certificate, at, reason = time.perf_counter(), None, 0, ""

    def ended(outcome: Outcome, reason: str = "") -> Check:
        return Check(outcome, reason, certificate, at, time.perf_counter() - begun)

    try:
        certificate = read(content)
        budget(_work(certificate))
        for at in bits:
            try:
                with precision(at):
                    _prove(certificate)
                return ended(Outcome.PROVED)
            except (Undecided, ZeroDivisionError, OverflowError) as problem:
                reason = str(problem)
    except Malformed as problem:
        return ended(Outcome.MALFORMED, str(problem))
    except Refuted as problem:
        return ended(Outcome.REFUTED, str(problem))
    except (Inconclusive, MemoryError) as problem:
        reason = str(problem) or type(problem).__name__
    return ended(Outcome.INCONCLUSIVE, reason)


def check_file(path: Path) -> Check:
    """`check` of a file's bytes; raises `OSError` if it cannot be read."""
    return check(path.read_bytes())


def _work(certificate: Certificate) -> float:
    """A proof costs about so much for every pair of a pole and a pole or a segment."""
    poles = sum(len(data.denominator) for data in certificate.task.plants)
    return WORK + WORK_PER_SIZE * poles * (poles + len(certificate.upper.segments if certificate.upper else ()))


def _prove(certificate: Certificate) -> None:
    posed, (below, above, criterion) = system(certificate.task), certificate.claim
    if criterion is not None:
        lower.impossible(posed, criterion)
    if below and certificate.lower is not None:
        lower.prove(posed, certificate.lower, below)
    if above is not None and certificate.upper is not None:
        upper.prove(posed, certificate.upper, above)


def _rounded(value: fmpq | None, rounding: str) -> str | None:
    """17 digits of `value`, correctly rounded towards the safe side."""
    if value is None:
        return None
    return f"{Context(prec=17, rounding=rounding).divide(Decimal(str(value.p)), Decimal(str(value.q))):f}"


def down(value: fmpq | None) -> str | None:
    """A lower bound for people and scripts: at most the proven one."""
    return _rounded(value, ROUND_FLOOR)


def up(value: fmpq | None) -> str | None:
    """An upper bound for people and scripts: at least the proven one."""
    return _rounded(value, ROUND_CEILING)


def claim(certificate: Certificate) -> str:
    """The whole claim in words, its numbers as written, so that a reader can see which problem it is about."""
    task, (lower, upper, impossible) = certificate.written["task"], certificate.claim
    lines = ["Plant (highest power of s first):"]
    for plant in task["plants"]:
        lines += [f"  {name:<12} [{', '.join(plant[name])}]" for name in ("numerator", "denominator")]
        if plant["zeros"]:
            lines.append("  further zeros of the command: " + ", ".join(f"{count} at {name}" for name, count in plant["zeros"].items()))
    rest, (low, high), tail = REST[task["rest"]], task["limits"]["input"], task["limits"]["tail_length"]
    lines.append(f"Task: from rest at input {task['initial_input']} move the output by {task['displacement']}; {rest}.")
    lines.append(f"Limits: {low} ≤ u(t) ≤ {high} for all t ≥ 0.")
    if tail:
        where = f"within {tail['within']} of the nearer limit's distance from its final rest value"
        lines.append(f"  From {tail['time']} s after T on, the input stays {where}.")
    sides = ["no measurable command within the limits does this in any time"] if impossible else []
    sides += [f"no measurable command within the limits does this in less than {down(lower)} s"] if lower is not None else []
    sides += [f"one does it in at most {up(upper)} s"] if upper is not None else []
    return "\n".join([*lines, f"Claim: {'; '.join(sides)}."])
