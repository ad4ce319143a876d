"""Costates that refute every command which costs less: `D(T) = T + λᵀ target - ∫_0^T σ(p) ds`, one λ for an interval of maneuver times.

At a fixed T the largest D is `T + α U(T)`, U the least fuel, and that λ stays the best to first order beside T. So intervals grow with the
distance from the cheapest time, and their number with the logarithm of how closely the cost is met. Times too short for any amount of fuel
have one λ, of any size: the larger, the more it asks for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from relaxations.errors import ShortHorizonError, SolverError
from relaxations.maneuvers import Problem
from relaxations.onoff.duals import Dual, Looks, Windows, largest_fraction, least_fuel

Reals = NDArray[np.float64]

SAMPLES = 400  # of D beside the time that a costate is the best at
WIDEST, NARROWER, SHORTEST = 0.5, 0.25, 1e-10  # widths looked at, of the time; an interval that is shorter is none
CERTAIN = 0.98  # of the interval on which D was seen to be large enough
MOST_PIECES = 400
SURE = 1e-7  # of the target: a time at which less is missing is not surely too short
SHORTER = (0.0, 1e-7, 1e-5)  # relative: times a little less, where the best costate was not found


@dataclass(frozen=True, slots=True)
class Piece:
    """Maneuver times [s] from `begin` to `end`, and the costate λ that is used for them."""

    begin: float
    end: float
    costate: Reals


def cover(problem: Problem, price: float, cost: float) -> list[Piece] | None:
    """Pieces from time 0 to `cost` [s], by ascending time, on which D is at least `cost`; None if some were not found."""
    found: list[Piece] = []
    end = cost
    while end > 0.0 and len(found) < MOST_PIECES:
        piece = _last(problem, end, cost) or _piece(problem, price, end, cost)
        if piece is None:
            return None
        found.append(piece)
        end = piece.begin
    return found[::-1] if end <= 0.0 else None


def least_at(problem: Problem, time: float) -> tuple[Looks, Dual] | None:
    """The dual of the least fuel at a maneuver time [s]; None where none was found."""
    try:
        with np.errstate(all="ignore"):  # a search that gets lost is told by what comes of it
            looks = Looks.of(problem, time, 1)
            dual = least_fuel(looks, Windows(0.0, time))
    except (ShortHorizonError, SolverError):
        return None
    return None if dual is None or not np.isfinite(dual.value) else (looks, dual)


def _piece(problem: Problem, price: float, end: float, cost: float) -> Piece | None:
    """The longest interval up to `end` on which the best costate there, or a little earlier, is good enough."""
    best: Piece | None = None
    for shorter in SHORTER:
        at = least_at(problem, end * (1.0 - shorter))
        begin = None if at is None else _reached(*at, price, end, cost)
        if at is not None and begin is not None and (best is None or begin < best.begin):
            best = Piece(begin, end, price * at[0].modal(at[1].costate))
        if best is not None and end - best.begin > 1e-3 * end:
            break
    return best if best is not None and end - best.begin > SHORTEST * end else None


def _reached(looks: Looks, dual: Dual, price: float, end: float, cost: float) -> float | None:
    """How early D is large enough from `end` down; None if it is not there."""

    def rate(s: Reals) -> Reals:
        return 1.0 - price * saved(looks, dual.costate, s)

    value = looks.maneuver_time + price * dual.value
    if end > looks.maneuver_time:
        value += float(np.trapezoid(rate(s := np.linspace(looks.maneuver_time, end, SAMPLES)), s))
    width = WIDEST * end
    while value >= cost and width > SHORTEST * end:
        s = np.linspace(max(end - width, 0.0), end, SAMPLES + 1)
        slopes = rate(s)
        gained = np.cumsum(((slopes[1:] + slopes[:-1]) / 2 * np.diff(s))[::-1])[::-1]
        below = np.flatnonzero(value - np.append(gained, 0.0) < cost)
        if not len(below):
            return float(s[0])
        if below[-1] < SAMPLES // 2:
            return float(end - CERTAIN * (end - s[below[-1] + 1]))
        width *= NARROWER
    return None


def saved(looks: Looks, costate: Reals, s: Reals) -> Reals:
    """σ(p) at a price of 1."""
    p = costate @ looks.rows(s)
    return np.maximum(0.0, np.maximum(looks.strong * (p - 1.0), looks.weak * (-p - 1.0)))


def _last(problem: Problem, end: float, cost: float) -> Piece | None:
    """All times up to `end`, if that is too short for any amount of fuel."""
    try:
        looks = Looks.of(problem, end, 1)
        dual = largest_fraction(looks, Windows(0.0, end), None)
    except (ShortHorizonError, SolverError):
        return None
    missing = 1.0 - dual.value  # D(end) is at least end and this times the scale; from there down it falls by what T falls
    return Piece(0.0, end, 2.0 * cost / missing * looks.modal(dual.costate)) if missing > SURE else None
