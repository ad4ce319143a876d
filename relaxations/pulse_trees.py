"""Branch and bound over the orders of pulses and the places of their edges: the lower side of commands of pulses.

Relaxed, pulse i is a share θ_i(s) ≥ 0 of every instant that it may be at, Σ θ_i ≤ 1, `∫ θ_i ds ≥ w`: a linear program on a grid for every
part of the tree, whose multipliers refute that part if no shares bring the plant to rest (`relaxations.checking.pulses`, which judges every
part here too, and whose boxes these are). Where they do not, the part is halved where the shares are least like pulses.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import flint
import numpy as np
from flint import fmpq
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.sparse import csr_array, vstack

from relaxations import certificates
from relaxations.checking import lower, pulses
from relaxations.checking.balls import System, system, work
from relaxations.checking.reading import LEAF, TASK, Undecided, shaped
from relaxations.maneuvers import Problem
from relaxations.plants import fraction, rational
from relaxations.sides import Side, accepted
from relaxations.thrusters import Pulsed, off

Reals = NDArray[np.float64]
Shorter = Callable[[tuple[Fraction, ...], Reals, float], Pulsed | None]  # near levels and durations [s] in the order of time, than so long

CLOSE, CLOSEST = 1e-4, 1e-6  # of a time: what a claim leaves
LONGER = (1.5, 2.5, 5.0)  # times the lower side, where no command is known
SHARE = 0.5  # of what is between the sides, or its square, where that is too close
ALL, MOST, FEW = 3000, 1000, 100  # parts of all trees of a task, of those of one claim; so few that a closer claim is tried
MANY = 24  # pulses: with more there are too many orders of them
LIKELY = 0.3  # of a move: where shares differ from pulses for less a command is looked for
CELLS = 48  # of a move, beside the edges of a part
REACHED = 1e-9  # of the scaled equations: what shares miss so little they may reach
INNER = 0.3  # of an edge's range: a split is not closer to its ends
LIKE = 0.05  # of a move: shares that differ from pulses for so long are nearly pulses
SMALLEST = 1e-7  # of a move: a range is not split further
DIGITS = 22  # bits of an instant of a split, relative to the move
BITS = 128
PLENTY = 1e15  # of the checker's work, which is counted when it judges the whole


@dataclass(frozen=True, slots=True)
class Shares:
    """What shares of a part miss of the equations, relative; multipliers λ, ν, μ; the cells' edges [s] and shares by (pulse, sign)."""

    missed: float
    costate: Reals
    widths: Reals
    fuel: float
    edges: Reals
    of: dict[tuple[int, int], Reals]


class Refutation:
    """Lower sides of one task by trees, as many as `left` parts allow; `shorter` looks for a command near an outline."""

    def __init__(self, problem: Problem, task: dict[str, Any], shorter: Shorter) -> None:
        self.problem, self.task, self.shorter, self.left = problem, task, shorter, ALL

    def closest(self, below: Side | None, above: float | None) -> tuple[Side | None, Pulsed | None]:
        """The best lower side that trees prove, closer to the time `above` [s] of a command than `below`; that one if none is.

        A claim is `CLOSE` first, and leaves larger shares of what is between where its trees grow too large; small ones are tried closer
        still. Without a command so many times the lower side are claimed instead. A shorter command found on the way ends the search.
        """
        problem, best, known = self.problem, below, float(below.claim) if below else 0.0
        other = problem.begin is not None or problem.residuals is not None or problem.transition is not None
        if other or known == 0.0 or _most(problem, above or LONGER[-1] * known) > MANY:
            return below, None
        if above is None:
            for factor in LONGER:
                trees = self._trees(known * factor)
                if trees.found or (side := trees.side(self.task)) is None:
                    return best, trees.found
                best = side
            return best, None
        share, close = 0.0, CLOSE * above
        while (left := max(share * (above - known), close)) < above - known and self.left:
            trees = self._trees(above - left)
            if trees.found:
                return best, trees.found
            if (side := trees.side(self.task)) is not None:
                best, known, share = side, float(side.claim), max(share, SHARE)
                if left > close:
                    continue
                if len(trees.nodes) < FEW:
                    trees = self._trees(above * (1.0 - CLOSEST), 4 * FEW)
                    best = trees.side(self.task) or best
                return best, trees.found
            if share >= SHARE:
                break
            share = SHARE if share else SHARE**2
        return best, None

    def _trees(self, time: float, most: int = 0) -> Trees:
        most = min(most or MOST, self.left)
        trees = Trees(self.problem, self.task, Fraction(time), most, self.shorter)
        self.left -= most - trees.left
        return trees


def _most(problem: Problem, time: float | Fraction) -> int:
    """How many pulses there may be in a move of `time` [s]."""
    limits = problem.maneuver.limits
    fit = int(time / limits.pulse_width) if limits.pulse_width else limits.pulses or 0
    return min(fit, limits.pulses or fit)


class Trees:
    """The trees of one task and time: `nodes`, in the order of the first visit, refute all moves of at most `time` [s] if `grown`.

    Or a command is `found` that is shorter, near shares that are nearly pulses.
    """

    def __init__(self, problem: Problem, task: dict[str, Any], time: Fraction, most: int, shorter: Shorter) -> None:
        self.problem, self.time, self.left, self.nodes = problem, time, most, list[dict[str, Any]]()
        self.found: Pulsed | None = None
        self._shorter, self._seen = shorter, dict[tuple[Fraction, ...], float]()
        before, flint.ctx.prec, work["left"] = flint.ctx.prec, BITS, PLENTY
        try:
            self.system = system(shaped(task, TASK, "task"))
            self.grown = all(self._grow(n) for n in self._numbers())
        finally:
            flint.ctx.prec = before

    def side(self, task: dict[str, Any]) -> Side | None:
        """The lower side, if the checker accepts it."""
        side = Side(self.time, {**certificates.costate_witness(self.problem, np.zeros(self.problem.size)), "pulses": self.nodes})
        return side if self.grown and accepted(task, lower=side) else None

    @property
    def width(self) -> fmpq:
        """The least width of a pulse [s]; 0: none."""
        return rational(self.problem.maneuver.limits.pulse_width or Fraction(0))

    def _numbers(self) -> range:
        most = _most(self.problem, self.time)
        return range(0 if self.problem.maneuver.limits.pulse_width else most, most + 1)

    def _grow(self, n: int) -> bool:
        waiting = [pulses.tight(pulses.whole(n, rational(self.time), self.system), self.width)]
        while waiting:
            box = waiting.pop()
            if box is None:
                self.nodes.append(self._leaf(np.zeros(self.problem.size), np.zeros(n), 0.0))
                continue
            if self.left == 0:
                return False
            self.left -= 1
            shares = relaxed(self.problem, self.system, box, float(self.time))
            if shares.missed > REACHED:
                leaf = self._leaf(shares.costate, shares.widths, shares.fuel)
                if self._refutes(box, leaf):
                    self.nodes.append(leaf)
                    continue
            elif self._finds(box, shares):
                return False
            if (split := _split(box, shares, float(self.time))) is None:
                return False
            self.nodes.append({"split": split, "leaf": None})
            parts = pulses.halves(box, SimpleNamespace(**split | {"at": rational(Fraction(float.fromhex(split["at"])))}))
            waiting += [pulses.tight(part, self.width) for part in parts[::-1]]
        return True

    def _finds(self, box: pulses.Box, shares: Shares) -> bool:
        """Whether there is a command in the time near the pulses that shares are like: looked for where they are liker than any before."""
        limits, coast, likeness = self.problem.maneuver.limits, off(self.problem), 0.0
        pieces: list[tuple[Fraction, float]] = []
        last = 0.0
        for i in range(len(box)):
            sign, begin, end, unlike = _like(shares, i)
            likeness += unlike
            pieces += [(coast, begin - last)] if begin > last and i else []
            pieces.append((limits.upper if sign > 0 else limits.lower, end - max(begin, last) if i else end))
            last = end
        levels, durations = tuple(level for level, _ in pieces[::-1]), np.array([max(duration, 0.0) for _, duration in pieces[::-1]])
        if likeness < min(self._seen.get(levels, np.inf) / 2, LIKELY * float(self.time)):
            self._seen[levels] = likeness
            self.found = self._shorter(levels, durations, float(self.time))
        return self.found is not None

    def _leaf(self, costate: Reals, widths: Reals, fuel: float) -> dict[str, Any]:
        size = np.abs(costate).max(initial=0.0) or 1.0
        short = [np.float64(np.float32(x / size)) for x in (*costate, *widths, fuel)]
        own, more = short[: len(costate)], short[len(costate) : -1]
        written = certificates.costate_witness(self.problem, self.problem.modal(np.array(own)))["costate"]
        return {
            "split": None,
            "leaf": {"costate": written, "widths": [certificates.text(x) for x in more], "fuel": certificates.text(short[-1])},
        }

    def _refutes(self, box: pulses.Box, leaf: dict[str, Any]) -> bool:
        try:
            return pulses.refuted(self.system, box, shaped(leaf["leaf"], LEAF, "leaf"), rational(self.time), lower.support)
        except Undecided:
            return False


def relaxed(problem: Problem, system: System, box: pulses.Box, time: float) -> Shares:
    """The shares of a part that miss the equations least."""
    limits, levels = problem.maneuver.limits, {1: problem.upper, -1: problem.lower}
    ranges = [[float(fraction(x)) for x in (*one.begin, *one.end)] for one in box]
    edges = np.unique(np.clip([*np.linspace(0.0, time, CELLS + 1), *(x for four in ranges for x in four)], 0.0, time))
    edges = edges[np.append(True, np.diff(edges) > 1e-12 * time)]
    widths, middles, table = np.diff(edges), (edges[1:] + edges[:-1]) / 2, np.diff(problem.rows(edges, 1), axis=1)
    count, size = len(widths), problem.size
    certain = np.full(count, -1)
    for i, (_, b, c, _) in enumerate(ranges):
        certain[(middles > b) & (middles < c)] = i
    keys, cells = [], []
    for i, (one, (a, _, _, d)) in enumerate(zip(box, ranges, strict=True)):
        where = np.flatnonzero((middles > a) & (middles < d) & ((certain < 0) | (certain == i)))
        for sign in (1, -1):
            if levels[sign] != 0.0 and one.sign in (0, sign):
                keys.append((i, sign))
                cells.append(where)
    owners = np.concatenate([np.zeros(0, int), *(np.full(len(where), k) for k, where in enumerate(cells))]).astype(int)
    places = np.concatenate([np.zeros(0, int), *cells]).astype(int)
    values = np.array([levels[keys[k][1]] for k in owners])
    of_pulse = np.array([keys[k][0] for k in owners], dtype=int)
    moments, scale = table[:, places] * values, np.abs(table).sum(axis=1) * max(abs(problem.upper), abs(problem.lower))
    n, total = len(box), len(places)
    exclusive = csr_array((np.ones(total), (places, np.arange(total))), shape=(count, total + 1))
    lasting = csr_array((-widths[places], (of_pulse, np.arange(total))), shape=(n, total + 1))
    burnt = csr_array(np.append(np.abs(values) * widths[places], 0.0)[None, :])
    budget = limits.fuel is not None
    upper = np.hstack([moments, -scale[:, None]]), np.hstack([-moments, -scale[:, None]])
    rows = [csr_array(upper[0]), csr_array(upper[1]), exclusive, lasting, *([burnt] if budget else [])]
    sides = [
        problem.target,
        -problem.target,
        np.ones(count),
        np.full(n, -float(limits.pulse_width or 0)),
        *([[float(limits.fuel or 0)]] if budget else []),
    ]
    sure = certain >= 0
    result = linprog(
        np.append(np.zeros(total), 1.0),
        A_ub=vstack(rows),
        b_ub=np.concatenate(sides),
        A_eq=exclusive[sure] if sure.any() else None,
        b_eq=np.ones(int(sure.sum())) if sure.any() else None,
        bounds=(0.0, None),
        method="highs",
    )
    if result.status != 0:
        return Shares(0.0, np.zeros(size), np.zeros(n), 0.0, edges, {})
    y = np.asarray(result.ineqlin.marginals)
    shares = {key: np.zeros(count) for key in keys}
    for k, where in enumerate(cells):
        shares[keys[k]][where] = result.x[:total][owners == k]
    at = 2 * size + count
    return Shares(
        float(result.fun),
        y[:size] - y[size : 2 * size],
        np.maximum(-y[at : at + n], 0.0),
        max(-float(y[-1]), 0.0) if budget else 0.0,
        edges,
        shares,
    )


def _like(shares: Shares, i: int) -> tuple[int, float, float, float]:
    """The pulse that the share of pulse i is like: sign, begin and end in time to go [s], and for how long it is not like it."""
    widths, middles = np.diff(shares.edges), (shares.edges[1:] + shares.edges[:-1]) / 2
    both = [shares.of.get((i, sign), np.zeros(len(widths))) for sign in (1, -1)]
    share, masses = both[0] + both[1], [float(part @ widths) for part in both]
    mass = sum(masses)
    center = float(share * middles @ widths) / mass if mass > 0.0 else float(shares.edges[-1]) / 2
    begin, end = center - mass / 2, center + mass / 2
    unlike = float(np.abs(share - ((middles > begin) & (middles < end))) @ widths) + 2 * min(masses)
    return 1 if masses[0] >= masses[1] else -1, begin, end, unlike


def _split(box: pulses.Box, shares: Shares, time: float) -> dict[str, Any] | None:
    """Where a part is halved: at the pulse whose share is least like one, its sign if that is open, else an edge; None: it is too small."""
    best: tuple[float, dict[str, Any]] | None = None
    for i, one in enumerate(box):
        _, *ideal, unlike = _like(shares, i)
        found = [(unlike, {"pulse": i, "edge": "sign", "at": 0.0})] if one.sign == 0 else []
        for edge, ends, wanted in (("begin", one.begin, ideal[0]), ("end", one.end, ideal[1])):
            a, b = (float(fraction(x)) for x in ends)
            if b - a > SMALLEST * time:
                at = min(max(wanted, a + INNER * (b - a)), b - INNER * (b - a))
                found.append(((unlike + LIKE * time) * math.sqrt((b - a) / time), {"pulse": i, "edge": edge, "at": at}))
        best = max(([best] if best else []) + found, key=lambda pair: pair[0], default=None)
    if best is None:
        return None
    step = 2.0 ** (math.frexp(time)[1] - DIGITS)
    return best[1] | {"at": certificates.text(float(round(best[1]["at"] / step) * step))}
