"""The linear program on a fixed grid of impulse amplitudes: the one door to cvxpy and Clarabel.

At a fixed maneuver time the *reachable fraction* α of the target is maximised (../docs/theory.md, section 2):

    maximise α   subject to   Q u = α q + S c,   u_k = Σ_{i≤k} A_i,   lower ≤ u ≤ upper,   -α below_i ≤ (E c)_i ≤ α above_i

over the impulse amplitudes A, that is, over the staircase u that they add up to (the solver's variables are the values u: with A as further
variables, linked sparsely, 10⁵ intervals take twice as long), and over the coefficients c of the tail, whose limits are imposed at instants
after the move and scale with α on both sides (unscaled, α would have a ceiling where the final rest input lies on a limit). The caps on
single coefficients are further such rows, tangents of a disc where one is complex. With a budget of fuel the levels are u⁺ - u⁻ of two
parts that are not negative, and `Σ widths (u⁺ + u⁻) ≤ fuel`; like the input's limits that does not scale with α. The rows of Q are
orthonormal, so that no scaling of poles, time or units is left in them, and the program is always feasible. Solver status is never
evidence: what comes out is a candidate.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from relaxations.courses import Motion, shares_left
from relaxations.errors import SolverError
from relaxations.maneuvers import Problem
from relaxations.posing import GridProgram
from relaxations.presses import presses
from relaxations.prices import NONE, Prices
from relaxations.ramps import priced
from relaxations.tails import moduli

Reals = NDArray[np.float64]

SETTINGS: dict[str, Any] = {
    # Pinned so that the same inputs give the same bytes; 1e-10 is what grids up to 10⁵ points still reach.
    "direct_solve_method": "qdldl",
    "max_threads": 1,
    "warm_start": False,  # a solver that was used before would answer with other last digits
    "tol_gap_abs": 1e-10,
    "tol_gap_rel": 1e-10,
    "tol_feas": 1e-10,
}


SMALL = 1e-4  # of the largest limited coefficient: smaller ones are not scaled up any further
RESIDUAL = 1e-8  # relative; the solver's 1e-10 with room for limits far from the amplitudes used


class Slope(Enum):
    """What of the input's slope is limited: nothing, the slope of a continuous input, its steps from sample to sample."""

    FREE, RAMPS, STEPS = range(3)


@dataclass(frozen=True, slots=True)
class GridSolution:
    """What the solver found: fraction α, levels u (N,) in deviations, tail coefficients (n,), and the multipliers.

    `costate` λ (size,) belongs to the moment equations, `mu_above` and `mu_below` (k,) ≥ 0 to the tail's limits, `pull` (n,) to its caps:
    `Sᵀλ + Eᵀ(μ⁺ - μ⁻)`, which is 0 without a cap, `prices` to all other limits. They are scaled to
    `λᵀ target - Σ μ⁺ above - Σ μ⁻ below - Σ |pull_k| cap_k = 1`, what else scales with α included.
    """

    program: GridProgram
    fraction: float
    levels: Reals
    tail: Reals
    costate: Reals
    mu_above: Reals
    mu_below: Reals
    pull: Reals
    status: str
    prices: Prices = NONE

    @property
    def fuel(self) -> float:
        """The price of the fuel."""
        return float(self.prices.fuel)

    @property
    def problem(self) -> Problem:
        """The problem in the coordinates of `costate`."""
        return self.program.problem

    @property
    def maneuver_time(self) -> float:
        """T [s]."""
        return self.program.maneuver_time

    @property
    def tail_coefficients(self) -> Reals:
        """Coefficients of the tail that follows the levels divided by α."""
        return self.tail / self.fraction if self.fraction > 0.0 else self.tail

    @property
    def tail_multipliers(self) -> tuple[tuple[float, float, float], ...]:
        """(instant after the move [s], μ⁺, μ⁻) wherever one is not zero."""
        own = np.count_nonzero(self.program.aspect == 0)  # those of its other aspects and of the caps come after
        triples = zip(self.program.looks[:own], self.mu_above, self.mu_below, strict=False)
        return tuple((float(t), float(above), float(below)) for t, above, below in triples if above > 0.0 or below > 0.0)

    def price(self, problem: Problem) -> float:
        """`Σ μ⁺ above + Σ μ⁻ below + Σ |pull_k| cap_k`, what the tail's limits take off the costate's target; that of fuel and courses."""
        others = self.fuel * (problem.fuel or 0.0) + sum(abs(press.weight) * press.course.limit for press in self.prices.pressed)
        return _price(self.program, self.mu_above, self.mu_below, self.pull) + others

    @property
    def residual(self) -> float:
        """Violation of the orthonormal rows relative to the part of the target reached (a solution judges itself).

        Where there is no target, and only what is left of the move is limited, relative to what the levels do.
        """
        reached = self.fraction * self.program.target
        size = float(np.linalg.norm(reached if self.program.target.any() else self.program.rows @ self.levels))
        missed = self.program.rows @ self.levels - self.program.columns @ self.tail - reached
        return float(np.linalg.norm(missed)) / size if size > 0.0 else np.inf

    @property
    def reaches(self) -> bool:
        """Whether the levels, divided by α, are a command that lands on the target: α ≥ 1, and not by the solver's tolerance alone."""
        return self.fraction >= 1.0 and self.residual <= RESIDUAL


def _price(program: GridProgram, above: Reals, below: Reals, pull: Reals) -> float:
    """What multipliers of a tail's limits cost, those of its caps by what they hold: exact, where their faces are tangents."""
    k = len(program.looks)
    limits = above[:k] @ program.above[:k] + below[:k] @ program.below[:k]
    return float(limits + moduli(pull, program.capped) @ program.bounds)


@lru_cache(maxsize=16)
def _compiled(size: int, cells: int, coefficients: int, looks: int, budget: bool, slope: Slope) -> dict[str, Any]:
    """The parametrised cvxpy problem of one shape, compiled once (a re-solve then costs a tenth)."""
    return _stated(size, cells, coefficients, looks, budget, slope)


def _stated(
    size: int, cells: int, coefficients: int, looks: int, budget: bool, slope: Slope, motion: Motion | None = None
) -> dict[str, Any]:
    """The cvxpy problem of one shape, by the names of its parameters, variables and constraints; courses are constants in it."""
    import cvxpy as cp

    named: dict[str, Any] = {"rows": cp.Parameter((size, cells)), "target": cp.Parameter(size)}
    named |= {"lower": cp.Parameter(), "upper": cp.Parameter()}
    named |= {"levels": cp.Variable(cells), "fraction": cp.Variable()}
    levels, fraction = named["levels"], named["fraction"]
    landed = fraction * named["target"]
    if budget:
        over, under = cp.Variable(cells, nonneg=True), cp.Variable(cells, nonneg=True)
        named |= {"widths": cp.Parameter(cells), "fuel": cp.Parameter(), "levels": over - under}
        levels, named["budget"] = named["levels"], named["widths"] @ (over + under) <= named["fuel"]
        limits = [over <= named["upper"], under <= -named["lower"], named["budget"]]
    else:
        limits = [levels >= named["lower"], levels <= named["upper"]]
    if coefficients:
        named |= {"columns": cp.Parameter((size, coefficients)), "shapes": cp.Parameter((looks, coefficients))}
        named |= {"above": cp.Parameter(looks), "below": cp.Parameter(looks), "tail": cp.Variable(coefficients)}
        landed = landed + named["columns"] @ named["tail"]
        shape = named["shapes"] @ named["tail"]
        named |= {"ceiling": shape <= fraction * named["above"], "floor": -shape <= fraction * named["below"]}
        limits += [named["ceiling"], named["floor"]]
    if slope is not Slope.FREE:
        count = cells if slope is Slope.RAMPS else cells + 1  # to the final rest it is one more step, and the last ramp ends there
        named |= {"rising": cp.Parameter(count), "falling": cp.Parameter(count), "end": cp.Parameter()}
        end = cp.hstack([fraction * named["end"]])
        steps = cp.hstack([levels, end])[:count] - cp.hstack([0.0, levels])[:count]
        named |= {"up": steps <= named["rising"], "down": steps >= named["falling"]}
        limits += [named["up"], named["down"]]
        if slope is Slope.RAMPS:
            if coefficients:
                named["begins"] = cp.Parameter(coefficients)
                end = end + cp.hstack([named["begins"] @ named["tail"]])
            named["landing"] = levels[-1:] == end
            limits.append(named["landing"])
    if motion is not None:
        count, past = len(motion.places), motion.unknowns
        named |= {"half": cp.Parameter(), "risen": cp.Parameter(count), "over": cp.Parameter(count), "under": cp.Parameter(count)}
        moments = cp.Variable(past)
        course = named["half"] * (motion.bends @ levels + motion.states @ moments) - fraction * named["risen"]
        named |= {"bent": course <= named["over"], "unbent": -course <= named["under"]}
        limits += [named["bent"], named["unbent"], motion.flow @ levels + motion.past @ moments == 0.0]
    named["reach"] = named["rows"] @ levels == landed
    named["problem"] = cp.Problem(cp.Maximize(fraction), [named["reach"], *limits])
    return named


def solve(program: GridProgram) -> GridSolution:
    """Maximise the reachable fraction; raises `SolverError` with the status if the solver gives no numbers."""
    import cvxpy as cp
    from cvxpy.error import SolverError as NotSolvedError

    (looks, coefficients), cells, fuel = program.shapes.shape, program.rows.shape[1], program.problem.fuel
    size, motion, imposed, rate = len(program.rows), program.motion, looks if coefficients else 0, program.problem.rate
    slope = Slope.FREE if rate is None else Slope.RAMPS if program.problem.sloped else Slope.STEPS
    if motion is None:
        compiled = _compiled(size, cells, coefficients, imposed, fuel is not None, slope)
    else:
        compiled = _stated(size, cells, coefficients, imposed, fuel is not None, slope, motion)
    # Levels are measured in half the actuator's range, the target in its own length, a tail coefficient in what fills that range: every
    # number is then of order one.
    half = (program.upper - program.lower) / 2
    length = float(np.linalg.norm(program.target) or np.abs(program.above).max(initial=0.0)) / np.sqrt(cells)
    if length == 0.0:
        raise SolverError(f"in T = {program.maneuver_time!r} s the plant does so much more than the target that this rounds to nothing")
    values = {"rows": program.rows, "target": program.target / length, "lower": program.lower / half, "upper": program.upper / half}
    unit = np.ones(0)
    if coefficients:
        sizes = np.abs(program.shapes).max(axis=0)
        unit = 1.0 / np.maximum(sizes, SMALL * sizes.max())
        values |= {"columns": program.columns * unit, "shapes": program.shapes * unit}
        values |= {"above": program.above / length, "below": program.below / length}
    width = program.maneuver_time / cells
    if fuel is not None:
        values |= {"widths": np.diff(program.instants) / width, "fuel": fuel / (half * width)}
    if rate is not None:
        step = program.problem.maneuver.sample_time
        steps = np.diff(program.instants) / half if step is None else np.full(cells + 1, float(step) / half)
        values |= {"rising": rate[1] * steps, "falling": rate[0] * steps, "end": program.problem.hold / length}
        if coefficients and slope is Slope.RAMPS:
            values["begins"] = program.problem.tail.rows(np.zeros(1))[0] * unit if program.problem.tail.size else 0.0 * unit
        if fuel is not None and step is None:  # nodes carry half of either cell
            values["widths"] = (values["widths"] + np.append(values["widths"][1:], 0.0)) / 2
    if motion is not None:
        most, least, posed = 1.0 - program.inside, 0.0, program.problem
        if posed.transition is None and posed.residuals is None:
            most, least = shares_left(program.inside, motion.finals, motion.places[:, 1]), -program.inside
        values |= {"half": half, "risen": half / length * (motion.finals - motion.free)}
        values |= {"over": np.maximum(most - motion.finals, least), "under": np.maximum(most + motion.finals, least)}
    for name, value in values.items():
        compiled[name].value = value
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # "solution may be inaccurate": judged below, by what is used of it
        try:
            compiled["problem"].solve(solver=cp.CLARABEL, ignore_dpp=motion is not None, **SETTINGS)
        except NotSolvedError as problem:
            raise SolverError(f"the linear program at T = {program.maneuver_time!r} s has no answer that was found") from problem
    status = str(compiled["problem"].status)
    if compiled["levels"].value is None or compiled["reach"].dual_value is None:
        raise SolverError(f"the linear program has no answer at T = {program.maneuver_time!r} s: {status}")
    levels = half * np.clip(compiled["levels"].value, program.lower / half, program.upper / half)
    multiplier = np.asarray(compiled["reach"].dual_value)
    # The sign of a multiplier is a convention of the solver. The costate is the one whose maximisers the levels are: stationarity in α says
    # `λᵀ target = 1 + what the tail's limits cost`, which is positive (the levels themselves say nothing where α = 0).
    prices = (
        [np.maximum(np.asarray(compiled[name].dual_value), 0.0) for name in ("ceiling", "floor")] if coefficients else [np.zeros(looks)] * 2
    )
    bent = [np.maximum(compiled[name].dual_value, 0.0) for name in ("bent", "unbent")] if motion is not None else []
    held = half * (bent[0] - bent[1]) if motion is not None else np.zeros(0)
    risen = float(held @ (motion.finals - motion.free)) if motion is not None else 0.0
    ends = {Slope.FREE: [0.0], Slope.RAMPS: [1.0, -1.0], Slope.STEPS: [1.0]}[slope]  # the multiplier of where the input has to end
    if slope is Slope.RAMPS:
        ends = [sign * float(compiled["landing"].dual_value[0]) for sign in ends]
    elif slope is Slope.STEPS:
        ends = [max(float(compiled["up"].dual_value[-1]), 0.0) - max(float(compiled["down"].dual_value[-1]), 0.0)]
    signs = [(sign * multiplier, end) for sign in (1.0, -1.0) for end in ends]
    if program.problem.residuals is not None:  # their limits may pay instead: the sign is then the one that they balance, for z is free
        balance = float((program.columns.T @ multiplier) @ (program.shapes.T @ (prices[0] - prices[1])))
        signs = [(-multiplier if balance > 0.0 else multiplier, ends[0])]
    turned = [_Turned.of(program, prices, *sign, risen, length) for sign in signs]
    best = min(turned, key=lambda one: one.off)
    multiplier, landing, pull, scale = best.multiplier, best.landing, best.pull, best.scale
    if slope is Slope.RAMPS and program.problem.tail.size and not _ends_on_a_ramp(program, levels):
        # Where the slope is not on a limit q is 0: what is left of it, half a cell's worth, is the limit's that the tail begins on.
        at = int(np.argmin(program.looks[program.aspect == 0]))
        kept = max(prices[0][at] + landing, 0.0)
        prices[1][at], prices[0][at] = prices[1][at] - min(prices[0][at] + landing, 0.0), kept
        landing = 0.0
    if scale <= 0.0:
        raise SolverError(f"the multipliers at T = {program.maneuver_time!r} s vanish on the target")
    return GridSolution(
        program,
        half * float(compiled["fraction"].value) / length,
        levels,
        half * unit * compiled["tail"].value if coefficients else np.zeros(0),
        np.linalg.solve(program.basis_change, multiplier[: len(program.basis_change)] / scale).astype(np.float64),
        prices[0] / scale,
        prices[1] / scale,
        pull / scale,
        status,
        _prices(program, levels, compiled, held / scale, slope, width, scale, prices, landing),
    )


def _prices(
    program: GridProgram,
    levels: Reals,
    compiled: dict[str, Any],
    held: Reals,
    slope: Slope,
    width: float,
    scale: float,
    tail: list[Reals],
    landing: float,
) -> Prices:
    """What the solver says of the limits that do not scale with α."""
    posed, motion = program.problem, program.motion
    fuel = 0.0 if posed.fuel is None else max(float(compiled["budget"].dual_value), 0.0) / (width * scale)
    spread = posed.maneuver.sample_time is None
    pressed = presses(posed.courses, motion.places, held, program.instants, spread) if motion is not None else ()
    ramps = priced(program.instants, levels, posed.rate, fuel) if posed.rate and slope is Slope.RAMPS else ()
    up, down = (np.maximum(compiled[name].dual_value, 0.0) for name in ("up", "down")) if slope is Slope.STEPS else (np.zeros(0),) * 2
    steps = tuple(float(x) for x in (up - down)[::-1] / scale)
    if posed.tail.size and landing and ramps and ramps[0].edges[0] == 0.0:
        steps = (landing / scale,)
    names = [None, *(aspect.name for aspect in posed.tail.aspects)]
    own = [(i, program.unit[i] / scale) for i in np.flatnonzero(program.aspect)] if posed.tail.aspects else []
    after = ((names[program.aspect[i]], float(program.looks[i]), float(tail[0][i] * u), float(tail[1][i] * u)) for i, u in own)
    return Prices(fuel, pressed, ramps, steps, tuple(one for one in after if one[2] > 0.0 or one[3] > 0.0))


@dataclass(frozen=True, slots=True)
class _Turned:
    """Multipliers of the equations with one choice of signs, which the solver does not tell, and how far off stationarity they are."""

    multiplier: Reals
    landing: float
    pull: Reals
    scale: float
    off: float

    @staticmethod
    def of(program: GridProgram, prices: list[Reals], multiplier: Reals, landing: float, risen: float, length: float) -> _Turned:
        k, tail = len(program.looks), program.problem.tail
        force = program.columns.T @ multiplier
        pull = force + program.shapes[:k].T @ (prices[0] - prices[1])[:k]
        if program.problem.sloped and tail.size:
            pull = pull + landing * tail.rows(np.zeros(1))[0]
        free = np.setdiff1d(np.arange(len(pull)), [at for places in program.capped for at in places]).astype(np.intp)
        scale = float(multiplier @ program.target) - _price(program, prices[0], prices[1], pull) - risen
        size = float(np.linalg.norm(force)) + np.finfo(float).tiny
        left = abs(scale + landing * program.problem.hold - length) / length + float(np.linalg.norm(pull[free])) / size
        return _Turned(multiplier, landing, pull, scale, left)


def _ends_on_a_ramp(program: GridProgram, levels: Reals) -> bool:
    rate = program.problem.rate
    ramps = priced(program.instants, levels, rate, 0.0) if rate else ()
    return bool(ramps) and ramps[0].edges[0] == 0.0


@dataclass(frozen=True, slots=True)
class ConeSolution:
    """What the solver found of `closest`: weights x (N,), excess r, and the multipliers: λ of the sum, y (k,) complex of the circles."""

    weights: Reals
    excess: float
    sum: float
    multipliers: NDArray[np.complex128]


def closest(columns: NDArray[np.complex128], radii: Reals, negative: float = 0.0) -> ConeSolution:
    """Minimise r subject to `|Z x|_i ≤ radii_i + r`, `Σ x = 1`, x ≥ 0, for complex columns Z (k, N): a second-order cone program.

    With `negative` > 0 the negative parts of x may sum to that much in size. The multipliers are scaled to Σ|y| = 1 and turned so that for
    q = Re(ȳᵀ Z) and N = `negative` `r = (1 + N) min q - N max q - Σ |y| radii`, λ = min q. Raises `SolverError`.
    """
    import cvxpy as cp

    x, r = cp.Variable(columns.shape[1]), cp.Variable()
    below: Any = cp.Variable(columns.shape[1], nonneg=True) if negative else 0
    reached = cp.vstack([columns.real @ x, columns.imag @ x])
    circles = cp.SOC(radii + r, reached, axis=0)
    limits: list[Any] = [circles, cp.sum(x) == 1, x + below >= 0, *([cp.sum(below) <= negative] if negative else [])]
    program = cp.Problem(cp.Minimize(r), limits)
    run(program, "cone program")
    if x.value is None or r.value is None or circles.dual_value is None:
        raise SolverError(f"the cone program has no answer: {program.status}")
    dual = np.asarray(circles.dual_value[1])
    multipliers = dual[0] + 1j * dual[1]
    scale = float(np.abs(multipliers).sum())
    multipliers = multipliers / scale if scale > 0.0 else multipliers
    # The sign of a multiplier is a convention of the solver: the right one supports the circles from outside.
    turned = (multipliers.conj() @ columns).real
    if float(turned @ x.value) < 0.0:
        multipliers, turned = -multipliers, -turned
    return ConeSolution(x.value if negative else np.maximum(x.value, 0.0), float(r.value), float(turned.min()), multipliers)


def run(program: Any, what: str) -> None:
    """Solve a cvxpy program as all others are; raises `SolverError`."""
    import cvxpy as cp
    from cvxpy.error import SolverError as NotSolvedError

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # as above: judged by what is used of it
        try:
            program.solve(solver=cp.CLARABEL, **SETTINGS)
        except NotSolvedError as problem:
            raise SolverError(f"the {what} has no answer that was found") from problem


def modelling() -> Any:
    """cvxpy, for programs that are posed elsewhere."""
    import cvxpy as cp

    return cp
