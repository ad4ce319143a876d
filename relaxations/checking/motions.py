"""What the plants of a box do after a command, `r(τ) = Re Σ Z_j e^{p_j τ}`: motions Z_j at places, along lines and over cells, as series.

The kicks are the jumps of the input, or of its slope where it is continuous. Over a cell a function of the place is known to third order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement, pairwise
from math import comb, factorial
from typing import Any

import flint
from flint import acb, acb_series, arb, fmpq

from relaxations.checking.balls import Root, System, Wave, spend
from relaxations.checking.families import Line, Moved, Written, over
from relaxations.checking.members import Numbers

FURTHER = 12  # terms of Taylor's formula over a wide ball of poles
NARROW = 1e-3  # rad: balls that are wider for the whole command
Way = tuple[int, ...]  # the parameters that grow along it; of the lines through a cell none


@dataclass(frozen=True, slots=True)
class Kicks:
    """Times to go and sizes of the jumps of the input (`order` 1), or of its slope (2)."""

    jumps: Sequence[tuple[arb, arb]]
    order: int

    @staticmethod
    def of(system: System, command: Numbers, n: int) -> Kicks:
        """Of a command, the last one to the final rest."""
        instants = [*command[1 : n + 1], command[0]]
        if system.sloped:
            levels = [*command[n + 1 : 2 * n + 1], system.rest]
            slopes = [arb(b - a) / arb(t - s) for (s, t), (a, b) in zip(pairwise(instants), pairwise(levels), strict=True)]
            changes = [after - before for before, after in pairwise([arb(0), *slopes, arb(0)])]
        else:
            changes = [arb(after - before) for before, after in pairwise([fmpq(0), *command[n + 1 : 2 * n + 1], system.rest])]
        return Kicks([(arb(command[0] - at), change) for at, change in zip(instants, changes, strict=True)], 1 + system.sloped)

    def shaken(self, pole: acb_series) -> acb_series:
        """What they leave of a motion: `Σ jump e^{ps} / p^order`.

        Over a wide ball of poles by Taylor's formula about its middle: what the jumps take from each other stays taken in the coefficients.
        """
        spend(6 * len(self.jumps))
        start = pole[0]
        middle = start.mid()
        off = start - middle
        if abs(off).upper() * self.jumps[0][0] > NARROW:
            reach, terms, rests = abs(off).upper(), [acb(0)] * FURTHER, [arb(0)] * flint.ctx.cap
            for s, jump in self.jumps:
                spend(FURTHER)
                term = (middle * s).exp() * jump
                most = abs(s).upper()  # powers of a ball that may reach below 0 are no numbers
                far, size = most * reach, abs(term)
                grown = size * far.exp()
                for k in range(len(rests)):
                    rests[k] += grown * most**k / factorial(k) * far ** (FURTHER - k) / factorial(FURTHER - k)
                for m in range(FURTHER):
                    terms[m] += term
                    term = term * s / (m + 1)
            beside, total = acb_series([0, *pole.coeffs()[1:]]), acb_series([0])
            for k in reversed(range(len(rests))):
                value = acb(0)
                for m in reversed(range(k, FURTHER)):
                    value = value * off + terms[m] * comb(m, k)
                around = arb(0, rests[k].upper())
                total = total * beside + (value + acb(around, 0 if start.imag.is_zero() else around))
        else:
            total = sum(((pole * s).exp() * jump for s, jump in self.jumps), acb_series([0]))
        return over(total, pole**self.order)


@dataclass(frozen=True, slots=True)
class Motion:
    """Poles p_j and motions Z_j along a line of places, as series."""

    poles: list[acb_series]
    sizes: list[acb_series]

    def course(self, span: arb, turned: dict[int, acb_series]) -> acb_series:
        """`Σ Z_j e^{p_j τ}` for the instants of a ball; e^{p_j τ} once for every series, by its identity."""
        spend(3 * len(self.poles))
        for pole in self.poles:
            if id(pole) not in turned:
                spend(5)
                turned[id(pole)] = (pole * span).exp()
        return sum((size * turned[id(pole)] for pole, size in zip(self.poles, self.sizes, strict=True)), acb_series([0]))


def motion(plants: Written | Moved, kicks: Kicks, line: Line, starts: Sequence[acb], flexible: Sequence[bool]) -> Motion:
    """The motions after the command, all over the balls of the line and of the poles that it begins with."""
    poles, sizes = plants.poles(line, starts), []
    for pole, weight, pair in zip(poles, plants.weights(line, poles), flexible, strict=True):
        own = plants.met.of("shaken", Kicks.shaken, kicks, pole) if isinstance(plants, Moved) else kicks.shaken(pole)
        sizes.append((1 + pair) * weight * own)
    return Motion(poles, sizes)


@dataclass(frozen=True, slots=True)
class Terms:
    """Of Taylor's formula about the centre of a cell: (b_q, c_q) of b t_q + c t_q², x_qk of x t_q t_k, |t| ≤ 1, and |f_3|."""

    single: list[tuple[acb, acb]]
    mixed: list[acb]
    last: arb

    @property
    def all(self) -> list[acb]:
        """One after the other, but for the last."""
        return [*(term for pair in self.single for term in pair), *self.mixed]

    def above(self, side: int) -> arb:
        """At most what the real parts add, or, on the `side` -1, take away."""
        total = sum((abs(term.real) for term in self.mixed), arb(0))
        return sum((highest(abs(b.real), side * c.real) for b, c in self.single), total)

    @staticmethod
    def sum(several: Sequence[Terms]) -> Terms:
        """Of a sum of functions, but for the last."""
        pairs = zip(*(terms.single for terms in several), strict=True)
        single = [(sum((b for b, _ in pair), acb(0)), sum((c for _, c in pair), acb(0))) for pair in pairs]
        return Terms(single, [sum(parts, acb(0)) for parts in zip(*(terms.mixed for terms in several), strict=True)], arb(0))


def highest(slope: arb, bend: arb) -> arb:
    """At least `slope t + bend t²` for all |t| ≤ 1, for slopes and bends of balls: it has its top where t = slope/(-2 bend), if that is
    in there."""
    b, c = slope.upper(), bend.upper()
    if c < 0 and b < -2 * c:
        return b * b / (-4 * c)
    return b + c


@dataclass(frozen=True, slots=True)
class Around:
    """Motions about the centre c of a cell: a function f of the place obeys there, with the half widths ρ of the cell,

        f - f(c) = Σ_q (∂_q f(c) ρ_q t_q + ∂_qq f(c)/2 ρ_q² t_q²) + Σ_{q<k} ∂_qk f(c) ρ_q ρ_k t_q t_k + f_3,    |t_q| ≤ 1,

    where f_3 is the third term of f along any line through any place of the cell, in directions within ±ρ (Taylor's formula). Of a real f
    the first sum is largest where each of its terms is (`highest`): nothing is lost where f has its top within the cell.
    """

    ways: dict[tuple[int, int], Motion]  # from the centre, along a parameter (q, q) or two of them at once
    whole: Motion
    radii: Sequence[arb]

    @staticmethod
    def of(plants: Written | Moved, kicks: Kicks, cell: Numbers, centre: Numbers, radii: Sequence[arb], poles: Any) -> Around:
        """All motions of a cell."""
        points, balls, flexible = poles
        wide = [q for q, radius in enumerate(radii) if not radius.is_zero()]
        if not wide:  # one plant, at an exact place
            alone = motion(plants, kicks, centre, points, flexible)
            return Around({(0, 0): alone}, alone, radii)
        ways = {}
        for q, k in combinations_with_replacement(wide, 2):
            line = [acb_series([x, int(i in (q, k))]) for i, x in enumerate(centre)]
            ways[q, k] = motion(plants, kicks, line, points, flexible)
        whole = [acb_series([x, arb(0, radius.upper())]) for x, radius in zip(cell, radii, strict=True)]
        return Around(ways, motion(plants, kicks, whole, balls, flexible), radii)

    @property
    def middle(self) -> Motion:
        """At the centre, along some way."""
        return next(iter(self.ways.values()))

    def terms(self, along: Callable[[Way, Motion], acb_series]) -> Terms:
        """The terms of Taylor's formula about the centre."""
        lines, single, mixed = {way: along(way, motion) for way, motion in self.ways.items()}, [], []
        for (q, k), own in lines.items():
            if q == k:
                single.append((own[1] * self.radii[q], own[2] * self.radii[q] ** 2))
            else:
                mixed.append((own[2] - lines[q, q][2] - lines[k, k][2]) * self.radii[q] * self.radii[k])
        return Terms(single, mixed, abs(along((), self.whole)[3]))

    def bends(self) -> list[float]:
        """How much of the second order of the motions each parameter has its part in, roughly: where a cell is best halved."""
        parts = [0.0] * len(self.radii)
        for j in range(len(self.middle.sizes)):
            for (q, k), own in self.ways.items():
                terms = own.sizes[j][2] - sum((self.ways[i, i].sizes[j][2] for i in (q, k)), acb(0)) if q != k else own.sizes[j][2]
                size = float((abs(terms) * self.radii[q] * self.radii[k]).upper())
                parts[q], parts[k] = parts[q] + size, parts[k] + size
        return parts

    def drift(self, span: arb) -> tuple[arb, arb]:
        """How far r(τ) is below and above what it is at the centre, in the cell, for the instants of a ball."""
        turned = dict[int, acb_series]()
        terms = self.terms(lambda _, motion: motion.course(span, turned))
        return terms.above(-1) + terms.last, terms.above(1) + terms.last

    def moduli(self) -> tuple[arb, list[arb]]:
        """`Σ |Z_j|` over the cell, and each by itself, at most.

        With the real part x_j and the imaginary part y_j of `Z_j e^{-j(α_j + β_j (θ - c))}`, where y_j and its slopes are 0 at the centre,
        |Z_j| ≤ x_j + y_j²/(2 x_j). Of the x_j the terms at the centre are summed before their sizes are taken.
        """
        bound, each, together = arb(0), [], list[Terms]()
        for j, size in enumerate(self.middle.sizes):
            start, plain = size[0], self.terms(lambda _, motion, j=j: motion.sizes[j])
            each.append(sum((abs(term) for term in plain.all), abs(start) + plain.last))
            if not 3 * abs(start) > 2 * each[j]:  # so near 0 it has no direction
                bound += each[j]
                continue
            turn, rates = start.conjugate() / abs(start), [arb(0)] * len(self.radii)
            for q, _ in self.ways:
                rates[q] = (self.ways[q, q].sizes[j][1] / start).imag.mid()

            def turned(way: Way, motion: Motion, j: int = j, turn: acb = turn, rates: list[arb] = rates) -> acb_series:
                speeds = [rates[q] for q in set(way)] if way else [b * arb(0, r.upper()) for b, r in zip(rates, self.radii, strict=True)]
                return motion.sizes[j] * turn * acb_series([0, acb(0, -sum(speeds, arb(0)))]).exp()

            terms = self.terms(turned)
            x, y = (sum((abs(part) for part in parts), terms.last) for parts in ([t.real for t in terms.all], [t.imag for t in terms.all]))
            if abs(start) - x > 0:
                across = y * y / (2 * (abs(start) - x))
                each[j], bound = abs(start) + x + across, bound + abs(start) + terms.last + across
                together.append(terms)
            else:
                bound += each[j]
        return bound + Terms.sum(together).above(1), each


def in_time(around: Around, sizes: Sequence[arb], flexible: Sequence[bool], below: arb, above: arb) -> bool | None:
    """Whether -below ≤ r(τ) ≤ above: at the centre by Taylor's formula in τ, elsewhere as `Around` says, far away by the envelope.

    None if it is more at an instant of the plant at the centre.
    """
    middle, whole = around.middle, around.whole
    roots = tuple(Root(p[0] if pair else acb(p[0].real), 1) for p, pair in zip(middle.poles, flexible, strict=True))
    wave = Wave.of(roots, [part for z, pair in zip(middle.sizes, flexible, strict=True) for part in (z[0].real, z[0].imag)[: 1 + pair]])
    lasting = sum((size for size, p in zip(sizes, whole.poles, strict=True) if not p[0].real < 0), arb(0))
    if not lasting <= below.min(above):
        return False  # as much is left for ever, as far as can be seen
    far, quick = max((1 / abs(p[0])).upper() for p in whole.poles), min((1 / abs(p[0])).lower() for p in middle.poles)
    while not sum((size * (p[0].real * far).exp() for size, p in zip(sizes, whole.poles, strict=True)), arb(0)) <= below.min(above):
        far = (far * 5 / 4).mid()
        if far > 1e4 * quick:
            return False
    count = int(float(far / quick)) + 1
    edges = [far * k / count for k in range(count + 1)]
    waiting = sorted(((a, b, *wave.over(a, b)) for a, b in pairwise(edges)), key=lambda piece: float(abs(piece[3]).mid()))  # largest last
    for _ in range(400 + 4 * count):
        if not waiting:
            return True
        a, b, c, value, _, values = waiting.pop()
        down, up = around.drift(a.union(b))
        if values + up <= above and values - down >= -below:
            continue
        if value > above or value < -below:
            return None
        down, up = around.drift(c)
        if not (a < c < b and value + up <= above and value - down >= -below):
            return False  # at this instant, which a shorter piece would not help
        waiting += [(s, t, *wave.over(s, t)) for s, t in ((a, c), (c, b))]
    return False
