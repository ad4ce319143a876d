"""Central differences whose step balances truncation against rounding, entry by entry; standard library only, as it runs in the child.

    D_h = (f(x + h) - f(x - h)) / 2h = f' + O(h²) + O(noise / h)

is computed on a ladder of steps, from small to large. Between neighbours the error shows itself: a rung's rounding is a quarter
of the one below it (its step is four times as large), its truncation a fifteenth of the difference to the one above. Each
entry of the column takes the rung with the least of both. The noise of f need not be known: an FMU that solves equations
inside is far noisier than a double.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from itertools import pairwise

RATIO = 4.0
SMALLEST, LARGEST = 2.0**-29, 2.0**-3  # steps, in units of the variable's size
HOPELESS = 1e3  # times the best error so far: larger steps only leave the neighbourhood further, and its domain in the end

Evaluate = Callable[[float], Sequence[float] | None]


def column(evaluate: Evaluate, point: float, size: float, largest: float = LARGEST) -> tuple[list[float], list[float]] | None:
    """∂f/∂x at `point` and the estimated error of each entry; None if f cannot be evaluated on both sides at any two steps.

    `evaluate` returns f(x), or None where it has no value. `size` is the variable's natural size: steps are powers of 4
    between 2^-29 and `largest` (at most) of it, and larger than the spacing of doubles at `point`.
    """
    rungs: list[list[float]] = []
    floors: list[list[float]] = []
    h = size * SMALLEST
    while h < 2.0**-40 * abs(point):
        h *= RATIO
    while h <= size * largest:
        above, below = point + h, point - h
        high, low = evaluate(above), evaluate(below)
        if high is None or low is None or not all(map(math.isfinite, (*high, *low))):
            if rungs:
                break  # the domain ends here
            h *= RATIO  # smaller than what some solver inside resolves
            continue
        width = above - below
        rungs.append([(a - b) / width for a, b in zip(high, low, strict=True)])
        floors.append([_rounding(a, b, width) for a, b in zip(high, low, strict=True)])
        if len(rungs) > 4 and _left_behind(rungs):
            break
        h *= RATIO
    if len(rungs) < 2:
        return None
    choices = [_best([rung[i] for rung in rungs], [floor[i] for floor in floors]) for i in range(len(rungs[0]))]
    return [value for value, _ in choices], [error for _, error in choices]


def _rounding(high: float, low: float, width: float) -> float:
    """What the last place of f, and that of the quotient, can do to a difference."""
    return sys.float_info.epsilon * ((abs(high) + abs(low)) / width + abs(high - low) / width)


def balance(jumps: Sequence[float], floors: Sequence[float], ratio: float) -> tuple[int, float]:
    """The rung of a ladder of steps, each `ratio` times the one before, on which the least is wrong, and how much; from rung to rung.

    `jumps[k]` is the change of a central difference between rung k and the next, `floors[k]` its rounding on rung k.
    """
    quiet = math.inf
    for k in range(1, len(jumps)):
        # Two jumps in a row: a single one may be small by chance.
        quiet = min(quiet, max(jumps[k - 1], jumps[k], floors[k]))
        if jumps[k] > HOPELESS * quiet:
            jumps = jumps[: k + 1]
            break
    # From the top down as long as the jumps shrink with the step: there they are truncation, and below that noise, which grows as 1/h.
    clean = len(jumps)
    while clean > 1 and jumps[clean - 2] < jumps[clean - 1] / ratio:
        clean -= 1
    noisy = jumps if clean == len(jumps) else jumps[: clean - 1]
    noise = max((jump * ratio**j for j, jump in enumerate(noisy)), default=0.0)
    above = [*(jump / (ratio**2 - 1.0) for jump in jumps), jumps[-1]]
    errors = [max(noise / ratio**k, truncation, floors[k]) for k, truncation in enumerate(above)]
    best = min(range(len(errors)), key=lambda k: (errors[k], -k))
    return best, errors[best]


def _best(rungs: Sequence[float], floors: Sequence[float]) -> tuple[float, float]:
    """The value on the rung of least error and that error, doubled."""
    # Steps that do not change f at all, while larger ones do, are below what f resolves: they say nothing.
    first = next((k for k, rung in enumerate(rungs) if rung), 0)
    if len(rungs) - first > 1:
        rungs, floors = rungs[first:], floors[first:]
    best, error = balance([abs(b - a) for a, b in pairwise(rungs)], floors, RATIO)
    return rungs[best], 2.0 * error


def _left_behind(rungs: Sequence[Sequence[float]]) -> bool:
    """Whether every entry that still changes changes hopelessly more than it did before."""
    changing = []
    for i in range(len(rungs[0])):
        values = [rung[i] for rung in rungs]
        jumps = [abs(b - a) for a, b in pairwise(values)]
        if jumps[-1] > 1e-3 * (abs(values[-1]) + abs(values[-2])):
            resolved = [max(pair) for pair in pairwise(jumps)]
            changing.append(jumps[-1] > HOPELESS * min(resolved) > 0.0)
    return bool(changing) and all(changing)
