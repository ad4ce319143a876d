"""`slewcert tradeoff`: the minimum time against the residual that is allowed, and against the width of the box of uncertain parameters.

Every point is a robust task of its own, with a certificate of its own. A smaller tolerance, or a box around another one, asks for more, so
the minimum time can only grow: what is proven at the points bounds it between them, too (`sweeps.stairs`).
"""

from __future__ import annotations

import json
from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from decimal import Context, Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

from relaxations.bounds import Bound, Status
from relaxations.errors import ManeuverError
from relaxations.maneuvers import Problem, problem
from relaxations.plants import LinearPlant, fraction
from relaxations.proofs import minimum_time
from relaxations.robust.boxes import Axis, Box, Family, Listed
from relaxations.robust.worst import WorstResidual, worst_residual
from suite.design import pose
from suite.errors import ABSENT, Mistake, StudyError, SuiteError
from suite.plants import nominal_plant, nominal_value
from suite.spans import span
from suite.study import Study, Uncertainty
from suite.sweeps import claimed, kept, sides

MOST_POINTS = 200
ROUND_NUMBERS = (Fraction(1), Fraction(3, 2), Fraction(2), Fraction(3), Fraction(5), Fraction(7))  # and their tenths, hundredths …
AROUND = Fraction(1, 10), Fraction(4)  # times the study's tolerance: how far the tolerances reach unless said otherwise
WIDTHS = tuple(Fraction(k, 4) for k in range(7))
NEIGHBOURS = Fraction(11, 10)  # a round tolerance that is nearer than this factor to the study's own is left out
USUAL = Fraction(1, 20)  # the tolerance of a study that names none
EXACT = Context(prec=400)  # every number that a study can hold, scaled, is a decimal of fewer digits
ALONE = Axis("nominal plant", Fraction(0), Fraction(0), Fraction(0))
"""The box of a study that has none: a parameter that nothing depends on, and that cannot change."""

FURTHER = (0, 1, 2)  # further zeros of the commands that are shown beside the box's


class TradeoffError(SuiteError):
    """The points or the file that are asked for make no sense."""


@dataclass(frozen=True, slots=True)
class Point:
    """The minimum time of one tolerance (a fraction of the displacement) and one width (times the study's box), both exact.

    `ranges` are those of the parameters then. `bound` is None where there is no such task, for instance because a plant in the box is
    unstable; `refused` says why. `sampled` tells a box of which some plants only are known. `certificate` is the file of the proof.
    """

    tolerance: Fraction
    width: Fraction
    ranges: tuple[tuple[str, float, float], ...]
    bound: Bound | None
    refused: str | None = None
    sampled: bool = False
    certificate: Path | None = None

    @property
    def status(self) -> str:
        """`proved`, `bracketed`, `impossible`, or `refused`."""
        return "refused" if self.bound is None else self.bound.status.name.lower()

    @property
    def lower(self) -> float | None:
        """The lower side [s], if it is proven; of a box that is sampled, too: its witness looks at some plants only."""
        return self.bound.lower if self.bound is not None and "lower" in claimed(self.bound) else None

    @property
    def upper(self) -> float | None:
        """The upper side [s], if it is proven for the whole box."""
        return self.bound.upper if self.bound is not None and "upper" in claimed(self.bound) and not self.sampled else None

    def to_dict(self) -> dict[str, Any]:
        """A point of `tradeoff --json`."""
        record: dict[str, Any] = {
            "tolerance": float(self.tolerance),
            "width": float(self.width),
            "ranges": {name: [low, high] for name, low, high in self.ranges},
            "status": self.status,
            "maneuver_time": sides(self.bound),
            "proven": {"lower": self.lower is not None, "upper": self.upper is not None},
            "certificate": None if self.certificate is None else str(self.certificate),
        }
        reason = self.refused or (self.bound and self.bound.reason)
        return {**record, "reason": reason} if reason else record


@dataclass(frozen=True, slots=True)
class Usual:
    """The fastest command with `robustness` further zeros, and what it leaves in the study's box (None: that is not proven)."""

    robustness: int
    bound: Bound
    worst: WorstResidual | None
    certificate: Path | None = None

    def to_dict(self) -> dict[str, Any]:
        """A command of `tradeoff --json`."""
        return {
            "robustness": self.robustness,
            "status": self.bound.status.name.lower(),
            "maneuver_time": sides(self.bound),
            "worst_residual": None if self.worst is None else float(self.worst.tolerance),
            "certificate": None if self.certificate is None else str(self.certificate),
        }


@dataclass(frozen=True, slots=True)
class Tradeoff:
    """Both sweeps, ascending, through the study's own point; `usual` commands beside them, and what a reader should know."""

    study: Study
    tolerance: Fraction
    tolerances: tuple[Point, ...]
    widths: tuple[Point, ...]
    usual: tuple[Usual, ...]
    seconds: float
    notes: tuple[str, ...] = ()

    @property
    def own(self) -> Point:
        """The study's own tolerance and box."""
        return next(point for point in self.tolerances if point.tolerance == self.tolerance)

    @property
    def points(self) -> tuple[Point, ...]:
        """All of them, the study's own once."""
        return (*self.tolerances, *(point for point in self.widths if point.width != 1))

    @property
    def impossible(self) -> bool:
        """Whether a point is proven impossible."""
        return any(point.status == "impossible" for point in self.points)

    def to_dict(self) -> dict[str, Any]:
        """The object of `tradeoff --json` (docs/schemas.md)."""
        return {
            "study": str(self.study.file),
            "tolerance": float(self.tolerance),
            "tolerances": [point.to_dict() for point in self.tolerances],
            "widths": [point.to_dict() for point in self.widths],
            "commands": [command.to_dict() for command in self.usual],
            "notes": list(self.notes),
            "seconds": round(self.seconds, 6),
        }


def tolerances(text: str | None, own: Fraction) -> tuple[Fraction, ...]:
    """`LO:HI:N` as N tolerances of equal ratio, to three digits, and the study's own; without it, round numbers around that one."""
    if text is None:
        low, high = (own * factor for factor in AROUND)
        decades = [Fraction(10) ** k for k in range(-12, 1)]
        found = {x * d for d in decades for x in ROUND_NUMBERS if low <= x * d <= high and x * d < 1}
        found = {x for x in found if not own / NEIGHBOURS < x < own * NEIGHBOURS}
    else:
        low, high, count = span("--tolerances", text, MOST_POINTS, "0.005:0.2:9", TradeoffError)
        if not 0 < low < high < 1:
            raise TradeoffError(f"--tolerances {text}: fractions of the displacement, more than 0 and less than 1")
        ratio = float(high / low) ** (1 / (count - 1))
        found = {low, high, *(Fraction(f"{float(low) * ratio**i:.3g}") for i in range(1, count - 1))}
    return tuple(sorted({*found, own}))


def widths(text: str | None) -> tuple[Fraction, ...]:
    """`LO:HI:N` as N equally spaced widths, times the study's box, and 1, which is that box; without it, 0 to 1.5."""
    if text is None:
        return WIDTHS
    low, high, count = span("--widths", text, MOST_POINTS, "0:1.5:7", TradeoffError)
    if low < 0:
        raise TradeoffError(f"--widths {text}: times the study's box, 0 (the nominal plant) or more")
    return tuple(
        sorted({*(Fraction(round((low + (high - low) * Fraction(i, count - 1)) * 10**6), 10**6) for i in range(count)), Fraction(1)})
    )


@dataclass(frozen=True, slots=True)
class Plan:
    """What is to be bracketed: the study, its nominal plant and tolerance, the points of both sweeps, and notes."""

    study: Study
    plant: LinearPlant
    own: Fraction
    tolerances: tuple[Fraction, ...]
    widths: tuple[Fraction, ...]
    notes: tuple[str, ...]

    @property
    def count(self) -> int:
        """How many minimum times."""
        return len(self.tolerances) + max(len(self.widths) - 1, 0) + len(FURTHER)


def plan(study: Study, tolerances_: str | None = None, widths_: str | None = None) -> Plan:
    """Choose the points; raises `StudyError` for a study that has no such trade-off, `TradeoffError` for options that make no sense."""
    mistakes, notes = [], []
    if study.command.alpha is not None:
        mistakes.append(Mistake("command.alpha", study.command.alpha, "a trade-off is one of the fastest commands"))
    if study.command.kind != "time-optimal":
        mistakes.append(Mistake("command.kind", study.command.kind, "a trade-off is one of time-optimal commands"))
    if study.command.type == 1:
        mistakes.append(Mistake("command.type", 1, "a trade-off is one of commands of any form"))
    if study.command.tail:
        why = "a trade-off is about residuals of every plant of a box, and a tail hides in the zeros of one plant only"
        mistakes.append(Mistake("command.tail", True, why))
    if study.plant.schedule is not None:
        mistakes.append(Mistake("plant", ABSENT, "varies while it moves: a trade-off is about plants of a box, none of which does"))
    if not study.uncertainties and widths_ is not None:
        mistakes.append(Mistake("uncertainty", ABSENT, "is missing: without a box there is nothing that --widths could widen"))
    if mistakes:
        raise StudyError(str(study.file), mistakes)
    own = study.command.tolerance if study.command.robustness == "box" else None
    if own is None:
        limits = [(r.maximum, r.id) for r in study.requirements if r.quantity.name == "residual_vibration" and r.maximum and r.maximum < 1]
        limit, source = min(limits, default=(None, ""))
        own = Decimal(repr(limit)) if limit else None
        chosen = f"{limit:g}, as {source} limits the residual vibration" if limit else f"{float(USUAL):g}, for want of another"
        notes.append(f'the study asks for robustness = {json.dumps(study.command.robustness)}; this is about "box", its tolerance {chosen}')
    if not study.uncertainties:
        notes.append("the study has no [[uncertainty]], so no box to widen: the residual is that of the nominal plant")
    centre = USUAL if own is None else Fraction(own)
    return Plan(
        study,
        nominal_plant(study),
        centre,
        tolerances(tolerances_, centre),
        widths(widths_) if study.uncertainties else (),
        tuple(notes),
    )


def tradeoff(planned: Plan, certificates: Path | None = None, advance: Callable[[], None] = lambda: None) -> Tradeoff:
    """Bracket every point, each search begun where its neighbour's ended; proofs are written to the folder `certificates`.

    Raises `StudyError` if the study's own point makes no sense.
    """
    study, own = planned.study, planned.own
    posed = _posed(planned, own, Fraction(1))
    stem = study.file.stem

    def proof(name: str, found: Bound | WorstResidual | None) -> Path | None:
        return kept(certificates, f"{stem}.{name}", found)

    first = _point(planned, own, Fraction(1), posed, None)
    first = replace(first, certificate=proof(f"tolerance-{_named(own)}", first.bound))
    advance()
    sweeps: list[list[Point]] = []
    for values, along in ((planned.tolerances, "tolerance"), (planned.widths, "width")):
        found = {own if along == "tolerance" else Fraction(1): first}
        for value, neighbour in _outward(values, own if along == "tolerance" else Fraction(1)):
            pair = (value, Fraction(1)) if along == "tolerance" else (own, value)
            try:
                asked, trouble = _posed(planned, *pair), None
            except StudyError as refused:
                asked, trouble = None, "; ".join(mistake.message for mistake in refused.mistakes)
            point = _point(planned, *pair, asked, found[neighbour].bound, trouble)
            found[value] = replace(point, certificate=proof(f"{along}-{_named(value)}", point.bound))
            advance()
        sweeps.append([found[value] for value in values])
    usual = []
    for robustness in FURTHER:
        bound = minimum_time(pose(_asking(study, robustness), planned.plant))
        worst = _left(posed, bound) if study.uncertainties else None
        proof(f"robustness-{robustness}.residual", worst)
        usual.append(Usual(robustness, bound, worst, proof(f"robustness-{robustness}", bound)))
        advance()
    done = Tradeoff(study, own, tuple(sweeps[0]), tuple(sweeps[1]), tuple(usual), 0.0, planned.notes)
    bounds = [*(point.bound for point in done.points), *(command.bound for command in usual)]
    return replace(done, seconds=sum(bound.seconds for bound in bounds if bound is not None))


def _outward(values: Sequence[Fraction], own: Fraction) -> Iterator[tuple[Fraction, Fraction]]:
    """Every other value with its neighbour on the side of the study's own."""
    middle = bisect_left(values, own)
    yield from ((values[i], values[i - 1]) for i in range(middle + 1, len(values)))
    yield from ((values[i], values[i + 1]) for i in reversed(range(middle)))


def _asking(study: Study, robustness: int) -> Study:
    return replace(study, command=replace(study.command, robustness=robustness, tolerance=None, final_tolerance=None))


def _scaled(study: Study, width: Fraction) -> tuple[Uncertainty, ...]:
    """The study's ranges, drawn out from or together towards the nominal values."""

    def at(nominal: Fraction, end: Decimal) -> Decimal:
        exact = nominal + width * (Fraction(end) - nominal)
        return EXACT.divide(Decimal(exact.numerator), Decimal(exact.denominator))

    nominals = [nominal_value(study, axis.parameter) for axis in study.uncertainties]
    return tuple(
        replace(axis, lower=at(nominal, axis.lower), upper=at(nominal, axis.upper))
        for axis, nominal in zip(study.uncertainties, nominals, strict=True)
    )


def _posed(planned: Plan, tolerance: Fraction, width: Fraction) -> Problem:
    """The robust task of one point; raises `StudyError` if there is none."""
    study, plant = planned.study, planned.plant
    if not study.uncertainties:
        terms = (plant.numerators[plant.output], plant.denominator)
        upper, lower = (tuple(((fraction(c), (0,)),) for c in reversed(polynomial.coeffs())) for polynomial in terms)
        alone = pose(_asking(study, 0), plant)
        try:
            return problem([plant], replace(alone.maneuver, box=Box((ALONE,), Family(upper, lower), tolerance)))
        except ManeuverError as refused:
            raise StudyError(str(study.file), [Mistake("maneuver", ABSENT, str(refused))]) from None
    final = study.command.final_tolerance if study.command.robustness == "box" else None
    written = EXACT.divide(Decimal(tolerance.numerator), Decimal(tolerance.denominator))
    command = replace(study.command, robustness="box", tolerance=written, final_tolerance=final)
    return pose(replace(study, uncertainties=_scaled(study, width), command=command), plant)


def _point(
    planned: Plan, tolerance: Fraction, width: Fraction, posed: Problem | None, neighbour: Bound | None, trouble: str | None = None
) -> Point:
    """The bracket of one point; `neighbour` is that of the point next to it."""
    ranges = tuple((axis.parameter, float(axis.lower), float(axis.upper)) for axis in _scaled(planned.study, width))
    if posed is None:
        return Point(tolerance, width, ranges, None, trouble)
    box = posed.maneuver.box
    assert box is not None
    try:
        bound = minimum_time(posed, near=neighbour.upper if neighbour is not None else None)
    except ManeuverError as refused:  # a plant of the box that only the search meets
        return Point(tolerance, width, ranges, None, str(refused))
    return Point(tolerance, width, ranges, bound, sampled=isinstance(box.family, Listed))


def _left(posed: Problem, bound: Bound) -> WorstResidual | None:
    """What a command leaves in the study's box, where that can be proven."""
    box = posed.maneuver.box
    if bound.command is None or bound.status is Status.IMPOSSIBLE or box is None or isinstance(box.family, Listed):
        return None
    try:
        return worst_residual(posed, bound.command)
    except ManeuverError:  # a command of ramps
        return None


def _named(value: Fraction) -> str:
    """A number as part of a file's name."""
    return f"{float(value):.10g}"
