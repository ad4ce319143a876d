"""The verdict on a certificate, and the claim in words."""

from __future__ import annotations

import time
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from flint import arb, fmpq

from relaxations.checking import impossible, lower, upper
from relaxations.checking.balls import Inconclusive, Refuted, plant, precision
from relaxations.checking.reading import Certificate, Malformed, read

BITS = (128, 256, 512, 1024)


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
                claimed = self.certificate
                record["maneuver_time"] = None if claimed.impossible else {"lower": down(claimed.lower), "upper": up(claimed.upper)}
                if claimed.impossible:
                    record["impossible"] = True
        if self.reason:
            record["reason"] = self.reason
        return record


def check(content: bytes, bits: tuple[int, ...] = BITS) -> Check:
    """Read a certificate and prove every side that it claims, at rising precision; never raises for any content."""
    begun = time.perf_counter()

    def ended(outcome: Outcome, reason: str, certificate: Certificate | None, at: int) -> Check:
        return Check(outcome, reason, certificate, at, time.perf_counter() - begun)

    try:
        certificate = read(content)
    except Malformed as problem:
        return ended(Outcome.MALFORMED, str(problem), None, 0)
    reason = ""
    for at in bits:
        try:
            with precision(at):
                _prove(certificate)
            return ended(Outcome.PROVED, "", certificate, at)
        except Malformed as problem:
            return ended(Outcome.MALFORMED, str(problem), certificate, at)
        except Refuted as problem:
            return ended(Outcome.REFUTED, str(problem), certificate, at)
        except (Inconclusive, ZeroDivisionError, OverflowError, MemoryError) as problem:
            reason = str(problem) or type(problem).__name__
    return ended(Outcome.INCONCLUSIVE, reason, certificate, bits[-1])


def check_file(path: Path) -> Check:
    """`check` of a file's bytes; raises `OSError` if it cannot be read."""
    return check(path.read_bytes())


def _prove(certificate: Certificate) -> None:
    task = certificate.task
    plants = tuple(plant(data, task) for data in task.plants)
    if len({str(own.rest_input) for own in plants}) != 1:
        raise Malformed("the plants share one final rest input")
    if certificate.impossible is not None:
        if certificate.lower is not None or certificate.upper is not None:
            raise Malformed("an impossible task has no maneuver time")
        impossible.prove(task, plants, certificate.impossible, certificate.lower_witness)
        return
    if certificate.lower is not None and certificate.lower > 0:
        if certificate.lower_witness is None:
            raise Malformed("the lower bound has no witness")
        lower.prove(task, plants, certificate.lower_witness, certificate.lower)
    if certificate.upper is not None:
        if certificate.upper_witness is None:
            raise Malformed("the upper bound has no witness")
        upper.prove(task, plants, certificate.upper_witness, certificate.upper)


def decimal(value: fmpq, digits: int, away: int) -> str:
    """`value` ≥ 0 with `digits` significant digits, rounded down (away = 0) or up (1), exactly."""
    if value == 0:
        return "0"
    p, q = int(value.p), int(value.q)
    places = digits - 1 - (len(str(p)) - len(str(q)))
    scaled = (p * 10**places, q) if places >= 0 else (p, q * 10**-places)
    whole, rest = divmod(*scaled)
    whole += 1 if away and rest else 0
    if places <= 0:
        return str(whole * 10**-places)
    text = str(whole).rjust(places + 1, "0")
    return f"{text[:-places]}.{text[-places:]}".rstrip("0").rstrip(".")


def down(value: fmpq | None) -> str | None:
    """A lower bound for people and scripts: at most the proven one."""
    return None if value is None else decimal(value, 17, 0)


def up(value: fmpq | None) -> str | None:
    """An upper bound for people and scripts: at least the proven one."""
    return None if value is None else decimal(value, 17, 1)


def claim(certificate: Certificate) -> str:
    """The whole claim in words, so that a reader can see which problem it is about."""
    task = certificate.task
    lines = ["Plant (highest power of s first):"]
    for data in task.plants:
        lines.append(f"  numerator    {_polynomial(data.numerator)}")
        lines.append(f"  denominator  {_polynomial(data.denominator)}")
        if data.zeros:
            lines.append("  further zeros of the command: " + ", ".join(f"{count} at {name}" for name, count in sorted(data.zeros.items())))
    rest = (
        "the output stays at its target from T on, and the input tends to its final rest value (output rest)"
        if task.output_rest
        else "the state stays at rest from T on (state rest)"
    )
    lines += [
        f"Task: from rest at input {_text(task.initial_input)} move the output by {_text(task.displacement)}; {rest}.",
        f"Limits: {_text(task.lower_limit)} ≤ u(t) ≤ {_text(task.upper_limit)} for all t ≥ 0.",
    ]
    if certificate.impossible:
        lines.append("Claim: no measurable command within the limits does this in any time.")
    else:
        sides = []
        if certificate.lower is not None:
            sides.append(f"no measurable command within the limits does this in less than {down(certificate.lower)} s")
        if certificate.upper is not None:
            sides.append(f"one does it in at most {up(certificate.upper)} s")
        lines.append("Claim: " + "; ".join(sides) + ".")
    return "\n".join(lines)


def _polynomial(coefficients: tuple[fmpq, ...]) -> str:
    return "[" + ", ".join(_text(c) for c in reversed(coefficients)) + "]"


def _text(value: fmpq) -> str:
    text = str(value)
    return text if len(text) <= 40 else f"{arb(value).str(17, radius=False)}…"
