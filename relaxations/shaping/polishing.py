"""From a grid to exact instants: Newton's method on the conditions of optimality of the shortest positive shaper.

With `F_i = Σ A_k z_i(t_k)`, `p(t) = Re Σ y_i* z_i(t)` (`shaping.insensitive`) the shortest shaper, or at a fixed duration the one of
least excess r over all tolerances, satisfies

    Σ A = 1,   F_i = (V_i + r) y_i/|y_i|,   p(t_k) = λ,   p'(t_k) = 0 inside,   Σ |y_i| = 1,   d|F_i|/dω = 0 inside a band

as many equations as unknowns: inner instants, amplitudes, multipliers, λ, inner frequencies, and the duration (r = 0) or r.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from relaxations.checking.durations import Condition

Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]

FREQUENCY, DAMPING = "frequency", "damping"  # along which a maximum moves
FAINT = 1e-6  # an amplitude that is none: the optimum is degenerate
STEPS = 40
CLOSED = 1e-12  # of equations of order one
DIFFERENCE = 1e-7  # of unknowns of order one: the Jacobian is then as exact as Newton's method needs
ALIKE, DEPENDENT = 1e3, 1e13  # condition of demands from which they are told apart, and to which doubles can
SMALLEST_ROOT = 1e-30  # of 1 - ζ²: a step of Newton's method may go too far
FINE = 401  # instants at which they are compared
LONGEST = 0.3  # a step that is longer leaves what the grid has found


@dataclass(frozen=True, slots=True)
class Demand:
    """One condition: at natural `frequency` [rad/s] and `damping` derivative number `power` is at most `tolerance` (0: vanishes).

    Derivatives are measured in `unit` [s], of the order of the duration, so that all are of order one. `band` is the number of the one that
    it belongs to; `inner`: the residual has a maximum there along FREQUENCY or DAMPING, which may move ("": it stays).
    """

    frequency: float
    damping: float
    tolerance: float
    power: int = 0
    unit: float = 1.0
    band: int = -1
    inner: str = ""


@dataclass(frozen=True, slots=True)
class Extremal:
    """A point that satisfies the conditions: instants [s] from 0 to the duration, amplitudes (n,), demands with multipliers (m,), r."""

    times: Reals
    amplitudes: Reals
    demands: tuple[Demand, ...]
    multipliers: Complexes
    excess: float


def rows(demands: Sequence[Demand], instants: Reals, duration: float) -> Complexes:
    """z_i(t): shape (demands, instants)."""
    omega, kappa, power, units = _columns(demands)
    since = instants - duration
    return ((since / units) ** power * np.exp(kappa * omega * since)).astype(np.complex128)


def apart(demands: Sequence[Demand], columns: Complexes) -> Complexes:
    """W (m, m), with which close demands are told apart: `W rows` stand for the same set of demands, their multipliers are `W^H y'`.

    Vibrations of close modes vanish together or nearly so: their rows are made orthonormal (and of order one) where their condition
    is worse than `ALIKE`. Rows with tolerances stay as they are.
    """
    whole = np.eye(len(demands), dtype=np.complex128)
    exact = [i for i, d in enumerate(demands) if not d.tolerance]
    if 1 < len(exact) <= columns.shape[1]:
        _, triangle = np.linalg.qr(columns[exact].conj().T)
        triangle = triangle / math.sqrt(columns.shape[1])
        sizes = np.linalg.svd(triangle, compute_uv=False)
        if sizes[-1] * ALIKE < sizes[0] < sizes[-1] * DEPENDENT:
            whole[np.ix_(exact, exact)] = np.linalg.inv(triangle.conj().T)
    return whole


def vanishing(demand: Demand, weight: complex) -> Condition:
    """What the proof takes of a demand whose vibration vanishes: derivatives by frequency, not in its unit of time."""
    weight /= (demand.frequency * demand.unit) ** demand.power
    return Condition(
        Fraction(demand.frequency), Fraction(demand.damping), Fraction(0), demand.power, (Fraction(weight.real), Fraction(weight.imag))
    )


def _columns(demands: Sequence[Demand]) -> tuple[Reals, Complexes, NDArray[np.int64], Reals]:
    omega, units = (np.array([[x] for x in numbers]) for numbers in ([d.frequency for d in demands], [d.unit for d in demands]))
    kappa = np.array([[complex(d.damping, math.sqrt(max(1.0 - d.damping**2, SMALLEST_ROOT)))] for d in demands])
    return omega, kappa, np.array([[d.power] for d in demands]), units


def _turning(kappa: Complexes) -> Complexes:
    """dκ/dζ."""
    return (1.0 - 1j * kappa.real / kappa.imag).astype(np.complex128)


def polished(start: Extremal, duration: float | None = None) -> Extremal | None:
    """The extremal near `start`, the shortest (r = 0) or the one of the given `duration` [s]; None if Newton's method finds none."""
    unit, n, m = 1.0 / start.demands[0].frequency, len(start.times), len(start.demands)
    inner = [i for i, d in enumerate(start.demands) if d.inner]
    scaled = [replace(d, frequency=d.frequency * unit, unit=d.unit / unit) for d in start.demands]
    fixed = None if duration is None else duration / unit
    ends = start.times[-1] / unit
    turned = apart(scaled, rows(scaled, np.linspace(0.0, ends, FINE), ends))

    def parts(x: Reals) -> tuple[Reals, float, Reals, Complexes, float, list[Demand]]:
        end, excess = (float(x[n - 2]), 0.0) if fixed is None else (fixed, float(x[n - 2]))
        times = np.concatenate([[0.0], x[: n - 2], [end]])
        amplitudes, rest = x[n - 1 : 2 * n - 1], x[2 * n - 1 :]
        y = rest[:m] + 1j * rest[m : 2 * m]
        moved = list(scaled)
        for place, i in enumerate(inner):
            moved[i] = replace(scaled[i], **{scaled[i].inner: float(rest[2 * m + 1 + place])})
        return times, excess, amplitudes, y, float(rest[2 * m]), moved

    def system(x: Reals) -> Reals:
        times, excess, amplitudes, y, level, demands = parts(x)
        omega, kappa, power, units = _columns(demands)
        since = times - times[-1]
        motion, share = np.exp(kappa * omega * since), since / units
        z = share**power * motion
        slope = (power / units * share ** np.maximum(power - 1, 0) + kappa * omega * share**power) * motion
        left, sizes = z @ amplitudes, np.abs(y)
        limits = np.array([d.tolerance for d in demands]) + excess
        missed = turned @ left - limits * y / np.maximum(sizes, 1e-300)
        course, rise = (y.conj() @ turned @ z).real, (y.conj() @ turned @ slope).real
        turned_by = [kappa[i] if demands[i].inner == FREQUENCY else omega[i] * _turning(kappa[i]) for i in inner]
        tops = [(left[i].conjugate() * (by * motion[i] * since) @ amplitudes).real / max(limits[i], 1e-9)
                for i, by in zip(inner, turned_by, strict=True)]  # fmt: skip
        return np.concatenate(
            [[amplitudes.sum() - 1.0, sizes.sum() - 1.0], missed.real, missed.imag, course - level, rise[1:-1], tops]
        )  # fmt: skip

    times, level = start.times / unit, float(np.abs(start.multipliers) @ [d.tolerance for d in start.demands])
    own = times[-1] if fixed is None else start.excess
    weights = np.linalg.solve(turned.conj().T, start.multipliers)
    weights /= max(float(np.abs(weights).sum()), 1e-300)
    guess = np.concatenate([times[1:-1], [own], start.amplitudes, weights.real, weights.imag, [level]])
    found = _newton(system, np.concatenate([guess, [getattr(scaled[i], scaled[i].inner) for i in inner]]))
    if found is None:
        return None
    times, excess, amplitudes, y, _, demands = parts(found)
    if amplitudes.min() <= -FAINT or np.diff(times).min() <= 0.0:
        return None
    freed = tuple(replace(d, frequency=moved.frequency / unit, damping=moved.damping) if d.inner else d
                  for d, moved in zip(start.demands, demands, strict=True))  # fmt: skip
    return Extremal(times * unit, amplitudes, freed, turned.conj().T @ y, excess)


def _newton(system: Callable[[Reals], Reals], start: Reals) -> Reals | None:
    """Damped; steps of least norm, for where the optimum is degenerate the equations depend on each other."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        x, value = start, system(start)
        for _ in range(STEPS):
            if not np.isfinite(value).all():
                return None
            if np.abs(value).max() <= CLOSED:
                return x
            columns = [(system(x + DIFFERENCE * e) - value) / DIFFERENCE for e in np.eye(len(x))]
            if not np.isfinite(columns).all():
                return None
            step, *_ = np.linalg.lstsq(np.array(columns).T, -value, rcond=1e-9)
            step *= min(1.0, LONGEST / max(float(np.abs(step).max()), 1e-300))
            for _ in range(8):
                following = system(x + step)
                if np.abs(following).max() < np.abs(value).max():
                    break
                step = step / 2.0
            else:
                return x if np.abs(value).max() <= 10.0 * CLOSED else None
            x, value = x + step, following
    return None
