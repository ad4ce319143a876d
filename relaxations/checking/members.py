"""A box of plants as a certificate writes it: the plants at its places, what is promised of them, and where each comes to rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

from flint import acb, arb, fmpq, fmpq_poly

from relaxations.checking.balls import spend
from relaxations.checking.reading import MOVED, Refuted, Undecided, require

Numbers = Sequence[arb | fmpq]
LONGEST_POWER = 20_000  # bits of a power of an exact parameter
DISPARATE = 1024  # how much narrower than in other parameters a cell may become


Which = str | tuple[str, str]  # numerator, denominator, or ("outputs", name)


def coefficients(owner: Any, which: Which) -> Any:
    """What is written of a polynomial, of a box or of a plant in its list."""
    return getattr(owner, which) if isinstance(which, str) else owner.outputs[which[1]]


def member(box: Any, place: Numbers, which: Which, derivative: int | None = None) -> list[Any]:
    """The coefficients, lowest power of s first, of a polynomial at a place in the box, or their derivative by a parameter."""
    if box.plants:
        spend(len(box.plants) / 2)
        found = next((coefficients(plant, which) for plant in box.plants if list(plant.place) == list(place)), ())
        require(bool(found), "a place at which no plant of the box is listed")
        return [fmpq(0) if derivative is not None else c for c in reversed(found)]
    return [valued(terms, place, derivative) for terms in reversed(coefficients(box, which))]


def valued(terms: Any, place: Numbers, derivative: int | None = None) -> arb | fmpq:
    """A polynomial in the parameters, or its derivative by one of them."""
    total: arb | fmpq = fmpq(0)
    for coefficient, powers in terms:
        factor: arb | fmpq = coefficient
        for i, (value, power) in enumerate(zip(place, powers, strict=True)):
            if i == derivative:
                factor, power = factor * power, max(power - 1, 0)
            if isinstance(value, fmpq) and value.height_bits() * power > LONGEST_POWER:
                raise Undecided("powers of a parameter are too long")
            if power:  # of a ball about 0 itself the power is no number, of a complex one it is
                factor = factor * ((acb(value) ** power).real if isinstance(value, arb) else value**power)
        spend(1 + len(powers) + (factor.height_bits() / 50 if isinstance(factor, fmpq) else 0))
        total = total + factor
    return total


def moves(box: Any) -> bool:
    """Whether the parameters of a box move roots of the nominal plant: it has neither coefficients nor plants of its own then."""
    return not (box.plants or box.denominator)


MOVING = (
    "  mode[i] is the complex pair of poles, zero[i] the zero (or pair) of the plant above, each counted once, by ascending magnitude;",
    "  frequency, and the parameter zero[i]: a factor of its magnitude; damping: the damping ratio. All other roots stay where they are,",
    "  and so does the static gain: the ratio of the lowest coefficients, poles at the origin aside.",
)


OTHERS = "  Each output keeps its static gain and its zeros; one that has all zeros of y, moved ones among them, keeps having these."


def plants(task: dict[str, Any]) -> list[str]:
    """In words, from the numbers as they are written: which plants the claim is about."""
    if not (box := task["box"]):
        return []
    if not (box["plants"] or box["denominator"]):
        ranges = ", ".join(f"{p['name']} in [{p['low']}, {p['high']}]" for p in box["parameters"])
        return [f"  and every plant that it becomes when these of its roots are moved: {ranges};", *MOVING]
    ranges = ", ".join(f"{p['name']!r} in [{p['low']}, {p['high']}] (nominal {p['nominal']})" for p in box["parameters"])
    if box["plants"]:
        heading = f"  and these {len(box['plants'])} plants of {ranges}; nothing is said of any other plant of these ranges:"
        return [
            heading,
            *(f"  at {', '.join(p['place'])}: [{', '.join(p['numerator'])}] / [{', '.join(p['denominator'])}]" for p in box["plants"]),
            *(f"    {name}: [{', '.join(above)}]" for p in box["plants"] for name, above in p["outputs"].items()),
        ]
    heading = f"  and every plant of the box {ranges}; coefficients in terms of these, (factor, powers):"
    written = [*((which, box[which]) for which in ("numerator", "denominator")), *box["outputs"].items()]
    return [heading, *(f"  {which:<12} {polynomial}" for which, polynomial in written)]


def promises(task: dict[str, Any]) -> list[str]:
    """In words: what they do after the command."""
    if not (box := task["box"]):
        return []
    allowed = f"at most {box['tolerance']} of the displacement instead of 0"
    residual = f"  In every one of these plants the residual |y(t) - y(∞)| for t ≥ T is {allowed};"
    limits = task["limits"]["deflection"]
    courses = ["  The limits of outputs hold in every one of them, for all t ≥ 0."] if limits else []
    if not (box["plants"] or box["denominator"]):
        courses += [OTHERS] if limits else []
        return [*courses, residual, "  y(∞) is the target in all of them, and none keeps drifting."]
    share = box["final_tolerance"]
    where = "" if share is None else f", within {share} of the displacement of it in the others"
    return [*courses, residual, f"  y(∞) is the target in the nominal plant{where}, and no plant keeps drifting."]


def sensible(task: Any) -> None:
    """Raise `Malformed` unless the box, if there is one, is one, and the plant written is its nominal one."""
    if task.box is None:
        return
    box, (plant,), count = task.box, task.plants, len(task.box.parameters)
    require(
        task.rest == "state" and not plant.zeros and task.limits.tail_length is None, "a box belongs to a state rest without further zeros"
    )
    require(box.tolerance > 0, "a tolerance is more than 0")
    require(box.final_tolerance is None or box.final_tolerance >= 0, "a final tolerance is 0 or more")
    names = task.limits.deflection.keys()
    require(plant.outputs.keys() == names, "the outputs written are those whose deflection is limited")
    outputs = [box.outputs] if box.denominator else [one.outputs for one in box.plants]
    fine = all(own.keys() == names for own in outputs) and not (box.outputs and not box.denominator)
    require(fine, "the outputs written of a box are those whose deflection is limited")
    proper = [(box.outputs, box.denominator), *((one.outputs, one.denominator) for one in box.plants)]
    require(all(0 < len(own) < len(d) for found, d in proper for own in found.values()), "outputs of a box are strictly proper")
    if moves(box):
        moving(box)
        return
    fine = all(p.nominal is not None and p.low <= p.nominal <= p.high for p in box.parameters)
    require(fine, "a parameter's nominal value lies in its range")
    require(bool(box.plants) != bool(box.denominator) == bool(box.numerator), "a box has coefficients in terms of parameters, or plants")
    places = [listed.place for listed in box.plants]
    inside = [len(place) == count and all(p.low <= x <= p.high for p, x in zip(box.parameters, place, strict=True)) for place in places]
    require(all(inside) and len(set(places)) == len(places), "plants are listed at different places of the box")
    terms = [
        powers for which in (box.numerator, box.denominator, *box.outputs.values()) for coefficient in which for _, powers in coefficient
    ]
    require(all(len(powers) == count and max(powers, default=0) <= 64 for powers in terms), f"a term has {count} powers of at most 64")
    nominal = [p.nominal for p in box.parameters]
    ours = [member(box, nominal, which) for which in ("numerator", "denominator")]
    require(ours[1][-1] != 0, "the nominal plant of the box has no highest power")
    same = all(
        [c / ours[1][-1] for c in reversed(mine)] == list(theirs)
        for mine, theirs in zip(ours, (plant.numerator, plant.denominator), strict=True)
    )
    require(same, "the plant is not the nominal one of the box")
    for name in names:
        own = fmpq_poly(member(box, nominal, ("outputs", name))) / ours[1][-1]
        require(own == fmpq_poly(list(plant.outputs[name][::-1])), f"the output {name} is not that of the nominal plant")


def moving(box: Any) -> None:
    """Raise `Malformed` unless the parameters of a box without coefficients and plants move roots of the nominal plant."""
    require(not box.numerator and all(MOVED.fullmatch(p.name) for p in box.parameters), "parameters without coefficients name roots")
    require(len({p.name for p in box.parameters}) == len(box.parameters), "a root is moved twice in the same way")
    for p in box.parameters:
        if p.name.endswith(".damping"):  # its nominal value is no exact number
            require(p.nominal is None and 0 <= p.low <= p.high < 1, "damping ratios lie from 0 to below 1, and their nominal value is null")
        else:
            require(p.nominal == 1 and 0 < p.low <= 1 <= p.high, "factors are more than 0, and 1 lies in their range")


def rigid(task: Any) -> int:
    """The multiplicity of the pole at the origin, that of the nominal plant: in no plant of the box it may be another."""
    (plant,) = task.plants
    return next(k for k, c in enumerate(reversed(plant.denominator)) if c != 0)


@dataclass(frozen=True, slots=True)
class Shift:
    """Where a plant comes to rest: its gain is `a/d`, the lowest coefficients of N and D (poles at the origin aside).

    The one moment at the origin that moves a body for good, or the one final input, is what brings the nominal plant to its target. So
    `y(∞)/Δ = (a/d) / (a_0/d_0)` whatever the command, and it is within the tolerance v iff `v s a_0 d ∓ (a d_0 - a_0 d) ≥ 0`, s = ±1 the
    sign of `a_0 d_0`.
    """

    task: Any
    nominal: tuple[fmpq, fmpq]

    @staticmethod
    def of(task: Any) -> Shift:
        nominal = [p.nominal for p in task.box.parameters]
        return Shift(task, (member(task.box, nominal, "numerator")[0], member(task.box, nominal, "denominator")[rigid(task)]))

    def room(self, place: Numbers, derivative: int | None = None) -> tuple[Any, Any]:
        """Both sides' left-hand side at a place, times d_0 squared's sign; or their derivative by a parameter."""
        spend(20)
        numerator, denominator = (member(self.task.box, place, which, derivative) for which in ("numerator", "denominator"))
        at, (a0, d0), share = rigid(self.task), self.nominal, self.task.box.final_tolerance
        a, d = numerator[0], denominator[at]
        if derivative is None and not (d * d0 > 0 and not any(denominator[:at])):
            raise Undecided("a plant of the box has another lowest power than the nominal one, or another sign of it")
        wide, off = (abs(a0) if d0 > 0 else -abs(a0)) * share * d, (a * d0 - a0 * d) * (1 if a0 * d0 > 0 else -1)
        return wide - off, wide + off


def too_far(task: Any, place: Sequence[fmpq]) -> None:
    """Prove that the plant at a place rests too far from the target, or raise `Undecided`."""
    box = task.box
    inside = len(place) == len(box.parameters) and all(p.low <= x <= p.high for p, x in zip(box.parameters, place, strict=True))
    require(inside and box.final_tolerance is not None, "a final tolerance, and a place of the box")
    if moves(box):
        raise Undecided("plants whose roots are moved rest at the target")
    if min(Shift.of(task).room(place)) >= 0:
        raise Undecided("the plant named rests within the final tolerance")


def lands(task: Any) -> None:
    """Prove that every plant of the box rests within the final tolerance; raises `Refuted` or `Undecided`."""
    box = task.box
    if box.final_tolerance is None or moves(box):  # a static gain that stays brings every plant to the target
        return
    shift = Shift.of(task)
    ends = [tuple((x, x) for x in plant.place) for plant in box.plants] or [tuple((p.low, p.high) for p in box.parameters)]
    waiting = [(sides, side) for sides in ends for side in (0, 1)]
    while waiting:
        sides, side = waiting.pop()
        cell = [low if low == high else arb(low).union(arb(high)) for low, high in sides]
        slopes = [arb(shift.room(cell, q)[side]) if low != high else arb(0) for q, (low, high) in enumerate(sides)]
        # where it rises or falls with a parameter all over the cell it is least at an end, which is exact
        sides = tuple(
            (low, low) if slope >= 0 else (high, high) if slope <= 0 else (low, high)
            for slope, (low, high) in zip(slopes, sides, strict=True)
        )
        centre = [(low + high) / 2 for low, high in sides]
        least = shift.room(centre, None)[side]
        if least < 0:
            where = ", ".join(f"{float(arb(x).mid()):.6g}" for x in centre)
            raise Refuted(f"the final error exceeds its tolerance at {where}")
        if all(low == high for low, high in sides):
            continue
        slopes = [arb(shift.room([arb(low).union(arb(high)) for low, high in sides], q)[side]) for q in range(len(sides))]
        if arb(least) - sum((abs(slope) * (high - low) / 2 for slope, (low, high) in zip(slopes, sides, strict=True)), arb(0)) >= 0:
            continue
        waiting += [(half, side) for half in halved(task, sides, "the final error is not told from its tolerance somewhere in the box")]


def laid(sides: Sequence[tuple[fmpq, fmpq]]) -> tuple[list[arb | fmpq], list[fmpq], list[arb]]:
    """A cell as balls, its centre and its half widths."""
    cell = [arb(low).union(arb(high)) if low < high else low for low, high in sides]
    return cell, [(low + high) / 2 for low, high in sides], [arb((high - low) / 2) for low, high in sides]


def halved(
    task: Any, sides: Sequence[tuple[fmpq, fmpq]], otherwise: str, bends: Sequence[float] = ()
) -> list[tuple[tuple[fmpq, fmpq], ...]]:
    """A cell in two, across the parameter that bends most what is looked at, or else in which it is widest; raises `Undecided` with a
    sentence where the cell is too small for that."""
    ranges = zip(sides, task.box.parameters, strict=True)
    widths = [(high - low) / (p.high - p.low) if high > low else fmpq(0) for (low, high), p in ranges]
    widest = max(range(len(sides)), key=lambda i: widths[i])
    if widths[widest] < fmpq(1, 2**40):
        raise Undecided(otherwise)
    most = max(range(len(bends)), key=lambda i: bends[i], default=widest)
    if bends and isfinite(bends[most]) and bends[most] > 0 and widths[most] * DISPARATE >= widths[widest]:
        widest = most
    low, high = sides[widest]
    return [
        tuple(half if i == widest else side for i, side in enumerate(sides)) for half in ((low, (low + high) / 2), ((low + high) / 2, high))
    ]
