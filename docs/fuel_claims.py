"""What the paper on commands with specified fuel says, beside what is computed and proven here.

    .venv/bin/python docs/fuel_claims.py          prints the table of docs/papers.md

Singhose, Singh, Seering: On-Off Control With Specified Fuel Usage, J. Dynamic Systems, Measurement, and Control 121 (1999): two unit
masses, a unit spring, |u| ≤ 1, a slew of 5. A number of the paper is reproduced if it is the one computed, rounded to the digits that the
paper gives; what it says without a number ("about", "no noticeable") is judged by the rule that stands beside it below. Times are proven
from both sides, to 1e-12 but for held forms (asserted here); insensitivities are measured.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from functools import cache
from itertools import pairwise
from pathlib import Path
from statistics import fmean, quantiles

from relaxations.bounds import Status
from suite.fuel_plans import DEFAULT_KINDS, plan, written
from suite.fuel_records import FuelSweep, Point
from suite.fuel_sweeps import sweep
from suite.fuel_weights import critical_weights
from suite.loading import load_study

STUDY = Path(__file__).parents[1] / "suite" / "studies" / "two_mass_fuel.toml"
HEADINGS = ("claim", "paper", "here", "verdict")
RANGE = "1", "7", 121  # budgets [N·s] of the curves, in steps of 0.05
CLOSED, NEAR = 1e-12, 2e-3  # gap of a proven time; budgets [N·s] between which a turn is found
RB, ZV, ZVD = "rb", "zv", "zvd"
REPRODUCED, CORRECTED, NOT = "reproduced", "corrected", "not reproduced"


@dataclass(frozen=True, slots=True)
class Claim:
    """A sentence of the paper, its number, ours, and whether it holds."""

    claim: str
    paper: str
    here: str
    verdict: str


@cache
def swept(least: str, most: str, count: int, *kinds: str, held: bool = False) -> FuelSweep:
    """A sweep of the paper's example, every time in it proven; with commands `held` in the form of pulses one way, then the other."""
    done = sweep(plan(load_study(STUDY), least, most, count, kinds or DEFAULT_KINDS, held=held, weights=False))
    for curve in done.curves:
        for point in curve.points:
            assert point.status == "proved", (curve.kind, point.fuel)
            assert point.bound.gap is not None
            assert point.bound.gap <= CLOSED
    return done


@cache
def at(kind: str, fuel: str) -> Point:
    """One budget of one kind."""
    done = swept(fuel, str(Decimal(fuel) + 1), 2, kind)
    found = done.curves[0].at(Fraction(fuel))
    assert found is not None
    return found


def time(kind: str, fuel: str) -> float:
    """Minimum time [s]."""
    return at(kind, fuel).bound.upper or float("nan")


def narrow(kind: str, fuel: str) -> float:
    """5 % insensitivity."""
    return at(kind, fuel).insensitivity or 0.0


def curve(kind: str) -> tuple[Point, ...]:
    """The points of a kind in steps of 0.05 N·s (the nodes, which a sweep adds, among them)."""
    return next(one for one in swept(*RANGE).curves if one.kind.name == kind).points


def rounded(claim: str, paper: str, found: float, unit: str = "", *, digits: int, otherwise: str = NOT) -> Claim:
    """A number of the paper that is reproduced if ours, rounded to as many decimals, is the same."""
    places = -int(Decimal(paper).as_tuple().exponent)
    same = round(found, places) == float(paper)
    suffix = f" {unit}" if unit else ""
    return Claim(claim, f"{paper}{suffix}", f"{found:.{digits}f}{suffix}", REPRODUCED if same else otherwise)


def judged(claim: str, paper: str, here: str, *, holds: bool, otherwise: str = NOT) -> Claim:
    """A sentence that holds or does not."""
    return Claim(claim, paper, here, REPRODUCED if holds else otherwise)


def turn(kind: str, low: str, high: str) -> tuple[str, str]:
    """Two budgets close together between which the fastest command turns from type 1 to type 2."""
    below, above = Decimal(low), Decimal(high)
    while above - below > Decimal(str(NEAR)):
        middle = (below + above) / 2
        pulses = at(kind, str(middle)).pulses
        assert pulses is not None
        below, above = (middle, above) if pulses.type == 1 else (below, middle)
    return str(below), str(above)


def form() -> Iterator[Claim]:
    """What it says of profiles that are held in the form of pulses one way, then the other."""
    held = {kind: swept("5", "5.3", 4, kind, held=True).curves[0] for kind in (ZV, ZVD)}
    burnt = {}
    for kind, one in held.items():
        assert one.efficient is not None
        assert one.efficient.bound.status is Status.PROVED
        burnt[kind] = one.efficient.burnt or 0.0
    told = f"{burnt[ZVD]:.4f} N·s"
    yield judged("III C: held in the form of type 1, ZVD burns at most some", "5.4 N·s", told, holds=abs(burnt[ZVD] - 5.4) <= 0.1)
    losses = [(one.bound.upper or 0.0) / time(ZVD, written(one.fuel)) - 1.0 for one in held[ZVD].held]
    told = f"{100 * min(losses):.3f} to {100 * max(losses):.3f} %"
    yield judged("III C: … and is no slower, from 5.0 to 5.3 N·s", "essentially", told, holds=max(losses) <= 2e-3)
    told = f"{burnt[ZV]:.6f} N·s"
    yield judged("IV: the fuel-efficient command of ZV is its first node", "4.5 N·s", told, holds=round(burnt[ZV], 1) == 4.5)
    weights = critical_weights(swept("5", "5.3", 4, ZV, held=True).curves[0].posed)
    alphas = {float(weight.displacement): weight.alpha for weight in weights}
    falls = all(a > b for a, b in pairwise(alphas.values()))
    told = f"{alphas[5.0]:.5f} s per N·s at 5 m, falling"
    yield judged("Fig. 10: α_crit depends on the distance", "yes", told, holds=falls)


def claims() -> Iterator[Claim]:
    """All of them, in the order of the paper."""
    cost = {(a, b): fmean(time(kind, b) - time(kind, a) for kind in (RB, ZV, ZVD)) for a, b in (("4", "3"), ("2", "1"))}
    yield rounded("III A: from 4 to 3 N·s the three kinds take longer by, on average", "1.53", cost["4", "3"], "s", digits=4)
    yield rounded("III A: from 2 to 1 N·s", "9.55", cost["2", "1"], "s", digits=4)
    rigid, zero, derivative = (curve(kind) for kind in (RB, ZV, ZVD))
    ratios = [(100.0 * ((c.bound.upper or 0) / (a.bound.upper or 1) - 1.0), c.fuel) for a, c in zip(rigid, derivative, strict=True)]
    most, where = max(ratios)
    told = f"{most:.1f} % (at {float(where):g} N·s)"
    yield judged("III A: ZVD takes longer than the rigid body by at most", "27 %", told, holds=round(most) == 27)
    quarter, middle, three = quantiles([ratio for ratio, _ in ratios], n=4)
    told = f"{middle:.1f} %, the middle half {quarter:.0f} to {three:.0f} %"
    yield judged("III A: … typically by some", "15 to 20 %", told, holds=15 <= middle <= 20)
    sides = [(a.bound, b.bound, c.bound) for a, b, c in zip(rigid, zero, derivative, strict=True)]
    between = all(a.lower <= (b.upper or 0.0) and b.lower <= (c.upper or 0.0) for a, b, c in sides)
    closest = min((c.bound.upper or 0) / (b.bound.upper or 1) - 1.0 for b, c in zip(zero, derivative, strict=True))
    nearest = min((b.bound.upper or 0) / (a.bound.upper or 1) - 1.0 for a, b in zip(rigid, zero, strict=True))
    told = f"RB ≤ ZV ≤ ZVD; {100 * nearest:.4f} % from RB, {100 * closest:.4f} % from ZVD"
    yield judged("III A: ZV lies between them and touches either at some fuel", "yes", told, holds=between and max(closest, nearest) < 1e-3)
    yield rounded("Fig. 5: 5 % insensitivity of ZV at 4 N·s", "0.107", narrow(ZV, "4"), digits=5)
    yield rounded("Fig. 5: … at 3.5 N·s", "0.012", narrow(ZV, "3.5"), digits=5)
    spread_ = {kind: [p.insensitivity or 0.0 for p in points] for kind, points in ((ZV, zero), (ZVD, derivative))}
    factor = {kind: max(values) / min(values) for kind, values in spread_.items()}
    yield judged("III B: insensitivity of ZV varies by an order of magnitude", "10", f"{factor[ZV]:.0f}", holds=factor[ZV] >= 10)
    yield judged("III B: … of ZVD by a factor of", "3", f"{factor[ZVD]:.2f}", holds=round(factor[ZVD]) == 3)
    told = f"{narrow(ZVD, '3.5'):.4f} against {narrow(ZVD, '4'):.4f}"
    yield judged("III B: ZVD is much less sensitive at 3.5 than at 4 N·s", "yes", told, holds=narrow(ZVD, "3.5") > 1.5 * narrow(ZVD, "4"))
    yield rounded("III C: ZV gains from 4.5 to 6.7 N·s", "0.03", time(ZV, "4.5016") - time(ZV, "6.7"), "s", digits=4)
    first, second = (f"M ω Δ/({two}nπ)" for two in ("2", ""))
    yield judged("(33): fuel of the n-th two-pulse command of ZV", first, second, holds=False, otherwise=CORRECTED)
    nodes = {choice.node.number: choice.node for choice in swept(*RANGE).choices if choice.node}
    yield rounded("Fig. 7: ZV falls together to two pulses at", "4.5", nodes[1].fuel, "N·s", digits=6)
    yield rounded("Fig. 7: … and at", "2.2", nodes[2].fuel, "N·s", digits=6, otherwise=CORRECTED)
    low, high = turn(ZVD, "4.5", "5.5")
    told = f"{float(low):.3f} to {float(high):.3f} N·s"
    yield judged("III C: ZVD turns from type 1 to type 2", "just below 5 N·s", told, holds=float(low) >= 4.9 and float(high) <= 5.0)
    yield from form()
    gained = time(ZVD, "5") - (swept(*RANGE).curves[-1].free.bound.upper or 0.0)
    told = f"{gained:.4f} s, {100 * gained / time(ZVD, '5'):.2f} %"
    yield judged("III C: more than 5 N·s speeds ZVD up by nothing noticeable", "0", told, holds=gained < 0.01 * time(ZVD, "5"))
    knees = sorted((float(point.fuel) for point in swept(*RANGE).curves[-1].knees), reverse=True)[:2]
    told = " and ".join(f"{knee:.2f}" for knee in knees) + " N·s"
    yield judged("III C: less fuel suddenly costs ZVD much at about", "4 and 2 N·s", told, holds=[round(knee) for knee in knees] == [4, 2])


def table(rows: Iterator[Claim], shown: Callable[[str], None] = print) -> None:
    """In columns."""
    cells = [HEADINGS, *((row.claim, row.paper, row.here, row.verdict) for row in rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    for row in cells:
        shown("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


if __name__ == "__main__":
    table(claims())
