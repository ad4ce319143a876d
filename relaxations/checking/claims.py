"""The verdict on a certificate, and the claim in words."""

from __future__ import annotations

import time
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from enum import Enum
from types import SimpleNamespace
from typing import Any

import flint
from flint import fmpq

from relaxations.checking import changes, costs, courses, lower, members, pulses, ramps, upper, varying, varying_boxes
from relaxations.checking.balls import system, work
from relaxations.checking.reading import Malformed, Refuted, Undecided, read

REST = {
    "state": "the state (of a controllable realisation) stays at rest from T on (state rest)",
    "output": "the output stays at its target from T on, and the input tends to its final rest value (output rest)",
    "box": "what is asked of every plant from T on is said below (robust rest)",
}
BITS = (128, 256, 512, 1024)
TERMS = 4  # of a power series
WORK, WORK_PER_BYTE, MOST_WORK = 3e6, 500, 5e7  # what a check may cost: some seconds as a rule, half a minute at most


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
    certificate: SimpleNamespace | None
    bits: int
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """The object of `check --json` (docs/schemas.md)."""
        record: dict[str, Any] = {"status": self.outcome.value}
        if self.certificate is not None:
            record["task"] = self.certificate.written["task"]
            if self.outcome is Outcome.PROVED:
                sides = self.certificate.claim
                proven = {"lower": rounded(sides.lower, ROUND_FLOOR), "upper": rounded(sides.upper, ROUND_CEILING)}
                if self.certificate.price is not None:
                    record |= {"maneuver_time": None, "price": self.certificate.written["price"], "cost": proven}
                else:
                    record |= {"maneuver_time": None, "impossible": True} if sides.impossible else {"maneuver_time": proven}
        return record | ({"reason": self.reason} if self.reason else {})


def check(content: bytes) -> Check:
    """Read a certificate and prove every side that it claims, at rising precision; never raises for any content."""
    begun, outside, certificate, bits = time.perf_counter(), (flint.ctx.prec, flint.ctx.cap), None, 0
    outcome, reason = Outcome.INCONCLUSIVE, ""
    try:
        certificate = read(content)
        claimed, box = certificate.claim, certificate.task.box
        cells = 4 ** max(len(box.parameters) - 2, 0) if box else 1  # each further parameter of a box multiplies its cells
        work["left"] = min((WORK + WORK_PER_BYTE * len(content)) * cells, MOST_WORK)
        for bits in BITS:
            flint.ctx.prec, flint.ctx.cap = bits, TERMS
            try:
                if certificate.price is not None:
                    _priced(certificate)
                    outcome, reason = Outcome.PROVED, ""
                    break
                varying.sensible(certificate.task)
                pulses.sensible(certificate.task, certificate.lower)
                if certificate.task.schedule is not None:
                    (varying_boxes if box else varying).prove(certificate)
                    outcome, reason = Outcome.PROVED, ""
                    break
                members.sensible(certificate.task)
                changes.sensible(certificate.task, certificate.lower)
                courses.sensible(certificate.task)
                ramps.sensible(certificate.task, certificate.lower)
                posed = system(certificate.task)
                if claimed.impossible is not None:
                    lower.impossible(posed, claimed.impossible, certificate.lower)
                if claimed.lower:
                    lower.prove(posed, certificate.lower, claimed.lower)
                if claimed.upper is not None:
                    upper.prove(posed, certificate.upper, claimed.upper)
                outcome, reason = Outcome.PROVED, ""
                break
            except (Undecided, ArithmeticError) as problem:
                reason = str(problem)
            if work["left"] < 0:
                break
    except Malformed as problem:
        outcome, reason, certificate = Outcome.MALFORMED, str(problem), None
    except Refuted as problem:
        outcome, reason = Outcome.REFUTED, str(problem)
    except MemoryError:
        reason = "more memory than there is"
    finally:
        flint.ctx.prec, flint.ctx.cap = outside
    return Check(outcome, reason, certificate, bits, time.perf_counter() - begun)


def _priced(certificate: SimpleNamespace) -> None:
    """Prove what a certificate says of a cost; raises `Malformed`, `Refuted` or `Undecided`."""
    costs.sensible(certificate)
    courses.sensible(certificate.task)
    posed, claimed, price = system(certificate.task), certificate.claim, certificate.price
    if claimed.lower is not None:
        costs.prove(posed, price, certificate.lower, claimed.lower, lower.support)
    if claimed.upper is not None:
        upper.cheap(posed, certificate.upper, price, claimed.upper)


def rounded(value: fmpq | None, rounding: str) -> str | None:
    """17 digits for people and scripts, correctly rounded towards the safe side."""
    if value is None:
        return None
    return f"{Context(prec=17, rounding=rounding).divide(Decimal(str(value.p)), Decimal(str(value.q))):f}"


def claim(found: Check) -> str:
    """The whole claim in words, its numbers as written, so that a reader can see which problem it is about; empty if malformed."""
    if found.certificate is None:
        return ""
    task, sides = found.certificate.written["task"], found.certificate.claim
    lines = ["Plant (highest power of s first):"] if task["plants"] else varying.described(task)
    for plant in task["plants"]:
        lines += [f"  {name:<12} [{', '.join(plant[name])}]" for name in ("numerator", "denominator")]
        if plant["zeros"]:
            lines.append("  further zeros of the command: " + ", ".join(f"{count} at {name}" for name, count in plant["zeros"].items()))
    lines += (members.plants if task["plants"] else varying_boxes.described)(task)
    rest, (low, high), tail = REST["box" if task["box"] else task["rest"]], task["limits"]["input"], task["limits"]["tail_length"]
    start, begins = task["initial_state"], f"Task: from rest at input {task['initial_input']}"
    if start is not None and not task["plants"]:
        lines.append(f"Start: x begins at [{', '.join(start)}], deviations from rest at input {task['initial_input']}.")
        begins = "Task: from there"
    elif start is not None:
        lines.append(
            f"Start: D(d/dt) x = u, y = N(d/dt) x, deviations from rest at input {task['initial_input']}, for numerator N, denominator D;"
        )
        lines.append(f"  x and its derivatives begin at [{', '.join(start)}].")
        begins = "Task: from there"
    lines.append(f"{begins} move the output by {task['displacement']}{'' if start is None else ' from that rest'}; {rest}.")
    lines.append(f"Limits: {low} ≤ u(t) ≤ {high} for all t ≥ 0.")
    if fuel := task["limits"]["fuel"]:
        lines.append(f"  The fuel ∫|u(t) - {task['initial_input']}| dt of the move, from 0 to T, is at most {fuel}.")
    for name, limit in task["limits"]["deflection"].items():
        which = f"numerator [{', '.join(task['plants'][0]['outputs'][name])}]" if task["plants"] else "a row times x, as above"
        lines.append(f"  The output {name!r}, {which}, never leaves its first rest value by more than {limit}.")
    if (rate := task["limits"]["rate"]) and task["limits"]["sample_time"]:
        lines.append(f"  From sample to sample, and from and to the rests, u changes by h times a slope in [{rate[0]}, {rate[1]}].")
    elif rate:
        lines.append(f"  u is continuous from its first rest to its last, and its slope stays in [{rate[0]}, {rate[1]}].")
    lines += (members.promises if task["plants"] else varying_boxes.promises)(task)
    if held := task["limits"]["held"]:
        first, second = held.split(", then ")
        lines.append(f"  Form: until some instant of the move u is {task['initial_input']} or on its {first} side, and from then on")
        lines.append(f"  {task['initial_input']} or on its {second} side. The claim is about inputs of this form alone.")
    trees = False
    if (width := task["limits"]["pulse_width"]) is not None or task["limits"]["pulses"] is not None:
        lines.append(f"  Thrusters: until T, u is {low}, {high} or {task['initial_input']}, in pulses (constant pieces other than that)")
        few = "" if task["limits"]["pulses"] is None else f", at most {task['limits']['pulses']} of them"
        trees = bool(found.certificate.lower and found.certificate.lower.pulses)
        whose = "such pulses" if trees else "all inputs in the limits"
        lines.append(f"  {'of any width' if width is None else f'of at least {width} s'}{few}. The lower side is that of {whose}.")
    who = "no command of such pulses" if trees else "no measurable command within the limits"
    if step := task["limits"]["sample_time"]:
        lines.append(f"  u is constant on each [k h, (k + 1) h), h = {step} s, and T is a whole number of h.")
        who = "no command within the limits that is constant over each sample"
    if tail:
        where = f"within {tail['within']} of the nearer limit's distance from its final rest value"
        lines.append(f"  From {tail['time']} s after T on, the input stays {where}.")
    for name, pair in task["limits"]["zero_sensitivity"].items():
        moved = f"moves the output by at most {pair['residual']} of the displacement"
        lines.append(f"  The tail at {name} (zeros by ascending magnitude) {moved}")
        lines.append(f"  if that zero lies elsewhere, by up to {pair['shift']} of its magnitude; to first order in that distance.")
    price = found.certificate.price
    if price is not None:
        burnt = f"∫|u(t) - {task['initial_input']}| dt"
        lines.append(f"Cost: T + {found.certificate.written['price']} {burnt}, in seconds, the integral from 0 to T. T is free.")
    words = [f"{who} does this in any time"] if price is None and sides.impossible else []
    if sides.lower is not None:
        words.append(f"{who} does this {'in' if price is None else 'at a cost of'} less than {rounded(sides.lower, ROUND_FLOOR)} s")
    if sides.upper is not None:
        words.append(f"one does it {'in' if price is None else 'at a cost of'} at most {rounded(sides.upper, ROUND_CEILING)} s")
    heading = "Claim" if found.outcome is Outcome.PROVED else "Not proven"
    return "\n".join([*lines, f"{heading}: {'; '.join(words)}."])
