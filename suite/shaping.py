"""`slewcert shaper`: a request as it is typed, the shaper that answers it, and what is proven and computed of that."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from relaxations.checking.worst import Worst, worst_residual
from relaxations.errors import RelaxationsError, ShaperError
from relaxations.sensitivity import insensitivity, residual, step_response
from relaxations.shaper_kinds import KINDS, Least, Request, find, make, mistakes
from relaxations.shaper_modes import Mode
from relaxations.shapers import Shaper
from reports.files import json_bytes, write_atomically
from suite.errors import SuiteError
from suite.suggestions import did_you_mean
from suite.values import mode_text

UNITS = {"Hz": 2.0 * math.pi, "rad/s": 1.0}
CURVE, STEPS = 601, 801  # samples of the two charts
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
    made = make(asked.kind, request)
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
    return Shaping(asked.kind, request, made.shaper, made.least, width, both, found.index(bottom) + 1, damping)


def _request(asked: Asked) -> tuple[Request, tuple[float, float] | None]:
    wrong: list[str] = []

    def tried(name: str, read: Callable[[], R]) -> R | None:
        try:
            return read()
        except (ValueError, RelaxationsError) as problem:
            wrong.append(f"{name}: {problem}")
            return None

    modes = [tried(f"--mode {text}", lambda text=text: _mode(text)) for text in asked.modes]
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
        wrong += mistakes(kind, asked.kind, request)
    except ShaperError as problem:
        names = [name for kind in KINDS for name in kind.written.split(", ")]
        wrong.append(f"{problem}{did_you_mean(asked.kind, names)}")
    if wrong:
        raise SuiteError("; ".join(wrong) if len(wrong) == 1 else "\n".join([f"{len(wrong)} mistakes", *(f"  {one}" for one in wrong)]))
    return request, damping


def _mode(text: str) -> Mode:
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


def picture(done: Shaping) -> str:
    """The sensitivity curve and the shaped step as SVG text that needs no page around it."""
    from reports import charts

    shaper, modes = done.shaper, done.request.modes
    low, high = done.request.band
    margin = 0.5 * (high - low) + 0.1
    factors = np.linspace(max(low - margin, 0.01), high + margin, CURVE)
    slowest = max(mode.half_period for mode in modes)
    instants = np.linspace(-0.5 * slowest, shaper.duration + 4.0 * slowest, STEPS)
    labels = [f"{mode.frequency / (2 * math.pi):.4g} Hz, damping {mode.damping:.3g}" for mode in modes]
    return charts.standalone(
        charts.shaping(
            f"Shaper {done.kind}",
            factors,
            {label: 100.0 * residual(shaper.times, shaper.amplitudes, factors * mode.frequency, mode.damping)
             for label, mode in zip(labels, modes, strict=True)},
            instants,
            np.sum([np.where(instants >= t, a, 0.0) for t, a in zip(shaper.times, shaper.amplitudes, strict=True)], axis=0),
            {label: step_response(shaper.times, shaper.amplitudes, mode.frequency, mode.damping, instants)
             for label, mode in zip(labels, modes, strict=True)},
            band=done.request.band,
            limit=charts.Limit(100.0 * done.request.tolerance, f"tolerance, {100.0 * done.request.tolerance:g} %"),
        )
    )  # fmt: skip


def save(done: Shaping, path: Path) -> None:
    """The shaper as a shaper file (`slewcert-shaper/1`), which `slewcert fmus export` makes an FMU of."""
    write_atomically(path, json_bytes(done.shaper.to_dict()))


def draw(done: Shaping, path: Path) -> None:
    """`picture` to a file."""
    write_atomically(path, picture(done).encode())


def known(paths: Sequence[Path]) -> None:
    """Raises `SuiteError` for files whose ending says nothing of whom they are for."""
    if unknown := [str(path) for path in paths if path.suffix not in EXPORTS]:
        raise SuiteError(
            f"{', '.join(unknown)}: the ending says for whom a shaper is written: .cfg for Klipper, .g for RepRapFirmware, .h for C"
        )


def export(done: Shaping, path: Path) -> None:
    """The shaper for other programs, by the file's ending (`known`)."""
    write_atomically(path, EXPORTS[path.suffix](done).encode())


def _klipper(done: Shaping) -> str:
    """Klipper: amplitudes and instants [s] of a custom shaper, for both axes."""
    lines = ["[input_shaper]"]
    for axis in "xy":
        lines += [f"shaper_type_{axis}: custom", f"shaper_a_{axis}: {_list(done.shaper.amplitudes, ', ')}"]
        lines += [f"shaper_t_{axis}: {_list(done.shaper.times, ', ')}"]
    return "\n".join(lines) + "\n"


def _reprapfirmware(done: Shaping) -> str:
    """RepRapFirmware: amplitudes but the last, which makes the sum 1, and delays [s] of the later impulses from the first one."""
    return f'M593 P"custom" H{_list(done.shaper.amplitudes[:-1], ":")} T{_list(done.shaper.times[1:], ":")}\n'


def _header(done: Shaping) -> str:
    """C: a header with the taps."""
    count = len(done.shaper.times)
    return "\n".join(
        [
            f"/* Shaper {done.kind}: amplitudes sum to 1, instants in seconds. */",
            "#ifndef SHAPER_TAPS_H",
            "#define SHAPER_TAPS_H",
            f"#define SHAPER_TAPS {count}",
            f"static const double shaper_times[SHAPER_TAPS] = {{{_list(done.shaper.times, ', ')}}};",
            f"static const double shaper_amplitudes[SHAPER_TAPS] = {{{_list(done.shaper.amplitudes, ', ')}}};",
            "#endif",
            "",
        ]
    )


def _list(numbers: Sequence[float], between: str) -> str:
    return between.join(f"{number:.17g}" for number in numbers)


EXPORTS: dict[str, Callable[[Shaping], str]] = {".cfg": _klipper, ".g": _reprapfirmware, ".h": _header}
