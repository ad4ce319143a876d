"""The lower side: weak duality (docs/theory.md, equation 2) with the integral of σ(p) bounded from above, its sign changes isolated.

λᵀ target > ∫_0^T σ(p) ds + Σ μ⁺ (upper - u_ss) - μ⁻ (lower - u_ss)   ⇒   no admissible command takes T or less
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import factorial

from flint import acb, arb, arb_mat, fmpq

from relaxations.checking.balls import Inconclusive, Plant, Refuted, Root, impulse, nearest, step, tail_room
from relaxations.checking.reading import Chain, LowerWitness, Malformed, TailMultiplier, Task

MOST_CELLS = 100_000
NARROW = 2.0**-60  # of the horizon: an undecided cell this small is bounded by its width times sup|p|


@dataclass(frozen=True, slots=True)
class Term:
    """`Re Σ c_k s^k/k! e^{ps}` at a root."""

    root: Root
    coefficients: tuple[acb, ...]

    def derivative(self) -> Term:
        """d/ds: c_k becomes p c_k + c_{k+1}."""
        shifted = (*self.coefficients[1:], acb(0))
        return Term(self.root, tuple(self.root.value * c + d for c, d in zip(self.coefficients, shifted, strict=True)))


def values(families: Sequence[Sequence[Term]], s: arb) -> list[arb]:
    """Exponential polynomials over the same roots at s (a ball: all their values there), the exponentials computed once."""
    totals = [arb(0) for _ in families]
    for terms in zip(*families, strict=True):
        powers = impulse(terms[0].root.value, len(terms[0].coefficients), s)
        for i, term in enumerate(terms):
            for c, b in zip(term.coefficients, powers, strict=True):
                totals[i] += (c * b).real
    return totals


def antiderivative(terms: Sequence[Term], s: arb) -> arb:
    """Its integral from 0 to s."""
    total = arb(0)
    for term in terms:
        for c, b in zip(term.coefficients, step(term.root, s), strict=True):
            total += (c * b).real
    return total


def costate(plant: Plant, chains: Sequence[Chain]) -> tuple[Term, ...]:
    """The witness's coefficients at the plant's own roots; roots that it does not name get none, a root named twice gets the last."""
    named: dict[int, Chain] = {}
    for chain in chains:
        named[id(nearest(plant.roots, chain.near))] = chain
    terms = []
    for root in plant.roots:
        given = named[id(root)].coefficients if id(root) in named else ()
        padded = (*given[: root.multiplicity], *[(fmpq(0), fmpq(0))] * (root.multiplicity - len(given)))
        terms.append(Term(root, tuple(acb(re, im if root.flexible else 0) for re, im in padded)))
    return tuple(terms)


def tail_coefficient(plant: Plant, terms: Sequence[Term], zero: Root, power: int) -> acb:
    """What the costate says of the tail `Re(c r^l/l! e^{zr})`: the h with `λᵀ ξ c = Re(c h)`."""
    total = acb(0)
    for term in terms:
        for k, c in enumerate(term.coefficients):
            one, other = plant.tail(term.root, k, zero.value, power), plant.tail(term.root, k, zero.value.conjugate(), power)
            total += (c * one + (c * other).conjugate()) / 2
    return total


def respect_tail(plant: Plant, terms: tuple[Term, ...], multipliers: Sequence[TailMultiplier]) -> tuple[Term, ...]:
    """The costate moved, in balls, onto the equalities `λᵀ ξ = -Σ (μ⁺ - μ⁻) υ e^{zτ}` that a free tail demands."""
    equalities = [(zero, power) for zero in plant.zeros for power in range(zero.multiplicity)]
    if not equalities:
        return terms

    def residual(of: tuple[Term, ...], forced: bool) -> list[arb]:
        rows: list[arb] = []
        for zero, power in equalities:
            h = tail_coefficient(plant, of, zero, power)
            for m in multipliers if forced else ():
                tau = arb(m.time)
                h += (arb(m.upper) - arb(m.lower)) * tau**power / factorial(power) * (zero.value * tau).exp()
            rows += [h.real, h.imag] if zero.flexible else [h.real]
        return rows

    places = [(i, k, part) for i, t in enumerate(terms) for k in range(len(t.coefficients)) for part in range(1 + t.root.flexible)]
    columns = []
    for i, k, part in places:
        unit = tuple(acb(0, 1) if part else acb(1) if j == k else acb(0) for j in range(len(terms[i].coefficients)))
        unit = tuple(u if j == k else acb(0) for j, u in enumerate(unit))
        columns.append(residual((Term(terms[i].root, unit),), forced=False))
    chosen = _pivots([[float(x.mid()) for x in column] for column in columns])
    matrix = arb_mat([[columns[place][row] for place in chosen] for row in range(len(chosen))])
    try:
        change = matrix.solve(arb_mat([[-x] for x in residual(terms, forced=True)]))
    except ZeroDivisionError:
        raise Inconclusive("the tail's equalities cannot be solved for the costate at this precision") from None
    moved = [list(term.coefficients) for term in terms]
    for row, place in enumerate(chosen):
        i, k, part = places[place]
        moved[i][k] += acb(0, change[row, 0]) if part else acb(change[row, 0])
    return tuple(Term(term.root, tuple(c)) for term, c in zip(terms, moved, strict=True))


def _pivots(columns: list[list[float]]) -> list[int]:
    """Columns that span: Gram-Schmidt, the longest remainder first (any choice is sound)."""
    left, chosen = [list(c) for c in columns], []
    for _ in range(len(columns[0])):
        best = max(range(len(left)), key=lambda j: sum(x * x for x in left[j]) if j not in chosen else -1.0)
        length = sum(x * x for x in left[best])
        if best in chosen or not length > 0.0:
            raise Inconclusive("the costate cannot meet the tail's equalities")
        chosen.append(best)
        direction = left[best]
        for j, column in enumerate(left):
            share = sum(x * y for x, y in zip(column, direction, strict=True)) / length
            left[j] = [x - share * y for x, y in zip(column, direction, strict=True)]
    return chosen


def support(terms: Sequence[Term], horizon: arb, lower: arb, upper: arb) -> arb:
    """A ball around `∫_0^horizon max(upper p, lower p) ds`, for an exact horizon and lower ≤ 0 ≤ upper.

    Cells are bisected until p has a sign, or is monotone: interval Newton then isolates its root. What stays undecided is tiny.
    """
    first = tuple(term.derivative() for term in terms)
    second = tuple(term.derivative() for term in first)
    decided: list[tuple[arb, arb, int]] = []  # [a, b] and the sign of p there; 0: bounded instead
    slack, cells = arb(0), 0
    waiting = [(arb(0), horizon)]
    while waiting:
        a, b = waiting.pop()
        cells += 1
        if cells > MOST_CELLS:
            raise Inconclusive(f"the sign of the costate is undecided after {MOST_CELLS} cells")
        width = b - a
        c = ((a + b) / 2).mid()
        whole = a.union(b)
        x = whole - c
        (p0, p1), (p2,) = values((terms, first), c), values((second,), whole)
        slope = p1 + p2 * x
        p = p0 + p1 * x + p2 * x * x / 2
        if p > 0 or p < 0:
            decided.append((a, b, 1 if p > 0 else -1))
            continue
        narrow = bool(width <= horizon * NARROW)
        if not narrow and (slope > 0 or slope < 0):
            root = c - p0 / slope
            rising = 1 if slope > 0 else -1
            low, high = root.lower(), root.upper()
            if low > b or high < a:
                decided.append((a, b, -rising if low > b else rising))
                continue
            low, high = (low if low > a else a), (high if high < b else b)
            if (high - low) * 2 < width:
                if low > a:
                    decided.append((a, low, -rising))
                if high < b:
                    decided.append((high, b, rising))
                if high > low:
                    waiting.append((low, high))
                continue
        if narrow or not (a < c and c < b):
            bound = abs(p).upper() * (upper if upper > -lower else -lower)
            slack += (bound * width).upper()
            decided.append((a, b, 0))
            continue
        waiting += [(a, c), (c, b)]
    return _integrate(terms, decided, lower, upper) + arb(0, slack.upper())


def _integrate(terms: Sequence[Term], decided: list[tuple[arb, arb, int]], lower: arb, upper: arb) -> arb:
    """Σ over runs of one sign of (limit) · (antiderivative's difference)."""
    decided.sort(key=lambda cell: (float(cell[0].mid()), float(cell[1].mid())))
    total, start, sign = arb(0), arb(0), 0
    before: arb | None = None
    for a, b, s in decided:
        if s != sign or before is None or not bool(a == before):
            if sign and before is not None:
                total += (upper if sign > 0 else lower) * (antiderivative(terms, before) - antiderivative(terms, start))
            start, sign = a, s
        before = b
    if sign and before is not None:
        total += (upper if sign > 0 else lower) * (antiderivative(terms, before) - antiderivative(terms, start))
    return total


def prove(task: Task, plants: Sequence[Plant], witness: LowerWitness, time: fmpq) -> None:
    """Prove that no admissible command takes `time` seconds or less; raises `Refuted` or `Inconclusive`."""
    if len(witness.costate) != len(plants):
        raise Malformed("lower.costate has one array for each plant")
    if witness.tail and not any(plant.zeros for plant in plants):
        raise Malformed("multipliers of a tail that the task does not have")
    lower, upper = arb(task.lower_limit - task.initial_input), arb(task.upper_limit - task.initial_input)
    terms: list[Term] = []
    left = arb(0)
    for plant, chains in zip(plants, witness.costate, strict=True):
        own = respect_tail(plant, costate(plant, chains), witness.tail)
        for term in own:
            left += sum((((c * plant.target(term.root, k)).real) for k, c in enumerate(term.coefficients)), arb(0))
        terms += own
    right = arb(0)
    for m in witness.tail:
        above, below = tail_room(task, plants[0].rest_input, m.time)
        right += arb(m.upper * above + m.lower * below)
    integral = support(terms, arb(time).upper(), lower, upper) if time > 0 else arb(0)
    if left > integral + right:
        return
    if left < integral + right:
        raise Refuted("the lower bound's inequality (2) does not hold for this costate")
    raise Inconclusive("the lower bound's inequality (2) is undecided at this precision")
