"""What a move of steps leaves if its instants are not quite kept: delays of thrusters, and jitter.

Thrusters are on or off, one for each direction: every rise of the input's deviation from rest to one side opens one, every fall closes one,
and a reversal is both at once. With jumps a_i at instants t_i, a pole p and its residues r_k in the output, what the move leaves of that
mode, seen as a motion at T and going on freely from there, is

    z(t_1 … t_n) = Σ_i a_i H(T - t_i),    H' = f = Σ_k r_k s^(k-1)/(k-1)! e^{ps},    ∂z/∂t_i = -a_i f(T - t_i)

exactly, since every instant stands in one term alone. The output holds 2 Re z e^{p(t - T)} of a simple flexible mode, so 2|z| is the
amplitude at T; a real pole's z is real; of a rigid body there are its displacement from the target and its rate (and, of more integrators,
the higher derivatives). Independent normal errors of standard deviation σ leave, to first order, the root mean square
`sqrt(z² + σ² Σ |∂z/∂t_i|²)`; the worst of errors that are bounded is in `relaxations.timing_worst`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import flint
import numpy as np
from numpy.typing import NDArray

from relaxations.commands import Command
from relaxations.errors import CommandError
from relaxations.plants import ROOT_BITS, LinearPlant, precision

Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]

DERIVATIVES = ("displacement", "rate", "acceleration")
CHUNK = 1 << 20  # exponentials at a time


@dataclass(frozen=True, slots=True)
class Event:
    """A thruster opens or closes at `instant` [s], and the input jumps by `jump` (input units).

    `pulse` counts the pulses of each `thruster`; `opens` is None where one actuator jumps from level to level.
    """

    instant: float
    jump: float
    opens: bool | None = None
    thruster: int = 0
    pulse: int = 0


@dataclass(frozen=True, slots=True)
class Motion:
    """One free motion of the output after the move: H(s) = e^{ps} Σ_k c_k s^k, and from what its sum over the jumps is measured.

    `unit` is the power of a second by which the output's unit is divided, `factor` 2 for a flexible pair and 1 for real poles.
    """

    name: str
    pole: complex
    coefficients: tuple[complex, ...]
    offset: float = 0.0
    unit: int = 0
    factor: float = 1.0
    balls: tuple[flint.acb, tuple[flint.acb, ...]] = (flint.acb(0), ())

    @property
    def flexible(self) -> bool:
        """Whether it swings: z is complex, and its phase means nothing."""
        return self.factor == 2.0

    def __call__(self, to_go: Reals) -> Complexes:
        """H at times to go s [s]."""
        return _along(self.pole, np.array(self.coefficients, dtype=complex), to_go)

    def slope(self, to_go: Reals) -> Complexes:
        """f = H' at times to go s [s]."""
        coefficients = np.array(self.coefficients, dtype=complex)
        derivative = self.pole * coefficients + np.append(np.arange(1, len(coefficients)) * coefficients[1:], 0.0)
        return _along(self.pole, derivative, to_go)

    def size(self, left: Complexes) -> Reals:
        """What is said of z: the amplitude of a flexible mode, else z itself with its sign."""
        return self.factor * np.abs(left) if self.flexible else left.real


def _along(pole: complex, coefficients: Complexes, to_go: Reals) -> Complexes:
    return np.asarray(np.exp(pole * to_go) * np.polynomial.polynomial.polyval(to_go, coefficients), dtype=np.complex128)


def events(command: Command, rest: float = 0.0, *, together: bool = False) -> tuple[Event, ...]:
    """The events of a command of steps, ascending: of a thruster for each direction, or `together` of one actuator that makes every jump.

    A command of several levels is made by thrusters of different size, one on the other. Raises `CommandError` for slopes and tails.
    """
    if command.tail.terms:
        raise CommandError("the command ends in a tail: its input goes on after the move, and timing is about steps alone")
    if sloped := [segment for segment in command.segments if segment.slope]:
        raise CommandError(f"the command has a slope from {sloped[0].start:.6g} s on: timing is about steps alone")
    if not command.segments:
        raise CommandError("the command is over before it begins: it has no instants")
    starts = [*(segment.start for segment in command.segments), command.end]
    levels = [rest, *(segment.level for segment in command.segments), command.tail.steady]
    jumps = [(start, after - before) for start, before, after in zip(starts, levels[:-1], levels[1:], strict=True) if after != before]
    if together:
        return tuple(Event(start, jump) for start, jump in jumps)
    found: list[Event] = []
    thruster = 0
    for sign in (1.0, -1.0):
        heights = [max(sign * (level - rest), 0.0) for level in levels]
        floor = 0.0
        for height in sorted({height for height in heights if height > 0.0}):
            pulse = -1
            for start, before, after in zip(starts, heights[:-1], heights[1:], strict=True):
                if (before >= height) != (after >= height):
                    opens = after >= height
                    pulse += opens
                    found.append(Event(start, sign * (height - floor) * (1.0 if opens else -1.0), opens, thruster, pulse))
            floor, thruster = height, thruster + 1
    return tuple(sorted(found, key=lambda event: event.instant))


def delayed(planned: Sequence[Event], on: float, off: float) -> tuple[tuple[Event, ...], tuple[str, ...]]:
    """The events as they happen if every thruster opens `on` [s] and closes `off` [s] late, and notes; the order is kept.

    A pulse that would close before it opens does not happen: both its events fall on one instant. Pulses of one thruster that run into each
    other are one. Where one actuator jumps both delays must be equal.
    """
    late = [event.instant + (off if event.opens is False else on) for event in planned]
    if any(event.opens is None for event in planned) and on != off:
        raise CommandError(f"one actuator has one delay: {on:g} s and {off:g} s differ; two are for thrusters that open and close")
    notes = []
    for thruster in sorted({event.thruster for event in planned if event.opens is not None}):
        mine = [i for i, event in enumerate(planned) if event.thruster == thruster]
        shut: int | None = None  # when the last pulse that happens ends
        for opening, closing in zip(mine[::2], mine[1::2], strict=False):
            width = planned[closing].instant - planned[opening].instant
            if late[closing] <= late[opening]:
                late[closing] = late[opening]
                notes.append(
                    f"the pulse of {width:.6g} s at {planned[opening].instant:.6g} s is shorter than the delays differ: it does not open"
                )
                continue
            if shut is not None and late[opening] <= late[shut]:
                notes.append(f"the pulses before and after {planned[opening].instant:.6g} s run into each other: the thruster stays open")
                late[opening] = late[shut] = (late[opening] + late[shut]) / 2
            shut = closing
    return tuple(replace(event, instant=instant) for event, instant in zip(planned, late, strict=True)), tuple(notes)


def pulses_left(happening: Sequence[Event]) -> int:
    """How many pulses of thrusters open: those that do not fall on one instant with their end."""
    spans: dict[tuple[int, int], list[float]] = {}
    for event in happening:
        spans.setdefault((event.thruster, event.pulse), []).append(event.instant)
    return sum(max(instants) > min(instants) for instants in spans.values())


def room(happening: Sequence[Event]) -> float:
    """The shortest time [s] between two events of one thruster (or of the one actuator) that do not fall together; infinite without two."""
    gaps = [
        later - earlier
        for thruster in {event.thruster for event in happening}
        for times in [sorted(event.instant for event in happening if event.thruster == thruster)]
        for earlier, later in itertools.pairwise(times)
        if later > earlier
    ]
    return min(gaps, default=float("inf"))


def motions(plant: LinearPlant, displacement: float) -> tuple[Motion, ...]:
    """What may be left in the controlled output: of the rigid body, of each flexible mode and of each real pole, by ascending frequency.

    A mode that the output does not see is left out.
    """
    found: list[Motion] = []
    with precision(ROOT_BITS):
        flexible = real = 0
        for pole, (ball, residues) in zip(plant.poles, plant.fractions(plant.output), strict=True):
            if pole.is_rigid:
                found += _rigid(residues, displacement)
                continue
            flexible, real = flexible + pole.is_flexible, real + (not pole.is_flexible)
            name = f"mode[{flexible}]" if pole.is_flexible else f"real[{real}]"
            chain = _antiderivative(ball, residues)
            if all(c.contains(0) for c in chain):
                continue
            values = tuple(complex(c) for c in chain)
            found.append(Motion(name, pole.value, values, factor=2.0 if pole.is_flexible else 1.0, balls=(ball, chain)))
    return tuple(found)


def _rigid(residues: tuple[flint.acb, ...], displacement: float) -> list[Motion]:
    """Displacement, rate … of the free motion Σ_k r_k s^(k-1)/(k-1)!."""
    found = []
    for order in range(len(residues)):
        chain = [flint.acb(0)] + [residues[order + k] / math.factorial(k + 1) for k in range(len(residues) - order)]
        name = DERIVATIVES[order] if order < len(DERIVATIVES) else f"derivative {order}"
        offset = displacement if order == 0 else 0.0
        found.append(Motion(f"rigid {name}", 0j, tuple(complex(c) for c in chain), offset, order, balls=(flint.acb(0), tuple(chain))))
    return found


def _antiderivative(pole: flint.acb, residues: tuple[flint.acb, ...]) -> tuple[flint.acb, ...]:
    """h with d/ds e^{ps} Σ h_k s^k = e^{ps} Σ r_{k+1} s^k/k!."""
    chain: list[flint.acb] = []
    for k in reversed(range(len(residues))):
        above = (k + 1) * chain[0] if chain else flint.acb(0)
        chain.insert(0, (residues[k] / math.factorial(k) - above) / pole)
    return tuple(chain)


def left(motion: Motion, happening: Sequence[Event], end: float, errors: Reals | None = None) -> Complexes:
    """z of the events, each later by its error [s] (…, n), shape (…); without errors one number. `end` is T's instant [s]."""
    instants = np.array([event.instant for event in happening])
    jumps = np.array([event.jump for event in happening])
    if errors is None:
        return motion(end - instants) @ jumps - motion.offset
    flat = np.asarray(errors, dtype=float).reshape(-1, len(instants))
    rows = max(CHUNK // max(len(instants), 1), 1)
    parts = [motion(end - instants - flat[i : i + rows]) @ jumps for i in range(0, len(flat), rows)]
    return (np.concatenate(parts) - motion.offset).reshape(np.shape(errors)[:-1])


def derivatives(motion: Motion, happening: Sequence[Event], end: float) -> Complexes:
    """∂z/∂t_i (n,), output units a second (of a rate, a second squared)."""
    instants = np.array([event.instant for event in happening])
    return -np.array([event.jump for event in happening]) * motion.slope(end - instants)


def root_mean_square(motion: Motion, happening: Sequence[Event], end: float, jitter: float) -> float:
    """Root mean square of what is left under independent errors of standard deviation `jitter` [s], to first order in them."""
    nominal = abs(left(motion, happening, end))
    each = np.abs(derivatives(motion, happening, end))
    return float(motion.factor * np.sqrt(nominal**2 + jitter**2 * np.sum(each**2)))


def sampled(motion: Motion, happening: Sequence[Event], end: float, errors: Reals) -> Reals:
    """What is left, exactly, under each row of `errors` (m, n) [s]: amplitudes, or values with their sign; shape (m,)."""
    return motion.size(left(motion, happening, end, errors))
