"""Whether nothing is left where nothing is promised: zeros of a shaper that is made, held against the size of their own terms.

With much damping the mode decays while the shaper lasts, and what is small as a residual may be large beside what every impulse has left of
itself by then. So a zero is told by

    |Σ A_i (t_i/T)^j e^{κω t_i}| ≤ δ max |A_i e^{κω t_i}|,   j = 0 … n

which does not depend on when one looks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from relaxations.errors import SolverError
from relaxations.shaping.amplitudes import decay_per_radian
from relaxations.shaping.modes import Mode
from relaxations.shaping.shapers import Shaper

Reals = NDArray[np.float64]

VANISHED = 1e-8  # of the largest term: instants and amplitudes in doubles leave 1e-15 and some of it, what was not solved all of it
ROUNDED = 1e-15  # of a radian, times all that the mode turns: what instants in doubles can tell


def fastest_decay(modes: Sequence[Mode]) -> float:
    """max ζω [1/s]: in units of amplitude e^{-max ζω t} no impulse of a zero outgrows the others by its mode's decay."""
    return max(mode.damping * mode.frequency for mode in modes)


def left(shaper: Shaper, mode: Mode, derivatives: int = 0) -> float:
    """The largest of the sums above as a fraction of the largest term, from 0 on; 1 where nothing cancels."""
    instants, sizes, _ = shaper.excitation
    times, amplitudes = np.array(instants), np.array(sizes)
    kept = amplitudes != 0.0
    times, amplitudes = times[kept] - times[0], amplitudes[kept]
    if len(times) < 2:
        return 1.0
    logs = np.log(np.abs(amplitudes)) + mode.damping * mode.frequency * times
    turns = np.sign(amplitudes) * np.exp(logs - logs.max() + 1j * mode.frequency * mode.direction.imag * times)
    return max(float(abs(((times / times[-1]) ** power * turns).sum())) for power in range(derivatives + 1))


def require(name: str, shaper: Shaper, zeros: Sequence[Mode], derivatives: int = 0) -> None:
    """Raises `SolverError`, saying what would be possible, unless all of it vanishes at every one of `zeros`."""
    for mode in zeros:
        found = left(shaper, mode, derivatives)
        most = max(VANISHED, ROUNDED * mode.frequency * shaper.duration)
        if not found <= most:
            order = f" and {derivatives} derivative(s) of it" if derivatives else ""
            raise SolverError(
                f"{name} promises zero vibration{order} at {mode.frequency:.6g} rad/s, damping {mode.damping!r}, but what was solved "
                f"leaves {min(found, 1.0):.3g} of its largest term instead of at most {most:g}: {possible(zeros)}"
            )


def require_told(modes: Sequence[Mode], derivatives: int, most: float) -> None:
    """Raises `SolverError` at once where programs in doubles would not tell the equations apart: (n + 1)πζ/√(1 - ζ²) above `most`.

    By as many e-folds a mode decays in the n + 1 half periods that a positive shaper takes.
    """
    folds, fastest = max((((derivatives + 1) * math.pi * decay_per_radian(mode.damping), mode) for mode in modes), key=lambda pair: pair[0])
    if folds > most:
        limit = most / ((derivatives + 1) * math.pi)
        raise SolverError(
            f"in the {derivatives + 1} half period(s) that {derivatives} derivative(s) take {_told(fastest)} decays to "
            f"{math.exp(-folds):.3g} of itself, which programs in doubles do not tell from nothing: they are tried up to a damping of "
            f"{math.floor(1e4 * limit / math.hypot(1.0, limit)) / 1e4:g}; {possible(modes)}"
        )


def possible(modes: Sequence[Mode]) -> str:
    """What there is instead."""
    decay, fastest = min(((mode.decay, mode) for mode in modes), key=lambda pair: pair[0])
    if decay >= 0.1:
        return (
            "fewer derivatives, fewer modes at once (without --simultaneous, where that is given) or si, which keeps a tolerance, "
            "are possible"
        )
    if len(set(modes)) > 1:
        return (
            f"of {len(set(modes))} modes at once {_told(fastest)} keeps but {decay:.3g} of itself in half a period, and they take "
            "amplitudes that differ by more than was solved; possible are one mode after the other (without --simultaneous), fewer modes "
            "at once, si, which keeps a tolerance, and to leave out a mode that hardly vibrates"
        )
    return (
        f"a mode that keeps but {decay:.3g} of itself in half a period takes amplitudes that differ by more than was "
        "solved; possible are zv and zvd without further options, which have a closed form, um-zv and um-zvd alike, and si, which keeps a "
        "tolerance at any damping; a mode like this hardly vibrates: it may be left out"
    )


def _told(mode: Mode) -> str:
    return f"the mode of {mode.frequency:.6g} rad/s, damping {mode.damping:g},"
