"""The robust task: one command for every plant in a box of parameters, a residual within a tolerance instead of rest.

The plants are one transfer function whose coefficients are polynomials in the parameters. Beside the poles at the origin, where all of
them must be at rest together, the output of one of them moves after the command as `r(τ) = Re Σ Z_j e^{p_j τ}`,

    Z_j = (1 or 2) N(p_j) / D'(p_j) · (1/p_j) Σ jumps e^{p_j s}     s: time to go of each jump of the input, the last one to u_ss at s = 0

and |r(τ)| ≤ tolerance · |Δ| is asked for all τ ≥ 0. The lower side samples that, which only drops conditions; the upper side encloses Z_j
and p_j over cells of the box.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Any

import flint
from flint import acb, acb_poly, arb, fmpq, fmpq_poly

from relaxations.checking.balls import Root, System, Wave, isolated, spend
from relaxations.checking.members import halved, lands, member, rigid
from relaxations.checking.reading import Refuted, Undecided, require

Numbers = Sequence[arb | fmpq]


@dataclass(frozen=True, slots=True)
class Sample:
    """One plant of the box in balls: its poles beside the origin, and the weights (1 or 2) N(p)/D'(p) of their motions in the output."""

    roots: tuple[Root, ...]
    weights: tuple[acb, ...]


def sample(task: Any, place: Sequence[fmpq]) -> Sample:
    """The plant at an exact place; raises `Malformed` outside the box, `Undecided` at repeated poles."""
    box = task.box
    inside = len(place) == len(box.parameters) and all(p.low <= x <= p.high for p, x in zip(box.parameters, place, strict=True))
    require(inside, "a sample lies in the box")
    numerator, denominator = (fmpq_poly(member(box, place, which)) for which in ("numerator", "denominator"))
    require(not denominator.is_zero(), "a sample of the box is no plant")
    roots = tuple(root for root in isolated(denominator) if not root.value.is_zero())
    if any(root.multiplicity > 1 for root in roots):
        raise Undecided("a plant of the box has a repeated pole beside the origin")
    slope = acb_poly(denominator.derivative())
    weights = tuple((1 + root.flexible) * acb_poly(numerator)(root.value) / slope(root.value) for root in roots)
    return Sample(roots, weights)


def relaxed(system: System, samples: Any) -> tuple[tuple[Root, ...], list[arb], arb]:
    """What the samples' multipliers add to the costate (roots and flat coefficients), and to the left side of (2).

    With ν = μ⁻ - μ⁺ the costate gains `Re Σ ν w e^{pτ} e^{ps}`, and the left side `ν Re Σ w e^{pτ} u_ss/(-p) - (μ⁺ + μ⁻) V |Δ|`.
    """
    roots: list[Root] = []
    numbers: list[arb] = []
    gain, allowed = arb(0), (system.task.box.tolerance if samples else fmpq(0)) * abs(system.task.displacement)
    for written in samples:
        plant = sample(system.task, written.place)
        factors = [acb(0)] * len(plant.roots)
        for contact in written.residual:
            force = contact.lower - contact.upper
            gain -= arb((contact.upper + contact.lower) * allowed)
            for j, root in enumerate(plant.roots):
                spend(5)
                factors[j] += (root.value * arb(contact.time)).exp() * arb(force)
        for root, weight, factor in zip(plant.roots, plant.weights, factors, strict=True):
            roots.append(root)
            numbers += [(weight * factor).real, (weight * factor).imag][: 1 + root.flexible]
            gain += (weight * factor * arb(system.rest) / -root.value).real
    return tuple(roots), numbers, gain


@dataclass(frozen=True, slots=True)
class Motion:
    """Over a cell: poles p_j and motions Z_j, and their derivatives by every parameter."""

    poles: list[acb]
    sizes: list[acb]
    drifts: list[list[acb]]  # of the poles, [parameter][pole]
    slopes: list[list[acb]]  # of the motions


def motion(task: Any, jumps: Sequence[tuple[arb, arb]], cell: Numbers, poles: Sequence[acb], flexible: Sequence[bool]) -> Motion:
    """`Z_j` and its derivatives: by the implicit function `dp/dθ = -D_θ/D_s`, all over the balls of the cell and of its poles."""
    box = task.box
    N, D = (acb_poly(member(box, cell, which)) for which in ("numerator", "denominator"))
    Ns, Ds, Dss = N.derivative(), D.derivative(), D.derivative().derivative()
    turned = [[acb_poly(member(box, cell, which, q)) for which in ("numerator", "denominator")] for q in range(len(cell))]
    found = Motion(list(poles), [], [[] for _ in cell], [[] for _ in cell])
    for p, pair in zip(poles, flexible, strict=True):
        spend(6 * len(jumps))
        powers = [(p * s).exp() * jump for s, jump in jumps]
        total, rising = sum(powers, acb(0)), sum((power * s for power, (s, _) in zip(powers, jumps, strict=True)), acb(0))
        numerator, slope = N(p), Ds(p)
        below = slope * p
        weight = (1 + pair) * numerator / below
        found.sizes.append(weight * total)
        for q, (Nq, Dq) in enumerate(turned):
            drift = -Dq(p) / slope
            change = (1 + pair) * (Ns(p) * drift + Nq(p)) / below - weight * ((Dss(p) * drift + Dq.derivative()(p)) / slope + drift / p)
            found.drifts[q].append(drift)
            found.slopes[q].append(change * total + weight * drift * rising)
    return found


def tracked(task: Any, cell: Numbers, centre: Sequence[fmpq]) -> tuple[list[acb], list[acb], list[bool]] | None:
    """The poles at the centre, and balls that hold those of every plant of the cell (interval Newton); None if the cell is too large."""
    box, count = task.box, rigid(task)
    exact = fmpq_poly(member(box, centre, "denominator"))
    roots = [root for root in isolated(exact) if not root.value.is_zero()]
    if any(root.multiplicity > 1 for root in roots):
        raise Undecided("a plant of the box has a repeated pole beside the origin")
    whole = [arb(c) for c in member(box, cell, "denominator")]
    if not whole or whole[-1].contains(0) or whole[count].contains(0) or not all(c.is_zero() for c in whole[:count]):
        return None  # somewhere in the cell a plant has other poles, in number or at the origin
    D, even = acb_poly(whole[count:]), all(c.is_zero() for c in whole[count + 1 :: 2])
    found = []
    for root in roots:
        if even:  # in w = p²: real and negative for an undamped plant, and its poles stay on the axis
            w = enclosed(acb_poly(list(D)[::2]), acb((root.value * root.value).real))
            if w is None or not (w.real < 0 or w.real > 0):
                return None
            found.append(acb(0, (-w.real).sqrt()) if w.real < 0 else acb((w.real).sqrt() if root.value.real > 0 else -(w.real).sqrt()))
        else:
            ball = enclosed(D, root.value)
            if ball is None or (root.flexible and not ball.imag > 0):
                return None
            found.append(ball)
    if not all(ball.overlaps(root.value) for ball, root in zip(found, roots, strict=True)) or any(
        one.overlaps(other) for one, other in combinations(found, 2)
    ):
        return None  # a ball that holds another pole than its own would leave its own out
    return [root.value for root in roots], found, [root.flexible for root in roots]


def enclosed(polynomial: acb_poly, start: acb) -> acb | None:
    """A ball around `start` that holds exactly one root of every polynomial in the ball of coefficients, by interval Newton."""
    slope, centre = polynomial.derivative(), start.mid()
    spread = (abs(polynomial(centre) / slope(centre)) * 2 + abs(centre) * arb(2) ** (-flint.ctx.prec // 2)).upper()
    for _ in range(4):
        real = start.imag.is_zero()
        wide = acb(centre.real + arb(0, spread), arb(0) if real else centre.imag + arb(0, spread))
        try:
            following = centre - polynomial(centre) / slope(wide)
        except ZeroDivisionError:
            return None
        if real:
            following = acb(following.real)
        if wide.real.contains_interior(following.real) and (real or wide.imag.contains_interior(following.imag)):
            return following
        spread *= 4
    return None


def prove(system: System, command: Numbers, n: int) -> None:
    """Prove that the residual stays within the tolerance in the whole box; raises `Undecided`."""
    task, box = system.task, system.task.box
    allowed = arb(box.tolerance * abs(task.displacement))
    instants, levels = [*command[1 : n + 1], command[0]], [fmpq(0), *command[n + 1 : 2 * n + 1], system.rest]
    jumps = [(arb(command[0] - at), arb(after - before)) for at, (before, after) in zip(instants, pairwise(levels), strict=True)]
    lands(task)
    waiting = [tuple((x, x) for x in plant.place) for plant in box.plants] or [tuple((p.low, p.high) for p in box.parameters)]
    while waiting:
        sides = waiting.pop()
        spend(200)
        centre = [(low + high) / 2 for low, high in sides]
        cell = [arb(low).union(arb(high)) if low < high else low for low, high in sides]
        radii = [arb((high - low) / 2) for low, high in sides]
        if not (within(task, jumps, cell, centre, radii, allowed) and settled(task, sides)):
            waiting += halved(task, sides, "the residual is not told from the tolerance somewhere in the box")


def within(task: Any, jumps: Sequence[tuple[arb, arb]], cell: Numbers, centre: Sequence[fmpq], radii: Sequence[arb], allowed: arb) -> bool:
    """Whether |r(τ)| ≤ allowed for all τ ≥ 0 in a cell: by the moduli of its motions, or in the course of time."""
    poles = tracked(task, cell, centre)
    if poles is None:
        return False
    points, balls, flexible = poles
    if any(ball.real > 0 for ball in balls):
        raise Undecided("a plant of the box is unstable")
    try:
        middle, whole = motion(task, jumps, centre, points, flexible), motion(task, jumps, cell, balls, flexible)
    except ZeroDivisionError:
        return False
    squares = []
    for j, size in enumerate(middle.sizes):
        change = sum(
            (abs(2 * (whole.sizes[j].conjugate() * slopes[j]).real) * r for slopes, r in zip(whole.slopes, radii, strict=True)), arb(0)
        )
        squares.append(size.real * size.real + size.imag * size.imag + change)
    if len(middle.sizes) == 1 and flexible[0] and middle.poles[0].real.is_zero() and abs(middle.sizes[0]) > allowed:
        raise Refuted(f"the residual exceeds the tolerance at {', '.join(f'{float(arb(x).mid()):.6g}' for x in centre)}")
    if sum((arb(square.upper()).sqrt() for square in squares), arb(0)) <= allowed:
        return True  # of stable plants, which these are if they are `settled`
    if not all(ball.real <= 0 for ball in balls):
        return False
    return in_time(middle, whole, flexible, radii, allowed)


def settled(task: Any, sides: Sequence[tuple[fmpq, fmpq]]) -> bool:
    """Whether no plant of a cell is unstable. Where that is not seen at once, a parameter that damps all poles in question, in all the
    cell, is set to where it damps least: there they may lie on the imaginary axis exactly."""
    centre, cell = [(low + high) / 2 for low, high in sides], [arb(low).union(arb(high)) if low < high else low for low, high in sides]
    poles = tracked(task, cell, centre)
    if poles is None:
        return False
    doubtful = [ball for ball in poles[1] if not ball.real <= 0]
    if not doubtful:
        return True
    slope = acb_poly(member(task.box, cell, "denominator")).derivative()
    for q, (low, high) in enumerate(sides):
        change = acb_poly(member(task.box, cell, "denominator", q))
        try:
            drifts = [(-change(ball) / slope(ball)).real for ball in doubtful]
        except ZeroDivisionError:
            return False
        for end, damps in ((low, all(drift <= 0 for drift in drifts)), (high, all(drift >= 0 for drift in drifts))):
            if low < high and damps:
                return settled(task, [(end, end) if i == q else side for i, side in enumerate(sides)])
    return False


def in_time(middle: Motion, whole: Motion, flexible: Sequence[bool], radii: Sequence[arb], allowed: arb) -> bool:
    """Whether |r(τ)| ≤ allowed: at the centre by Taylor's formula, elsewhere by r's derivatives over the cell, far away by its envelope."""
    roots = tuple(Root(p if pair else acb(p.real), 1) for p, pair in zip(middle.poles, flexible, strict=True))
    wave = Wave.of(roots, [part for z, pair in zip(middle.sizes, flexible, strict=True) for part in (z.real, z.imag)[: 1 + pair]])
    far = max((1 / abs(p)).upper() for p in whole.poles)
    while not sum((abs(z) * (p.real * far).exp() for z, p in zip(whole.sizes, whole.poles, strict=True)), arb(0)) <= allowed:
        far *= 2
        if far > 1e6 * abs(1 / middle.poles[0]):
            return False
    waiting = [(arb(0), far)]
    for _ in range(400):
        if not waiting:
            return True
        a, b = waiting.pop()
        *_, values = wave.over(a, b)
        span = a.union(b)
        decays = [(p * span).exp() for p in whole.poles]
        spread = arb(0)
        for drifts, slopes, r in zip(whole.drifts, whole.slopes, radii, strict=True):
            moved = sum(
                ((dz + z * dp * span) * decay for dz, z, dp, decay in zip(slopes, whole.sizes, drifts, decays, strict=True)), acb(0)
            )
            spread += abs(moved.real) * r
        if abs(values) + spread <= allowed:
            continue
        c = ((a + b) / 2).mid()
        if not a < c < b:
            return False
        waiting += [(a, c), (c, b)]
    return False
