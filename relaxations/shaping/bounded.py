"""Shapers with negative impulses: the shortest sequence whose partial sums stay within two bounds, with a proof that none is shorter.

The shaped unit step is the partial sums. It is a command from rest to rest of the plant `∏ ω²/(s² + 2ζωs + ω²)` within these bounds as
actuator limits, so nothing new is needed: `relaxations.proofs.minimum_time` finds and proves the shortest one, for any modes at once and
with any number of derivatives. Bounds 0 and 1 give the unity-magnitude shapers 1, -1, 1 …. One mode that all but decays meanwhile has a
form of its own (relaxations.shaping.decayed).
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from relaxations.bounds import Bound
from relaxations.commands import Command
from relaxations.errors import ShaperError, SolverError
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import Exact, exact
from relaxations.proofs import minimum_time
from relaxations.shaping.at_once import decaying, dips_at_once
from relaxations.shaping.commanded import plant_of, shaper_of
from relaxations.shaping.decayed import DECAYED, decayed, least_up_to_one
from relaxations.shaping.fewest import fewest
from relaxations.shaping.modes import Mode
from relaxations.shaping.sampled import require_fine
from relaxations.shaping.sampled_sums import amplitudes_within, on_samples
from relaxations.shaping.shapers import Shaper
from relaxations.shaping.switched import MOST, PROGRAMMED, switched
from relaxations.shaping.vanishing import VANISHED, left, possible, require_told

MOST_EQUATIONS = 24  # real ones: with more programs take minutes
MOST_DAMPED = 0.9  # beyond it they do not tell the equations apart
LEAST_DECAY = 1e-32  # of a mode while the impulses last: with less the digits of certificates do not tell them apart
WELL_TOLD = 4.0  # of folds of decay: up to so many programs come first
NEAR = 1e-6  # relative: so near its lower bound a sequence is the shortest
MOST_SAMPLES = 1000
MOST_FOLDS = 20.0  # of decay while the impulses last: programs in doubles tell that much
LONGER = 1.25  # times as many samples are tried next


@dataclass(frozen=True, slots=True)
class BoundedShaper:
    """A shaper, the bracket of its duration where it is sought, and what is known in closed form of the least one [s]."""

    shaper: Shaper
    bound: Bound | None
    closed: float = 0.0

    @property
    def lower(self) -> float | None:
        """The least duration [s] of any such sequence, *proven*; None if nothing was."""
        certified = None if self.bound is None or self.bound.certificate is None else json.loads(self.bound.certificate)["lower"]
        proven = self.bound.lower if self.bound is not None and certified is not None else 0.0
        return max(proven, self.closed) or None


def bounded(modes: Sequence[Mode], lower: Exact, upper: Exact, derivatives: int = 0) -> BoundedShaper:
    """The shortest shaper with partial sums in [lower, upper], with residual vibration and `derivatives` of it zero at every mode.

    Raises `ShaperError` unless lower ≤ 0 and upper ≥ 1 and for more than is searched, `SolverError` if no such shaper was found.
    """
    _require(modes, lower, upper)
    if len(modes) == 1:
        (mode,) = modes
        one = exact(upper) == 1 and derivatives <= MOST
        closed = least_up_to_one(mode, derivatives) if one else 0.0
        if one and mode.decay ** (derivatives + 1) < LEAST_DECAY:
            return BoundedShaper(decayed(mode, derivatives), None, closed)
        try:
            return BoundedShaper(*switched(mode, exact(lower), exact(upper), derivatives), closed)
        except SolverError:
            if one and mode.decay < DECAYED:
                return BoundedShaper(decayed(mode, derivatives), None, closed)
            if derivatives > PROGRAMMED or mode.damping > MOST_DAMPED:
                raise
    # Dips from 1 down are followed to any damping, without a grid: of more than one mode they come first where programs tell little.
    found, trouble, zeros = None, None, [(mode, derivatives) for mode in modes]
    if len(modes) > 1 and exact(upper) == 1 and decaying(zeros) > WELL_TOLD:
        try:
            shaper, least = dips_at_once(modes, exact(lower), derivatives)
            found = BoundedShaper(shaper, None, least or 0.0)
        except SolverError as problem:
            trouble = problem
        if found is not None and found.closed >= (1.0 - NEAR) * found.shaper.duration:
            return found
    try:
        command, bound = _fastest(modes, lower, upper, derivatives, None)
    except SolverError:
        if trouble is not None:
            raise trouble from None
        if found is None:
            raise
        return found
    other = BoundedShaper(shaper_of(command), bound)
    vanishes = all(left(other.shaper, mode, derivatives) <= VANISHED for mode in modes)
    return other if found is None or vanishes else found


def bounded_on_samples(modes: Sequence[Mode], lower: Exact, upper: Exact, derivatives: int, sample_time: float) -> tuple[Shaper, int]:
    """The same with impulses at multiples of `sample_time` [s]: on as few samples as do, and how many are proven to be needed (or 0).

    Of these the sequence of the least `Σ |A|`: a vertex, whose partial sums are within the bounds on few samples only. Raises as `bounded`,
    and `ShaperError` for a sample time that is none or puts too many samples into half a period.
    """
    _require(modes, lower, upper)
    require_fine(modes, sample_time)
    longest = max(mode.half_period for mode in modes) * (derivatives + 1)
    if longest > MOST_SAMPLES * sample_time:
        raise ShaperError(
            f"a sample time of {sample_time!r} s puts some {longest / sample_time:.4g} samples into the shaper; up to {MOST_SAMPLES} are "
            f"searched, so from {longest / MOST_SAMPLES:.4g} s on; without a sample time the instants are free"
        )
    sums = float(lower), float(upper)
    try:
        command, bound = _fastest(modes, lower, upper, derivatives, sample_time)
    except SolverError:
        # With more damping it is looked for on one number of samples after the other; what is proven is the bound of free instants.
        proven = bounded(modes, lower, upper, derivatives).lower or 0.0
        needed = max(math.ceil(Fraction(proven) / exact(repr(sample_time))), 1)
        found = fewest(lambda k: amplitudes_within(modes, sums, derivatives, sample_time, k), needed, MOST_SAMPLES, LONGER, needed - 1)
        if found is None:
            raise
        return on_samples(found[1], sample_time), needed if proven else 0
    shaper, samples = shaper_of(command), round(command.maneuver_time / sample_time)
    least = BoundedShaper(shaper, bound).lower
    few = amplitudes_within(modes, sums, derivatives, sample_time, samples)
    return shaper if few is None else on_samples(few, sample_time), 0 if least is None else round(least / sample_time)


def _require(modes: Sequence[Mode], lower: Exact, upper: Exact) -> None:
    if not modes:
        raise ShaperError("a shaper needs at least one mode")
    if not (exact(lower) <= 0 and exact(upper) >= 1):
        raise ShaperError(f"partial sums go from 0 to 1, so their bounds are at most 0 and at least 1, not {lower} and {upper}")


def _fastest(modes: Sequence[Mode], lower: Exact, upper: Exact, derivatives: int, sample_time: float | None) -> tuple[Command, Bound]:
    if (equations := 2 * len(modes) * (derivatives + 1)) > MOST_EQUATIONS:
        raise ShaperError(
            f"{derivatives} derivatives of {len(modes)} mode(s) are {equations} equations at once; up to {MOST_EQUATIONS} are possible, "
            f"and of one mode {MOST} derivatives with free instants; zv-d:N takes any number"
        )
    # With an upper bound beyond 1 a sequence ends before the modes decay.
    if (len(modes) > 1 or sample_time is not None) and exact(upper) == 1:
        require_told(modes, derivatives, MOST_FOLDS)
    grid = None if sample_time is None else exact(repr(sample_time))
    found = minimum_time(problem([plant_of(modes)], Maneuver(exact(1), Limits.of(lower, upper), robustness=derivatives, sample_time=grid)))
    if found.command is None:
        raise SolverError(f"no sequence with partial sums in [{lower}, {upper}] was found: {possible(modes)}")
    return found.command, found
