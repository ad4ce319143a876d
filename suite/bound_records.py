"""A bracket of the minimum time as commands print it."""

from __future__ import annotations

from relaxations.bounds import Bound, Status
from relaxations.commands import Command


def bound_record(bound: Bound, command: Command | None, rest: float, certificate: str | None = None) -> dict[str, object]:
    """The object that `slewcert bound --json` prints (docs/schemas.md); `rest` is the input at the initial rest."""
    impossible = bound.status is Status.IMPOSSIBLE
    found = {
        "status": bound.status.name.lower(),
        "maneuver_time": None if impossible else {"lower": bound.lower, "upper": bound.upper},
        "command": None if command is None else command.to_dict(),
        "switches": bound.switches,
        "fuel": None if command is None else command.fuel(rest),
        "certificate": certificate,
        "seconds": round(bound.seconds, 6),
    }
    if bound.free is not None:
        found["free"] = {"lower": bound.free[0], "upper": bound.free[1]}
    return found if bound.reason is None else {**found, "reason": bound.reason}
