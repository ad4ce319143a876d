"""The equations of shapers with humps, with their Jacobian, in as many digits as are set (relaxations.shaping.humps says what they are).

`F(ν) = Σ A_i e^{-κνψ_i}`, κ = ζ + j√(1 - ζ²), of impulses at the phases ψ_i before the last one. `places` are zeros and humps in ascending
order of ν, alternating, from a zero on; the middle one is 1. Unknown are ψ without the last, 0, A if they are not given, the places but for
the middle one, and w = log V:

    Σ A = 1,   F = 0 at a zero,   |F|²/V² = 1 and Re(F* F')/V² = 0 at a hump

With damping the last zero moves away, in the end beyond all frequencies, while the last two impulses merge; its turn τ = νψ_{n-1} stays
finite and is the unknown in its place (`merging`). Where they are one, the places end with a hump.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from flint import acb, arb, fmpq

from relaxations.shaping.paths import Vector


@dataclass(frozen=True, slots=True)
class Ripples:
    """`impulses` of amplitudes that are unknown, or `given`, at damping ζ, and how many `places`, of which number `middle` is 1."""

    damping: arb
    impulses: int
    places: int
    middle: int
    given: tuple[int, ...] = ()
    merging: bool = False

    @property
    def direction(self) -> acb:
        """κ."""
        return acb(self.damping, (1 - self.damping * self.damping).sqrt())

    @property
    def _first_place(self) -> int:
        return self.impulses - 1 if self.given else 2 * self.impulses - 1

    def parts(self, x: Vector) -> tuple[Vector, Vector, Vector]:
        """Phases ψ (n,), amplitudes (n,), places."""
        n = self.impulses
        phases, places = [*x[: n - 1], arb(0)], x[self._first_place :]
        amplitudes = [arb(a) for a in self.given] if self.given else x[n - 1 : 2 * n - 1]
        if self.merging:
            places = [*places[:-1], places[-1] / phases[n - 2]]
        return phases, amplitudes, [*places[: self.middle], arb(1), *places[self.middle :]]

    def unknowns(self, phases: Vector, amplitudes: Vector, places: Vector) -> Vector:
        """The inverse of `parts`."""
        last = [places[-1] * phases[-2]] if self.merging else [places[-1]]
        rest = [*places[:-1], *last]
        del rest[self.middle]
        return [*phases[:-1], *([] if self.given else amplitudes), *rest]

    def __call__(self, x: Vector, w: arb) -> tuple[Vector, list[Vector]]:
        """Values and Jacobian (relaxations.shaping.paths), the last column by w."""
        phases, amplitudes, places = self.parts(x)
        values, rows = self._sum(amplitudes, len(x))
        square, n = (2 * w).exp(), self.impulses
        for number, place in enumerate(places):
            own = None if number == self.middle else self._first_place + number - (number > self.middle)
            course = _Course(self.direction, phases, amplitudes, place)
            by_x = self._padded(course.by_phases, course.by_amplitudes, len(x))
            slope = course.slope
            if own is not None:
                by_x[own] = slope
                if self.merging and number == len(places) - 1:  # ν = τ/ψ_{n-1}
                    by_x[own] = slope / phases[n - 2]
                    by_x[n - 2] -= slope * place / phases[n - 2]
            if number % 2 == 0:
                values += [course.value.real, course.value.imag]
                rows += [[*(d.real for d in by_x), arb(0)], [*(d.imag for d in by_x), arb(0)]]
                continue
            mirrored = course.value.conjugate()
            rise_by_x = self._padded(course.slope_by_phases, course.slope_by_amplitudes, len(x))
            if own is not None:
                rise_by_x[own] = course.bend
            values += [(mirrored * course.value).real / square - 1, (mirrored * slope).real / square]
            rows += [
                [*(2 * (mirrored * d).real / square for d in by_x), arb(-2)],
                [*((d.conjugate() * slope + mirrored * e).real / square for d, e in zip(by_x, rise_by_x, strict=True)), arb(0)],
            ]
        return values, rows

    def apart(self, x: Vector, w: arb, places: Sequence[arb]) -> tuple[Vector, list[Vector]]:
        """The zeros' equations alone, with the places given; x are phases and amplitudes, w has no part in it."""
        phases = [*x[: self.impulses - 1], arb(0)]
        amplitudes = [arb(a) for a in self.given] if self.given else x[self.impulses - 1 :]
        values, rows = self._sum(amplitudes, len(x))
        for place in places[::2]:
            course = _Course(self.direction, phases, amplitudes, place)
            by_x = self._padded(course.by_phases, course.by_amplitudes, len(x))
            values += [course.value.real, course.value.imag]
            rows += [[*(d.real for d in by_x), arb(0)], [*(d.imag for d in by_x), arb(0)]]
        return values, rows

    def _sum(self, amplitudes: Vector, size: int) -> tuple[Vector, list[Vector]]:
        if self.given:
            return [], []
        n = self.impulses
        return [sum(amplitudes, arb(0)) - 1], [[arb(0)] * (n - 1) + [arb(1)] * n + [arb(0)] * (size - 2 * n + 2)]

    def _padded(self, by_phases: list[acb], by_amplitudes: list[acb], size: int) -> list[acb]:
        by_x = [*by_phases, *([] if self.given else by_amplitudes)]
        return by_x + [acb(0)] * (size - len(by_x))


class _Course:
    """F at one ν, F' and F'', and the derivatives of F and F' by phases and amplitudes."""

    def __init__(self, direction: acb, phases: Vector, amplitudes: Vector, nu: arb) -> None:
        rate = -direction * nu
        motions = [(rate * phase).exp() for phase in phases]
        parts = [amplitude * motion for amplitude, motion in zip(amplitudes, motions, strict=True)]
        self.value = sum(parts, acb(0))
        self.slope = -direction * sum((phase * part for phase, part in zip(phases, parts, strict=True)), acb(0))
        self.bend = direction**2 * sum((phase * phase * part for phase, part in zip(phases, parts, strict=True)), acb(0))
        self.by_phases, self.by_amplitudes = [rate * part for part in parts[:-1]], motions
        self.slope_by_phases = [-direction * part * (1 + rate * phase) for phase, part in zip(phases, parts[:-1], strict=False)]
        self.slope_by_amplitudes = [-direction * phase * motion for phase, motion in zip(phases, motions, strict=True)]


@dataclass(frozen=True, slots=True)
class MultipleZero:
    """Impulses `given` at unknown phases ψ (without the last, 0) that leave nothing at ν = 1, nor any of n derivatives; w is the damping.

    `Σ A_i ψ_i^j e^{-κψ_i} = 0`, j = 0 … n, as many real equations as phases. The imaginary parts are divided by √(1 - ζ²): so they do not
    vanish towards critical damping.
    """

    given: tuple[int | fmpq, ...]

    def __call__(self, x: Vector, w: arb) -> tuple[Vector, list[Vector]]:
        """Values and Jacobian (relaxations.shaping.paths), the last column by w."""
        root = (1 - w * w).sqrt()
        direction, turned = acb(w, root), acb(1, -w / root)
        phases = [*x, arb(0)]
        motions = [a * (-direction * phase).exp() for a, phase in zip(self.given, phases, strict=True)]
        values: Vector = []
        rows: list[Vector] = []
        for power in range(len(x) // 2):
            terms = [phase**power * motion for phase, motion in zip(phases, motions, strict=True)]
            value = sum(terms, acb(0))
            by_x = [(power * phase ** (power - 1) if power else 0) * m - direction * t
                    for phase, m, t in zip(x, motions, terms, strict=False)]  # fmt: skip
            by_w = -turned * sum((phase * term for phase, term in zip(phases, terms, strict=True)), acb(0))
            values += [value.real, value.imag / root]
            rows += [[*(d.real for d in by_x), by_w.real], [*(d.imag / root for d in by_x), by_w.imag / root + value.imag * w / root**3]]
        return values, rows
