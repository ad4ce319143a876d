"""Sequences of partial sums up to 1 of a mode that all but decays while they last: to any damping, and a bound in closed form.

Partial sums S = 1 - x, x ≥ 0, leave nothing of a pole p = (r + j)ω_d, r = ζ/√(1 - ζ²), nor n derivatives of it, if

    1 + p ∫ x e^{pt} dt = 0 and its derivatives by p,   so   ∫ y χ^k e^{jχ} dχ = (-1)^{k+1} k!/(r + j)^{k+1},   k = 0 … n

with χ = ω_d t and y = x e^{rχ}. Against that growth a bound on x says nothing: the shortest such y is n + 1 points, near kπ, and everything
in these equations is of order one, however near ζ is to 1. The points are dips of x (relaxations.shaping.dips).

Least: let f = Re(P(χ) e^{(r+j)χ}), P of degree n. Where f ≥ 0 on [0, T] and ∫_{-∞}^0 f > 0, no such x ends by T, for it makes the sum of
∫ x f and the latter vanish. Of the function that tells the least duration of positive impulses (relaxations.shaping.least_durations) that
is known in closed form.
"""

from __future__ import annotations

import math
from contextlib import suppress
from fractions import Fraction
from math import comb, factorial

from flint import acb, arb, arb_poly

from relaxations.errors import SolverError
from relaxations.plants import precision
from relaxations.shaping.amplitudes import LEAST, decay_per_radian, named, too_small
from relaxations.shaping.depths import widened
from relaxations.shaping.dips import drawn_apart
from relaxations.shaping.modes import Mode
from relaxations.shaping.paths import CLOSED, Vector, ordered, solved
from relaxations.shaping.shapers import Shaper

DECAYED = 1e-7  # of itself is left of a mode in half a period: from there on dips are narrower than doubles tell well
BITS = 256
STEPS = (1, 4, 16)  # from r = ∞
WELL_BEFORE = 0.5  # damping: there amplitudes are no question
HALVINGS = 60


def decayed(mode: Mode, derivatives: int) -> Shaper:
    """The sequence; its partial sums lie in [0, 1]. Raises `SolverError` where amplitudes are too small for doubles."""
    n = derivatives
    if smallest(mode.damping, n) < LEAST:
        raise SolverError(too_small(f"um-{named(n)}", mode.damping, lambda damping: smallest(damping, n)))
    folds = (n + 1) * math.pi * decay_per_radian(mode.damping)
    with precision(BITS + 64 * n + math.ceil(4.0 * folds / math.log(2.0))):
        points, sizes = points_of(mode.damping, n)
        zeta, omega = arb(mode.damping), arb(mode.frequency)
        root = (1 - zeta * zeta).sqrt()
        instants = [point / (omega * root) for point in points]
        with suppress(SolverError):
            return drawn_apart([(mode, n)], [(at, at) for at in instants])
        # Of many derivatives the first dips are wide.
        integrals = [size * (-zeta / root * point).exp() / (omega * root) for point, size in zip(points, sizes, strict=True)]
        return drawn_apart([(mode, n)], widened([(mode, n)], instants, integrals, Fraction(1)))


def least_up_to_one(mode: Mode, derivatives: int) -> float:
    """The least duration [s] of sequences with partial sums up to 1, *proven*, at any damping for any number n of derivatives.

    With X = χ - χ_T, T the end, the function `f = e^{rX} sin X Π_{k=1}^n (X + kπ)` is nowhere positive on [-(n+1)π, 0]. Its integral up
    to the beginning is `Im(e^{(r+j)X} Σ_k (-1)^k Q^(k)(X)/(r + j)^{k+1})`, Q the product; where that is negative, none is as short.
    Without damping there is no such integral, and the answer is 0.
    """
    n = derivatives
    if not mode.damping:
        return 0.0
    with precision(BITS + 16 * n):
        zeta = arb(mode.damping)
        root = (1 - zeta * zeta).sqrt()
        rate, product = acb(zeta / root, 1), arb_poly([1])
        for k in range(1, n + 1):
            product *= arb_poly([k * arb.pi(), 1])

        def proven(short: float) -> bool:
            """Whether none is shorter than (n + 1)π by so much."""
            begin = -(n + 1) * arb.pi() + arb(short)
            total, part, factor = acb(0), product, 1 / rate
            for _ in range(n + 1):
                total += part(begin) * factor
                part, factor = part.derivative(), -factor / rate
            return bool((acb(0, begin).exp() * total).imag < 0)

        low, high = 0.0, math.pi  # half a period from the beginning f changes its sign
        if not proven(high):
            return least_up_to_one(mode, n - 1) if n else 0.0
        for _ in range(HALVINGS):
            middle = (low + high) / 2.0
            low, high = (low, middle) if proven(middle) else (middle, high)
        whole = ((n + 1) * arb.pi() - arb(high)) / (arb(mode.frequency) * root)
        return max(0.0, math.nextafter(float(whole.lower()), 0.0))


def smallest(damping: float, derivatives: int) -> float:
    """The decimal logarithm of the smallest amplitude: of the last dip, the difference of both heights."""
    if damping < WELL_BEFORE:
        return 0.0
    with precision(BITS):
        points, sizes = points_of(damping, derivatives)
        height = (sizes[-1] / (2 * points[-1])).log()  # that of two steps of WIDTH, and by about WIDTH they differ
        return (float(height) - decay_per_radian(damping) * float(points[-1])) / math.log(10.0)


def points_of(damping: float, derivatives: int) -> tuple[Vector, Vector]:
    """Places χ and sizes of y, n + 1 of each: from r = ∞, where they are those of binomial impulses at kπ."""
    n, zeta = derivatives + 1, arb(damping)
    goal = (1 - zeta * zeta).sqrt() / zeta
    for steps in STEPS:
        x: Vector | None = [*(k * arb.pi() for k in range(1, n + 1)), *(arb(comb(n, k)) for k in range(1, n + 1))]
        for step in range(1, steps + 1):
            found = None if x is None else solved(_equations, [*x, goal * step / steps], None, CLOSED)
            x = None if found is None else found[:-1]
        if x is not None and ordered(x[:n][::-1]):
            root = (1 + goal**-2).sqrt()  # |r + j|
            return x[:n], [size / root for size in x[n:]]
    raise SolverError(f"impulses with {derivatives} derivative(s) were not found at damping {damping!r}; fewer are possible")


def _equations(x: Vector, w: arb) -> tuple[Vector, list[Vector]]:
    """`Σ |r + j| y_k χ_k^i e^{j(χ_k + arg(r + j))} = (-1)^{i+1} i!/(r + j)^i`, i = 0 … n, w = 1/r; each divided by (nπ)^i."""
    n = len(x) // 2
    values: Vector = []
    rows: list[Vector] = []
    direction = acb(1, w)
    turn = direction / abs(direction)
    motions = [turn * acb(0, place).exp() for place in x[:n]]
    for i in range(n):
        scale = (n * arb.pi()) ** i
        terms = [place**i / scale * motion for place, motion in zip(x[:n], motions, strict=True)]
        value = sum((size * term for size, term in zip(x[n:], terms, strict=True)), acb(0))
        value += (-1) ** i * factorial(i) * (w / direction) ** i / scale
        by_place = [size * term * (acb(0, 1) + arb(i) / place) for size, term, place in zip(x[n:], terms, x[:n], strict=True)]
        values += [value.real, value.imag]
        rows += [[*(d.real for d in (*by_place, *terms)), arb(0)], [*(d.imag for d in (*by_place, *terms)), arb(0)]]
    return values, rows
