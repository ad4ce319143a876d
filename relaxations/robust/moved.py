"""Boxes of a plant that is given as numbers: parameters move its roots, by factors or, of a mode, to a damping ratio.

    mode[i].frequency  f:  ω → f ω        mode[i].damping  ζ:  p = ω (-ζ ± j √(1 - ζ²))        zero[i]  g:  z → g z

All other roots stay where they are, and so does the static gain, poles at the origin aside.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from flint import arb, fmpq_poly

from relaxations.digits import roots_near
from relaxations.errors import ManeuverError
from relaxations.plants import ROOT_BITS, LinearPlant, Pole, fraction, precision
from relaxations.robust.boxes import Axis, Family, Polynomial

NAME = re.compile(r"(?P<root>(?P<kind>mode|zero)\[[1-9]\d{0,2}\])(?(kind)(?:\.(?P<what>frequency|damping))?)")
PLAIN = 10**15  # a damping ratio that is this close to a fraction with a smaller denominator is meant to be it
CLOSE = Fraction(1, 10**40)

Terms = dict[tuple[int, ...], Fraction]


@dataclass(frozen=True, slots=True)
class Moved(Family):
    """The plants of such a box, to many digits: the exact ones are known by the plant and the names of the parameters."""


@dataclass(frozen=True, slots=True)
class Move:
    """What a parameter moves: a root by its name, and `what` of it: "frequency", "damping" or "place"."""

    root: str
    what: str

    @staticmethod
    def of(name: str) -> Move | None:
        """From a parameter's name: `mode[i].frequency`, `mode[i].damping` or `zero[i]`; None for any other."""
        found = NAME.fullmatch(name)
        if found is None or (found["kind"] == "mode") != bool(found["what"]):
            return None
        return Move(found["root"], found["what"] or "place")


def nominal(plant: LinearPlant, name: str) -> Fraction:
    """A parameter's value in the plant itself: 1 for factors, or the damping ratio."""
    move = Move.of(name)
    return _damping(plant, named(plant)[move.root]) if move is not None and move.what == "damping" else Fraction(1)


def axis(plant: LinearPlant, name: str, low: Fraction, high: Fraction) -> Axis:
    """A parameter with its nominal value; raises `ManeuverError` for a root that the plant does not have, or a range that is none."""
    move = Move.of(name)
    if move is None:
        raise ManeuverError(f"{name} names no root; valid are mode[i].frequency, mode[i].damping, zero[i]")
    roots = named(plant)
    if move.root not in roots:
        known = ", ".join(f"{key} ({_shown(root.value)})" for key, root in roots.items())
        raise ManeuverError(f"the plant has no {move.root}; it has {known or 'neither flexible modes nor zeros'}")
    root, rivals = roots[move.root], [other.value for key, other in roots.items() if key[:4] == move.root[:4]]
    if sum(abs(abs(other) - abs(root.value)) <= 1e-12 * abs(root.value) for other in rivals) > 1:
        raise ManeuverError(f"which one {move.root} is is not defined: another one is as large, {abs(root.value):.6g} rad/s")
    if move.what != "place" and root.multiplicity > 1:
        raise ManeuverError(f"{move.root} is a repeated mode: beside the origin a box is about simple poles")
    if move.what == "damping":
        if not 0 <= low <= high < 1:
            raise ManeuverError(
                f"a damping ratio lies from 0 to below 1: less is unstable, more no flexible mode; not [{_n(low)}, {_n(high)}]"
            )
    elif not low > 0:
        raise ManeuverError(f"a factor is more than 0, not {_n(low)}")
    usual = nominal(plant, name)
    if not low - CLOSE <= usual <= high + CLOSE:
        why = "the factor 1" if move.what != "damping" else f"its damping ratio, {float(usual):.10g},"
        raise ManeuverError(f"{why} of the nominal plant is not in [{_n(low)}, {_n(high)}]")
    return Axis(name, min(max(usual, low), high), low, high)  # of a ratio that is no fraction a range without width holds the nearest one


def named(plant: LinearPlant) -> dict[str, Pole]:
    """The roots that can be moved, by their names."""
    return {f"mode[{i}]": pole for i, pole in enumerate(plant.flexible, 1)} | {f"zero[{i}]": zero for i, zero in enumerate(plant.zeros, 1)}


def _shown(value: complex) -> str:
    """A root for people."""
    return f"{value.real:.6g} ± {value.imag:.6g} j" if value.imag else f"{value.real:.6g}"


def moved(plant: LinearPlant, axes: Sequence[Axis]) -> Moved:
    """The plants over axes made by `axis`."""
    places = {Move.of(axis.name): i for i, axis in enumerate(axes)}

    def powers(*ones: int | None) -> tuple[int, ...]:
        return tuple(ones.count(i) for i in range(len(axes)))

    numerator, one = plant.numerators[plant.output], {powers(): Fraction(1)}
    above: list[list[Terms]] = [[{powers(): fraction(numerator.leading_coefficient())}]]
    below: list[list[Terms]] = [[one]]
    names = {root: name for name, root in named(plant).items()}
    gained: list[list[Terms]] = []  # what keeps the static gain of poles that are moved
    for kind, which, gains, found in (
        ("frequency", below, gained, exactly(plant.denominator, plant.poles)),
        ("place", above, below, exactly(numerator, plant.zeros)),
    ):
        for root, (real, imaginary) in found:
            name = names.get(root, "") if kind == "place" or root.is_flexible else ""
            scale, damping = places.get(Move(name, kind)), places.get(Move(name, "damping"))
            factor: list[Terms] = [one, {powers(scale): -real}]
            if root.is_flexible:
                middle = {powers(scale): -2 * real} if damping is None else {powers(scale, damping): 2 * magnitude(real, imaginary)}
                factor = [one, middle, {powers(scale, scale): real * real + imaginary * imaginary}]
            which += [factor] * root.multiplicity
            if scale is not None:
                gains += [[{powers(scale): Fraction(1)}]] * (root.multiplicity * (1 + root.is_flexible))
    others = []
    zeros = any(move is not None and move.what == "place" for move in map(Move.of, (axis.name for axis in axes)))
    for key, own in plant.numerators.items():
        whole, rest = divmod(own, numerator)
        if key in (plant.output, "output_rate") or not own or own.degree() >= plant.order or (rest and zeros):
            continue  # of some it is not known where their zeros go
        factor = [{powers(): fraction(c)} for c in reversed((own if rest else whole).coeffs())]
        others.append((key, _product([factor, *gained] if rest else [*above, *gained, factor])))
    return Moved(_product([*above, *gained]), _product(below), tuple(others), plant.output)


def exactly(polynomial: fmpq_poly, roots: Sequence[Pole]) -> list[tuple[Pole, tuple[Fraction, Fraction]]]:
    """Roots with many digits, real and imaginary part; what is exactly 0 of them is so here."""
    with precision(ROOT_BITS):
        found = roots_near(roots, polynomial, ROOT_BITS)
    parts = [(fraction(value.real.fmpq()), fraction(value.imag.fmpq())) for value, _, _ in found]
    return [
        (root, (real if root.value.real else Fraction(0), imaginary if root.value.imag else Fraction(0)))
        for root, (real, imaginary) in zip(roots, parts, strict=True)
    ]


def magnitude(real: Fraction, imaginary: Fraction) -> Fraction:
    """|p|, to many digits."""
    square = real * real + imaginary * imaginary
    with precision(ROOT_BITS):
        return fraction((arb(square.numerator) / square.denominator).sqrt().mid().fmpq())


def _damping(plant: LinearPlant, mode: Pole) -> Fraction:
    """-Re p/|p|, to many digits; the decimal that it was written as, if it was."""
    real, imaginary = next(parts for root, parts in exactly(plant.denominator, plant.poles) if root == mode)
    near = -real / magnitude(real, imaginary)
    plain = near.limit_denominator(PLAIN)
    return plain if abs(plain - near) < CLOSE else near


def _n(value: Fraction) -> str:
    return f"{float(value):.10g}"


def _product(factors: Sequence[Sequence[Terms]]) -> tuple[Polynomial, ...]:
    """The product of polynomials in s, highest power first, whose coefficients are polynomials in the parameters."""
    total: list[Terms] = [{}]
    for k, factor in enumerate(factors):
        if k == 0:
            total = [dict(terms) for terms in factor]
            continue
        product: list[Terms] = [{} for _ in range(len(total) + len(factor) - 1)]
        for i, one in enumerate(total):
            for j, other in enumerate(factor):
                for powers, a in one.items():
                    for more, b in other.items():
                        both = tuple(p + q for p, q in zip(powers, more, strict=True))
                        product[i + j][both] = product[i + j].get(both, Fraction(0)) + a * b
        total = product
    return tuple(tuple((c, powers) for powers, c in terms.items() if c) for terms in total)
