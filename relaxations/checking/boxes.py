"""The robust task: one command for every plant in a box of parameters, a residual within a tolerance instead of rest.

The plants are given by parameters in one way or the other (`families`). Beside the poles at the origin, where all of them must be at
rest together, the output of one of them moves after the command as `r(τ) = Re Σ Z_j e^{p_j τ}`,

    Z_j = (1 or 2) N(p_j) / D'(p_j) · (1/p_j) Σ jumps e^{p_j s}     s: time to go of each jump of the input, the last one to u_ss at s = 0

(of an input that is continuous the jumps are those of its slope, and 1/p_j² takes the place of 1/p_j),
and |r(τ)| ≤ tolerance · |Δ| is asked for all τ ≥ 0. The lower side samples that, which only drops conditions; the upper side encloses Z_j
and p_j over cells of the box.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from flint import acb, acb_series, arb, fmpq

from relaxations.checking import excursions
from relaxations.checking.balls import Root, System, spend
from relaxations.checking.courses import Chains, Kick, pressed
from relaxations.checking.families import Moved, Written, family
from relaxations.checking.members import Numbers, halved, laid, lands, rigid
from relaxations.checking.motions import Around, Kicks, in_time
from relaxations.checking.reading import Refuted, Undecided, require


@dataclass(frozen=True, slots=True)
class Sample:
    """One plant of the box in balls: its poles beside the origin, and the weights (1 or 2) N(p)/D'(p) of their motions in an output."""

    plants: Written | Moved
    place: Sequence[fmpq]
    roots: tuple[Root, ...]

    def weights(self, output: str | None) -> list[acb]:
        """Of a named output, or of the controlled one."""
        found = self.plants.weights(self.place, [acb_series([root.value]) for root in self.roots], output)
        return [(1 + root.flexible) * weight[0] for root, weight in zip(self.roots, found, strict=True)]

    def answer(self, roots: Sequence[Root], output: str, integrals: int) -> Chains:
        """The response of a named output to an impulse, or its integrals, as chains over `roots`, this plant's and one at the origin."""
        own = {id(root): weight / root.value**integrals for root, weight in zip(self.roots, self.weights(output), strict=True)}
        count = rigid(self.plants.task) + integrals
        series = [c[0] for c in self.plants.at_origin(self.place, output, count)][::-1]
        return [
            [*series, *[acb(0)] * (root.multiplicity - count)] if root.value.is_zero() else [own.get(id(root), acb(0))] for root in roots
        ]


def sample(plants: Written | Moved, place: Sequence[fmpq]) -> Sample:
    """The plant at an exact place; raises `Malformed` outside the box, `Undecided` at repeated poles."""
    box = plants.task.box
    inside = len(place) == len(box.parameters) and all(p.low <= x <= p.high for p, x in zip(box.parameters, place, strict=True))
    require(inside, "a sample lies in the box")
    return Sample(plants, place, plants.roots(place))


@dataclass(frozen=True, slots=True)
class Relaxed:
    """What the samples' multipliers add to the costate (roots and flat coefficients), and to the left side of (2); those of outputs in the
    course of the move come with their plants."""

    roots: tuple[Root, ...]
    numbers: list[arb]
    gain: arb
    pressed: tuple[tuple[Sample, Sequence[Any]], ...]

    def kicks(self, system: System, roots: tuple[Root, ...], horizon: Any) -> list[Kick]:
        """What multipliers of outputs take off the costate's function up to the horizon."""
        found: list[Kick] = []
        for plant, presses in self.pressed:
            found += pressed(system, roots, presses, horizon, lambda name, integrals, plant=plant: plant.answer(roots, name, integrals))
        return found


def relaxed(system: System, samples: Any) -> Relaxed:
    """With ν = μ⁻ - μ⁺ the costate gains `Re Σ ν w e^{pτ} e^{ps}`, and the left side `ν Re Σ w e^{pτ} u_ss/(-p) - μ⁺ above - μ⁻ below`.

    Both rooms are V |Δ| of the residual, d ∓ y_r(∞) of an output; for one in the course of the move the left side loses d |ν|.
    """
    if not samples:
        return Relaxed((), [], arb(0), ())
    roots: list[Root] = []
    numbers: list[arb] = []
    followed: list[tuple[Sample, Sequence[Any]]] = []
    plants, gain, limits = family(system.task), arb(0), system.task.limits.deflection
    allowed = arb(system.task.box.tolerance * abs(system.task.displacement))
    for written in samples:
        plant = sample(plants, written.place)
        totals = [acb(0)] * len(plant.roots)
        for output in (None, *limits):
            contacts = written.residual if output is None else [contact for contact in written.after if contact.output == output]
            if not contacts:
                continue
            final = arb(0) if output is None else excursions.final(system, plants, plant.place, output)[0].real
            size, weights = allowed if output is None else arb(limits[output]), plant.weights(output)
            for contact in contacts:
                force = arb(contact.lower - contact.upper)
                gain -= arb(contact.upper) * (size - final) + arb(contact.lower) * (size + final)
                for j, (root, weight) in enumerate(zip(plant.roots, weights, strict=True)):
                    spend(5)
                    totals[j] += weight * (root.value * arb(contact.time)).exp() * force
        for root, total in zip(plant.roots, totals, strict=True):
            roots.append(root)
            numbers += [total.real, total.imag][: 1 + root.flexible]
            gain += (total * arb(system.rest) / -root.value).real
        gain -= sum((arb(abs(press.weight) * limits[press.output]) for press in written.deflection), arb(0))
        if written.deflection:
            followed.append((plant, written.deflection))
    return Relaxed(tuple(roots), numbers, gain, tuple(followed))


def prove(system: System, command: Numbers, n: int) -> None:
    """Prove that the residual stays within the tolerance in the whole box; raises `Undecided`."""
    task, box = system.task, system.task.box
    allowed = arb(box.tolerance * abs(task.displacement))
    kicks = Kicks.of(system, command, n)
    lands(task)
    plants = family(task)
    if isinstance(plants, Moved) and not within(plants, kicks, plants.nominal, plants.nominal, [arb(0)] * len(plants.nominal), allowed)[0]:
        raise Undecided("the residual of the nominal plant is not told from the tolerance")
    waiting = [tuple((x, x) for x in plant.place) for plant in box.plants] or [tuple((p.low, p.high) for p in box.parameters)]
    while waiting:
        sides = waiting.pop()
        spend(200)
        cell, centre, radii = laid(sides)
        fine, bends = within(plants, kicks, cell, centre, radii, allowed)
        if not (fine and plants.settled(sides)):
            waiting += halved(task, sides, "the residual is not told from the tolerance somewhere in the box", bends)
    excursions.prove(system, plants, kicks)


def within(
    plants: Written | Moved, kicks: Kicks, cell: Numbers, centre: Any, radii: Sequence[arb], allowed: arb
) -> tuple[bool, Sequence[float]]:
    """Whether |r(τ)| ≤ allowed for all τ ≥ 0 in a cell: by the moduli of its motions, or in the course of time; and how much each parameter
    bends them, if that is known."""
    poles = plants.tracked(cell, centre)
    if poles is None:
        return False, ()
    points, balls, flexible = poles
    if not points:
        return True, ()  # bodies alone, which are at rest
    if any(ball.real > 0 for ball in balls):
        raise Undecided("a plant of the box is unstable")
    try:
        around = Around.of(plants, kicks, cell, centre, radii, poles)
        total, sizes = around.moduli()
        if total <= allowed:
            return True, ()  # of stable plants, which these are if they are `settled`
    except ZeroDivisionError:
        return False, ()
    alone = len(points) == 1 and flexible[0] and points[0].real.is_zero() and abs(around.middle.sizes[0][0]) > allowed
    if alone or (inside := all(ball.real <= 0 for ball in balls) and in_time(around, sizes, flexible, allowed, allowed)) is None:
        raise Refuted(f"the residual exceeds the tolerance at {', '.join(f'{float(arb(x).mid()):.6g}' for x in centre)}")
    return inside, () if inside else around.bends()
