"""Extra-insensitive shapers: the residual vibration touches a tolerance instead of vanishing at the mode alone (docs/theory.md, section 8).

`F(ν) = Σ A_i e^{κν(φ_i - φ_n)}`, κ = ζ + j√(1 - ζ²), is the residual at ν times the mode's frequency, φ_i = ωt_i, with ζ held. With m zeros
its modulus has m - 1 humps between them:

    F = 0 at every zero,   |F| = V and d|F|/dν = 0 at every hump,   the middle one of zeros and humps at ν = 1

EI has one hump, at the mode; 2-hump EI a zero there, and so on: any number. Undamped and with positive amplitudes that is the
Dolph-Chebyshev sequence at half periods, from which damping is followed; published polynomial fits are not used. With amplitudes 1, -1, 1 …
the zeros split from the multiple one of the shaper with derivatives, in Chebyshev's pattern again.

Such a solution exists up to a largest V, which falls with damping: there the highest zero has gone beyond all frequencies and the last two
impulses have become one, or V is largest on the curve of solutions (large V). Of a tolerance above it the shaper with that largest V is
made: it keeps the tolerance all the more, and is continuous in damping and tolerance. With one hump it is the ZV shaper of a lower
frequency, whose highest residual beyond its zero is at the mode.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from flint import acb, arb
from numpy.polynomial import chebyshev, polynomial
from numpy.typing import NDArray

from relaxations.errors import ShaperError, SolverError
from relaxations.plants import precision
from relaxations.shaping.amplitudes import LEAST, decay_per_radian, smallest_of_derivatives, too_small
from relaxations.shaping.continuation import continued
from relaxations.shaping.decayed import DECAYED, smallest
from relaxations.shaping.dips import Dip
from relaxations.shaping.modes import Mode
from relaxations.shaping.paths import CLOSE, CLOSED, Point, Vector, followed, ordered, solved
from relaxations.shaping.ripples import Ripples
from relaxations.shaping.shapers import Shaper
from relaxations.shaping.switched import as_doubles, dips_of, in_doubles, phases_of

Reals = NDArray[np.float64]

MOST_HUMPS = 12  # the equations' condition grows with each
LEAST_TOLERANCE = 1e-13  # below it doubles' own rounding is no longer small
ROUNDED = 1e-15  # of what is left: what rounding to doubles may add, for each zero; with impulses 1, -1, 1 … for each unit of phase
MOST_ROUNDED = 0.5  # of a tolerance, that is given up for it
PLAIN = 1e-3  # tolerances from here on are solved in doubles where that goes
SPREAD = 0.25  # of √(1 - ζ²)/(mπ): so close to each other zeros are in Chebyshev's pattern
LONGER = 2  # times as long as with derivatives: impulses 1, -1, 1 … are made no longer
CLOSER = (1, 8, 8)  # times closer zeros that are tried, each time
MERGED = 0.05  # phase between the last two impulses from which they are made one
POINTS, FEWER_POINTS = 500, 150  # of the curve that are followed; of impulses 1, -1, 1 … that all but decay in between
MUCH = 0.9  # damping: below it amplitudes are no question
BITS = 128


@dataclass(frozen=True, slots=True)
class Humped:
    """A shaper, the modes at which it has its zeros, at the mode's damping, in ascending order of frequency, and its humps' height.

    `ripple` is the tolerance but for rounding, or the largest one that such a shaper can use. Of impulses 1, -1, 1 … `dips` are where their
    partial sums are 0 [s], in more digits than doubles have.
    """

    shaper: Shaper
    zeros: tuple[Mode, ...]
    ripple: float
    dips: tuple[Dip, ...] = ()


def extra_insensitive(mode: Mode, tolerance: float, humps: int = 1) -> Humped:
    """EI (1), 2-hump EI (2) … with positive amplitudes at any damping; V = `tolerance`, a fraction of the unshaped vibration, in (0, 1).

    Raises `ShaperError` for values outside, `SolverError` where the numerics fail.
    """
    aim = _require(tolerance, humps)
    _require_told(mode, f"{'' if humps == 1 else f'{humps}-hump-'}ei", lambda damping: smallest_of_derivatives(damping, humps - 1))
    if aim >= PLAIN:
        try:
            return _plain(mode, aim, humps)
        except SolverError:
            pass  # the solution ends before this damping, or doubles do not tell: from the multiple zero at this damping, then
    zeros, n = humps + 1, humps + 2
    with _digits(_first_ripple(mode, zeros, aim)) as (first, spread):
        damping = arb(mode.damping)
        root = (1 - damping * damping).sqrt()
        decay = (-damping * arb.pi() / root).exp()
        phases = [(n - 1 - i) * arb.pi() / root for i in range(n)]
        amplitudes = [math.comb(zeros, i) * decay**i / (1 + decay) ** zeros for i in range(n)]
        ripples = Ripples(damping, n, 2 * zeros - 1, zeros - 1, merging=True)
        end = _spread(ripples, phases, amplitudes, spread, first, aim, None, POINTS + int(-math.log(mode.decay)))
        if not (end.goal or end.end) and end.x[n - 2] < MERGED:
            ripples, end = _merged(ripples, end)
        elif not (end.goal or end.end):
            raise SolverError(_lost(humps, tolerance, end))
        return _humped(mode, ripples, end)


def unity_magnitude(mode: Mode, tolerance: float, humps: int = 1) -> Humped:
    """The same with impulses 1, -1, 1 … (2 humps + 3 of them): the shaped step switches between 0 and 1.

    With damping large humps take ever longer impulses: V is no larger than what takes twice as long as the shaper with derivatives.
    Raises as `extra_insensitive`.
    """
    aim = _require(tolerance, humps)
    _require_told(mode, f"um-{'' if humps == 1 else f'{humps}-hump-'}ei", lambda damping: smallest(damping, humps))
    zeros, given = humps + 1, tuple((-1) ** i for i in range(2 * humps + 3))
    folds = zeros * math.pi * decay_per_radian(mode.damping)
    with _digits(_first_ripple(mode, zeros, aim), math.ceil(4.0 * folds / math.log(2.0))):  # dips are as narrow
        phases = list(phases_of(mode.damping, Fraction(0), Fraction(1), humps).phases)
        aim = min(aim, tolerance - ROUNDED * min(LONGER * float(phases[0]), MOST_ROUNDED * tolerance / ROUNDED))
        ripples = Ripples(arb(mode.damping), len(given), 2 * zeros - 1, zeros - 1, given)
        bend = abs(sum((a * (ripples.direction * p) ** zeros * (-ripples.direction * p).exp()
                        for a, p in zip(given, phases, strict=True)), acb(0))) / math.factorial(zeros)  # fmt: skip
        spread = SPREAD * (1 - arb(mode.damping) ** 2).sqrt() / (zeros * arb.pi())
        first = bend * spread**zeros / 2 ** (zeros - 1)
        if first > arb(aim) / 2:
            first, spread = arb(aim) / 2, spread * (arb(aim) / 2 / first).root(zeros)
        end = _spread(ripples, phases, [], spread, first, aim, LONGER * phases[0], POINTS if mode.decay > DECAYED else FEWER_POINTS)
        if not (end.goal or end.end):  # as far as it could be followed: these humps keep the tolerance all the more
            exact = solved(ripples, [*end.x, end.w], None, CLOSED)
            if exact is None or not _proper(ripples, exact[:-1]):
                raise SolverError(_lost(humps, tolerance, end))
            end = Point(exact[:-1], end.w, False)
        return _humped(mode, ripples, end)


def _require(tolerance: float, humps: int) -> float:
    """The height at which humps are designed, so that the tolerance holds for what is rounded to doubles."""
    if not 0.0 < tolerance < 1.0:
        raise ShaperError(f"a tolerance is a fraction of the unshaped vibration between 0 and 1, not {tolerance!r}")
    if tolerance < LEAST_TOLERANCE:
        raise ShaperError(
            f"a tolerance of {tolerance!r} is lost in the rounding of times and amplitudes; humps are from {LEAST_TOLERANCE!r} on, "
            f"and {'zv' + 'd' * min(humps, 2) if humps < 3 else f'zv-d:{humps}'} leaves nothing at the mode"
        )
    if not 1 <= humps <= MOST_HUMPS:
        raise ShaperError(f"humps are counted from 1 to {MOST_HUMPS}, not {humps}")
    return tolerance - min(ROUNDED * (humps + 1), MOST_ROUNDED * tolerance)


def _require_told(mode: Mode, name: str, smallest_amplitude: Callable[[float], float]) -> None:
    """With much damping humps are so low that the smallest amplitude is nearly that of the multiple zero."""
    if mode.damping > MUCH and smallest_amplitude(mode.damping) < LEAST:
        raise SolverError(too_small(name, mode.damping, smallest_amplitude))


def _lost(humps: int, tolerance: float, end: Point) -> str:
    return f"{humps} hump(s) of {tolerance!r} were not found; {float(end.w.exp()):.4g} is possible, fewer humps too"


@contextmanager
def _digits(first: tuple[float, float], more: int = 0) -> Iterator[tuple[arb, arb]]:
    """So many that the first ripple, e^`first`, is not lost in rounding; V and spread to begin with."""
    with precision(BITS + more + int(-2.0 * first[0] / math.log(2.0))):
        yield arb(first[0]).exp(), arb(first[1])


def _first_ripple(mode: Mode, zeros: int, aim: float) -> tuple[float, float]:
    """(log V, spread): `|F| = |κπK/(√(1-ζ²)(1 + K))|^m |ν - 1|^m` near the mode of the shaper with derivatives, K its decay."""
    root = math.sqrt(1.0 - mode.damping**2)
    bend = zeros * (math.log(math.pi / root) - mode.damping * math.pi / root - math.log1p(mode.decay))
    spread = SPREAD * root / (zeros * math.pi)
    first = bend + zeros * math.log(spread) - (zeros - 1) * math.log(2.0)
    most = math.log(aim) - 1.0
    return (first, spread) if first <= most else (most, spread * math.exp((most - first) / zeros))


def _spread(
    ripples: Ripples, phases: Vector, amplitudes: Vector, spread: arb, first: arb, aim: float, most: arb | None, points: int
) -> Point:
    """From the multiple zero to humps of V = `first`, and from them as far as to V = `aim`."""
    m, n, end = ripples.middle + 1, ripples.impulses, None
    for closer in CLOSER:
        spread, first = spread / closer, first / closer**m
        places = [1 - spread * (k * arb.pi() / (2 * m)).cos() for k in range(1, 2 * m)]
        apart = solved(lambda x, w, places=places: ripples.apart(x, w, places), [*phases[:-1], *amplitudes, arb(0)], None, CLOSE)
        if apart is not None:
            start = ripples.unknowns([*apart[: n - 1], arb(0)], apart[n - 1 : -1], places)
            end = followed(ripples, start, first.log(), arb(aim).log(), lambda x: _proper(ripples, x), most, points)
        if end is not None:
            break
    if end is None:
        raise SolverError(
            f"zeros near {m - 1} derivative(s) at damping {float(ripples.damping)!r} were not found; fewer humps are possible, and si"
        )
    return end


def _proper(ripples: Ripples, x: Vector) -> bool:
    if ripples.merging and not x[ripples.impulses - 2] > 0:
        return False
    phases, amplitudes, places = ripples.parts(x)
    return ordered(phases[:-1]) and ordered(places[::-1]) and (bool(ripples.given) or all(a > 0 for a in amplitudes))


def _merged(ripples: Ripples, near: Point) -> tuple[Ripples, Point]:
    """The end of the curve, where the last two impulses are one and all humps are as high as V can be."""
    phases, amplitudes, places = ripples.parts(near.x)
    fewer = Ripples(ripples.damping, ripples.impulses - 1, ripples.places - 1, ripples.middle)
    start = fewer.unknowns([*phases[:-2], arb(0)], [*amplitudes[:-2], amplitudes[-2] + amplitudes[-1]], places[:-1])

    def system(x: Vector, w: arb) -> tuple[Vector, list[Vector]]:
        """V is unknown here."""
        values, rows = fewer(x[:-1], x[-1])
        return values, [[*row, arb(0)] for row in rows]

    found = solved(system, [*start, near.w, arb(0)], None, CLOSED)
    if found is None or not _proper(fewer, found[:-2]):
        raise SolverError(f"humps at damping {float(ripples.damping)!r} end near {float(near.w.exp()):.4g}, where exactly was not found")
    return fewer, Point(found[:-2], found[-2], False)


def _humped(mode: Mode, ripples: Ripples, end: Point) -> Humped:
    phases, amplitudes, places = ripples.parts(end.x)
    zeros = tuple(mode.scaled(float(place)) for place in places[::2])
    if ripples.given:
        shaper = in_doubles(mode, [(zero, 0) for zero in zeros], phases, ripples.given)
    else:
        shaper = as_doubles(mode, phases, amplitudes)
    return Humped(shaper, zeros, float(end.w.exp()), tuple(dips_of(mode, phases)) if ripples.given else ())


def _plain(mode: Mode, tolerance: float, humps: int) -> Humped:
    """In doubles, from the undamped shaper on. Raises `SolverError` where that cannot be followed to the mode's damping."""
    zeros = humps + 1
    amplitudes, places = _undamped(tolerance, zeros)
    phases: Reals = np.pi * np.arange(1.0, zeros + 1.0)
    found = continued(
        lambda x, damping: _equations(x[:zeros], x[zeros : 2 * zeros + 1], x[2 * zeros + 1 :], damping, tolerance),
        np.concatenate([phases, amplitudes, np.delete(places, len(places) // 2)]),
        mode.damping,
    )
    shaper = Shaper((0.0, *map(float, found[:zeros] / mode.frequency)), tuple(map(float, found[zeros : 2 * zeros + 1])))
    # Of zeros and humps in ascending order without the middle one, which is at the mode, every second is a zero.
    return Humped(shaper, tuple(mode.scaled(float(nu)) for nu in _with_middle(found[2 * zeros + 1 :])[::2]), tolerance)


def _with_middle(places: Reals) -> Reals:
    return np.insert(places, len(places) // 2, 1.0)


def _undamped(tolerance: float, zeros: int) -> tuple[Reals, Reals]:
    """Amplitudes at half periods, and zeros and humps in ascending order of ν: `V T_m(x_0 cos(φ/2))`, φ = πν, with T_m(x_0) = 1/V."""
    edge = math.cosh(math.acosh(1.0 / tolerance) / zeros)
    # In powers of 2 cos(φ/2) = q + 1/q the polynomial's coefficients in q are the amplitudes (every second power).
    power = chebyshev.cheb2poly([0.0] * zeros + [1.0])
    total = np.zeros(2 * zeros + 1)
    for k, weight in enumerate(power):
        term = polynomial.polypow([1.0, 0.0, 1.0], k)  # (q² + 1)^k / q^k
        total[zeros - k : zeros + k + 1] += tolerance * weight * (edge / 2.0) ** k * term
    k = np.arange(1, 2 * zeros)  # zeros (odd) and humps (even) of T_m lie at cos(kπ/2m)
    return total[::2].astype(np.float64), 2.0 / np.pi * np.arccos(np.cos(k * np.pi / (2 * zeros)) / edge)


def _equations(phases: Reals, amplitudes: Reals, places: Reals, damping: float, tolerance: float) -> Reals:
    """The equations above: `places` are zeros and humps in ascending order without the middle one, 1; `phases` without the first, 0."""
    direction = complex(damping, math.sqrt(1.0 - damping**2))
    phi = np.concatenate([[0.0], phases]) - phases[-1]
    nu = _with_middle(places)
    with np.errstate(over="ignore", invalid="ignore"):  # far from a solution numbers may end; such a step is refused
        motions = np.exp(direction * np.multiply.outer(nu, phi))
        values, slopes = motions @ amplitudes, (motions * (direction * phi)) @ amplitudes
        zeros, humps = values[::2], values[1::2]
        tops = (humps.conj() * slopes[1::2]).real / tolerance**2 * (nu[-1] - nu[0])  # of order one, however narrow the humps
        circles = (np.abs(humps) / tolerance) ** 2 - 1.0
        return np.concatenate([[amplitudes.sum() - 1.0], zeros.real / tolerance, zeros.imag / tolerance, circles, tops])
