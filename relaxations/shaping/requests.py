"""What is asked of a shaper, and what comes of it: the impulses, and how short such shapers could be at all."""

from __future__ import annotations

from dataclasses import dataclass

from relaxations.errors import ShaperError
from relaxations.shaping.bands import Band
from relaxations.shaping.modes import Mode
from relaxations.shaping.shapers import Shaper

TOLERANCE, BAND = 0.05, (0.8, 1.2)  # unless a request says otherwise


@dataclass(frozen=True, slots=True)
class Request:
    """What a shaper is made for: `modes`, and the numbers that its kind needs (None: not given).

    `tolerance` is a fraction of the unshaped vibration, `band` factors of each mode's frequency, `negative` the size of the negative
    impulse, `sums` bounds of the partial sums, `sample_time` [s] the grid of the instants; `simultaneous`: one solution for all modes
    instead of a convolution of one for each. `bands` (low, high, tolerance) take the place of band and tolerance: one for each mode, or
    several for one mode. `pulse` [s] draws impulses out to pulses of this width, `height` [1/s] is that of all pulses; `impulses` are a
    shaper that is given. `dampings` is the range over which `si` keeps its tolerance, and every worst case is told (None: the modes' own).
    `deflection` limits how far the shaped step takes a mode from it, as a fraction of what an unshaped one does.
    """

    modes: tuple[Mode, ...]
    tolerance: float = TOLERANCE
    band: tuple[float, float] = BAND
    negative: float | None = None
    sums: tuple[float, float] | None = None
    sample_time: float | None = None
    simultaneous: bool = False
    bands: tuple[tuple[float, float, float], ...] = ()
    pulse: float | None = None
    height: float | None = None
    impulses: Shaper | None = None
    deflection: float | None = None
    dampings: tuple[float, float] | None = None

    def contradictions(self) -> tuple[str, ...]:
        """Bands of one mode of which one says nothing beside another, each told in words."""
        found, bands = [], [band for _, band in self.reaches()] if len(self.modes) == 1 else []
        for place, band in enumerate(bands):
            for other in [one for number, one in enumerate(bands) if number != place]:
                inside = other.low <= band.low and band.high <= other.high and other.tolerance <= band.tolerance
                if inside and not (band == other and place == 0):
                    found.append(
                        f"{_written(band)} lies within {_written(other)} and allows no less: it says nothing; leave it out, or give it "
                        f"a tolerance below {other.tolerance:g} or a reach beyond {other.low:g} to {other.high:g}"
                    )
                    break
        return tuple(found)

    def reaches(self) -> tuple[tuple[int, Band], ...]:
        """Every band with the number of its mode, from 0; raises `ShaperError` if bands and modes do not go together."""
        modes, bands = self.modes, self.bands or ((*self.band, self.tolerance),)
        if len(bands) == 1:
            return tuple((i, Band(mode, *bands[0], self.dampings)) for i, mode in enumerate(modes))
        if len(modes) == 1:
            return tuple((0, Band(modes[0], *band, self.dampings)) for band in bands)
        if len(modes) == len(bands):
            return tuple((i, Band(mode, *band, self.dampings)) for i, (mode, band) in enumerate(zip(modes, bands, strict=True)))
        raise ShaperError(
            f"bands are one for all modes, one for each, or several for one mode; there are {len(bands)} for {len(modes)} modes"
        )


@dataclass(frozen=True, slots=True)
class Least:
    """`duration` [s], *proven*: no sequence that is `among` these is shorter.

    If these are told by `zeros` alone, modes of which nothing is left, and by sizes of amplitudes, it holds for impulses drawn out to
    pulses of one width, too, with this width added.
    """

    duration: float
    among: str
    zeros: tuple[Mode, ...] = ()


@dataclass(frozen=True, slots=True)
class Made:
    """A shaper, the least duration of such shapers where that is proven, and `ranges` that its kind keeps (mode, counted from 0; band).

    `notes` are sentences about both that whoever uses them should read.
    """

    shaper: Shaper
    least: Least | None = None
    ranges: tuple[tuple[int, Band], ...] = ()
    notes: tuple[str, ...] = ()


def _written(band: Band) -> str:
    return f"{band.low:g}:{band.high:g}@{band.tolerance:g}"
