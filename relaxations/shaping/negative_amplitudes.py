"""Specified negative amplitudes for several modes in one solution: the shortest sequence whose negative impulses sum to no more.

Of one mode that is three impulses A, -b, 1 + b - A. Of several modes it is a linear program on a grid, with as many impulses as there are
equations; from there the instants are exact: the duration is minimised over instants and amplitudes (sequential quadratic programs), and
the equations are closed to rounding. That nothing with such negative amplitudes is shorter is proven for any form
(relaxations.shaping.least_durations).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog, minimize

from relaxations.errors import SolverError
from relaxations.shaping.modes import Mode
from relaxations.shaping.shapers import Shaper
from relaxations.shaping.vanishing import left, possible

Reals = NDArray[np.float64]

CELLS = 240
BRACKET = 1e-4  # relative width of the bracket on the grid
FAINT = 1e-7  # an amplitude of the grid that is none
CLOSED, STEPS = 1e-14, 12  # of the equations, and of Newton's method on them
NOTHING = 1e-9  # of the largest term of what vanishes


def negative_at_once(modes: Sequence[Mode], negative: float) -> Shaper:
    """The shaper, `negative` > 0 the sum of its negative impulses' sizes. Raises `SolverError`."""
    low, high, found = 0.0, sum(mode.half_period for mode in modes), None  # one zv shaper for each mode has no negative impulses at all
    while high - low > BRACKET * high:
        middle = (low + high) / 2.0 if found is not None else high
        amplitudes = _on_grid(modes, negative, middle)
        if amplitudes is not None:
            high, found = middle, amplitudes
        elif found is None:
            break
        else:
            low = middle
    if found is None:
        raise SolverError(f"no sequence with negative amplitudes of {negative!r} was found: {possible(modes)}")
    times, amplitudes = _gathered(high * np.linspace(0.0, 1.0, CELLS + 1), found)
    times, amplitudes = _closed(modes, negative, *_shortest(modes, negative, times, amplitudes))
    shaper = Shaper(tuple(map(float, times)), tuple(map(float, amplitudes)))
    if not all(left(shaper, mode) <= NOTHING for mode in modes):
        raise SolverError(f"a sequence with negative amplitudes of {negative!r} was found on a grid only: {possible(modes)}")
    return shaper


def _rows(modes: Sequence[Mode], since: Reals) -> Reals:
    """Real and imaginary parts of what a unit impulse leaves, (2 modes, instants)."""
    rates = np.array([mode.frequency * mode.direction for mode in modes], dtype=np.complex128)
    z = np.exp(rates[:, None] * since).astype(np.complex128)
    return np.concatenate([z.real, z.imag])


def _on_grid(modes: Sequence[Mode], negative: float, duration: float) -> Reals | None:
    table = _rows(modes, duration * np.linspace(-1.0, 0.0, CELLS + 1))
    count = CELLS + 1
    ones = np.ones(count)
    equal = np.vstack([np.concatenate([ones, -ones]), np.hstack([table, -table])])
    found = linprog(
        np.concatenate([np.zeros(count), ones]),
        A_ub=np.concatenate([np.zeros(count), ones])[None, :],
        b_ub=[negative],
        A_eq=equal,
        b_eq=np.eye(len(equal))[0],
        bounds=(0.0, None),
        method="highs",
    )
    return found.x[:count] - found.x[count:] if found.status == 0 else None


def _gathered(instants: Reals, amplitudes: Reals) -> tuple[Reals, Reals]:
    """Neighbours of the same sign are one impulse."""
    kept = np.flatnonzero(np.abs(amplitudes) > FAINT)
    kept = np.unique(np.concatenate([[0], kept, [len(instants) - 1]]))
    groups: list[list[int]] = []
    for k in kept:
        if groups and k - groups[-1][-1] == 1 and amplitudes[k] * amplitudes[groups[-1][-1]] > 0.0:
            groups[-1].append(int(k))
        else:
            groups.append([int(k)])
    sizes = np.array([amplitudes[group].sum() for group in groups])
    times = np.array([float(np.average(instants[group], weights=np.abs(amplitudes[group]) + 1e-12)) for group in groups])
    times[0], times[-1] = instants[0], instants[-1]
    return times, sizes


def _equations(modes: Sequence[Mode], negative: float, times: Reals, amplitudes: Reals, signs: Reals) -> tuple[Reals, Reals]:
    """`Σ A - 1`, the negative amplitudes' sum less what is given, what is left; the Jacobian by instants (but the first) and amplitudes."""
    since = times - times[-1]
    rates = np.array([mode.frequency * mode.direction for mode in modes])[:, None]
    z = np.exp(rates * since)
    values = z @ amplitudes
    by_times = rates * z * amplitudes
    by_times[:, -1] -= (rates * z * amplitudes).sum(axis=1)
    missed = np.concatenate([[amplitudes.sum() - 1.0, amplitudes[signs < 0].sum() + negative], values.real, values.imag])
    ones, below, flat = np.ones_like(amplitudes), (signs < 0).astype(float), np.zeros((2, len(times) - 1))
    slopes = np.hstack([np.vstack([flat, by_times.real[:, 1:], by_times.imag[:, 1:]]), np.vstack([ones, below, z.real, z.imag])])
    return missed, slopes


def _shortest(modes: Sequence[Mode], negative: float, times: Reals, amplitudes: Reals) -> tuple[Reals, Reals]:
    n, unit, signs = len(times), float(times[-1]), np.sign(amplitudes)
    scale = np.concatenate([np.full(n - 1, unit), np.ones(n)])

    def parts(x: Reals) -> tuple[Reals, Reals]:
        y = x * scale
        return np.concatenate([[0.0], y[: n - 1]]), y[n - 1 :]

    start = np.concatenate([times[1:], amplitudes]) / scale
    bounds = [(0.0, None)] * (n - 1) + [(0.0, None) if sign >= 0 else (None, 0.0) for sign in signs]
    found = minimize(
        lambda x: x[n - 2],
        start,
        jac=lambda x: np.eye(len(x))[n - 2],
        method="SLSQP",
        bounds=bounds,
        constraints={
            "type": "eq",
            "fun": lambda x: _equations(modes, negative, *parts(x), signs)[0],
            "jac": lambda x: _equations(modes, negative, *parts(x), signs)[1] * scale,
        },
        options={"maxiter": 300, "ftol": 1e-15},
    )
    times, amplitudes = parts(found.x)
    order = np.argsort(times, kind="stable")
    return times[order], amplitudes[order]


def _closed(modes: Sequence[Mode], negative: float, times: Reals, amplitudes: Reals) -> tuple[Reals, Reals]:
    """To rounding, by steps of least norm."""
    kept = np.abs(amplitudes) > FAINT
    times, amplitudes = times[kept] - times[kept][0], amplitudes[kept]
    signs, n = np.sign(amplitudes), len(times)
    scale = np.concatenate([np.full(n - 1, times[-1]), np.ones(n)])
    for _ in range(STEPS):
        missed, slopes = _equations(modes, negative, times, amplitudes, signs)
        if np.abs(missed).max() <= CLOSED:
            break
        step = scale * np.linalg.lstsq(slopes * scale, -missed, rcond=None)[0]
        times = times + np.concatenate([[0.0], step[: n - 1]])
        amplitudes = amplitudes + step[n - 1 :]
    if np.diff(times).min() <= 0.0 or (np.sign(amplitudes) != signs).any():
        raise SolverError(f"exact instants of negative amplitudes of {negative!r} were not found: {possible(modes)}")
    return times, amplitudes
