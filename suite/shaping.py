"""`slewcert shaper`: a request as it is typed, the shaper that answers it, and what is proven and computed of that."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from relaxations.checking.worst import Worst
from relaxations.errors import RelaxationsError, ShaperError, SolverError
from relaxations.shaping.bands import Band
from relaxations.shaping.deflection import deflection
from relaxations.shaping.kinds import KINDS, find, make, mistakes
from relaxations.shaping.modes import Mode
from relaxations.shaping.moves import Move
from relaxations.shaping.requests import BAND, TOLERANCE, Least, Request
from relaxations.shaping.sensitivity import insensitivity
from relaxations.shaping.shapers import Shaper
from relaxations.shaping.worst_cases import worst_over
from suite.decays import Measured, measured_decay
from suite.errors import SuiteError
from suite.shaper_moves import Moved, moved
from suite.shaper_references import ShapedReference
from suite.sources import read_shaper
from suite.suggestions import did_you_mean
from suite.values import split_mode

UNITS = {"Hz": 2.0 * math.pi, "rad/s": 1.0}
PROVEN = 1e-10  # how closely the worst case is enclosed: closer than si is designed below its tolerance
CLOSER = (1e-12, 1e-15)  # and how closely while that does not tell whether the tolerance is kept: humps are as high as doubles let them be
R = TypeVar("R")


@dataclass(frozen=True, slots=True)
class Asked:
    """The command line's words, as they were typed (None: not given)."""

    kind: str
    modes: Sequence[str]
    tolerance: float = TOLERANCE
    band: Sequence[str] = ()
    damping: str | None = None
    negative: float | None = None
    sums: str | None = None
    sample_time: float | None = None
    simultaneous: bool = False
    pulse: float | None = None
    height: float | None = None
    impulses: str | None = None
    deflection: float | None = None
    decay: Path | None = None
    signal: str | None = None
    begin: float | None = None
    until: float | None = None
    move: float | None = None
    input: str | None = None
    order: int = 2


@dataclass(frozen=True, slots=True)
class Reach:
    """A band of one mode (counted from 1), and the proven worst residual over it and the dampings."""

    mode: int
    band: Band
    worst: Worst

    def to_dict(self) -> dict[str, Any]:
        """An item of `bands` and `ranges` in `shaper --json` (docs/schemas.md)."""
        return {
            "mode": self.mode,
            "frequency": [self.band.low, self.band.high],
            "tolerance": self.band.tolerance,
            "worst_residual": [self.worst.lower, self.worst.upper],
        }


@dataclass(frozen=True, slots=True)
class Shaping:
    """The answer: the shaper, its least duration if known, its insensitivity at the tolerance, its proven worst residual over each band.

    `ranges`: those that the kind keeps by itself, where it does.
    `deflection`: the largest one from the shaped step lies between these, where it was to be limited. `notes`: what to know of the above.
    """

    kind: str
    request: Request
    shaper: Shaper
    least: Least | None
    insensitivity: float
    reaches: tuple[Reach, ...]
    damping: tuple[float, float] | None
    decay: Measured | None = None
    deflection: tuple[float, float] | None = None
    move: Moved | None = None
    ranges: tuple[Reach, ...] = ()
    notes: tuple[str, ...] = ()
    shaped: ShapedReference | None = None

    @property
    def worst(self) -> tuple[float, float]:
        """The largest residual of all bands lies between these: it is at least the largest of their lower ends."""
        return max(reach.worst.lower for reach in self.reaches), max(reach.worst.upper for reach in self.reaches)

    @property
    def worst_reach(self) -> Reach:
        """The one with the largest lower end."""
        return max(self.reaches, key=lambda reach: reach.worst.lower)

    def to_dict(self) -> dict[str, Any]:
        """The object of `shaper --json` (docs/schemas.md)."""
        at = self.worst_reach
        least = self.least and {
            "lower": self.least.duration,
            "among": self.least.among,
            "zeros": [{"frequency": zero.frequency, "damping": zero.damping} for zero in self.least.zeros],
        }
        whole = self.shaper.to_dict()
        record = {
            "kind": self.kind,
            "modes": [{"frequency": mode.frequency, "damping": mode.damping} for mode in self.request.modes],
            "damping": None if self.damping is None else list(self.damping),
            "times": whole["times"],
            "amplitudes": whole["amplitudes"],
            "pulses": whole.get("pulses", []),
            "decay": self.decay and self.decay.to_dict(),
            "duration": self.shaper.duration,
            "least_duration": least,
            "insensitivity": {f"{self.request.tolerance:g}": self.insensitivity},
            "deflection": None if self.deflection is None else list(self.deflection),
            "worst_residual": list(self.worst),
            "worst_at": {"mode": at.mode, "frequency": at.worst.frequency, "damping": at.worst.damping},
            "bands": [reach.to_dict() for reach in self.reaches],
            "ranges": [reach.to_dict() for reach in self.ranges],
            "notes": list(self.notes),
        }
        further = {"move": self.move, "shaped": self.shaped}
        return {**record, **{name: made.to_dict() for name, made in further.items() if made is not None}}


def design(asked: Asked, further: Sequence[str] = ()) -> Shaping:
    """Make the shaper and prove its worst case; `further` mistakes of the same command are told with those of `asked`.

    Raises `SuiteError` naming every mistake, `ImpossibleShaperError` if there is no such shaper.
    """
    request, damping, measured, move = _request(asked, further)
    done = replace(assess(asked.kind, request, damping), decay=measured)
    if move is None:
        return done
    of_its_own = [name for name, value in (("--sample-time", request.sample_time), ("--pulse", request.pulse)) if value is not None]
    notes = (*done.notes, *(f"{name} is of the shaper: the move designed together with it switches at any instant" for name in of_its_own))
    return replace(done, move=moved(asked.kind, request, done.shaper, move, damping), notes=notes)


def _move(asked: Asked) -> Move | None:
    """Raises `ValueError`, `ShaperError`."""
    if asked.move is None:
        if asked.input is not None:
            raise ValueError("says within what a --move is made, which is missing")
        return None
    limits = _interval(asked.input, "limits of the input, such as -2:2")
    if limits is None:
        raise ValueError("needs the limits of its input, such as --input -2:2")
    return Move(asked.move, *limits, asked.order)


def assess(kind: str, request: Request, damping: tuple[float, float] | None = None) -> Shaping:
    """The shaper of a kind, and its proven worst residual over the band and these dampings (None: those of the modes).

    Raises `ShaperError`, `ImpossibleShaperError`, `SolverError`.
    """
    request = replace(request, dampings=damping)
    reaches = request.reaches()
    made = make(kind, request)
    times, amplitudes, order = made.shaper.excitation
    found = [_reach(made.shaper, number, band) for number, band in reaches]
    kept = [_reach(made.shaper, number, band) for number, band in made.ranges]
    for reach in (*kept, *(found if find(kind)[0].keeps else ())):
        _require_kept(kind, reach)
    width = min(insensitivity(times, amplitudes, mode.frequency, mode.damping, request.tolerance, order) for mode in request.modes)
    strays = None
    if request.deflection is not None:
        each = [deflection(made.shaper, mode) for mode in request.modes]
        strays = max(one.lower for one in each), max(one.upper for one in each)
    return Shaping(kind, request, made.shaper, made.least, width, tuple(found), damping,
                   deflection=strays, ranges=tuple(kept), notes=made.notes)  # fmt: skip


def _require_kept(kind: str, reach: Reach) -> None:
    """What is promised is proven, or not broken at least: the enclosure may hold the tolerance by its own width."""
    band = reach.band
    if reach.worst.lower > band.tolerance:
        raise SolverError(
            f"{kind} promises {band.tolerance!r} from {band.low:g} to {band.high:g} of mode {reach.mode}'s frequency, but what was solved "
            f"leaves {reach.worst.lower:.6g} there (proved); another tolerance or band is possible, or one mode after the other"
        )


def _reach(shaper: Shaper, number: int, band: Band) -> Reach:
    worst = worst_over(shaper, band, PROVEN)
    for closely in CLOSER:
        if worst.lower <= band.tolerance < worst.upper:
            worst = worst_over(shaper, band, closely)
    return Reach(number + 1, band, worst)


def _request(asked: Asked, further: Sequence[str]) -> tuple[Request, tuple[float, float] | None, Measured | None, Move | None]:
    """What is asked, with the dampings of the worst case, the decay that modes come from, and the move."""
    wrong = list(further)

    def tried(name: str, read: Callable[[], R]) -> R | None:
        try:
            return read()
        except OSError as problem:
            wrong.append(f"{name}: {problem.filename or ''} cannot be read: {problem.strerror or problem}")
        except (ValueError, RelaxationsError, SuiteError) as problem:
            wrong.append(f"{name}: {problem}")
        return None

    measured = known = None
    if asked.decay is not None:
        file = asked.decay
        measured = tried("--decay", lambda: measured_decay(file, asked.signal, asked.begin, asked.until))
        known = () if measured is None else tuple(found.mode for found in measured.decay.modes)
    modes = [tried(f"--mode {text}", lambda text=text: mode_of(text)) for text in asked.modes]
    bands = [tried(f"--band {text}", lambda text=text: band_of(text, asked.tolerance)) for text in asked.band]
    damping = tried(f"--damping {asked.damping}", lambda: _interval(asked.damping, "damping ratios, such as 0:0.05"))
    sums = tried(f"--sums {asked.sums}", lambda: _interval(asked.sums, "bounds of the partial sums, such as -0.5:1.5"))
    if damping and not (damping[0] >= 0.0 and damping[1] < 1.0):
        wrong.append(f"--damping {asked.damping}: damping ratios are at least 0 and less than 1")
    if not 0.0 < asked.tolerance < 1.0:
        wrong.append(f"--tolerance {asked.tolerance!r}: a fraction of the unshaped vibration, between 0 and 1")
    if damping and (
        others := [f"{mode.damping:g}" for mode in (*(known or ()), *modes) if mode and not damping[0] <= mode.damping <= damping[1]]
    ):
        wrong.append(
            f"--damping {asked.damping}: is a range that the machine may have, and does not hold the damping of the mode itself "
            f"({', '.join(others)}); it begins no higher and ends no lower"
        )
    for option, value, what in (
        ("negative", asked.negative, "the size of the negative amplitude, a positive number"),
        ("sample-time", asked.sample_time, "a positive number of seconds"),
        ("pulse", asked.pulse, "a positive number of seconds"),
        ("height", asked.height, "a positive number, in 1/s"),
        ("deflection", asked.deflection, "a positive fraction of what an unshaped step deflects"),
    ):
        if value is not None and not 0.0 < value < math.inf:
            wrong.append(f"--{option} {value!r}: {what}")
    given = None if asked.impulses is None else tried("--impulses", lambda: impulses_of(str(asked.impulses)))
    told = f"--move {asked.move:g}{'' if asked.input is None else f' --input {asked.input}'}" if asked.move is not None else "--input"
    move = tried(told, lambda: _move(asked))
    if not asked.modes and known is None:
        wrong.append("--mode is missing: a shaper needs at least one, such as --mode 1.0Hz:0.05, or a measured --decay")
    if asked.decay is None and (asked.signal, asked.begin, asked.until) != (None, None, None):
        wrong.append("--signal, --from and --until say what of a --decay is looked at, which is missing")
    request = Request(
        modes=(*(known or ()), *(mode for mode in modes if mode)),
        tolerance=asked.tolerance,
        negative=asked.negative,
        sums=sums,
        sample_time=asked.sample_time,
        simultaneous=asked.simultaneous,
        bands=tuple(band for band in bands if band),
        pulse=asked.pulse,
        height=asked.height,
        impulses=given,
        deflection=asked.deflection,
    )
    if len(request.modes) == len(modes) + len(known or ()) and len(request.bands) == len(bands) and 0.0 < asked.tolerance < 1.0:
        reached = tried("--band", request.reaches)
        if reached is not None and asked.kind == "si":
            wrong += [f"--band {problem}" for problem in request.contradictions()]
    try:
        kind, _ = find(asked.kind)
        wrong += [
            f"--{option.replace('_', '-')} {problem}"
            for option, problem in mistakes(kind, asked.kind, request)
            if getattr(asked, option) is None or getattr(request, option) is not None
        ]  # else it is there, and wrong
    except ShaperError as problem:
        names = [name for kind in KINDS for name in kind.written.split(", ")]
        wrong.append(f"{problem}{did_you_mean(asked.kind, names)}")
    if wrong:
        raise SuiteError("; ".join(wrong) if len(wrong) == 1 else "\n".join([f"{len(wrong)} mistakes", *(f"  {one}" for one in wrong)]))
    return request, damping, measured, move


def mode_of(text: str) -> Mode:
    """A mode as it is written, "1.0Hz:0.05"; raises `ValueError`, `ShaperError`."""
    frequency, unit, damping = split_mode(text)
    return Mode(frequency * UNITS[unit], damping)


def band_of(text: str, tolerance: float) -> tuple[float, float, float]:
    """A band as it is written, "0.8:1.2" or "0.8:1.2@0.1" with a tolerance of its own; raises `ValueError`."""
    factors, _, own = text.partition("@")
    low, high = _interval(factors, "factors of the mode's frequency, such as 0.8:1.2") or BAND
    if low <= 0.0:
        raise ValueError("frequencies are positive")
    try:
        level = float(own) if own else tolerance
    except ValueError:
        raise ValueError(f"the tolerance {own!r} is no number") from None
    if own and not 0.0 < level < 1.0:
        raise ValueError(f"the tolerance {own} is no fraction of the unshaped vibration, between 0 and 1")
    return low, high, level


def impulses_of(text: str) -> Shaper:
    """A shaper that is given: the path of its file, or "0:0.5,0.49:0.5", instants [s] and amplitudes.

    Raises `ValueError`, `OSError`, `ShaperError`, `SourceError`.
    """
    if text.endswith(".json"):
        return read_shaper(Path(text))
    try:
        pairs = [tuple(map(float, pair.split(":"))) for pair in text.split(",")]
        times, amplitudes = zip(*((time, amplitude) for time, amplitude in pairs), strict=True)
    except ValueError:
        raise ValueError('must be INSTANT:AMPLITUDE,…, such as "0:0.5,0.49:0.5", or a shaper file, FILE.json') from None
    return Shaper(times, amplitudes)


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
