"""Plants that vary along a known schedule, `x' = A(t) x + B(t) u`: their transition, and what takes the place of time to go.

Rest at T, `x(T) = ∫_0^T Φ(T, t) B(t) u(t) dt = x_ss`, is seen from the beginning instead. With `g(t) = Φ(0, t) B(t)` and deviations
v = u - u_ss from the final rest it says

    ∫_0^T g(t) v(t) dt = x_ss                                                                                             (1')

for every T alike, because (x_ss, u_ss) is a rest at every instant of the schedule, `A(t) x_ss + B(t) u_ss = 0`: the derivative of
`Φ(0, T) x_ss` is then `g(T) u_ss`. So (1') is equation (1) of docs/theory.md with t for time to go and g for b, and one table of g serves
every horizon.

Between its instants the matrices are linear in t, and g is a power series in every step (Taylor's method): with Φ(0, t) = Σ Y_k τ^k, τ
from the step's begin on, `(k+1) Y_{k+1} = -(Y_k A_0 + Y_{k-1} A_1)`, and `g_k = Y_k B_0 + Y_{k-1} B_1`. python-flint's balls serve as long
floats here.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property

import numpy as np
from flint import arb, arb_mat, fmpq, fmpq_mat
from numpy.typing import NDArray

from relaxations.errors import PlantError, SolverError
from relaxations.plants import Exact, LinearPlant, Pole, exact, fraction, precision, rational

Reals = NDArray[np.float64]
Matrix = tuple[tuple[Fraction, ...], ...]
Row = tuple[Fraction, ...]

REACH = 0.7  # of a step: its length times the largest eigenvalue of |A|
MOST_STEPS = 20_000
POINTS = 16  # of a step at which a costate is looked at


@dataclass(frozen=True)
class VaryingPlant:
    """`x' = A(t) x + B(t) u`, `y = C(t) x + D(t) u`, in deviations from rest, exact: one matrix each for every instant [s], the first 0.

    Between two instants they are linear in t, after the last constant. `output` names y, `outputs` are rows c(t) of other ones. `kept` are
    the states as written, `states` by name, that the input moves at some time.
    """

    instants: tuple[Fraction, ...]
    A: tuple[Matrix, ...]
    B: tuple[Row, ...]
    C: tuple[Row, ...]
    D: tuple[Fraction, ...]
    output: str = "output"
    notes: tuple[str, ...] = field(default=())
    outputs: Mapping[str, tuple[Row, ...]] = field(default_factory=dict)
    kept: tuple[int, ...] = ()
    states: tuple[str, ...] = ()

    @staticmethod
    def of(
        instants: Sequence[Exact],
        A: Sequence[Sequence[Sequence[Exact]]],
        B: Sequence[Sequence[Exact]],
        C: Sequence[Sequence[Exact]],
        D: Sequence[Exact] | None = None,
        output: str = "output",
        outputs: Mapping[str, Sequence[Sequence[Exact]]] | None = None,
        states: Sequence[str] = (),
    ) -> VaryingPlant:
        """From numbers as written; without `states` these are x[1], x[2] …

        States that the input moves at no time are dropped, as they stay at rest (see `notes`).

        Raises `PlantError` if instants do not ascend from 0, sizes differ, or the input moves nothing.
        """
        times, n = tuple(exact(t) for t in instants), len(B[0])
        if not times or times[0] != 0 or any(after <= before for before, after in itertools.pairwise(times)):
            raise PlantError(f"the instants of a schedule ascend from 0, not {[float(t) for t in times]}")
        through = [exact(d) for d in D] if D is not None else [Fraction(0)] * len(times)
        if not len(times) == len(A) == len(B) == len(C) == len(through):
            raise PlantError(f"a schedule of {len(times)} instants has as many matrices A, B, C and D")
        if any(len(a) != n or any(len(row) != n for row in a) for a in A) or any(len(row) != n for row in (*B, *C)):
            raise PlantError(f"at every instant A is n×n, B and C have n numbers; here n = {n}")
        reached = {i for i in range(n) if any(exact(b[i]) for b in B)}
        while more := {i for i in range(n) if i not in reached and any(exact(a[i][j]) for a in A for j in reached)}:
            reached |= more
        kept = sorted(reached)
        if not kept:
            raise PlantError("the input moves no state")
        for name, rows in (outputs or {}).items():
            if len(rows) != len(times) or any(len(row) != n for row in rows):
                raise PlantError(f"the output {name!r} has a row of {n} numbers for each of {len(times)} instants")
        notes = () if len(kept) == n else (f"{n - len(kept)} of {n} states are not moved by the input at any time and were dropped",)
        return VaryingPlant(
            times,
            tuple(tuple(tuple(exact(a[i][j]) for j in kept) for i in kept) for a in A),
            tuple(tuple(exact(b[i]) for i in kept) for b in B),
            tuple(tuple(exact(c[i]) for i in kept) for c in C),
            tuple(through),
            output,
            notes,
            {name: tuple(tuple(exact(c[i]) for i in kept) for c in rows) for name, rows in (outputs or {}).items()},
            tuple(kept),
            tuple(states) or tuple(f"x[{i}]" for i in range(1, n + 1)),
        )

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.B[0])

    @property
    def rows(self) -> dict[str, tuple[Row, ...]]:
        """The outputs that may be limited, by name: the controlled one without feed-through, its rate, if it is such a row, and others."""
        found = {self.output: self.C, "output": self.C} if not any(self.D) else {}
        jumps = any(sum((c * b for c, b in zip(row, column, strict=True)), Fraction(0)) for row, column in zip(self.C, self.B, strict=True))
        if found and len({*self.C}) == 1 and not jumps:
            found["output_rate"] = tuple(
                tuple(sum((c * row[j] for c, row in zip(self.C[0], A, strict=True)), Fraction(0)) for j in range(self.order))
                for A in self.A
            )
        return found | dict(self.outputs)

    def begun(self, state: Sequence[Exact] | Mapping[str, Exact]) -> Row:
        """The states that the input moves, of a deviation from rest of all states, in order or by name; raises `PlantError`."""
        shown = ", ".join(self.states)
        if isinstance(state, Mapping):
            if unknown := [name for name in state if name not in self.states]:
                raise PlantError(f"the initial state names {', '.join(unknown)}; the states are {shown}")
            state = [state.get(name, 0) for name in self.states]
        if len(state) != len(self.states):
            raise PlantError(f"the initial state has {len(state)} numbers; the states are {shown}")
        numbers = [exact(x) for x in state]
        if unmoved := [name for i, name in enumerate(self.states) if numbers[i] and i not in self.kept]:
            raise PlantError(f"the plant begins with {', '.join(unmoved)} away from rest, which its input moves at no time")
        return tuple(numbers[i] for i in self.kept)

    @cached_property
    def final(self) -> LinearPlant:
        """The constant plant after the last instant."""
        plant, last = LinearPlant.from_state_space(self.A[-1], self.B[-1], self.C[-1], self.D[-1], name=self.output), self.instants[-1]
        varies = (
            f"the plant varies until {float(last):.6g} s, its matrices linear between the instants; poles and modes are those afterwards"
        )
        return replace(plant, notes=(*plant.notes, *self.notes, varies))

    def rest(self, displacement: Fraction) -> tuple[Row, Fraction]:
        """The state and the input that hold the output `displacement` away; raises `PlantError` unless they do so at every instant."""
        n = self.order
        table = [[*(rational(x) for x in (*row, b))] for row, b in zip((*self.A[-1], self.C[-1]), (*self.B[-1], self.D[-1]), strict=True)]
        try:
            found = fmpq_mat(table).solve(fmpq_mat([*([fmpq(0)] for _ in range(n)), [rational(displacement)]]))
        except ZeroDivisionError:
            raise PlantError(f"after its schedule the plant has no rest with {self.output!r} elsewhere, or more than one") from None
        state, held = tuple(fraction(found[i, 0]) for i in range(n)), fraction(found[n, 0])
        for at, a, b, c, d in zip(self.instants, self.A, self.B, self.C, self.D, strict=True):
            rates = [sum((x * s for x, s in zip(row, state, strict=True)), held * e) for row, e in zip(a, b, strict=True)]
            seen = sum((x * s for x, s in zip(c, state, strict=True)), held * d)
            if any(rates) or seen != displacement:
                moving = f"move on, by {max(map(abs, map(float, rates))):.2g} a second" if any(rates) else f"show {float(seen):.9g}"
                raise PlantError(
                    f"the final rest, with the output at {float(displacement):.6g}, is none at {float(at):.6g} s: there the plant "
                    f"would {moving}; a schedule varies what is in motion, not where the plant rests"
                )
        return state, held

    @property
    def eigenvalues(self) -> tuple[complex, ...]:
        """Those of A at every instant, Im ≥ 0, in floating point."""
        values = (value for a in self.A for value in np.linalg.eigvals(np.array(a, dtype=float)))
        return tuple(dict.fromkeys(complex(round(v.real, 12), round(v.imag, 12)) for v in values if v.imag >= 0.0))

    @property
    def pace(self) -> float:
        """The largest eigenvalue of |A|, entries over all instants [rad/s]; 0 where motions only add up."""
        largest = np.abs(np.array(self.A, dtype=float)).max(axis=0)
        return float(np.abs(np.linalg.eigvals(largest)).max())


@dataclass(frozen=True, slots=True)
class Step:
    """g from `begin` [s] on: its coefficients g_k (n, 1), those of g' and of the integral of g from 0."""

    begin: arb
    g: list[arb_mat]
    rate: list[arb_mat]
    total: list[arb_mat]


class Transition:
    """g(t) of a plant, its derivative and its integral from 0, as power series that are extended as far as they are asked for.

    It has what `relaxations.moments.Basis` has, with t in place of time to go; `poles` are those of motions backwards in time, for grids.
    """

    def __init__(self, plant: VaryingPlant, bits: int = 128) -> None:
        self.plant, self.bits = plant, bits
        self.poles = tuple(Pole(complex(0.0 - value.real, abs(value.imag)), 1) for value in plant.eigenvalues)
        self._steps: list[Step] = []
        self._end = Fraction(0)
        self._ends: list[float] = []
        self._tables: list[tuple[Reals, Reals, Reals]] = []  # g, g', ∫g in doubles: (n, terms) each
        with precision(bits):
            self._state, self._sum = arb_mat(plant.order, plant.order, 1), arb_mat(plant.order, 1)
        self._pace = plant.pace or 1.0 / float(plant.instants[-1] or 1)

    @property
    def size(self) -> int:
        """Number of rows n."""
        return self.plant.order

    def _extend(self, until: float) -> None:
        if (until - (self._ends[-1] if self._ends else 0.0)) * self._pace > REACH * MOST_STEPS:
            raise SolverError(f"the transition of a varying plant is followed for {MOST_STEPS} steps at most: not until {until:.6g} s")
        with precision(self.bits):
            while not self._ends or self._ends[-1] < until:
                self._add()

    def _add(self) -> None:
        """One more step, which ends at the next instant of the schedule at the latest."""
        plant, begin = self.plant, self._end
        after = next((i for i, at in enumerate(plant.instants) if at > begin), None)
        end = begin + Fraction(REACH / self._pace)
        if after is None and not plant.pace:  # the series ends by itself
            end = max(end, 2 * begin)
        if after is not None and plant.instants[after] <= end + (end - begin) / 2:
            end = plant.instants[after]
        length = arb(rational(end - begin))
        matrices, column = [_linear(which, plant.instants, after, begin) for which in (plant.A, [tuple((x,) for x in b) for b in plant.B])]
        # Series of Φ(0, t) until nothing is left of it at this precision.
        series, k = [self._state], 0
        size = arb(2) ** -self.bits * _largest(self._state)
        while k < 8 or max(_largest(series[-1]) * length, _largest(series[-2])) * length ** (k - 1) > size:
            series.append(-_convolved(series, matrices, k) / (k + 1))
            k += 1
        g = [_convolved(series, column, k) for k in range(len(series))]
        rate = [coefficient * k for k, coefficient in enumerate(g)][1:]
        total = [self._sum, *(coefficient / (k + 1) for k, coefficient in enumerate(g))]
        self._steps.append(Step(arb(rational(begin)), g, rate, total))
        self._end = end
        self._ends.append(float(end))
        self._tables.append(tuple(_doubles(which) for which in (g, rate, total)))  # type: ignore[arg-type]
        self._state, self._sum = _at(series, length), _at(total, length)

    def _evaluated(self, s: Reals, which: int) -> Reals:
        result = np.zeros((self.size, len(s)))
        if not len(s):
            return result
        self._extend(float(s.max()))
        index = np.searchsorted(np.array(self._ends), s)
        begins = np.concatenate([[0.0], self._ends])
        for i in np.unique(index):
            at = index == i
            tau, table = s[at] - begins[i], self._tables[i][which]
            value = np.zeros((self.size, int(at.sum())))
            for coefficient in table.T[::-1]:
                value = value * tau + coefficient[:, None]
            result[:, at] = value
        return result

    def rows(self, s: Sequence[float] | Reals, integrals: int = 0) -> Reals:
        """g(s) (integrals = 0), or its integral from 0 (1), at instants s ≥ 0 [s]: shape (n, len(s))."""
        return self._evaluated(np.atleast_1d(np.asarray(s, dtype=float)), 2 if integrals else 0)

    def slopes(self, s: Reals) -> Reals:
        """g'(s): shape (n, len(s))."""
        return self._evaluated(s, 1)

    def crossings(self, costate: Reals, horizon: float, level: float) -> Reals:
        """Instants in (0, horizon) at which `p = λᵀ g` crosses `level`, ascending [s]."""
        self._extend(horizon)
        edges = np.unique(np.minimum(np.concatenate([[0.0], self._ends]), horizon))
        points = np.unique(np.concatenate([np.linspace(a, b, POINTS + 1) for a, b in itertools.pairwise(edges)]))

        def p(s: Reals) -> Reals:
            return costate @ self.rows(s) - level

        def turning(s: Reals) -> Reals:
            return costate @ self.slopes(s)

        values, slopes = p(points), turning(points)
        bent = np.flatnonzero((values[:-1] * values[1:] > 0.0) & (slopes[:-1] * slopes[1:] < 0.0) & (slopes[:-1] * values[:-1] < 0.0))
        if len(bent):  # an extremum that may be on the other side: a pair of crossings
            points = np.unique(np.concatenate([points, _bisected(turning, points[bent], points[bent + 1])]))
            values = p(points)
        values[values == 0.0] = np.finfo(float).tiny
        changed = np.flatnonzero(np.sign(values[:-1]) != np.sign(values[1:]))
        return _bisected(p, points[changed], points[changed + 1])

    def long(self, s: Sequence[arb], which: int) -> arb_mat:
        """g (0), g' (1) or the integral of g (2) in long floats: shape (n, len(s))."""
        columns = []
        for at in s:
            self._extend(float(at.mid()))
            i = int(np.searchsorted(np.array(self._ends), float(at.mid())))
            step = self._steps[i]
            columns.append(_at((step.g, step.rate, step.total)[which], at - step.begin).entries())
        return arb_mat([list(row) for row in zip(*columns, strict=True)]) if columns else arb_mat(self.size, 0)


def _linear(which: Sequence[Matrix], instants: Sequence[Fraction], after: int | None, begin: Fraction) -> tuple[arb_mat, arb_mat]:
    """Value and slope of matrices at `begin`, which is before instant number `after` (None: beyond the last)."""
    if after is None:
        last = _long(which[-1])
        return last, arb_mat(last.nrows(), last.ncols())
    width = instants[after] - instants[after - 1]
    slope = [[(b - a) / width for a, b in zip(*rows, strict=True)] for rows in zip(which[after - 1], which[after], strict=True)]
    value = [
        [a + s * (begin - instants[after - 1]) for a, s in zip(row, rises, strict=True)]
        for row, rises in zip(which[after - 1], slope, strict=True)
    ]
    return _long(value), _long(slope)


def _long(matrix: Sequence[Sequence[Fraction]]) -> arb_mat:
    return arb_mat([[arb(rational(x)) for x in row] for row in matrix])


def _convolved(series: Sequence[arb_mat], linear: tuple[arb_mat, arb_mat], k: int) -> arb_mat:
    """Coefficient k of the product of a series and a linear function."""
    return series[k] * linear[0] + series[k - 1] * linear[1] if k else series[0] * linear[0]


def _at(series: Sequence[arb_mat], tau: arb) -> arb_mat:
    """Horner's rule, midpoints kept."""
    value = series[-1]
    for coefficient in reversed(series[:-1]):
        value = value * tau + coefficient
    return value.mid()


def _largest(matrix: arb_mat) -> arb:
    return max((abs(x).mid() for x in matrix.entries()), key=float)


def _doubles(series: Sequence[arb_mat]) -> Reals:
    return np.array([[float(x.mid()) for x in coefficient.entries()] for coefficient in series]).T


def _bisected(function: Callable[[Reals], Reals], low: Reals, high: Reals) -> Reals:
    """The root in each bracket, by halving."""
    if not len(low):
        return np.zeros(0)
    rising = function(high) > 0.0
    for _ in range(80):
        middle = (low + high) / 2
        above = (function(middle) > 0.0) == rising
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return (low + high) / 2
