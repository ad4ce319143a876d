"""Files that hold a command: command files, and spline files, which become commands of lines."""

from __future__ import annotations

from relaxations.commands import Command


def command_of(text: str) -> Command:
    """A command file (`slewcert-command/1`), or a spline file (`slewcert-spline/1`) as lines within 1e-6 of its excursion.

    Raises `CommandError`.
    """
    if '"slewcert-spline/' in text[:4096] or '"slewcert-spline/' in text[-4096:]:
        from relaxations.shaping.splines import Spline

        return Spline.from_json(text).lines()
    return Command.from_json(text)
