"""Named outputs in every plant of a box: proven to stay within their limits, piece by piece of the command, cell by cell of the box.

Between two kicks of the input (of its slope where it is continuous) an output is, in the time τ since the last one,

    y(τ) = Σ_m g_m P_m(τ) + Re Σ_j w_j/p_j^o A_j e^{p_j τ},     A_j = Σ kicks e^{p_j (t - t_i)},  P_m = Σ kicks (t + τ - t_i)^m/m!

with o = 1 for jumps of the input, 2 for those of its slope, and g_m from the expansion of N/D at the origin. Poles, weights and g depend on
the place, along lines as power series. With half widths h of a piece about its middle and ρ of a cell about its centre

    |y| ≤ max over corners of |y + Σ ± ρ_q ∂_q y| + h |y' + Σ ± ρ_q ∂_q y'|, at middle and centre, + h²/2 (|y''| + Σ ρ_q |∂_q y''|)
          + second and third order of the place, for all instants of the piece

which is tight where an output rests on its limit for a while in a plant at an end of the box. Afterwards the output moves about where it
comes to rest, as the residual does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement, product
from math import factorial
from typing import Any

from flint import acb, acb_series, arb

from relaxations.checking.balls import System, spend
from relaxations.checking.families import Line, Moved, Written, mirrored, over
from relaxations.checking.members import Numbers, halved, laid, rigid
from relaxations.checking.motions import Around, Kicks, Motion, in_time
from relaxations.checking.reading import Refuted, Undecided

AFTER = -1  # the piece after the move
DEPTH = 10  # how often a piece of the move is halved before the cell is


def final(system: System, plants: Written | Moved, line: Line, output: str) -> acb_series:
    """Where an output comes to rest: its gain times what brings the nominal plant to its target."""
    return plants.at_origin(line, output, 1)[0] * arb(system.highest)


@dataclass(frozen=True, slots=True)
class Along:
    """Along a line of places: poles, for every output (1 or 2) w_j/p_j^o and g_m, and the motions A_j of the command so far."""

    poles: list[acb_series]
    weights: dict[str, list[acb_series]]
    origin: dict[str, list[acb_series]]
    decays: list[acb_series]
    turns: list[acb_series]
    shaken: list[acb_series]

    @staticmethod
    def of(plants: Written | Moved, names: Sequence[str], line: Line, starts: Sequence[acb], flexible: Sequence[bool], order: int) -> Along:
        """At the beginning of the move; raises `ZeroDivisionError` where something may vanish in the cell."""
        poles, count = plants.poles(line, starts), rigid(plants.task) + order
        powers = [pole**order for pole in poles]
        weights, origin = {}, {}
        for name in names:
            own = zip(plants.weights(line, poles, name), powers, flexible, strict=True)
            weights[name] = [(1 + pair) * over(weight, power) for weight, power, pair in own]
            origin[name] = plants.at_origin(line, name, count)[::-1]
        decays = [(pole + mirrored(pole)) / 2 for pole in poles]
        turns = [(pole - mirrored(pole)) / 2 for pole in poles]
        return Along(poles, weights, origin, decays, turns, [acb_series([0])] * len(poles))

    def motions(self, at: arb, since: arb, change: arb) -> list[acb_series]:
        """A_j just after the kick at an instant, `since` [s] after the one before. Decays are taken from kick to kick, turns from the
        beginning: a product of many turns of a ball would be wrapped too often."""
        found = []
        for j, (decay, turn) in enumerate(zip(self.decays, self.turns, strict=True)):
            spend(8)
            phase = (turn * at).exp()
            self.shaken[j] = self.shaken[j] * (decay * since).exp() + mirrored(phase) * change
            found.append(self.shaken[j] * phase)
        return found


Sums = tuple[acb_series, acb_series, acb_series]


@dataclass(frozen=True, slots=True)
class Piece:
    """An output after a kick, along a line of places: sizes w_j/p_j^o A_j, poles, g_m and P_m(0)."""

    sizes: list[acb_series]
    poles: list[acb_series]
    origin: list[acb_series]
    moments: list[arb]

    def over(self, span: arb) -> Sums:
        """The output and two derivatives at the instants of a ball."""
        spend(14 * len(self.poles))
        powers = [span**k / factorial(k) for k in range(len(self.moments))]
        sums = [sum((m * p for m, p in zip(self.moments[k::-1], powers, strict=False)), arb(0)) for k in range(len(self.moments))]
        found = [sum((g * s for g, s in zip(self.origin[k:], sums, strict=False)), acb_series([0])) for k in range(3)]
        for size, pole in zip(self.sizes, self.poles, strict=True):
            term = size * (pole * span).exp()
            for k in range(3):
                found[k] += term
                term = term * pole
        return found[0], found[1], found[2]


def prove(system: System, plants: Written | Moved, kicks: Kicks) -> None:
    """Prove that all outputs whose deflection is limited are within their limits in the whole box; raises `Refuted` or `Undecided`."""
    task, box = system.task, system.task.box
    if not task.limits.deflection:
        return
    whole = [*range(len(kicks.jumps) - 1), AFTER]
    every = [(name, piece) for name in task.limits.deflection for piece in whole]
    waiting = [(tuple((x, x) for x in plant.place), every) for plant in box.plants]
    waiting = waiting or [(tuple((p.low, p.high) for p in box.parameters), every)]
    if isinstance(plants, Moved):  # the nominal plant is none of an exact place
        nominal = plants.nominal
        if beyond(system, plants, kicks, nominal, nominal, [arb(0)] * len(nominal), every):
            raise Undecided("an output of the nominal plant is not told from its limit")
    while waiting:
        sides, wanted = waiting.pop()
        spend(200)
        left = beyond(system, plants, kicks, *laid(sides), wanted)
        if left:
            waiting += [(half, left) for half in halved(task, sides, "an output is not told from its limit somewhere in the box")]


Wanted = list[tuple[str, int]]


def beyond(
    system: System, plants: Written | Moved, kicks: Kicks, cell: Numbers, centre: Any, radii: Sequence[arb], wanted: Wanted
) -> Wanted:
    """Those of the pieces `wanted`, by outputs, that are not proven to be within the limits all over a cell."""
    tracked = plants.tracked(cell, centre)
    if tracked is None:
        return wanted
    points, balls, flexible = tracked
    wide, names = [q for q, radius in enumerate(radii) if not radius.is_zero()], list(dict.fromkeys(name for name, _ in wanted))
    lines: dict[tuple[int, ...], tuple[Line, Sequence[acb]]] = {}
    for q, k in combinations_with_replacement(wide, 2):
        lines[q, k] = [acb_series([x, int(i in (q, k))]) for i, x in enumerate(centre)], points
    if wide:
        lines[()] = [acb_series([x, arb(0, radius.upper())]) for x, radius in zip(cell, radii, strict=True)], balls
    else:
        lines[0, 0] = centre, points
    try:
        along = {way: Along.of(plants, names, line, starts, flexible, kicks.order) for way, (line, starts) in lines.items()}
    except ZeroDivisionError:
        return wanted
    moments, before, left = [arb(0)] * (rigid(system.task) + kicks.order), kicks.jumps[0][0], []
    last, duration = max(piece if piece != AFTER else len(kicks.jumps) for _, piece in wanted), kicks.jumps[0][0]
    asked = set(wanted)
    for i, (to_go, change) in enumerate(kicks.jumps):
        if i > last:
            break
        since = before - to_go if i else arb(0)  # of a ball and itself the powers would be no numbers
        powers = [since**k / factorial(k) for k in range(len(moments))]
        moments = [sum((m * p for m, p in zip(moments[k::-1], powers, strict=False)), arb(0)) for k in range(len(moments))]
        moments[0] += change
        motions = {way: one.motions(duration - to_go, since, change) for way, one in along.items()}
        before, ends = to_go, i == len(kicks.jumps) - 1
        for name in names:
            if (name, AFTER if ends else i) not in asked:
                continue
            pieces = {
                way: Piece([w * a for w, a in zip(one.weights[name], motions[way], strict=True)], one.poles, one.origin[name], moments)
                for way, one in along.items()
            }
            cells = Cell(pieces, radii, wide)
            limit = arb(system.task.limits.deflection[name])
            if ends:
                rest = {way: final(system, plants, line, name) for way, (line, _) in lines.items()}
                fine = cells.settled(rest, flexible, balls, limit)
            else:
                fine = cells.within((to_go - kicks.jumps[i + 1][0]).upper(), limit, name, centre)
            if not fine:
                left.append((name, AFTER if ends else i))
    return left


@dataclass(frozen=True, slots=True)
class Cell:
    """An output after a kick, along the lines through the centre of a cell, and () through any of its places."""

    pieces: dict[tuple[int, ...], Piece]
    radii: Sequence[arb]
    wide: Sequence[int]

    def beside(self, terms: dict[tuple[int, ...], acb_series]) -> arb:
        """Second and third order of a function of the place."""
        total = abs(terms[()][3].real) if () in terms else arb(0)
        for q, k in combinations_with_replacement(self.wide, 2):
            second = terms[q, k][2] if q == k else terms[q, k][2] - terms[q, q][2] - terms[k, k][2]
            total += abs(second.real) * self.radii[q] * self.radii[k]
        return total

    def bound(self, a: arb, b: arb) -> tuple[arb, arb, arb]:
        """The middle, |y| there at the centre, and a bound of |y| in the cell and between a and b."""
        middle = ((a + b) / 2).mid()
        span, half = a.union(b).union(middle), (b - middle).max(middle - a)
        ways = {way: piece for way, piece in self.pieces.items() if way}
        at = {way: ways[way].over(middle) for way in ([(q, q) for q in self.wide] or [(0, 0)])}
        all_over = {way: piece.over(span) for way, piece in self.pieces.items()}
        centre = next(iter(at.values()))
        value, slope = centre[0][0].real, centre[1][0].real
        bend = abs(all_over[next(iter(at))][2][0].real)
        bend += sum((abs(all_over[q, q][2][1].real) * self.radii[q] for q in self.wide), arb(0))
        largest = arb(0)
        for signs in product((1, -1), repeat=len(self.wide)):
            moved = [(sign * self.radii[q], at[q, q]) for sign, q in zip(signs, self.wide, strict=True)]
            here = value + sum((r * one[0][1].real for r, one in moved), arb(0))
            turning = slope + sum((r * one[1][1].real for r, one in moved), arb(0))
            largest = largest.max(abs(here) + abs(turning) * half)
        return middle, abs(value), largest + bend * half * half / 2 + self.beside({way: sums[0] for way, sums in all_over.items()})

    def within(self, end: arb, limit: arb, name: str, centre: Any) -> bool:
        """Whether the output is within its limit until `end` in the cell; raises `Refuted` where it is not, at the centre."""
        waiting = [(arb(0), end, 0)]
        while waiting:
            a, b, depth = waiting.pop()
            middle, value, bound = self.bound(a, b)
            if bound <= limit:
                continue
            if value > limit:
                where = ", ".join(f"{float(arb(x).mid()):.6g}" for x in centre)
                raise Refuted(f"the output {name} leaves its limit at {where}")
            if depth >= DEPTH or not (a < middle < b and self.bound(middle, middle)[2] <= limit):
                return False
            waiting += [(a, middle, depth + 1), (middle, b, depth + 1)]
        return True

    def settled(self, rest: dict[tuple[int, ...], acb_series], flexible: Sequence[bool], balls: Sequence[acb], limit: arb) -> bool:
        """Whether the output stays within its limit for ever, moving about its `rest`."""
        ways = [(q, q) for q in self.wide] or [(0, 0)]
        spread = sum((abs(rest[q, q][1].real) * self.radii[q] for q in self.wide), arb(0)) + self.beside(rest)
        resting = rest[ways[0]][0].real
        above, below = limit - resting - spread, limit + resting - spread
        if not balls:
            return bool(above >= 0 and below >= 0)
        motions = {way: Motion(piece.poles, piece.sizes) for way, piece in self.pieces.items()}
        whole = motions.pop((), motions.get((0, 0)))
        assert whole is not None
        try:
            around = Around({(q, k): motions[q, k] for q, k in motions}, whole, self.radii)
            total, sizes = around.moduli()
        except ZeroDivisionError:
            return False
        if total <= above.min(below):
            return True
        if not (above > 0 and below > 0 and all(ball.real < 0 for ball in balls)):
            return False
        return in_time(around, sizes, flexible, below, above) is True
