"""What a sweep of budgets comes to: points, a curve of them for each kind of command, prudent choices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

from relaxations.bounds import Bound
from relaxations.maneuvers import Problem
from relaxations.transition_fuels import Node
from suite.fuel_weights import Weight
from suite.quantities import Modes
from suite.study import Study
from suite.sweeps import claimed, sides

LEVEL = 0.05  # at which insensitivity is measured unless said otherwise
HIGHER = 3.0  # times the highest frequency that is modelled: about where the mode is that nobody modelled
BENT = 2.0  # a knee bends the curve this many times as much as the curve is bent before it bends the next time
MOST_KNEES = 4  # of a curve: the clearest ones
CLEAR = 1e-9  # gap above which a point says nothing about the curve's bends


@dataclass(frozen=True, slots=True)
class Kind:
    """What a command leaves at rest: `zeros` further zeros at each flexible mode; None: flexible modes are left alone."""

    name: str
    zeros: int | None

    @property
    def title(self) -> str:
        """As it stands in texts and pictures."""
        return "rigid body" if self.zeros is None else self.name.upper()


@dataclass(frozen=True, slots=True)
class Pulses:
    """A command of three levels by its switches: `times` [s] from 0 to T, and on which side of the rest it is in between (1, 0, -1).

    `type` is 1 if all pulses of one side come first, 2 if they alternate; None of other commands.
    """

    times: tuple[float, ...]
    sides: tuple[int, ...]

    @property
    def count(self) -> int:
        """How many pulses."""
        return sum(side != 0 for side in self.sides)

    @property
    def type(self) -> int:
        """See above."""
        signs = [side for side in self.sides if side]
        return 1 if sum(a != b for a, b in pairwise(signs)) <= 1 else 2


@dataclass(frozen=True, slots=True)
class Point:
    """The minimum time of one budget [input units · s], exact; its command's insensitivity, and what it leaves of an unmodelled mode."""

    fuel: Fraction
    bound: Bound
    pulses: Pulses | None = None
    burnt: float | None = None
    insensitivity: float | None = None
    higher_mode: float | None = None
    certificate: Path | None = None

    @property
    def status(self) -> str:
        """`proved`, `bracketed` or `impossible`."""
        return self.bound.status.name.lower()

    @property
    def lower(self) -> float | None:
        """The lower side [s], if it is proven."""
        return self.bound.lower if "lower" in claimed(self.bound) else None

    @property
    def upper(self) -> float | None:
        """The upper side [s], if it is proven."""
        return self.bound.upper if "upper" in claimed(self.bound) else None

    def to_dict(self) -> dict[str, Any]:
        """A point of `fuel --json`."""
        bound, pulses = self.bound, self.pulses
        record: dict[str, Any] = {
            "fuel": float(self.fuel),
            "status": self.status,
            "maneuver_time": sides(bound),
            "proven": {"lower": self.lower is not None, "upper": self.upper is not None},
            "burnt": self.burnt,
            "pulses": None if pulses is None else pulses.count,
            "type": None if pulses is None else pulses.type,
            "switch_times": None if pulses is None else list(pulses.times),
            "sides": None if pulses is None else list(pulses.sides),
            "insensitivity": self.insensitivity,
            "higher_mode": self.higher_mode,
            "certificate": None if self.certificate is None else str(self.certificate),
        }
        return record if bound.reason is None else {**record, "reason": bound.reason}


@dataclass(frozen=True, slots=True)
class Curve:
    """The points of one kind by ascending fuel; `free` is its fastest command without a budget, `least` [input units · s] the fuel that
    every command of it needs, whatever its time, where that is more than 0. `efficient` is the fastest command without a budget whose
    pulses go one way first, then the other (type 1); `held` are points of that form at budgets where the fastest command is not of it."""

    kind: Kind
    posed: Problem
    free: Point
    points: tuple[Point, ...]
    least: float | None = None
    efficient: Point | None = None
    held: tuple[Point, ...] = ()

    @property
    def penalty(self) -> tuple[float, Point] | None:
        """By what share the form costs the most, and where: the command of type 1 over the fastest one; None if that is not known."""
        pairs = [(point.bound.upper, self.at(point.fuel), point) for point in self.held]
        if self.efficient is not None and self.efficient.bound.upper is not None and self.free.bound.upper is not None:
            pairs.append((self.efficient.bound.upper, self.free, self.efficient))
        known = [(up / free.bound.upper - 1.0, one) for up, free, one in pairs if up is not None and free and free.bound.upper]
        return max(known, key=lambda pair: pair[0], default=None)

    @property
    def knees(self) -> tuple[Point, ...]:
        """Where a little less fuel suddenly costs much more time: the points at which the sampled curve bends most; measured."""
        return _knees([p for p in self.points if p.bound.upper is not None and (p.bound.gap or 0.0) <= CLEAR])

    @property
    def turns(self) -> tuple[tuple[Point, Point], ...]:
        """Neighbours of which one has pulses of one side first and the other has not."""
        pairs = zip(self.points, self.points[1:], strict=False)
        return tuple((a, b) for a, b in pairs if a.pulses and b.pulses and a.pulses.type != b.pulses.type)

    def at(self, fuel: Fraction) -> Point | None:
        """The point of this budget."""
        return next((point for point in self.points if point.fuel == fuel), None)

    def to_dict(self) -> dict[str, Any]:
        """A curve of `fuel --json`."""
        return {
            "kind": self.kind.name,
            "robustness": self.kind.zeros,
            "unlimited": self.free.to_dict() | {"fuel": None},
            "least_fuel": self.least,
            "points": [point.to_dict() for point in self.points],
            "fuel_efficient": None if self.efficient is None else self.efficient.to_dict() | {"fuel": None},
            "held": [point.to_dict() for point in self.held],
            "knees": [float(point.fuel) for point in self.knees],
        }


@dataclass(frozen=True, slots=True)
class Choice:
    """A prudent budget: a little less would cost much more time. `node` is what it is by the closed form, None: a knee of the samples."""

    kind: Kind
    fuel: Fraction
    node: Node | None = None

    @property
    def why(self) -> str:
        """In words."""
        if self.node is None:
            return "knee of the curve (measured)"
        return f"just above node {self.node.number}, at one pulse either way"

    def to_dict(self) -> dict[str, Any]:
        """A choice of `fuel --json`."""
        node = self.node
        told = None if node is None else {"number": node.number, "fuel": node.fuel, "maneuver_time": node.maneuver_time}
        return {"kind": self.kind.name, "robustness": self.kind.zeros, "fuel": float(self.fuel), "node": told}


@dataclass(frozen=True, slots=True)
class Settings:
    """What is measured of every command: insensitivity at `level`, the largest excitation around `higher` times the highest frequency."""

    level: float = LEVEL
    higher: float = HIGHER


@dataclass(frozen=True, slots=True)
class FuelSweep:
    """The curves, the prudent choices, the budgets shown in full, what a reader should know, and α_crit against the displacement."""

    study: Study
    modes: Modes
    settings: Settings
    curves: tuple[Curve, ...]
    choices: tuple[Choice, ...]
    shown: tuple[Fraction, ...]
    seconds: float
    notes: tuple[str, ...] = ()
    weights: tuple[Weight, ...] = ()

    @property
    def unit(self) -> str:
        """Of fuel."""
        return f"{self.study.plant.input_unit or 'input'}·s"

    @property
    def impossible(self) -> bool:
        """Whether a budget is proven to be too small for a kind."""
        return any(point.status == "impossible" for curve in self.curves for point in curve.points)

    def curve(self, kind: Kind) -> Curve:
        """That of a kind."""
        return next(curve for curve in self.curves if curve.kind == kind)

    def to_dict(self) -> dict[str, Any]:
        """The object of `fuel --json` (docs/schemas.md)."""
        return {
            "study": str(self.study.file),
            "fuel_unit": self.unit,
            "modes": [{"frequency": frequency, "damping": damping} for frequency, damping in self.modes],
            "level": self.settings.level,
            "higher_mode": self.settings.higher,
            "curves": [curve.to_dict() for curve in self.curves],
            "choices": [choice.to_dict() for choice in self.choices],
            "critical_weights": [weight.to_dict() for weight in self.weights],
            "shown": [float(fuel) for fuel in self.shown],
            "notes": list(self.notes),
            "seconds": round(self.seconds, 6),
        }


def _knees(points: Sequence[Point]) -> tuple[Point, ...]:
    """The points at which the curve of time against fuel bends most, from more fuel to less."""
    bends = []
    for before, here, after in zip(points, points[1:], points[2:], strict=False):
        left, right = float(here.fuel - before.fuel), float(after.fuel - here.fuel)
        times = [point.bound.upper or 0.0 for point in (before, here, after)]
        bends.append(2.0 * ((times[0] - times[1]) / left - (times[1] - times[2]) / right) / (left + right))
    found: list[tuple[float, Point]] = []
    top, place, flat = 0.0, -1, 0.0
    for i in reversed(range(len(bends))):
        if bends[i] >= top and bends[i] > BENT * flat:
            top, place = bends[i], i
        elif place >= 0 and bends[i] * BENT < top:
            knee = points[place + 1]
            found.append((top * float(knee.fuel) ** 2 / (knee.bound.upper or 1.0), knee))  # whatever the units of fuel and time
            top, place, flat = 0.0, -1, max(bends[i], 0.0)
        if place < 0:
            flat = min(flat, max(bends[i], 0.0))
    clearest = sorted(found, key=lambda pair: -pair[0])[:MOST_KNEES]
    return tuple(sorted((knee for _, knee in clearest), key=lambda point: -point.fuel))
