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
from relaxations.checking.reading import Refuted, Undecided, require

Numbers = Sequence[arb | fmpq]
LONGEST_POWER = 20_000  # bits of a power of an exact parameter


def member(box: Any, place: Numbers, which: str, derivative: int | None = None) -> list[Any]:
    """The coefficients, lowest power of s first, of numerator or denominator at a place in the box, or their derivative by a parameter."""
    if box.plants:
        spend(len(box.plants) / 2)
        found = next((getattr(plant, which) for plant in box.plants if list(plant.place) == list(place)), ())
        require(bool(found), "a place at which no plant of the box is listed")
        return [fmpq(0) if derivative is not None else c for c in reversed(found)]
    return [valued(terms, place, derivative) for terms in reversed(getattr(box, which))]


def valued(terms: Any, place: Numbers, derivative: int | None = None) -> arb | fmpq:
    """A polynomial in the parameters, or its derivative by one of them."""
    total: arb | fmpq = fmpq(0)
    for coefficient, powers in terms:
        factor: arb | fmpq = coefficient
        for i, (value, power) in enumerate(zip(place, powers, strict=True)):
            if i == derivative:
                factor, power = factor * power, max(power - 1, 0)
            if isinstance(value, fmpq) and value.height_bits() * power > LONGEST_POWER:
                raise Undecided("powers of a parameter are too long")
            factor = factor * value**power if power else factor
        spend(1 + len(powers) + (factor.height_bits() / 50 if isinstance(factor, fmpq) else 0))
        total = total + factor
    return total


def plants(task: dict[str, Any]) -> list[str]:
    """In words, from the numbers as they are written: which plants the claim is about."""
    if not (box := task["box"]):
        return []
    ranges = ", ".join(f"{p['name']!r} in [{p['low']}, {p['high']}] (nominal {p['nominal']})" for p in box["parameters"])
    if box["plants"]:
        heading = f"  and these {len(box['plants'])} plants of {ranges}; nothing is said of any other plant of these ranges:"
        return [
            heading,
            *(f"  at {', '.join(p['place'])}: [{', '.join(p['numerator'])}] / [{', '.join(p['denominator'])}]" for p in box["plants"]),
        ]
    heading = f"  and every plant of the box {ranges}; coefficients in terms of these, (factor, powers):"
    return [heading, *(f"  {which:<12} {box[which]}" for which in ("numerator", "denominator"))]


def promises(task: dict[str, Any]) -> list[str]:
    """In words: what they do after the command."""
    if not (box := task["box"]):
        return []
    allowed = f"at most {box['tolerance']} of the displacement instead of 0"
    residual = f"  In every one of these plants the residual |y(t) - y(∞)| for t ≥ T is {allowed};"
    share = box["final_tolerance"]
    where = "" if share is None else f", within {share} of the displacement of it in the others"
    return [residual, f"  y(∞) is the target in the nominal plant{where}, and no plant keeps drifting."]


def sensible(task: Any) -> None:
    """Raise `Malformed` unless the box, if there is one, is one, and the plant written is its nominal one."""
    if task.box is None:
        return
    box, (plant,), count = task.box, task.plants, len(task.box.parameters)
    require(
        task.rest == "state" and not plant.zeros and task.limits.tail_length is None, "a box belongs to a state rest without further zeros"
    )
    require(box.tolerance > 0, "a tolerance is more than 0")
    require(box.final_tolerance is None or box.final_tolerance >= 0, "a final tolerance is 0 or more")
    require(all(p.low <= p.nominal <= p.high for p in box.parameters), "a parameter's nominal value lies in its range")
    require(bool(box.plants) != bool(box.denominator) == bool(box.numerator), "a box has coefficients in terms of parameters, or plants")
    places = [listed.place for listed in box.plants]
    inside = [len(place) == count and all(p.low <= x <= p.high for p, x in zip(box.parameters, place, strict=True)) for place in places]
    require(all(inside) and len(set(places)) == len(places), "plants are listed at different places of the box")
    terms = [powers for which in (box.numerator, box.denominator) for coefficient in which for _, powers in coefficient]
    require(all(len(powers) == count and max(powers, default=0) <= 64 for powers in terms), f"a term has {count} powers of at most 64")
    nominal = [p.nominal for p in box.parameters]
    ours = [member(box, nominal, which) for which in ("numerator", "denominator")]
    require(ours[1][-1] != 0, "the nominal plant of the box has no highest power")
    same = all(
        [c / ours[1][-1] for c in reversed(mine)] == list(theirs)
        for mine, theirs in zip(ours, (plant.numerator, plant.denominator), strict=True)
    )
    require(same, "the plant is not the nominal one of the box")


def rigid(task: Any) -> int:
    """The multiplicity of the pole at the origin, that of the nominal plant: in no plant of the box it may be another."""
    (plant,) = task.plants
    return next(k for k, c in enumerate(reversed(plant.denominator)) if c != 0)


@dataclass(frozen=True, slots=True)
class Shift:
    """Where a plant comes to rest: its gain is `a/d`, the lowest coefficients of N and D (poles at the origin aside).

    The one moment at the origin that moves a body for good, or the one final input, is what brings the nominal plant to its target. So
    `y(∞)/Δ = (a/d) / (a_0/d_0)` whatever the command, and it is within the tolerance v iff `v s a_0 d ∓ (a d_0 - a_0 d) ≥ 0`, s = ±1 the
    sign of `a_0 d_0`.
    """

    task: Any
    nominal: tuple[fmpq, fmpq]

    @staticmethod
    def of(task: Any) -> Shift:
        nominal = [p.nominal for p in task.box.parameters]
        return Shift(task, (member(task.box, nominal, "numerator")[0], member(task.box, nominal, "denominator")[rigid(task)]))

    def room(self, place: Numbers, derivative: int | None = None) -> tuple[Any, Any]:
        """Both sides' left-hand side at a place, times d_0 squared's sign; or their derivative by a parameter."""
        spend(20)
        numerator, denominator = (member(self.task.box, place, which, derivative) for which in ("numerator", "denominator"))
        at, (a0, d0), share = rigid(self.task), self.nominal, self.task.box.final_tolerance
        a, d = numerator[0], denominator[at]
        if derivative is None and not (d * d0 > 0 and not any(denominator[:at])):
            raise Undecided("a plant of the box has another lowest power than the nominal one, or another sign of it")
        wide, off = (abs(a0) if d0 > 0 else -abs(a0)) * share * d, (a * d0 - a0 * d) * (1 if a0 * d0 > 0 else -1)
        return wide - off, wide + off


def too_far(task: Any, place: Sequence[fmpq]) -> None:
    """Prove that the plant at a place rests too far from the target, or raise `Undecided`."""
    box = task.box
    inside = len(place) == len(box.parameters) and all(p.low <= x <= p.high for p, x in zip(box.parameters, place, strict=True))
    require(inside and box.final_tolerance is not None, "a final tolerance, and a place of the box")
    if min(Shift.of(task).room(place)) >= 0:
        raise Undecided("the plant named rests within the final tolerance")


def lands(task: Any) -> None:
    """Prove that every plant of the box rests within the final tolerance; raises `Refuted` or `Undecided`."""
    box = task.box
    if box.final_tolerance is None:
        return
    shift = Shift.of(task)
    ends = [tuple((x, x) for x in plant.place) for plant in box.plants] or [tuple((p.low, p.high) for p in box.parameters)]
    waiting = [(sides, side) for sides in ends for side in (0, 1)]
    while waiting:
        sides, side = waiting.pop()
        cell = [low if low == high else arb(low).union(arb(high)) for low, high in sides]
        slopes = [arb(shift.room(cell, q)[side]) if low != high else arb(0) for q, (low, high) in enumerate(sides)]
        # where it rises or falls with a parameter all over the cell it is least at an end, which is exact
        sides = tuple(
            (low, low) if slope >= 0 else (high, high) if slope <= 0 else (low, high)
            for slope, (low, high) in zip(slopes, sides, strict=True)
        )
        centre = [(low + high) / 2 for low, high in sides]
        least = shift.room(centre, None)[side]
        if least < 0:
            where = ", ".join(f"{float(arb(x).mid()):.6g}" for x in centre)
            raise Refuted(f"the final error exceeds its tolerance at {where}")
        if all(low == high for low, high in sides):
            continue
        slopes = [arb(shift.room([arb(low).union(arb(high)) for low, high in sides], q)[side]) for q in range(len(sides))]
        if arb(least) - sum((abs(slope) * (high - low) / 2 for slope, (low, high) in zip(slopes, sides, strict=True)), arb(0)) >= 0:
            continue
        waiting += [(half, side) for half in halved(task, sides, "the final error is not told from its tolerance somewhere in the box")]


def halved(task: Any, sides: Sequence[tuple[fmpq, fmpq]], otherwise: str) -> list[tuple[tuple[fmpq, fmpq], ...]]:
    """A cell in two, across the parameter in which it is widest; raises `Undecided` with a sentence where it is too small for that."""
    ranges = zip(sides, task.box.parameters, strict=True)
    widths = [(high - low) / (p.high - p.low) if high > low else fmpq(0) for (low, high), p in ranges]
    widest = max(range(len(sides)), key=lambda i: widths[i])
    if widths[widest] < fmpq(1, 2**40):
        raise Undecided(otherwise)
    low, high = sides[widest]
    return [
        tuple(half if i == widest else side for i, side in enumerate(sides)) for half in ((low, (low + high) / 2), ((low + high) / 2, high))
    ]


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
