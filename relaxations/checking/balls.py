"""The task in balls: isolated roots with exact multiplicities, moments, exponential polynomials. Everything returned encloses the truth.

Rest after the move is `M = target + Σ c_j column_j` for the moments `M_{p,k} = ∫_0^T s^k/k! e^{ps} u(T - s) ds` of the command's
deviation u and the real coefficients c_j of its tail (docs/theory.md, equation 1). A complex moment counts as two real ones, (Re, -Im):
coefficients (re, im) of a costate then pair with it as `Re c M`, and those of a tail with its shapes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate, combinations
from math import comb, factorial
from typing import Any

import flint
from flint import acb, acb_mat, acb_poly, arb, arb_mat, fmpq, fmpq_poly

from relaxations.checking.reading import Undecided, require

ORDER, TERMS = 8, 6  # of Taylor's formula, and one more for so many terms: the more of them, the larger those that cancel
ISOLATION = 200_000  # bits times degree: roots that these do not tell apart make a check inconclusive, for it would cost too much
LARGEST_POLYNOMIAL = 2_000_000  # bits of a coefficient times degree
work = {"left": 0.0}  # in units of about a microsecond, counted, so that a check ends on every machine at the same place


def spend(units: float) -> None:
    """Count work; raises `Undecided` when all is spent."""
    work["left"] -= units * (1 + flint.ctx.prec / 512)
    if work["left"] < 0:
        raise Undecided("more work than a check may cost")


@dataclass(frozen=True, slots=True)
class Root:
    """A root with Im ≥ 0 in a ball that holds no other; one that is not real stands for a conjugate pair."""

    value: acb
    multiplicity: int

    @property
    def flexible(self) -> bool:
        return not self.value.imag.is_zero()

    @property
    def size(self) -> int:
        return self.multiplicity * (1 + self.flexible)

    def impulse(self, s: arb) -> list[acb]:
        """b_k(s) = s^k/k! e^{ps} for k < multiplicity."""
        spend(4 + 2 * self.multiplicity)
        values = [(self.value * s).exp()]
        for k in range(1, self.multiplicity):
            values.append(values[-1] * s / k)
        return values

    def step(self, s: arb) -> list[acb]:
        """S_k(s) = ∫_0^s b_k, by parts: S_k = (b_k - S_{k-1}) / p with S_{-1} = 1."""
        values, below = self.impulse(s), acb(1)
        for k, b in enumerate(values):
            values[k] = below = b * s / (k + 1) if self.value.is_zero() else (b - below) / self.value
        return values

    def ramp(self, s: arb) -> list[acb]:
        """R_k(s) = ∫_0^s S_k, by parts: R_k = (S_k - R_{k-1}) / p with R_{-1} = s."""
        values, below = self.step(s), acb(s)
        for k, step in enumerate(values):
            values[k] = below = step * s / (k + 2) if self.value.is_zero() else (step - below) / self.value
        return values

    def before(self, zero: Root, power: int, unit: acb) -> list[acb]:
        """The moments for an input `Re unit r^l/l! e^{zr}` after the move: (-1)^l C(k+l, l) / (z - p)^{k+l+1}, half each for z and z*."""
        one, other = 1 / (zero.value - self.value), 1 / (zero.value.conjugate() - self.value)
        degrees = range(power + 1, power + 1 + self.multiplicity)
        return [(-1) ** power * comb(n - 1, power) * (unit * one**n + unit.conjugate() * other**n) / 2 for n in degrees]


def flat(roots: Sequence[Root], entries: Callable[..., Sequence[acb]], *of: Any) -> arb_mat:
    """Complex `entries(root, *of)` for every root and k < multiplicity as a column of real ones: (Re, -Im), at a real root Re alone."""
    parts = [part for root in roots for entry in entries(root, *of) for part in (entry.real, -entry.imag)[: 1 + root.flexible]]
    return arb_mat(len(parts), 1, parts)


def placed(roots: Sequence[Root], chains: Sequence[Any]) -> tuple[list[fmpq], list[tuple[int, Root]]]:
    """The numbers of chains in the flat order; where each begins, and its root: the nearest one (a wrong one proves nothing)."""
    numbers, found = [fmpq(0)] * sum(root.size for root in roots), []
    for chain in chains:
        require(bool(roots), "coefficients of a tail that the task does not have")
        best = min(range(len(roots)), key=lambda i: float(abs(roots[i].value - acb(*chain.near)).mid()))
        begin, root = sum(other.size for other in roots[:best]), roots[best]
        fits = len(chain.coefficients) <= root.multiplicity and (root.flexible or not any(c[1] for c in chain.coefficients))
        require(fits and begin not in dict(found), "a root is named twice, or with other coefficients than its multiplicity allows")
        found.append((begin, root))
        for place, number in enumerate((part for c in chain.coefficients for part in c[: 1 + root.flexible]), begin):
            numbers[place] = number
    return numbers, found


def long(polynomial: fmpq_poly) -> bool:
    """Whether exact arithmetic with a polynomial costs too much."""
    return polynomial.numer().height_bits() * len(polynomial) > LARGEST_POLYNOMIAL


def isolated(polynomial: fmpq_poly) -> tuple[Root, ...]:
    """All distinct roots with Im ≥ 0, to as many bits as the precision, and their exact multiplicities (square-free factorisation)."""
    if long(polynomial):
        raise Undecided("a polynomial's numbers are too long")
    whole = polynomial.numer()
    spend(8 * len(whole) ** 2)
    rigid = next(k for k, c in enumerate(whole.coeffs()) if c != 0)
    found = [Root(acb(0), rigid)] if rigid else []
    for factor, multiplicity in whole.right_shift(rigid).factor_squarefree()[1]:
        accuracy = arb(2) ** -flint.ctx.prec / acb_poly(factor.coeffs()[::-1]).root_bound()
        try:
            balls = acb_poly(factor.coeffs()).roots(tol=accuracy, maxprec=min(ISOLATION // len(factor), 4096))
        except ValueError:
            work["left"] = -1.0  # more bits would not help
            raise Undecided("roots of the plant are too close to be told apart") from None
        for ball in balls:
            real = ball.imag.contains(0)  # and the root too, if the mirrored ball, which holds the mirrored root, meets no other one
            if real and sum(ball.conjugate().overlaps(other) for other in balls) > 1:
                raise Undecided("a root is not told from its conjugate at this precision")
            if not ball.imag < 0:
                found.append(Root(acb(ball.real) if real else ball, multiplicity))
    return tuple(found)


def on_axis(polynomial: fmpq_poly) -> int:
    """How many distinct pairs of roots lie on the imaginary axis, the origin aside: exactly those common to P(s) and P(-s)."""
    beside = fmpq_poly(polynomial.coeffs()[next(k for k, c in enumerate(polynomial.coeffs()) if c != 0) :])
    common = beside.gcd(fmpq_poly([c * (-1) ** k for k, c in enumerate(beside.coeffs())]))
    squares = isolated(fmpq_poly(common.coeffs()[::2]))  # in w = s²: the common part is even
    return sum(not w.flexible and bool(w.value.real < 0) for w in squares)


def stable(numerator: fmpq_poly) -> tuple[Root, ...]:
    """The zeros strictly left of the imaginary axis."""
    zeros = isolated(numerator)
    if sum(not (zero.value.real < 0 or zero.value.real > 0) for zero in zeros) != on_axis(numerator):
        raise Undecided("a zero is not told from the imaginary axis at this precision")
    return tuple(zero for zero in zeros if zero.value.real < 0)


def named(roots: Sequence[Root], kind: str, given: dict[str, Any], otherwise: Any) -> list[tuple[Root, Any]]:
    """What is given to roots by name, kind[i] by ascending magnitude, which must be clear where it matters; names are used up."""
    ordered = sorted(roots, key=lambda root: abs(root.value).mid())
    found = [(root, given.pop(f"{kind}[{place}]", otherwise)) for place, root in enumerate(ordered, 1)]
    if any(one != other and not abs(root.value) < abs(next_.value) for (root, one), (next_, other) in combinations(found, 2)):
        raise Undecided(f"the order of {kind}[i] is not defined: two are equally large")
    return found


def further(roots: Sequence[Root], counts: dict[str, int]) -> tuple[Root, ...]:
    """The roots with further zeros: mode[i] (flexible) and real[i]."""
    left, result = dict(counts), [root for root in roots if root.value.is_zero()]
    for kind, flexible in (("mode", True), ("real", False)):
        group = [root for root in roots if root.flexible is flexible and not root.value.is_zero()]
        result += [Root(root.value, root.multiplicity + n) for root, n in named(group, kind, left, 0)]
    require(not left, f"the plant has no {', '.join(left)}")
    return tuple(result)


def caps(task: Any, zeros: Sequence[Root], numerator: fmpq_poly, denominator: fmpq_poly) -> tuple[arb | None, ...]:
    """How large the highest coefficient c at each zero of a tail may be; None: not limited.

    A zero of multiplicity m that lies at z + d instead forces c d G^(m)(z)/(m-1)! e^{zr} on the output, to first order in d: at most the
    fraction `residual` of the displacement for |d| ≤ shift |z|. The names zero[i] count all zeros of the plant.
    """
    given, bounds = dict(task.limits.zero_sensitivity), []
    asked = [(root, pair) for root, pair in named(isolated(numerator), "zero", given, None) if pair] if given else []
    for zero in zeros:
        pair = next((pair for root, pair in asked if root.value.overlaps(zero.value)), None)
        slope, m = numerator, zero.multiplicity
        for _ in range(m):
            slope = slope.derivative()
        steep = abs(zero.value * acb_poly(slope)(zero.value) / acb_poly(denominator)(zero.value)) / factorial(m - 1)
        bounds.append(arb(pair[1] * abs(task.displacement) / pair[0]) / steep if pair else None)
    require(not given and len(asked) == len(bounds) - bounds.count(None), "a zero that may be elsewhere has no tail")
    return tuple(bounds)


@dataclass(frozen=True, slots=True)
class System:
    """A task in balls; inputs are deviations from the initial rest, exact."""

    task: Any
    roots: tuple[Root, ...]
    zeros: tuple[Root, ...]
    caps: tuple[arb | None, ...]
    rest: fmpq
    lower: fmpq
    upper: fmpq
    highest: fmpq  # moment at the origin, if there is a pole
    target: arb_mat
    columns: arb_mat
    begin: tuple[acb, ...]  # moments of an initial state, in the order of the roots

    @property
    def sloped(self) -> bool:
        """Whether the input is continuous, straight between instants: limits of its slope, without a sample time."""
        return self.task.limits.rate is not None and self.task.limits.sample_time is None

    @property
    def capped(self) -> list[tuple[range, arb]]:
        """The places of a tail's coefficients (real and imaginary part) whose modulus is limited, and the limit."""
        ends = zip(self.zeros, accumulate(zero.size for zero in self.zeros), self.caps, strict=True)
        return [(range(end - 1 - zero.flexible, end), cap) for zero, end, cap in ends if cap is not None]

    def drift(self, time: arb, derivative: bool = False) -> arb_mat:
        """What the moments of an initial state have become after `time` seconds without input, or its derivative."""
        if not self.begin:
            return arb_mat(self.target.nrows(), 1)
        begins = {id(root): self.begin[at : at + root.multiplicity] for root, at in zip(self.roots, self._places, strict=True)}

        def moved(root: Root) -> list[acb]:
            chain, powers = begins[id(root)], root.impulse(time)
            course = [sum((chain[i] * powers[k - i] for i in range(k + 1)), acb(0)) for k in range(root.multiplicity)]
            return [root.value * x + before for x, before in zip(course, [acb(0), *course], strict=False)] if derivative else course

        return flat(self.roots, moved)

    @property
    def _places(self) -> list[int]:
        return list(accumulate((root.multiplicity for root in self.roots), initial=0))[:-1]

    def room(self, time: fmpq) -> tuple[fmpq, fmpq]:
        """How far above and below the final rest input the tail may be, `time` seconds after the move."""
        above, below, length = self.upper - self.rest, self.rest - self.lower, self.task.limits.tail_length
        share = length.within * min(above, below) if length and time >= length.time else max(above, below)
        return min(above, share), min(below, share)

    def end(self, tail: Sequence[arb | fmpq]) -> arb | fmpq:
        """The input when the move ends, where the tail with these coefficients begins."""
        begins = accumulate((zero.size for zero in self.zeros), initial=0)
        return sum((tail[at] for _, at in zip(self.zeros, begins, strict=False)), self.rest)

    def after(self, output: str | None) -> tuple[Callable[[Sequence[acb], Root], list[acb]], fmpq, fmpq]:
        """What a tail does to the slope of the input (None) or an output, and the room for that above and below where they come to rest.

        A chain of coefficients c_l of `r^l/l! e^{zr}` becomes `z c_l + c_{l+1}` in the slope, `Σ_{k≥l} G^(k-l)(z)/(k-l)! c_k` in an output.
        """
        if output is None:
            low, high = self.task.limits.rate
            return lambda chain, zero: [zero.value * c + after for c, after in zip(chain, [*chain[1:], acb(0)], strict=True)], high, -low
        (plant,), limit = self.task.plants, self.task.limits.deflection[output]
        polynomials = [acb_poly(list(written[::-1])) for written in (plant.outputs[output], plant.denominator)]
        rest = self.task.displacement * plant.outputs[output][-1] / plant.numerator[-1]

        unseen = not fmpq_poly(list(plant.outputs[output][::-1])) % fmpq_poly(list(plant.numerator[::-1]))

        def answer(chain: Sequence[acb], zero: Root) -> list[acb]:
            if unseen:  # as the controlled output does, and its derivatives
                return [acb(0)] * len(chain)
            above, below = ([*p(acb_poly([zero.value, 1])).coeffs(), *[acb(0)] * len(chain)] for p in polynomials)
            series: list[acb] = []
            for k in range(len(chain)):
                series.append((above[k] - sum((series[i] * below[k - i] for i in range(k)), acb(0))) / below[0])
            return [sum((g * c for g, c in zip(series, chain[at:], strict=False)), acb(0)) for at in range(len(chain))]

        return answer, limit - rest, limit + rest


def beginning(roots: Sequence[Root], denominator: fmpq_poly, start: Sequence[fmpq]) -> Iterator[acb]:
    """The moments of ξ and its derivatives, D(d/dt) ξ = u: `Σ q_i ξ^{(i)}` with `D(s)/(s - p)^{k+1} = Σ q_i s^i`."""
    for root in roots:
        quotient = [acb(c) for c in denominator.coeffs()]
        for _ in range(root.multiplicity):
            below = [quotient[-1]]
            for coefficient in reversed(quotient[1:-1]):
                below.insert(0, coefficient + root.value * below[0])
            quotient = below
            yield sum((q * x for q, x in zip(quotient, start, strict=False)), acb(0))


def system(task: Any) -> System:
    """The task's equations; raises `Malformed` if it is no task: no rest within the limits, or hidden modes under output rest."""
    (plant,), output = task.plants, task.rest == "output"
    numerator, denominator = (fmpq_poly(list(written[::-1])) for written in (plant.numerator, plant.denominator))
    require(not (long(numerator) or long(denominator)), "the plant's numbers are too long")
    require(not output or numerator.gcd(denominator).degree() == 0, "under output rest numerator and denominator have no common factor")
    roots, zeros = further(isolated(denominator), plant.zeros), stable(numerator) if output else ()
    if task.box is not None:  # only at the origin do all plants come to rest
        roots = tuple(root for root in roots if root.value.is_zero())
    rigid = next(k for k, c in enumerate(denominator.coeffs()) if c != 0)
    ratio = task.displacement * denominator[rigid] / numerator[0]
    rest = fmpq(0) if rigid else ratio
    lower, upper = (limit - task.initial_input for limit in task.limits.input)
    require(lower <= min(0, rest) and max(0, rest) <= upper, "the limits exclude the input at a rest")
    require(task.limits.fuel is None or not rest, "a budget of fuel belongs to a plant that rests without input")

    def target(root: Root) -> list[acb]:
        if root.value.is_zero():
            return [acb(0)] * (rigid - 1) + [acb(ratio)]
        return [acb(rest) / (-root.value) ** (k + 1) for k in range(root.multiplicity)]

    aim = flat(roots, target)
    shapes = [(z, k, unit) for z in zeros for k in range(z.multiplicity) for unit in (acb(1), acb(0, 1))[: 1 + z.flexible]]
    spend(10 * len(shapes) * aim.nrows())
    columns = [x for shape in shapes for x in flat(roots, Root.before, *shape).entries()]
    bounds = caps(task, zeros, numerator, denominator)
    begin = () if task.initial_state is None else tuple(beginning(roots, denominator, task.initial_state))
    return System(task, roots, zeros, bounds, rest, lower, upper, ratio, aim, arb_mat(len(shapes), aim.nrows(), columns).transpose(), begin)


@dataclass(frozen=True, slots=True)
class Wave:
    """`Re Σ_roots Σ_k c_k s^k/k! e^{ps}`: a costate in time to go, a tail in time after the move. Row j of `rows` is its derivative j."""

    roots: tuple[Root, ...]
    rows: acb_mat

    @staticmethod
    def of(roots: tuple[Root, ...], numbers: Sequence[arb | fmpq]) -> Wave:
        """From real coefficients in the flat order; d/ds turns c_k into p c_k + c_{k+1}."""
        rest, places = iter(numbers), [(root, k + 1 < root.multiplicity) for root in roots for k in range(root.multiplicity)]
        rows = [[acb(next(rest), next(rest) if root.flexible else 0) for root, _ in places]]
        for _ in range(ORDER + len(places) // TERMS):
            steps = zip(places, rows[-1], [*rows[-1][1:], 0], strict=True)
            rows.append([root.value * c + (after if chained else 0) for (root, chained), c, after in steps])
        return Wave(roots, acb_mat(rows))

    def __call__(self, s: arb) -> list[arb]:
        """Its value and derivatives at s; over a ball of s balls around all their values there."""
        return [x.real for x in (self.rows * acb_mat([[x] for root in self.roots for x in root.impulse(s)])).entries()]

    def raised(self, level: arb) -> Wave:
        """The wave plus a constant: one more root at the origin."""
        rows = [[*row, acb(0 if k else level)] for k, row in enumerate(self.rows.tolist())]
        return Wave((*self.roots, Root(acb(0), 1)), acb_mat(rows))

    def derivative(self) -> Wave:
        """The wave's derivative: the same terms, one row fewer."""
        return Wave(self.roots, acb_mat(self.rows.tolist()[1:]))

    def reversed(self) -> Wave:
        """Minus the wave."""
        return Wave(self.roots, -self.rows)

    def integral(self, s: arb) -> arb:
        """From 0 to s."""
        return (self.rows * acb_mat([[x] for root in self.roots for x in root.step(s)]))[0, 0].real

    def over(self, a: arb, b: arb) -> tuple[arb, arb, arb, arb]:
        """The middle c of [a, b], the value there, and balls around slope and value on all of [a, b], by Taylor's formula."""
        spend(30)
        c = ((a + b) / 2).mid()
        whole = a.union(b).union(c)
        x, terms = whole - c, [*self(c)[:-1], self(whole)[-1]]
        slope = value = terms[-1]
        for j in range(len(terms) - 2, -1, -1):
            slope = terms[j] + x * slope / j if j else slope
            value = terms[j] + x * value / (j + 1)
        return c, terms[0], slope, value
