"""`slewcert shaper --move`: the same move rigid, shaped, and designed together with its shaper; times, what is left, and the command."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from relaxations.bounds import Bound, Status
from relaxations.commands import Command
from relaxations.errors import ImpossibleShaperError, ShaperError
from relaxations.shaping.banded_moves import within_each
from relaxations.shaping.bands import Band
from relaxations.shaping.kinds import find
from relaxations.shaping.listed_moves import within_all
from relaxations.shaping.moves import Move, gaps, in_turn, left_over, rigid, with_zeros, within_bands
from relaxations.shaping.requests import Request
from relaxations.shaping.shapers import Shaper
from suite.bound_records import bound_record


@dataclass(frozen=True, slots=True)
class Moved:
    """What became of a move: `bound` and `command` of each design, and between which values the envelope of the vibration left lies.

    `shaped` is None where negative impulses take the rigid body's command beyond the limits; `kept` is the fraction of the move by which it
    swings at most over the band, where that is what `together` proves. `between`: factors of a mode's frequency that lie between its bands;
    there the tolerance is kept as well, so that the time is that of bands without such gaps. `box`: the bands that the command is about,
    where they are several; `plants`: how many plants of them the certificate is about.
    """

    move: Move
    rigid: Bound
    shaped: Command | None
    together: Bound
    left: dict[str, tuple[float, float] | None]
    kept: float | tuple[float, ...] | None = None
    between: tuple[tuple[float, float], ...] = ()
    box: tuple[Band, ...] = ()
    plants: int = 0

    @property
    def command(self) -> Command | None:
        """The one designed together with the shaper."""
        return self.together.command

    def to_dict(self) -> dict[str, Any]:
        """The member `move` of `shaper --json` (docs/schemas.md)."""
        return {
            "displacement": self.move.displacement,
            "input": [self.move.lower, self.move.upper],
            "order": self.move.order,
            "rigid": {**bound_record(self.rigid, self.rigid.command, 0.0), "left": self.left["rigid"]},
            "shaped": None
            if self.shaped is None
            else {"maneuver_time": self.shaped.maneuver_time, "command": self.shaped.to_dict(), "left": self.left["shaped"]},
            "together": {
                **bound_record(self.together, self.together.command, 0.0),
                "left": self.left["together"],
                "kept": list(self.kept) if isinstance(self.kept, tuple) else self.kept,
                "box": [
                    {"frequency": band.mode.frequency, "factors": [band.low, band.high], "tolerance": band.tolerance} for band in self.box
                ],
                "plants": self.plants,
                "between": [list(gap) for gap in self.between],
            },
        }


def moved(kind: str, request: Request, shaper: Shaper, move: Move, damping: tuple[float, float] | None) -> Moved:
    """The move in its three designs.

    Raises `ShaperError` for kinds that are made by other demands than zeros or bands, `SolverError`, `ImpossibleShaperError`.
    """
    found, number = find(kind)
    bands = [band for _, band in request.reaches()]
    alone = rigid(move)
    if alone.command is None:
        if alone.status is not Status.IMPOSSIBLE:
            raise ShaperError(f"no such move was found: {alone.reason or alone.status.value}")
        needed = "limits below and above 0" if move.order == 2 else f"a limit {'above' if move.displacement > 0.0 else 'below'} 0"
        raise ImpossibleShaperError(
            f"no input from {move.lower:g} to {move.upper:g} moves the body by {move.displacement:g} and stops it; {needed} would"
        )
    kept: float | tuple[float, ...] | None = None
    box: tuple[Band, ...] = ()
    plants = 0
    if found.zeros is not None:
        together = with_zeros(move, *found.zeros(request, number))
    elif kind == "si" and len({band.tolerance for band in bands}) > 1:
        each = within_each(move, bands)
        together, box, kept, plants = each.bound, each.box, tuple(band.tolerance for band in bands), each.plants
    elif kind == "si" and len(request.modes) == 1 and gaps(bands) and (whole := within_all(move, bands)) is not None:
        together, box, kept, plants = whole.bound, tuple(bands), tuple(band.tolerance for band in bands), whole.plants
    elif kind == "si":
        together, kept = within_bands(move, bands), bands[0].tolerance
    else:
        raise ShaperError(f"{kind} is made by no demands that a move could be designed for")
    shaped = in_turn(move, alone.command, shaper)
    commands = {"rigid": alone.command, "shaped": shaped, "together": together.command}
    left = {name: None if command is None else left_over(move, command, bands, damping) for name, command in commands.items()}
    between = gaps(bands) if kind == "si" and not box else ()
    if not box and together.status is not Status.PROVED:
        kept = None
    return Moved(move, alone, shaped, together, left, kept, between, box, plants)
