"""The plants of a box: balls around their poles beside the origin, and the weights N(p)/D'(p) of the motions along these.

There are two kinds: coefficients in terms of parameters (or plants listed one by one), and roots of the nominal plant that parameters move.
A place may be a power series in a real variable t, as cells are followed along lines: poles and weights are then series too.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import flint
from flint import acb, acb_poly, acb_series, arb, fmpq, fmpq_poly

from relaxations.checking.balls import Root, isolated, named, on_axis, spend
from relaxations.checking.members import Numbers, Which, member, moves, rigid
from relaxations.checking.reading import Undecided, require

Tracked = tuple[list[acb], list[acb], list[bool]]
Line = Sequence[acb_series | arb | fmpq]  # a place, or all places of a cell, and where they go as t grows


def family(task: Any) -> Written | Moved:
    """The plants of a task's box."""
    return Moved.of(task) if moves(task.box) else Written(task)


def simple(roots: Sequence[Root]) -> tuple[Root, ...]:
    """Those beside the origin; raises `Undecided` if one of them is repeated."""
    if any(root.multiplicity > 1 and not root.value.is_zero() for root in roots):
        raise Undecided("a plant of the box has a repeated pole beside the origin")
    return tuple(root for root in roots if not root.value.is_zero())


@dataclass(frozen=True, slots=True)
class Written:
    """Plants with coefficients in terms of the parameters, or listed."""

    task: Any

    def member(self, place: Any, which: Which) -> list[Any]:
        """Coefficients, lowest power of s first."""
        return member(self.task.box, place, which)

    def roots(self, place: Sequence[fmpq]) -> tuple[Root, ...]:
        """The poles beside the origin of the plant at an exact place."""
        denominator = fmpq_poly(self.member(place, "denominator"))
        require(not denominator.is_zero(), "a sample of the box is no plant")
        return simple(isolated(denominator))

    def tracked(self, cell: Numbers, centre: Sequence[fmpq]) -> Tracked | None:
        """The poles at the centre, and balls that hold those of every plant of the cell (interval Newton); None if it is too large."""
        count, roots = rigid(self.task), self.roots(centre)
        whole = [arb(c) for c in self.member(cell, "denominator")]
        if not whole or whole[-1].contains(0) or whole[count].contains(0) or not all(c.is_zero() for c in whole[:count]):
            return None  # somewhere in the cell a plant has other poles, in number or at the origin
        D, even = acb_poly(whole[count:]), all(c.is_zero() for c in whole[count + 1 :: 2])
        found = []
        for root in roots:
            if even:  # in w = p²: real and negative for an undamped plant, and its poles stay on the axis
                w = enclosed(acb_poly(list(D)[::2]), acb((root.value * root.value).real))
                if w is None or not (w.real < 0 or w.real > 0):
                    return None
                found.append(acb(0, (-w.real).sqrt()) if w.real < 0 else acb((w.real).sqrt() if root.value.real > 0 else -(w.real).sqrt()))
            else:
                ball = enclosed(D, root.value)
                if ball is None or (root.flexible and not ball.imag > 0):
                    return None
                found.append(ball)
        if not all(ball.overlaps(root.value) for ball, root in zip(found, roots, strict=True)) or any(
            one.overlaps(other) for one, other in combinations(found, 2)
        ):
            return None  # a ball that holds another pole than its own would leave its own out
        return [root.value for root in roots], found, [root.flexible for root in roots]

    def poles(self, line: Line, starts: Sequence[acb]) -> list[acb_series]:
        """The poles that begin in `starts`, which hold them, by Newton's method on series: the implicit function."""
        D, found = [acb_series([c]) if isinstance(c, fmpq) else c for c in self.member(line, "denominator")], []
        slope = [k * c for k, c in enumerate(D)][1:]
        for start in starts:
            terms = [start]
            for k in range(1, flint.ctx.cap):
                pole = acb_series(terms)
                terms.append(-valued_at(D, pole)[k] / valued_at(slope, pole)[0])
            found.append(acb_series(terms))
        return found

    def weights(self, line: Line, poles: Sequence[acb_series], output: str | None = None) -> list[acb_series]:
        """N(p)/D'(p) of the controlled output, or of a named one."""
        N, D = (self.member(line, which) for which in (chosen(output), "denominator"))
        slope = [k * c for k, c in enumerate(D)][1:]
        return [over(valued_at(N, pole), valued_at(slope, pole)) for pole in poles]

    def at_origin(self, line: Line, output: str, count: int) -> list[acb_series]:
        """The first terms of N/(D/s^r) at s = 0, r poles there, of a named output."""
        N, D = ([as_series(c) for c in self.member(line, which)] for which in (chosen(output), "denominator"))
        if not all(c.is_zero() for coefficient in D[: rigid(self.task)] for c in coefficient.coeffs()):
            raise Undecided("a plant of the box has fewer poles at the origin than the nominal one")
        return quotient(N, D[rigid(self.task) :], count)

    def settled(self, sides: Sequence[tuple[fmpq, fmpq]]) -> bool:
        """Whether no plant of a cell is unstable. Where that is not seen at once, a parameter that damps all poles in question, in all the
        cell, is set to where it damps least: there they may lie on the imaginary axis exactly."""
        centre, cell = [(low + high) / 2 for low, high in sides], [arb(low).union(arb(high)) if low < high else low for low, high in sides]
        poles = self.tracked(cell, centre)
        if poles is None:
            return False
        doubtful = [ball for ball in poles[1] if not ball.real <= 0]
        if not doubtful:
            return True
        for q, (low, high) in enumerate(sides):
            if low == high:
                continue
            line = [acb_series([x, int(i == q)]) for i, x in enumerate(cell)]
            try:
                drifts = [pole[1].real for pole in self.poles(line, doubtful)]
            except ZeroDivisionError:
                return False
            for end, damps in ((low, all(drift <= 0 for drift in drifts)), (high, all(drift >= 0 for drift in drifts))):
                if damps:
                    return self.settled([(end, end) if i == q else side for i, side in enumerate(sides)])
        return False


def enclosed(polynomial: acb_poly, start: acb) -> acb | None:
    """A ball around `start` that holds exactly one root of every polynomial in the ball of coefficients, by interval Newton."""
    slope, centre = polynomial.derivative(), start.mid()
    spread = (abs(polynomial(centre) / slope(centre)) * 2 + abs(centre) * arb(2) ** (-flint.ctx.prec // 2)).upper()
    for _ in range(4):
        real = start.imag.is_zero()
        wide = acb(centre.real + arb(0, spread), arb(0) if real else centre.imag + arb(0, spread))
        try:
            following = centre - polynomial(centre) / slope(wide)
        except ZeroDivisionError:
            return None
        if real:
            following = acb(following.real)
        if wide.real.contains_interior(following.real) and (real or wide.imag.contains_interior(following.imag)):
            return following
        spread *= 4
    return None


def valued_at(coefficients: Sequence[Any], point: acb_series) -> acb_series:
    """A polynomial's value, lowest power first, by Horner's rule."""
    spend(2 * len(coefficients))
    total = acb_series([0])
    for coefficient in reversed(coefficients):
        total = total * point + coefficient
    return total


def over(one: Any, other: acb_series) -> acb_series:
    """A quotient; raises `ZeroDivisionError` where the divisor may vanish."""
    if other[0].contains(0):
        raise ZeroDivisionError("a divisor may vanish")
    return one / other


def chosen(output: str | None) -> Which:
    """What is written of the controlled output's numerator, or of that of a named one."""
    return "numerator" if output is None else ("outputs", output)


def as_series(number: Any) -> acb_series:
    """A number, or a series as it is."""
    return number if isinstance(number, acb_series) else acb_series([number])


def quotient(above: Sequence[acb_series], below: Sequence[acb_series], count: int) -> list[acb_series]:
    """The first terms in s of a quotient of polynomials, lowest power first; raises `ZeroDivisionError` if the divisor may vanish at 0."""
    found: list[acb_series] = []
    for i in range(count):
        known = (found[i - k] * below[k] for k in range(1, min(i, len(below) - 1) + 1))
        left = (above[i] if i < len(above) else acb_series([0])) - sum(known, acb_series([0]))
        spend(4 * len(below))
        found.append(over(left, below[0]))
    return found


def times(one: Sequence[acb_series], other: Sequence[acb_series]) -> list[acb_series]:
    """The product of polynomials."""
    found = [acb_series([0])] * (len(one) + len(other) - 1)
    for i, a in enumerate(one):
        for k, b in enumerate(other):
            found[i + k] += a * b
    spend(len(one) * len(other))
    return found


def mirrored(series: acb_series) -> acb_series:
    """The conjugate, for real t."""
    return acb_series([c.conjugate() for c in series.coeffs()])


@dataclass(frozen=True, slots=True)
class Met:
    """Series that were met before, told apart by every bit of their coefficients, and what was made of them. A root that is moved by
    itself meets the same places again and again, in cells that differ elsewhere."""

    same: dict[Hashable, acb_series] = field(default_factory=dict)
    made: dict[Hashable, tuple[acb_series, Any]] = field(default_factory=dict)

    def one(self, series: acb_series) -> acb_series:
        """This series, the same object whenever it is met."""
        if not all(c.is_finite() for c in series.coeffs()):
            return series
        parts = (part for c in series.coeffs() for part in (c.real, c.imag))
        key = (series.prec, *(number for part in parts for side in (part.mid(), part.rad()) for number in side.man_exp()))
        return self.same.setdefault(key, series)

    def of(self, what: Hashable, make: Callable[..., acb_series], *objects: Any) -> acb_series:
        """`make(*objects)`, or what it was before for the very same objects, which are kept: no other one can take their identity."""
        key = (what, *map(id, objects))
        if key not in self.made:
            spend(10)
            self.made[key] = make(*objects), objects
        return self.made[key][0]


@dataclass(frozen=True, slots=True)
class Moved:
    """The nominal plant with some of its roots moved, by factors f and g of their distance from the origin, or to a damping ratio ζ:

        p = f ω (-ζ + j √(1 - ζ²)),    z → g z,    N(s) ∏ f² ∏ ((s - g z)/(s - z))^m / (D(s) ∏ g^m)   with these p in D,

    so that all other roots and the static gain (poles at the origin aside) stay. The roots stand with the places of their
    parameters: (of the factor, of the damping ratio).
    """

    task: Any
    poles_moved: tuple[tuple[Root, tuple[int | None, int | None]], ...]
    zeros_moved: tuple[tuple[Root, tuple[int | None, int | None]], ...]
    met: Met = field(default_factory=Met)

    @staticmethod
    def of(task: Any) -> Moved:
        """From the names of the parameters; raises `Malformed` for a root that the plant has not."""
        (plant,) = task.plants
        numerator, denominator = (fmpq_poly(list(which[::-1])) for which in (plant.numerator, plant.denominator))
        given: dict[str, Any] = {}
        for place, parameter in enumerate(task.box.parameters):
            root, _, what = parameter.name.partition(".")
            scale, damping = given.get(root, (None, None))
            given[root] = (scale, place) if what == "damping" else (place, damping)
        bare, axis = (None, None), on_axis(denominator)
        poles = [root for root in isolated(denominator) if not root.value.is_zero()]
        if sum(root.value.real.contains(0) for root in poles) != axis:
            raise Undecided("a pole is not told from the imaginary axis at this precision")
        poles = [Root(acb(0, root.value.imag), root.multiplicity) if root.value.real.contains(0) else root for root in poles]
        modes = named([root for root in poles if root.flexible], "mode", given, bare)
        zeros = named(isolated(numerator), "zero", given, bare)
        require(not given, f"the plant has no {', '.join(given)}")
        return Moved(task, (*modes, *((root, bare) for root in poles if not root.flexible)), tuple(zeros))

    @property
    def nominal(self) -> list[arb]:
        """The place of the nominal plant: 1 for factors, and its damping ratios."""
        place = [arb(1)] * len(self.task.box.parameters)
        for root, (_, damping) in self.poles_moved:
            if damping is not None:
                place[damping] = -root.value.real / abs(root.value)
        return place

    def poles(self, line: Line, starts: Sequence[acb] = ()) -> list[acb_series]:
        """The poles beside the origin."""
        line, found = [x if isinstance(x, acb_series) else acb_series([x]) for x in line], []
        for root, (scale, damping) in self.poles_moved:
            pole = acb_series([root.value])
            if damping is not None:
                zeta = line[damping]
                pole = ((1 - zeta * zeta).sqrt() * acb(0, 1) - zeta) * abs(root.value)
            found.append(self.met.one(pole if scale is None else pole * line[scale]))
        return found

    def factors(self, line: Line, output: str | None) -> tuple[acb_series, list[tuple[Root, acb_series]], list[acb_series]]:
        """Of the controlled output, or of a named one: a gain, zeros, and a further factor N_r/N or N_r, lowest power first.

        An output that has all zeros of the controlled one keeps having them, others keep their own, and so do all the static gain. Raises
        `Malformed` where one of these has not while zeros are moved.
        """
        (plant,), scales = self.task.plants, [as_series(x) for x in line]
        gain, further = acb_series([1]), [acb_series([plant.numerator[0]])]
        for root, (scale, _) in self.poles_moved:  # what keeps the static gain
            gain = gain if scale is None else gain * scales[scale] ** root.size
        moved = any(scale is not None for _, (scale, _) in self.zeros_moved)
        if output is not None:
            own, numerator = (fmpq_poly(list(which[::-1])) for which in (plant.outputs[output], plant.numerator))
            whole, rest = divmod(own, numerator)
            require(rest.is_zero() or not moved, f"the output {output} has not all zeros of the controlled output, which are moved")
            if not rest.is_zero():
                return gain, [], [acb_series([c]) for c in own.coeffs()]
            further = [acb_series([c * plant.numerator[0]]) for c in whole.coeffs()]
        for root, (scale, _) in self.zeros_moved:
            gain = gain if scale is None else over(gain, scales[scale] ** root.size)
        places = [(root, acb_series([root.value]) * (1 if scale is None else scales[scale])) for root, (scale, _) in self.zeros_moved]
        zeros = [(root, self.met.one(place)) for root, place in places]
        return gain, zeros, further

    def at_origin(self, line: Line, output: str, count: int) -> list[acb_series]:
        """The first terms of N/(D/s^r) at s = 0, r poles there, of a named output."""
        gain, zeros, above = self.factors(line, output)
        below, poles = [acb_series([1])], [(root, pole) for (root, _), pole in zip(self.poles_moved, self.poles(line), strict=True)]
        for found, which in ((zeros, 0), (poles, 1)):
            for root, at in found:
                factor = [at * mirrored(at), -at - mirrored(at), acb_series([1])] if root.flexible else [-at, acb_series([1])]
                for _ in range(root.multiplicity):
                    above, below = (above, times(below, factor)) if which else (times(above, factor), below)
        return quotient([gain * c for c in above], below, count)

    def weights(self, line: Line, poles: Sequence[acb_series], output: str | None = None) -> list[acb_series]:
        """N(p)/D'(p), in factors, of the controlled output, or of a named one."""
        gain, zeros, further = self.factors(line, output)
        found, count, one = [], rigid(self.task), acb_series([1])

        def alone(pole: acb_series) -> acb_series:
            return over(further[0] if len(further) == 1 else valued_at(further, pole), pole**count)

        def towards(pole: acb_series, root: Root, zero: acb_series) -> acb_series:
            return ((pole - zero) * (pole - mirrored(zero)) if root.flexible else pole - zero) ** root.multiplicity

        def beside(pole: acb_series, root: Root) -> acb_series:
            return over(one, pole - mirrored(pole)) if root.flexible else one

        def apart(pole: acb_series, root: Root, other: acb_series) -> acb_series:
            return over(over(one, pole - other), pole - mirrored(other)) if root.flexible else over(one, pole - other)

        for j, pole in enumerate(poles):
            spend(len(poles) + len(zeros))
            value = gain * self.met.of(("alone", output), alone, pole)
            for root, zero in zeros:
                value *= self.met.of("towards", towards, pole, root, zero)
            for i, (other, (root, _)) in enumerate(zip(poles, self.poles_moved, strict=True)):
                value *= self.met.of("beside", beside, pole, root) if i == j else self.met.of("apart", apart, pole, root, other)
            found.append(value)
        return found

    def roots(self, place: Numbers) -> tuple[Root, ...]:
        """The poles beside the origin of the plant at a place; raises `Undecided` if one of them is repeated."""
        simple([root for root, _ in self.poles_moved])
        return tuple(
            Root(acb(0, pole[0].imag) if pole[0].real.is_zero() else pole[0], 1) for pole in self.poles([acb_series([x]) for x in place])
        )

    def tracked(self, cell: Numbers, centre: Numbers) -> Tracked | None:
        """The poles at the centre, and balls that hold those of every plant of the cell."""
        points, balls = ([root.value for root in self.roots(place)] for place in (centre, cell))
        return points, balls, [root.flexible for root, _ in self.poles_moved]

    def settled(self, sides: Sequence[tuple[fmpq, fmpq]]) -> bool:
        """Whether no plant is unstable: factors are more than 0, damping ratios from 0 on."""
        return all(damping is not None or root.value.real <= 0 for root, (_, damping) in self.poles_moved)
