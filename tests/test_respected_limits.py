"""Limits of the input that a command which was not designed within them has to respect: files, and what shapers make."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path

import pytest
from marks import slow

from relaxations.commands import Command, Segment, Tail
from suite.design import design
from suite.errors import StudyError
from suite.loading import load_study
from suite.respecting import complaints
from suite.study import Limits

STEPS = Command(3.0, (Segment(0.0, 1.0), Segment(1.0, 0.5), Segment(2.0, -1.0)), Tail(0.0))  # fuel 2.5
RAMPS = Command(2.0, (Segment(0.0, 0.0, 1.0), Segment(1.0, 1.0, -1.0)), Tail(0.0))


@pytest.mark.parametrize(
    ("command", "limits", "told"),
    [
        (STEPS, {"fuel": Decimal("2.5")}, ""),
        (STEPS, {"fuel": Decimal("2.4")}, "uses 2.5 of fuel, more than limits.fuel, 2.4"),
        (STEPS, {"sample_time": Decimal("0.5")}, ""),
        (STEPS, {"sample_time": Decimal("0.4")}, "changes at 1 s, but limits.sample_time is 0.4 s"),
        (RAMPS, {"sample_time": Decimal("0.5")}, "is not constant"),
        (RAMPS, {"rate": (Decimal(-1), Decimal(1))}, ""),
        (RAMPS, {"rate": (Decimal("-0.9"), Decimal(1))}, "slope of -1 from 1 s on, but limits.rate is [-0.9, 1]"),
        (STEPS, {"rate": (Decimal(-1), Decimal(1))}, "jumps by 1 at 0 s, but limits.rate"),
        (STEPS, {"rate": (Decimal(-3), Decimal(2)), "sample_time": Decimal("0.5")}, ""),
        (STEPS, {"rate": (Decimal(-2), Decimal(2)), "sample_time": Decimal("0.5")}, "jumps by -1.5 at 2 s"),
        (STEPS, {"pulses": 3}, "other levels"),
    ],
)
def test_each_limit_is_looked_at(command: Command, limits: dict[str, object], told: str) -> None:
    found = list(complaints(command, Limits(Decimal(-1), Decimal(1), **limits), -1.0, 1.0, 0.0))  # type: ignore[arg-type]
    assert bool(found) == bool(told)
    assert told in "; ".join(found)


@pytest.mark.parametrize(
    ("limit", "told"),
    [
        ("fuel = 1.0", "more than limits.fuel"),
        ("sample_time = 0.25", "limits.sample_time"),
        slow("deflection = { output_rate = 0.6 }", "beyond limits.deflection (output_rate)"),  # it comes to 0.7 or so
        ("deflection = { output_rate = 2.0 }", ""),
        ("", ""),
    ],
)
def test_a_shaped_command_respects_them(limit: str, told: str, tmp_path: Path) -> None:
    """One mode and a rigid body: the fastest rigid move takes 2 s and 2 of fuel, and is shaped at instants of no sample."""
    study = tmp_path / "study.toml"
    study.write_text(f"""
[plant]
numerator = [9]
denominator = [1, 0, 9, 0, 0]
[maneuver]
displacement = 1.0
[limits]
input = [-1.0, 1.0]
{limit}
[command]
kind = "shaper"
shaper = "zv"
""")
    if not told:
        assert design(load_study(study)).command is not None
        return
    with pytest.raises(StudyError) as caught:
        design(load_study(study))
    assert [mistake.path for mistake in caught.value.mistakes] == ["command.shaper"]
    assert told in str(caught.value)
