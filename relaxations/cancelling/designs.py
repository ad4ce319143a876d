"""The shortest filter of a given structure: delays, gains and numerators that cancel a plant's poles, within bounds.

The conditions are linear but for the delays. What is left of them when gains and numerators do their best is looked at over all delays on a
grid (or, of more than two, on a fixed low-discrepancy sequence); Newton's method goes on from its valleys. Where there are more unknowns
than equations, the bounds decide: the last delay is minimised within them (Singh 2012, (53)), and at its end the bounds that are reached
are equations too. The least last delay of all that was found is the answer: nothing proves that there is none shorter
(`relaxations.proofs.minimum_time` brackets what any filter within limits on the input could do).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog, minimize

from relaxations.cancelling.prefilters import Prefilter
from relaxations.cancelling.structures import Structure
from relaxations.errors import ImpossibleShaperError, ShaperError

Reals = NDArray[np.float64]

WINDOWS = (1.0, 2.0, 4.0)  # of the plant's own time: how long a filter is looked for
GRID = {1: 2000, 2: 140}  # delays on a side
DRAWS = 1 << 13  # of more delays
STARTS, TRIES = 400, 24  # of Newton's method, and of the minimisation
APART = 1e-6  # of the duration: delays closer than this are one
MOST = 10  # delays that are free: half a minute of minimisation
SLACK = 1e-9  # of the gains' size: closer to 0 is 0
MARGIN = 1e-9  # of the bounds' size: what is minimised stays so far inside, and is then moved onto the bounds it has reached
ROUNDED = 1e-13  # of the size of what is summed: how far beyond a bound rounding may take it
SOLVED = 1e-11  # of the equations' size
STEPS = 40
UNBOUNDED = (
    "they have infinitely many solutions, the shorter the larger the gains: bound the gains or the levels, ask for a monotone reference, "
    "or give the delays"
)
ROUNDING = 1e-15


@dataclass(frozen=True, slots=True)
class Found:
    """A solution: delays (L+1,) [s], and gains and numerators (parts,)."""

    delays: Reals
    unknowns: Reals

    @property
    def duration(self) -> float:
        """The last delay [s]."""
        return float(self.delays[-1])


def design(structure: Structure) -> Prefilter:
    """The filter with the least last delay that was found.

    Raises `ShaperError` if the unknowns cannot satisfy the equations, or nothing bounds them; `ImpossibleShaperError` if none was found.
    """
    free = structure.freedom
    if free < 0:
        enough = f"with this form it takes {_enough(structure)} delays"
        raise ShaperError(f"{structure.counted} cannot satisfy them with {_delays(structure.form.delays)}; {enough}")
    if free > 0 and not structure.bounds:
        raise ShaperError(f"{structure.counted} and {_delays(structure.form.delays)}; {UNBOUNDED}")
    if structure.contradiction is not None:
        raise ImpossibleShaperError(structure.contradiction)
    if structure.form.delays > MOST:
        asked = f"filters of more than {MOST} free delays are not looked for, and {structure.form.delays} were asked for"
        raise ShaperError(f"{asked}: give their instants or a sample time, or ask for the fastest command of all, a time-optimal one")
    horizon, fine = 0.0, structure.fine
    for window in WINDOWS:
        horizon = window * natural_time(structure)
        found = list(_solutions(structure, horizon) if free == 0 else _minimised(structure, horizon, _starts(structure, horizon)))
        found.sort(key=lambda one: one.duration)
        for one in found:
            if _kept(fine, one):
                return structure.filter(one.delays, one.unknowns)
            if free and (again := [more for more in _minimised(fine, horizon, [(one.delays, one.unknowns)]) if _kept(fine, more)]):
                return structure.filter(again[0].delays, again[0].unknowns)
    within = " within the bounds" if structure.bounds else ""
    raise ImpossibleShaperError(
        f"no filter of this form with {_delays(structure.form.delays)} was found up to {horizon * structure.unit:.6g} s{within}; one delay "
        "more, wider bounds or another form may do"
    )


def at_delays(structure: Structure, delays: Reals) -> Prefilter:
    """The filter with these delays [s]: of several, that of the least sum of |gains| within the bounds.

    Raises `ImpossibleShaperError` if there is none.
    """
    found = solved_at(structure.fine, delays)
    if found is None:
        given, within = ", ".join(f"{delay * structure.unit:.6g}" for delay in delays[1:]), " within the bounds" if structure.bounds else ""
        raise ImpossibleShaperError(f"no filter of this form has its delays at {given} s{within}: {structure.counted}")
    return structure.filter(found.delays, found.unknowns)


def solved_at(structure: Structure, delays: Reals) -> Found | None:
    """Gains and numerators at these delays, if there are any."""
    table, aim = structure.conditions.table(structure.parts, delays), structure.conditions.aim
    if len(structure.parts) <= len(aim):
        unknowns = np.asarray(np.linalg.lstsq(table, aim, rcond=None)[0], dtype=float)
    elif (least := _least_sizes(structure, delays, table)) is not None:
        unknowns = least
    else:
        return None
    found = Found(delays, unknowns)
    right = structure.conditions.error(structure.parts, delays, unknowns) <= SOLVED
    return found if right and _kept(structure, found) else None


def _least_sizes(structure: Structure, delays: Reals, table: Reals) -> Reals | None:
    """Of more unknowns than equations (their left sides: `table`) those of the least sum of |steps| within the bounds, if there are any."""
    aim, parts = structure.conditions.aim, len(structure.parts)
    # Sizes |x| ≤ t, Σ t least over the steps; the numerators cost nothing.
    rows, sides = structure.limits(delays)
    eye, cost = np.eye(parts), np.array([1.0 if part.power is None else 0.0 for part in structure.parts])
    more = np.block([[-rows, np.zeros((len(rows), parts))], [eye, -eye], [-eye, -eye]])
    solved = linprog(
        np.concatenate([np.zeros(parts), cost]),
        A_ub=more,
        b_ub=np.concatenate([-_inside(sides), np.zeros(2 * parts)]),
        A_eq=np.hstack([table, np.zeros_like(table)]),
        b_eq=aim,
        bounds=[(None, None)] * parts + [(0.0, None)] * parts,
        options={"primal_feasibility_tolerance": 1e-10},
    )
    if solved.x is None or solved.status != 0:
        return None
    # A vertex lies on bounds: only the others are moved to satisfy the equations to rounding.
    unknowns = np.asarray(solved.x[:parts], dtype=float)
    used = np.abs(unknowns) > SLACK * np.abs(unknowns).max()
    unknowns[~used] = 0.0
    unknowns[used] += np.linalg.pinv(table[:, used]) @ (aim - table @ unknowns)
    return unknowns


def natural_time(structure: Structure) -> float:
    """About how long it takes to cancel the poles one after the other [s]: half a period each, or the time constant of a real one.

    A rigid body takes as long as the levels, or the gains, push it there.
    """
    conditions, bounds = structure.conditions, structure.bounds
    total = sum(
        pole.multiplicity * (math.pi / abs(pole.value.imag) if pole.is_flexible else 1.0 / abs(pole.value)) for pole in conditions.poles
    )
    if conditions.rigid:
        pushed = min((abs(end) for pair in (bounds.levels, bounds.gains) if pair for end in pair if end), default=abs(conditions.target))
        total += 2.0 * conditions.rigid * (abs(conditions.target) / pushed) ** (1.0 / conditions.rigid)
    slowest = max((1.0 / abs(root.value) for root in (*conditions.poles, *conditions.zeros)), default=1.0)
    return total + conditions.rigid * slowest if conditions.poles else total + max(conditions.rigid, 1) * slowest * 4.0


def _delays(count: int) -> str:
    return f"{count} delay{'s' * (count > 1)}"


def _enough(structure: Structure) -> int:
    """The least number of delays with which a form like this has as many unknowns as equations."""
    form = structure.form
    step = len(structure.parts) - form.delays  # parts beside one step for each delay
    more = 2 if len(form.carriers) < form.delays + 1 or form.step else 1 + len(structure.parts) // (form.delays + 1)
    return max(form.delays + 1, math.ceil((structure.conditions.size - step) / more))


def _grid(delays: int, horizon: float) -> tuple[Reals, NDArray[np.bool_] | None]:
    """Delays to look at (n, L+1), and which of them are neighbours on a grid of two: (side, side) mask."""
    if delays == 1:
        last = horizon * np.arange(1, GRID[1] + 1) / GRID[1]
        return np.stack([np.zeros_like(last), last], axis=1), None
    if delays == 2:
        side = horizon * np.arange(1, GRID[2] + 1) / GRID[2]
        first, last = np.meshgrid(side, side, indexing="ij")
        inside = first < last
        return np.stack([np.zeros(inside.sum()), first[inside], last[inside]], axis=1), inside
    from scipy.stats import qmc  # here: it takes longer to load than most designs take

    drawn = np.sort(qmc.Sobol(delays, scramble=False).random(DRAWS), axis=1) * horizon
    return np.hstack([np.zeros((len(drawn), 1)), drawn]), None


def _residuals(structure: Structure, delays: Reals) -> Reals:
    """What is left of the equations, relative, at the best gains and numerators: (n,)."""
    table, aim = structure.conditions.table(structure.parts, delays), structure.conditions.aim
    table = table / np.maximum(np.abs(table).max(axis=-1, keepdims=True), 1e-300)
    basis = np.linalg.qr(table)[0]
    scaled = np.where(aim, 1.0, 0.0)
    left = scaled - (basis @ (np.swapaxes(basis, -1, -2) @ scaled[:, None]))[..., 0]
    return np.linalg.norm(left, axis=-1)


def _valleys(structure: Structure, horizon: float) -> Reals:
    """Delays from which to go on, the shorter ones first."""
    delays, inside = _grid(structure.form.delays, horizon)
    left = _residuals(structure, delays)
    if structure.form.delays == 1:
        low = np.r_[True, left[1:] <= left[:-1]] & np.r_[left[:-1] <= left[1:], True]
    elif inside is not None:
        field = np.full((GRID[2] + 2,) * 2, np.inf)
        field[1:-1, 1:-1][inside] = left
        shifts = [np.roll(field, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
        low = (field <= np.min(shifts, axis=0))[1:-1, 1:-1][inside]
        low |= left <= np.sort(left)[min(STARTS, len(left)) - 1]
    else:
        low = left <= np.sort(left)[STARTS - 1]
    chosen = np.flatnonzero(low)
    return delays[chosen[np.argsort(left[chosen], kind="stable")][: 2 * STARTS]].copy()


def _solutions(structure: Structure, horizon: float) -> Iterator[Found]:
    """As many unknowns as equations: Newton's method from every valley, all at once."""
    tau, count = _valleys(structure, horizon), structure.form.delays
    table, aim = structure.conditions.table(structure.parts, tau), structure.conditions.aim
    x = (np.linalg.pinv(table) @ aim[:, None])[..., 0]
    for _ in range(STEPS):
        jacobian, error = _linearised(structure, tau, x)
        change = -(np.linalg.pinv(jacobian, rcond=1e-14) @ error[..., None])[..., 0]
        keep = _shortened(tau, change[:, :count])[:, None]
        tau[:, 1:] += keep * change[:, :count]
        x += keep * change[:, count:]
        fine = np.isfinite(x).all(axis=1) & np.isfinite(tau).all(axis=1) & (tau[:, -1] < 2.0 * horizon)
        tau, x = tau[fine], x[fine]
    for one, unknowns in zip(tau, x, strict=True):
        found = _checked(structure, one, unknowns)
        if found is not None and found.duration <= horizon:
            yield found


def _linearised(structure: Structure, tau: Reals, x: Reals) -> tuple[Reals, Reals]:
    """The equations' Jacobian by the delays and the unknowns, and what they miss: (…, size, L + parts) and (…, size)."""
    table, slopes = structure.conditions.table(structure.parts, tau), structure.conditions.slopes(structure.parts, tau)
    which = np.array([part.delay for part in structure.parts])
    moved = slopes * x[..., None, :]
    by_delay = np.stack([moved[..., which == k].sum(axis=-1) for k in range(1, structure.form.delays + 1)], axis=-1)
    return np.concatenate([by_delay, table], axis=-1), (table @ x[..., None])[..., 0] - structure.conditions.aim


def _shortened(tau: Reals, change: Reals) -> Reals:
    """How much of a change of the delays leaves them in order: (…,)."""
    gaps, moves = np.diff(tau, axis=-1), np.diff(change, axis=-1, prepend=0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(moves < 0.0, np.minimum(1.0, 0.7 * gaps / -moves), 1.0).min(axis=-1)


def _newton(structure: Structure, delays: Reals, unknowns: Reals, active: NDArray[np.intp]) -> Found | None:
    """A solution near these delays and unknowns, on these bounds too (rows of `limits`)."""
    tau, x, count = delays.copy(), unknowns.copy(), structure.form.delays
    for _ in range(STEPS):
        jacobian, error = _linearised(structure, tau, x)
        if len(active):
            rows, sides = structure.limits(tau)
            on = np.hstack([structure.bends(tau, x)[active], rows[active]])
            jacobian, error = np.vstack([jacobian, on]), np.append(error, rows[active] @ x - sides[active])
        change = np.linalg.lstsq(jacobian, -error, rcond=1e-14)[0]
        if not np.isfinite(change).all():
            return None
        keep = float(_shortened(tau, np.asarray(change[:count], dtype=float)))
        tau[1:] += keep * change[:count]
        x += keep * change[count:]
        if keep == 1.0 and np.abs(change[:count]).max() <= ROUNDING * tau[-1]:
            break
    return _checked(structure, tau, x)


def _checked(structure: Structure, tau: Reals, x: Reals) -> Found | None:
    if not (np.isfinite(x).all() and np.isfinite(tau).all() and np.diff(tau).min() > APART * tau[-1]):
        return None
    return Found(tau, x) if structure.conditions.error(structure.parts, tau, x) <= SOLVED else None


def _kept(structure: Structure, found: Found) -> bool:
    """Whether the bounds are kept to rounding; steps that are not to be negative to what counts as 0."""
    if not structure.bounds:
        return True
    rows, sides = structure.limits(found.delays)
    allowed = np.where(sides == 0.0, SLACK, ROUNDED) * (
        np.abs(sides) + np.abs(rows) @ np.abs(found.unknowns) + np.abs(found.unknowns).max()
    )
    return bool((rows @ found.unknowns >= sides - allowed).all())


def _inside(sides: Reals) -> Reals:
    """The bounds a little tighter; not those at 0, which steps may be on."""
    return sides + MARGIN * np.abs(sides)


def _minimised(structure: Structure, horizon: float, starts: Iterable[tuple[Reals, Reals]]) -> Iterator[Found]:
    """More unknowns than equations: the last delay is minimised within the bounds, from several starts."""
    conditions, parts, count = structure.conditions, structure.parts, structure.form.delays

    def split(v: Reals) -> tuple[Reals, Reals]:
        return np.append(0.0, np.cumsum(v[:count])), v[count:]

    def equations(v: Reals) -> Reals:
        return _linearised(structure, *split(v))[1]

    def slopes(v: Reals) -> Reals:
        jacobian = _linearised(structure, *split(v))[0]
        gaps = np.cumsum(jacobian[:, count - 1 :: -1], axis=1)[:, ::-1]  # a gap moves all delays after it
        return np.hstack([gaps, jacobian[:, count:]])

    def room(v: Reals) -> Reals:
        tau, x = split(v)
        rows, sides = structure.limits(tau)
        return rows @ x - _inside(sides)

    def bends(v: Reals) -> Reals:
        tau, x = split(v)
        gaps = np.cumsum(structure.bends(tau, x)[:, ::-1], axis=1)[:, ::-1]
        return np.hstack([gaps, structure.limits(tau)[0]])

    cost = np.append(np.ones(count), np.zeros(len(parts)))
    for delays, unknowns in starts:
        begin = np.concatenate([np.diff(delays), unknowns])
        solved = minimize(
            lambda v: float(cost @ v) / horizon,
            begin,
            jac=lambda _: cost / horizon,
            method="SLSQP",
            bounds=[(1e-4 * horizon, horizon)] * count + [(None, None)] * len(parts),
            constraints=[{"type": "eq", "fun": equations, "jac": slopes}, {"type": "ineq", "fun": room, "jac": bends}],
            options={"maxiter": 120, "ftol": 1e-14},
        )
        tau, x = split(solved.x)
        if (
            not np.isfinite(solved.x).all()
            or tau[-1] > horizon
            or np.abs(equations(solved.x)).max() > 1e-5 * (1.0 + abs(conditions.target))
        ):
            continue
        reached = np.flatnonzero(room(solved.x) <= 1e-7 * (1.0 + abs(conditions.target)))
        found = _newton(structure, tau, x, _independent(structure, tau, x, reached)) or _newton(structure, tau, x, reached[:0])
        if found is not None and found.duration <= tau[-1] * (1 + 1e-5):
            yield found


def _independent(structure: Structure, tau: Reals, x: Reals, reached: NDArray[np.intp]) -> NDArray[np.intp]:
    """Of the bounds that are reached as many as the unknowns leave room for, each in another direction."""
    rows, bends, chosen = structure.limits(tau)[0], structure.bends(tau, x), []
    basis, rank = _linearised(structure, tau, x)[0], structure.conditions.size
    for index in reached:
        if len(chosen) == structure.freedom:
            break
        more = np.vstack([basis, np.append(bends[index], rows[index])])
        if np.linalg.matrix_rank(more / np.linalg.norm(more, axis=1, keepdims=True), tol=1e-8) > rank:
            basis, rank = more, rank + 1
            chosen.append(index)
    return np.array(chosen, dtype=np.intp)


def _starts(structure: Structure, horizon: float) -> Iterator[tuple[Reals, Reals]]:
    """Delays with the gains of least norm there, those that break bounds and equations least first, long and short ones."""
    delays, _ = _grid(structure.form.delays, horizon)
    thinned = delays[:: max(1, len(delays) // 1500)]
    left = _residuals(structure, thinned)
    order = np.argsort(left, kind="stable")[: 8 * TRIES]
    scored = []
    for tau in thinned[order]:
        table = structure.conditions.table(structure.parts, tau)
        x = np.linalg.lstsq(table, structure.conditions.aim, rcond=None)[0]
        rows, sides = structure.limits(tau)
        broken = float(np.maximum(sides - rows @ x, 0.0).max(initial=0.0))
        scored.append((broken, float(tau[-1]), tau, x))
    scored.sort(key=lambda one: (one[0], one[1]))
    by_time = sorted(scored[: 4 * TRIES], key=lambda one: one[1])
    yield from ((tau, x) for _, _, tau, x in [*scored[: TRIES // 2], *by_time[:: max(1, len(by_time) // (TRIES // 2))]])
