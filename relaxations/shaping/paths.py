"""A solution that is known is followed along its curve in as many digits as are set: pseudo-arclength continuation with python-flint.

`f(x, w) = 0`, one equation fewer than unknowns (x, w), is a curve. From a point with tangent T the next one is sought on the plane across
T: unlike steps of w alone that also finds the way around a fold, where w is largest. Balls serve as long floats; nothing is proven here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from flint import arb, arb_mat

Vector = list[arb]
System = Callable[[Vector, arb], tuple[Vector, list[Vector]]]
"""Values (n,) at (x, w), and their derivatives by x and, last, by w: (n, n + 1)."""

CLOSE, CLOSED = 1e-8, 1e-24  # a step of Newton's method, relative to the unknowns: along the curve, and at its end
STEPS = 8  # of Newton's method
FIRST, LONGEST, SHORTEST = 0.5, 2.0, 1e-9  # steps along the curve
FARTHEST = 0.2  # by which a step may miss where it pointed to, relative
MOST = 500  # points
BELOW = 3.0  # w below a fold's at which the curve is followed no farther
HALVINGS = 60
LEVEL = 1e-12  # slope of w along the curve at which w is at its largest: w itself is then exact to the square of it
STRAIGHT = 0.8  # cosine of the turn in one step: more could be a turn back


@dataclass(frozen=True, slots=True)
class Point:
    """A solution; `goal`: it has the w that was asked for, `end`: the curve's fold, or as far as it was to be followed.

    With neither it is where the curve was lost.
    """

    x: Vector
    w: arb
    goal: bool
    end: bool = False


def followed(
    system: System,
    x: Vector,
    w: arb,
    goal: arb,
    kept: Callable[[Vector], bool] = lambda x: True,
    most: arb | None = None,
    points: int = MOST,
) -> Point | None:
    """The curve from near (x, w) on, in the direction of `goal` > w, as long as its points are `kept`; None without a first point.

    It is followed around folds, but no farther than to where the first unknown is `most`, for so many `points`. If it does not come to the
    goal, its highest fold counts, unless it ends higher up.
    """
    at = solved(system, [*x, w], None, CLOSE)
    if at is None:
        return None
    ahead, bend, step, top = _tangent(system, at, [arb(0)] * len(x) + [arb(1)]), [arb(0)] * (len(x) + 1), FIRST, None
    for _ in range(points):
        if ahead is None or step < SHORTEST:
            break
        aim = _ahead(at, ahead, step, bend)
        if float(aim[-1]) >= float(goal) and float(ahead[-1]) > 0.0:
            share = (goal - at[-1]) / ahead[-1]
            aim = [*_ahead(at, ahead, share, bend)[:-1], goal]
            found = solved(system, aim, None, CLOSED)
            if found is not None and kept(found[:-1]) and _near(found, aim) and (most is None or found[0] <= most):
                return Point(found[:-1], goal, True)
            step = min(step, max(float(share), SHORTEST)) / 4.0
            continue
        following = solved(system, aim, ahead, CLOSE)
        if following is None or not kept(following[:-1]) or not _near(following, aim):
            step /= 4.0
            continue
        turned = _tangent(system, following, ahead)
        if turned is None or float(sum((a * b for a, b in zip(turned, ahead, strict=True)), arb(0))) < STRAIGHT:
            step /= 4.0
            continue
        if float(turned[-1]) <= 0.0 < float(ahead[-1]):
            fold = _fold(system, at, ahead, step)
            top = fold if top is None or (fold is not None and fold[-1] > top[-1]) else top
        if top is not None and following[-1] < top[-1] - BELOW:
            break
        if most is not None and following[0] > most:
            share = (most - at[0]) / (following[0] - at[0])
            aim = [most, *((1 - share) * a + share * b for a, b in zip(at[1:], following[1:], strict=True))]
            last = solved(system, aim, [arb(1)] + [arb(0)] * len(x), CLOSED)
            if last is not None and kept(last[:-1]) and _near(last, aim):
                return Point(last[:-1], last[-1], False, True)
            step /= 4.0
            continue
        bend = [((b - a) / step).mid() for a, b in zip(ahead, turned, strict=True)]
        at, ahead, step = following, turned, min(2.0 * step, LONGEST)
    if top is not None and top[-1] > at[-1]:
        return Point(top[:-1], top[-1], False, True)
    return Point(at[:-1], at[-1], False)


def solved(
    system: System, start: Vector, across: Vector | None, close: float, steps: int = STEPS, longest: float = math.inf
) -> Vector | None:
    """Newton's method from `start`, (x, w), on the plane `across` a direction (None: w stays); None if it does not converge.

    In so many `steps`, no unknown changing by more than `longest` in any of them.
    """
    at, fixed, last = start, [arb(0)] * (len(start) - 1) + [arb(1)] if across is None else across, float("inf")
    for _ in range(steps):
        values, slopes = system(at[:-1], at[-1])
        step = _solve([*slopes, fixed], [*(-value for value in values), arb(0)])
        if step is None:
            return None
        if (farthest := max(abs(float(b)) for b in step)) > longest:
            step = [b * (longest / farthest) for b in step]
        at = [(a + b).mid() for a, b in zip(at, step, strict=True)]
        size = max(abs(float(b)) / max(1.0, abs(float(a))) for a, b in zip(at, step, strict=True))
        if size <= close:
            return at
        if size > 10.0 * last or size > 1e3:
            return None
        last = size
    return None


def ordered(phases: Vector) -> bool:
    """Strictly descending, and positive."""
    return all(a > b for a, b in zip(phases, [*phases[1:], arb(0)], strict=True))


def _fold(system: System, at: Vector, ahead: Vector, step: float) -> Vector | None:
    """Where w is largest, at most `step` ahead: the tangent's last member changes its sign."""
    low, high, best, rise, fall = 0.0, step, at, float(ahead[-1]), None
    for number in range(HALVINGS):
        # The Illinois method once both signs are known, else and now and then halving.
        middle = (low + high) / 2.0 if fall is None or number % 4 == 3 else low + (high - low) * rise / (rise - fall)
        found = solved(system, _ahead(at, ahead, middle, None), ahead, CLOSED)
        turned = None if found is None else _tangent(system, found, ahead)
        if found is None or turned is None:
            return None
        slope = float(turned[-1])
        if slope > 0.0:
            low, best, rise, fall = middle, found, slope, None if fall is None else fall / 2.0
        else:
            high, rise, fall = middle, rise / 2.0 if fall is not None else rise, slope
        if high - low <= 1e-13 * step or abs(slope) <= LEVEL:
            break
    return best


def _ahead(at: Sequence[arb], ahead: Sequence[arb], step: float | arb, bend: Sequence[arb] | None) -> Vector:
    """Along the tangent, and with what it has last turned by."""
    if bend is None:
        return [(a + step * b).mid() for a, b in zip(at, ahead, strict=True)]
    return [(a + step * b + step * step / 2 * c).mid() for a, b, c in zip(at, ahead, bend, strict=True)]


def _near(found: Sequence[arb], aim: Sequence[arb]) -> bool:
    return all(abs(float(a - b)) <= FARTHEST * max(1.0, abs(float(b))) for a, b in zip(found, aim, strict=True))


def _tangent(system: System, at: Vector, along: Vector) -> Vector | None:
    """The curve's direction, of length 1, no more than a right angle from `along`."""
    _, slopes = system(at[:-1], at[-1])
    found = _solve([*slopes, along], [arb(0)] * len(slopes) + [arb(1)])
    if found is None:
        return None
    length = sum((a * a for a in found), arb(0)).sqrt()
    return [(a / length).mid() for a in found]


def _solve(matrix: Sequence[Sequence[arb]], right: Sequence[arb]) -> Vector | None:
    try:
        found = arb_mat([[entry.mid() for entry in row] for row in matrix]).solve(arb_mat([[entry.mid()] for entry in right]))
    except ZeroDivisionError:  # what arb cannot tell from singular
        return None
    vector = [found[i, 0].mid() for i in range(len(right))]
    return vector if all(entry.is_finite() for entry in vector) else None
