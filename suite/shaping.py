"""`slewcert shaper`: a request as it is typed, the shaper that answers it, and what is proven and computed of that."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, TypeVar

from relaxations.checking.worst import Worst, worst_residual
from relaxations.errors import RelaxationsError, ShaperError
from relaxations.sensitivity import insensitivity
from relaxations.shaper_kinds import KINDS, Least, Request, find, make, mistakes
from relaxations.shaper_modes import Mode
from relaxations.shapers import Shaper
from suite.errors import SuiteError
from suite.suggestions import did_you_mean
from suite.values import mode_text

UNITS = {"Hz": 2.0 * math.pi, "rad/s": 1.0}
PROVEN = 1e-10  # how closely the worst case is enclosed: closer than a shaper is designed below its tolerance
R = TypeVar("R")


@dataclass(frozen=True, slots=True)
class Asked:
    """The command line's words, as they were typed (None: not given)."""

    kind: str
    modes: Sequence[str]
    tolerance: float = 0.05
    band: str = "0.8:1.2"
    damping: str | None = None
    negative: float | None = None
    sums: str | None = None
    sample_time: float | None = None
    simultaneous: bool = False


@dataclass(frozen=True, slots=True)
class Shaping:
    """The answer: the shaper, its least duration if known, its insensitivity at the tolerance, its proven worst residual over the box."""

    kind: str
    request: Request
    shaper: Shaper
    least: Least | None
    insensitivity: float
    worst: Worst
    worst_mode: int
    damping: tuple[float, float] | None

    def to_dict(self) -> dict[str, Any]:
        """The object of `shaper --json` (docs/schemas.md)."""
        least = self.least and {"lower": self.least.duration, "among": self.least.among}
        return {
            "kind": self.kind,
            "modes": [{"frequency": mode.frequency, "damping": mode.damping} for mode in self.request.modes],
            "box": {"frequency": list(self.request.band), "damping": None if self.damping is None else list(self.damping)},
            "times": list(self.shaper.times),
            "amplitudes": list(self.shaper.amplitudes),
            "duration": self.shaper.duration,
            "least_duration": least,
            "insensitivity": {f"{self.request.tolerance:g}": self.insensitivity},
            "worst_residual": [self.worst.lower, self.worst.upper],
            "worst_at": {"mode": self.worst_mode, "frequency": self.worst.frequency, "damping": self.worst.damping},
        }


def design(asked: Asked) -> Shaping:
    """Make the shaper and prove its worst case.

    Raises `SuiteError` naming every mistake, `ImpossibleShaperError` if there is no such shaper.
    """
    request, damping = _request(asked)
    return assess(asked.kind, request, damping)


def assess(kind: str, request: Request, damping: tuple[float, float] | None = None) -> Shaping:
    """The shaper of a kind, and its proven worst residual over the band and these dampings (None: those of the modes).

    Raises `ShaperError`, `ImpossibleShaperError`, `SolverError`.
    """
    made = make(kind, request)
    times, amplitudes = made.shaper.times, made.shaper.amplitudes
    exact = [Fraction(t) for t in times], [Fraction(a) for a in amplitudes]
    found: list[Worst] = []
    for mode in request.modes:
        low, high = damping or (mode.damping, mode.damping)
        frequencies = [Fraction(repr(factor)) * Fraction(repr(mode.frequency)) for factor in request.band]
        box = (frequencies[0], frequencies[1]), (Fraction(repr(low)), Fraction(repr(high)))
        found.append(worst_residual(*exact, *box, relative=PROVEN, absolute=PROVEN))
    worst = max(range(len(found)), key=lambda i: found[i].upper)
    width = min(insensitivity(times, amplitudes, mode.frequency, mode.damping, request.tolerance) for mode in request.modes)
    # The largest residual of all modes is at least the largest of their lower ends.
    bottom = max(found, key=lambda one: one.lower)
    both = Worst(bottom.lower, found[worst].upper, bottom.frequency, bottom.damping, sum(one.cells for one in found))
    return Shaping(kind, request, made.shaper, made.least, width, both, found.index(bottom) + 1, damping)


def _request(asked: Asked) -> tuple[Request, tuple[float, float] | None]:
    wrong: list[str] = []

    def tried(name: str, read: Callable[[], R]) -> R | None:
        try:
            return read()
        except (ValueError, RelaxationsError) as problem:
            wrong.append(f"{name}: {problem}")
            return None

    modes = [tried(f"--mode {text}", lambda text=text: mode_of(text)) for text in asked.modes]
    band = tried(f"--band {asked.band}", lambda: _interval(asked.band, "factors of the mode's frequency, such as 0.8:1.2"))
    damping = tried(f"--damping {asked.damping}", lambda: _interval(asked.damping, "damping ratios, such as 0:0.05"))
    sums = tried(f"--sums {asked.sums}", lambda: _interval(asked.sums, "bounds of the partial sums, such as -0.5:1.5"))
    if band and band[0] <= 0.0:
        wrong.append(f"--band {asked.band}: frequencies are positive")
    if damping and not (damping[0] >= 0.0 and damping[1] < 1.0):
        wrong.append(f"--damping {asked.damping}: damping ratios are at least 0 and less than 1")
    if not 0.0 < asked.tolerance < 1.0:
        wrong.append(f"--tolerance {asked.tolerance!r}: a fraction of the unshaped vibration, between 0 and 1")
    if asked.negative is not None and not 0.0 < asked.negative < math.inf:
        wrong.append(f"--negative {asked.negative!r}: the size of the negative amplitude, a positive number")
    if asked.sample_time is not None and not 0.0 < asked.sample_time < math.inf:
        wrong.append(f"--sample-time {asked.sample_time!r}: a positive number of seconds")
    if not asked.modes:
        wrong.append("--mode is missing: a shaper needs at least one, such as --mode 1.0Hz:0.05")
    request = Request(
        tuple(mode for mode in modes if mode), asked.tolerance, band or (0.8, 1.2), asked.negative, sums, asked.sample_time,
        asked.simultaneous,
    )  # fmt: skip
    try:
        kind, _ = find(asked.kind)
        wrong += [f"--{option.replace('_', '-')} {problem}" for option, problem in mistakes(kind, asked.kind, request)]
    except ShaperError as problem:
        names = [name for kind in KINDS for name in kind.written.split(", ")]
        wrong.append(f"{problem}{did_you_mean(asked.kind, names)}")
    if wrong:
        raise SuiteError("; ".join(wrong) if len(wrong) == 1 else "\n".join([f"{len(wrong)} mistakes", *(f"  {one}" for one in wrong)]))
    return request, damping


def mode_of(text: str) -> Mode:
    """A mode as it is written, "1.0Hz:0.05"; raises `ValueError`, `ShaperError`."""
    found = re.fullmatch(r"(.+?)\s*(Hz|rad/s)\s*:\s*(.+)", mode_text(text))
    if found is None:
        raise ValueError('must be FREQUENCY(Hz|rad/s):DAMPING, such as "1.0Hz:0.05"')
    return Mode(float(found[1]) * UNITS[found[2]], float(found[3]))


def _interval(text: str | None, what: str) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        low, high = map(float, text.split(":"))
    except ValueError:
        raise ValueError(f"must be LOW:HIGH, {what}") from None
    if not (math.isfinite(low) and math.isfinite(high) and low <= high):
        raise ValueError(f"must be LOW:HIGH with LOW ≤ HIGH, {what}")
    return low, high
