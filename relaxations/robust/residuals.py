"""What the plants of a box may leave of the move: rows of the program that bound the output about its final value, instant by instant.

The moments at the origin are the same functions in every plant, so all of them rest together there, exactly. Beside it each plant of the
box may move (../docs/theory.md, section 3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from relaxations.errors import ManeuverError
from relaxations.moments import Basis
from relaxations.plants import LinearPlant
from relaxations.ramps import hats
from relaxations.robust.alignment import aligned, course, sharpened, tops
from relaxations.robust.boxes import Place, at

Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]

PERIODS = 8.0  # of the slowest mode: how long after the command a residual is followed
LOOKS = 12  # instants in a period of the fastest mode at first
FINE = 48  # instants in a period of the fastest mode at which its residual is followed
MISSED = 1e-7  # relative excess between two instants that calls for another one
LEAST = 1e-12  # of the room on the other side
WORST = 4  # instants of one plant that are added at a time


@dataclass(frozen=True, slots=True)
class Sample:
    """One plant of the box at `place`: poles beside the origin, the weights of their moments in the output, their moments at rest."""

    place: Place
    basis: Basis
    weights: Reals
    rest: Reals
    window: float  # how long its residual is followed [s]
    lasts: float  # no instant is later [s]: so long its modes may take to meet
    room: tuple[float, float]  # how far below and above its rest an output may be
    name: str | None = None  # of an output other than the controlled one

    @staticmethod
    def of(place: Place, plant: LinearPlant, hold: float, room: tuple[float, float], name: str | None = None) -> Sample:
        """Raises `ManeuverError` for an unstable plant (it is nowhere at rest after a command) and for repeated poles."""
        for pole in plant.poles:
            where = f"the plant {at(place)} in the box"
            if pole.value.real > 1e-12 * abs(pole.value):
                raise ManeuverError(f"{where} is unstable: pole {pole.value:.6g}")
            if not pole.is_rigid and pole.multiplicity > 1:
                raise ManeuverError(f"{where} has the repeated pole {pole.value:.6g}: beside the origin a box is about simple poles")
        rigid = plant.rigid_order
        basis = Basis(tuple(pole for pole in plant.poles if not pole.is_rigid))
        weights = Basis(tuple(plant.poles)).weights(plant.partial(name or plant.output))[rigid:]
        slowest = min((abs(pole.value) for pole in basis.poles), default=1.0)
        periods = PERIODS if basis.size > 2 or any(pole.value.real for pole in basis.poles) else 1.0  # one undamped mode repeats itself
        window = 2 * np.pi * periods / slowest
        lasts = window + np.pi * (tops(_modes(basis)) + 2) / slowest
        least = LEAST * max(room)  # where it rests on its limit nothing else would be measured
        return Sample(place, basis, weights, basis.hold(hold), window, lasts, (max(room[0], least), max(room[1], least)), name)

    @property
    def fastest(self) -> float:
        """The largest |p| [1/s], of modes if there are any: a real pole that is faster than these is gone at once."""
        swinging = [abs(pole.value) for pole in self.basis.poles if pole.is_flexible]
        return max(swinging or [abs(pole.value) for pole in self.basis.poles], default=1.0)

    def rows(self, since: Reals) -> Reals:
        """The output about its final value at `since` [s] after the command, for each unit moment about the rest: (len(since), n)."""
        return np.einsum("i,ijs->sj", self.weights, self.basis.moves(since))

    def table(self, instants: Reals, ramps: bool = False) -> Reals:
        """The moments at the end of the grid of a unit level in each cell, or of a unit value at each node but the first: (n, cells)."""
        if ramps:
            return hats(self.basis.rows, instants)
        integrated = self.basis.rows(instants[-1] - instants, 1)
        return integrated[:, :-1] - integrated[:, 1:]

    def looks(self) -> Reals:
        """Instants at which the residual is limited at first: a period of the fastest mode."""
        return np.linspace(0.0, min(2 * np.pi / self.fastest, self.window), LOOKS, endpoint=False)

    def motions(self, moments: Reals) -> Complexes:
        """`Z_j` of the residual `Re Σ Z_j e^{p_j τ}` that moments about the rest leave."""
        found, at = [], 0
        for pole in self.basis.poles:
            (w, m), pair = (numbers[at : at + 2] for numbers in (self.weights, moments)), pole.is_flexible
            found.append(complex(w[0], -w[1]) * complex(m[0], m[1]) if pair else complex(w[0] * m[0]))
            at += 1 + pair
        return np.array(found, dtype=complex)

    def peaks(self, moments: Reals, factor: float = np.inf) -> tuple[Reals, Reals]:
        """Instants of the local extremes (and the first instant) of the residual that moments about the rest leave; its size there, as a
        multiple of what is allowed on that side. Where modes that add up to more than `factor` of it may meet later on, an instant at which
        they nearly do is among them."""
        if not self.basis.size:
            return np.zeros(1), np.zeros(1)
        limit = factor * min(self.room)
        motions, poles = self.motions(moments)[None, :], np.array([[pole.value for pole in self.basis.poles]])
        step = 2 * np.pi / (FINE * max((abs(pole.value) for pole in self.basis.poles), default=1.0))
        fine = np.linspace(0.0, self.window, int(FINE * self.window * self.fastest / (2 * np.pi)) + 3)
        fine = np.union1d(np.arange(0.0, min(FINE * step, self.window), step), fine) if step < 0.9 * fine[1] else fine
        values = course(motions, poles, fine[None, :])[0]
        turns = np.flatnonzero((values[1:-1] - values[:-2]) * (values[2:] - values[1:-1]) <= 0.0) + 1
        near = fine[np.append(turns, 0)]  # it may turn before the first instant of the grid
        where, _ = sharpened(motions, poles, near[None, :], np.diff(fine).max(keepdims=True))
        late, _ = aligned(motions, poles, np.array([self.window]), limit, tops(_modes(self.basis)))
        instants = np.concatenate([[0.0], where[0], late])
        found = course(motions, poles, instants[None, :])[0]
        return instants, np.where(found > 0.0, found / self.room[1], -found / self.room[0])


def _modes(basis: Basis) -> int:
    return sum(pole.is_flexible for pole in basis.poles)


@dataclass(frozen=True, slots=True)
class Residuals:
    """What the samples of a box leave after the command: `-below ≤ r ≤ above` (output units) at instants of each. For the residual both
    sides are `allowed`, for other outputs what their limits leave of where they come to rest.

    Instants count on one axis: those of sample k from `begins[k]` on, which is after all of the sample before.
    """

    samples: tuple[Sample, ...]
    allowed: float

    @property
    def begins(self) -> Reals:
        """Where the instants of each sample begin."""
        return np.concatenate([[0.0], np.cumsum([2.0 * sample.lasts for sample in self.samples])])[:-1]

    def owner(self, looks: Reals) -> NDArray[np.intp]:
        """The sample that each instant on the one axis belongs to."""
        return np.searchsorted(self.begins, looks, side="right") - 1

    def split(self, looks: Reals) -> list[Reals]:
        """Instants [s] after the command, sample by sample, of instants on the one axis."""
        owner = self.owner(looks)
        return [looks[owner == k] - begin for k, begin in enumerate(self.begins)]

    def looks(self) -> Reals:
        """Instants at which the residuals are limited at first."""
        return np.concatenate([begin + sample.looks() for begin, sample in zip(self.begins, self.samples, strict=True)])

    def table(self, instants: Reals, ramps: bool = False) -> Reals:
        """The moments of all samples at the end of the grid, as `Sample.table` has them: (n, cells)."""
        return np.vstack([sample.table(instants, ramps) for sample in self.samples])

    def rows(self, looks: Reals) -> tuple[Reals, Reals]:
        """`R` (looks, n) and `e` (looks,): the residuals R M - α e of the moments M of all samples."""
        parts = [(sample.rows(since), sample.rest) for sample, since in zip(self.samples, self.split(looks), strict=True)]
        return np.asarray(block_diag(*(rows for rows, _ in parts))), np.concatenate([rows @ rest for rows, rest in parts])

    def exceeded(self, instants: Reals, levels: Reals, factor: float = 1.0 + MISSED, ramps: bool = False) -> Reals:
        """Instants of local extremes beyond `factor` times the tolerance, of levels that reach the target."""
        found = []
        for begin, sample in zip(self.begins, self.samples, strict=True):
            peaks, sizes = sample.peaks(sample.table(instants, ramps) @ levels - sample.rest, factor)
            over = np.flatnonzero(sizes > factor)
            found.append(begin + peaks[over[np.argsort(-sizes[over], kind="stable")[:WORST]]])
        return np.concatenate(found)

    def rooms(self, looks: Reals) -> tuple[Reals, Reals]:
        """How far below and above a residual may be at instants on the one axis."""
        both = np.array([sample.room for sample in self.samples]).reshape(-1, 2)[self.owner(looks)]
        return both[:, 0], both[:, 1]

    def costates(self, multipliers: Sequence[tuple[float, float, float]]) -> list[Reals]:
        """What multipliers (instant on the one axis, μ⁺, μ⁻) add to the costate of each sample's moments."""
        looks = np.array([look for look, _, _ in multipliers])
        forces = np.array([above - below for _, above, below in multipliers])
        owner = self.owner(looks)
        return [
            forces[owner == k] @ sample.rows(since) for k, (sample, since) in enumerate(zip(self.samples, self.split(looks), strict=True))
        ]
