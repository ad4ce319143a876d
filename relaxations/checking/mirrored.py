"""Commands that are their own mirror image about the middle of the move, where a plant's modes do not decay: half of the equations hold by
themselves.

With s the time to go from the middle, `u(-s) = e u(s)`, e = ±1, the moments about the middle are

    Y_{0,k} = ∫ s^k/k! u ds,     Y_{iω,k} = ∫ s^k/k! (cos ωs + i sin ωs) u ds     over [-T/2, T/2]

of which every part whose factor of u is of the other parity is 0. Those after the move are `e^{pT/2} Σ_j (T/2)^{k-j}/(k-j)! Y_{p,j}`.
So a plant with r poles at the origin is at rest in its target if Y_{0,r-1} is the target's only number and all others are 0; with
`e = (-1)^{r-1}` that one is not 0 by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from flint import acb, arb, arb_mat, fmpq, fmpq_poly

from relaxations.checking.balls import Root, System, flat, on_axis
from relaxations.checking.reading import require


@dataclass(frozen=True, slots=True)
class Half:
    """The equations that are left, of a command of n segments: roots on the axis, the places of these equations in the flat order."""

    system: System
    roots: tuple[Root, ...]
    places: tuple[int, ...]
    count: int

    @staticmethod
    def of(system: System, n: int, command: Sequence[Any], free: Sequence[Any]) -> Half:
        """Raises `Malformed` where a plant decays or holds, and for a command that is not its own mirror image."""
        task, rigid = system.task, sum(root.multiplicity for root in system.roots if root.value.is_zero())
        plain = not (system.begin or system.zeros or system.sloped or task.limits.sample_time or task.box) and rigid > 0
        beside = [root for root in system.roots if not root.value.is_zero()]
        undamped = plain and on_axis(fmpq_poly(list(task.plants[0].denominator[::-1]))) == len(beside)
        require(undamped, "a mirrored command moves a plant with poles at the origin whose modes do not decay")
        parity = (-1) ** (rigid - 1)
        levels = command[n + 1 : 2 * n + 1]
        fine = all(kind == "time" or (kind == "start" and 2 * i < n) for kind, i, _ in free)
        same = all(a == parity * b for a, b in zip(levels, levels[::-1], strict=True))
        require(
            fine and same, "a mirrored command's levels are their own image, and its unknowns the duration and starts of its first half"
        )
        roots = tuple(root if root.value.is_zero() else Root(acb(0, root.value.imag), root.multiplicity) for root in system.roots)
        parities = [(-1) ** k * side for root in roots for k in range(root.multiplicity) for side in (1, -1)[: 1 + root.flexible]]
        return Half(system, roots, tuple(place for place, one in enumerate(parities) if one == parity), n)

    def whole(self, command: Sequence[Any]) -> list[Any]:
        """The command with the instants of its second half: those of the first, mirrored."""
        n, duration = self.count, command[0]
        mirrored = [duration / 2 if 2 * i == n else duration - command[1 + n - i] if 2 * i > n else command[1 + i] for i in range(n)]
        return [duration, *mirrored, *command[n + 1 :]]

    def _kicks(self, command: Sequence[Any]) -> list[tuple[Any, arb]]:
        """Every change of the level, with its time to go from the middle."""
        n, levels = self.count, [fmpq(0), *command[self.count + 1 : 2 * self.count + 1], fmpq(0)]
        instants = [*self.whole(command)[1 : n + 1], command[0]]
        return [(levels[i + 1] - levels[i], arb(command[0]) / 2 - arb(instants[i])) for i in range(n + 1)]

    def _chosen(self, column: arb_mat) -> arb_mat:
        return arb_mat(len(self.places), 1, [column[place, 0] for place in self.places])

    def residual(self, command: Sequence[Any]) -> arb_mat:
        """The moments about the middle minus where they must be."""
        total = arb_mat(self.system.target.nrows(), 1) - self.system.target
        for jump, since in self._kicks(command):
            total += flat(self.roots, Root.step, since) * arb(jump)
        return self._chosen(total)

    def derivative(self, command: Sequence[Any], place: int) -> arb_mat:
        """Of the residual by the duration (place 0) or start i in the first half (place 1 + i), whose image moves the other way."""
        total, start = arb_mat(self.system.target.nrows(), 1), place - 1
        for i, (jump, since) in enumerate(self._kicks(command)):
            half = fmpq(1 if 2 * i < self.count else -1 if 2 * i > self.count else 0, 2)
            moved = half if place == 0 else fmpq((i == self.count - start) - (i == start))
            if moved:
                total += flat(self.roots, Root.impulse, since) * arb(jump * moved)
        return self._chosen(total)
