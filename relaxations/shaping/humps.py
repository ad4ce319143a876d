"""Extra-insensitive shapers: the residual vibration touches a tolerance instead of vanishing at the mode alone (docs/theory.md, section 5).

`F(ν) = Σ A_i e^{κν(φ_i - φ_n)}`, κ = ζ + j√(1 - ζ²), is the residual at ν times the mode's frequency, φ_i = ωt_i, with ζ held. With m zeros
its modulus has m - 1 humps between them:

    F = 0 at every zero,   |F| = V and d|F|/dν = 0 at every hump,   the middle one of zeros and humps at ν = 1

EI has one hump, at the mode; 2-hump EI a zero there, and so on: any number. Undamped and with positive amplitudes that is the
Dolph-Chebyshev sequence at half periods, from which damping is followed; published polynomial fits are not used. With amplitudes 1, -1, 1 …
the zeros split from the multiple one of the shaper with derivatives, in Chebyshev's pattern again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev, polynomial
from numpy.typing import NDArray

from relaxations.errors import ShaperError, SolverError
from relaxations.shaping.bounded import bounded
from relaxations.shaping.continuation import continued
from relaxations.shaping.modes import Mode
from relaxations.shaping.shapers import Shaper

Reals = NDArray[np.float64]

FIRST_RIPPLE = 1e-3  # so small that the Chebyshev pattern is the solution but for terms of higher order
MOST_HUMPS = 12  # the equations' condition grows with each


@dataclass(frozen=True, slots=True)
class Humped:
    """A shaper, and the modes at which it has its zeros, at the mode's damping, in ascending order of frequency."""

    shaper: Shaper
    zeros: tuple[Mode, ...]


def extra_insensitive(mode: Mode, tolerance: float, humps: int = 1) -> Humped:
    """EI (1), 2-hump EI (2) … with positive amplitudes at any damping; V = `tolerance`, a fraction of the unshaped vibration, in (0, 1).

    Raises `ShaperError` for values outside, `SolverError` where the damping cannot be reached.
    """
    _require(tolerance, humps)
    zeros = humps + 1
    amplitudes, places = _undamped(tolerance, zeros)
    phases: Reals = np.pi * np.arange(1.0, zeros + 1.0)
    try:
        found = continued(
            lambda x, damping: _equations(x[:zeros], x[zeros : 2 * zeros + 1], x[2 * zeros + 1 :], damping, tolerance, True),
            np.concatenate([phases, amplitudes, np.delete(places, len(places) // 2)]),
            mode.damping,
        )
    except SolverError as problem:  # with damping the highest zeros move away, in the end beyond all frequencies
        raise SolverError(
            f"{humps} hump(s) of {tolerance!r} at increasing damping: {problem}; fewer humps reach farther, si and zv-d:N any damping"
        ) from None
    shaper = Shaper((0.0, *map(float, found[:zeros] / mode.frequency)), tuple(map(float, found[zeros : 2 * zeros + 1])))
    return Humped(shaper, _zeros(mode, found[2 * zeros + 1 :]))


def unity_magnitude(mode: Mode, tolerance: float, humps: int = 1) -> Humped:
    """The same with impulses 1, -1, 1 … (2 humps + 3 of them): the shaped step switches between 0 and 1.

    Raises as `extra_insensitive`.
    """
    _require(tolerance, humps)
    zeros = humps + 1
    start = bounded([Mode(1.0, mode.damping)], 0, 1, humps).shaper
    phases, amplitudes = np.array(start.times[1:]), np.array(start.amplitudes).round()
    direction, ends = mode.direction, np.array(start.times) - start.duration
    bend = abs(np.sum(amplitudes * (direction * ends) ** zeros * np.exp(direction * ends))) / math.factorial(zeros)
    small = min(FIRST_RIPPLE, tolerance)
    spread = (small * 2.0 ** (zeros - 1) / bend) ** (1.0 / zeros)
    places: Reals = (1.0 - spread * np.cos(np.arange(1, 2 * zeros) * np.pi / (2 * zeros))).astype(np.float64)

    def vanishing(phases: Reals, way: float) -> Reals:
        """The zeros alone, moving apart from where they were one."""
        apart = 1.0 + way * (places - 1.0)
        return _equations(phases, amplitudes, np.delete(apart, zeros - 1), mode.damping, small, False)[: 2 * zeros]

    def system(x: Reals, way: float) -> Reals:
        """From a small ripple to the one asked for."""
        ripple = small * (tolerance / small) ** way
        return _equations(x[: 2 * zeros], amplitudes, x[2 * zeros :], mode.damping, ripple, False)

    phases = continued(vanishing, phases, 1.0, 0.5)
    found = continued(system, np.concatenate([phases, np.delete(places, zeros - 1)]), 1.0)
    shaper = Shaper((0.0, *map(float, found[: 2 * zeros] / mode.frequency)), tuple(map(float, amplitudes)))
    return Humped(shaper, _zeros(mode, found[2 * zeros :]))


def _zeros(mode: Mode, places: Reals) -> tuple[Mode, ...]:
    """Of zeros and humps in ascending order without the middle one, which is at the mode, every second is a zero."""
    return tuple(mode.scaled(float(nu)) for nu in _with_middle(places)[::2])


def _with_middle(places: Reals) -> Reals:
    return np.insert(places, len(places) // 2, 1.0)


def _require(tolerance: float, humps: int) -> None:
    if not 0.0 < tolerance < 1.0:
        raise ShaperError(f"a tolerance is a fraction of the unshaped vibration between 0 and 1, not {tolerance!r}")
    if not 1 <= humps <= MOST_HUMPS:
        raise ShaperError(f"humps are counted from 1 to {MOST_HUMPS}, not {humps}")


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


def _equations(phases: Reals, amplitudes: Reals, places: Reals, damping: float, tolerance: float, normalised: bool) -> Reals:
    """The equations above: `places` are zeros and humps in ascending order without the middle one, 1; `phases` without the first, 0."""
    direction = complex(damping, math.sqrt(1.0 - damping**2))
    phi = np.concatenate([[0.0], phases]) - phases[-1]
    nu = _with_middle(places)
    with np.errstate(over="ignore", invalid="ignore"):  # far from a solution numbers may end; such a step is refused
        motions = np.exp(direction * np.multiply.outer(nu, phi))
        values, slopes = motions @ amplitudes, (motions * (direction * phi)) @ amplitudes
        zeros, humps = values[::2], values[1::2]
        tops = (humps.conj() * slopes[1::2]).real / tolerance**2 * (nu[-1] - nu[0])  # of order one, however narrow the humps
        sums = [amplitudes.sum() - 1.0] if normalised else []
        return np.concatenate([sums, zeros.real / tolerance, zeros.imag / tolerance, (np.abs(humps) / tolerance) ** 2 - 1.0, tops])
