"""Thrusters: pulses at full thrust, wide and few enough; what is proven of them, and what a changed certificate proves."""

from __future__ import annotations

import json
from fractions import Fraction
from math import sqrt
from pathlib import Path

import numpy as np
import pytest
from proving import proven
from study_texts import mistakes, read

from relaxations.bounds import Status
from relaxations.checking.claims import Outcome, check
from relaxations.commands import Command, Segment, Tail
from relaxations.errors import ManeuverError
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import LinearPlant
from relaxations.proofs import minimum_time
from relaxations.response import response
from suite.errors import StudyError
from suite.loading import load_study
from suite.tables import tabulate

RIGID = LinearPlant.from_transfer([1], [1, 0, 0])
TWO_MASS = LinearPlant.from_transfer([1], [1, 0, 2, 0, 0])
PENDULUM = LinearPlant.from_transfer([1], [1, 0, 1])


def posed(plant: LinearPlant, width: str | None, pulses: int | None = None, **others: object):
    limits = Limits(Fraction(-1), Fraction(1), others.pop("fuel", None), None if width is None else Fraction(width), pulses)  # type: ignore[arg-type]
    return problem([plant], Maneuver(others.pop("displacement", Fraction(1)), limits, **others))  # type: ignore[arg-type]


def pulses(command: Command) -> list[float]:
    widths = np.diff([*(s.start for s in command.segments), command.end])
    assert {s.level for s in command.segments} <= {-1.0, 0.0, 1.0}
    return [float(width) for s, width in zip(command.segments, widths, strict=True) if s.level]


def test_where_the_fastest_pulses_are_wide_enough_nothing_is_lost() -> None:
    found, command = proven(posed(RIGID, "0.99", 2))
    assert found.gap is not None
    assert found.gap < 1e-14
    assert pulses(command) == pytest.approx([1.0, 1.0])


@pytest.mark.slow
def test_pulses_that_are_too_wide_for_two_need_a_third() -> None:
    """Back, forth and back: for width w ≥ 1 the outer ones… the shortest of three full pulses of at least w that move a rigid body by 1."""
    width = 1.1
    found, command = proven(posed(RIGID, "1.1"))
    wide = pulses(command)
    assert len(wide) == 3
    assert min(wide) >= width
    # -w, +m, -(m - w): displacement w m - w² ... with m² / 4 ... : 2 w + 2 sqrt(1 + w²) for the pulses -w, m, -w' in balance
    assert found.upper == pytest.approx(2 * width + 2 * sqrt(1 + width**2), rel=1e-6)
    assert found.lower == pytest.approx(found.upper, rel=1.01e-4)  # what a first claim leaves
    after = np.linspace(command.end, command.end + 5.0, 11)
    np.testing.assert_allclose(response(RIGID, command, after), 1.0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("width", "known"), [("0.8", 6.693673728551), ("2.26", 11.2355326), ("2.3", 11.4121715)])
def test_a_wider_pulse_than_the_fastest_command_has(width: str, known: float) -> None:
    """Two pulses of 10/T, one period T of the mode apart, are the best until they would have to be wider."""
    found, command = proven(posed(TWO_MASS, width, displacement=Fraction(5)))
    assert min(pulses(command)) >= float(width)
    assert found.gap is not None
    assert found.gap < 1.01e-4
    assert found.upper == pytest.approx(known, rel=1e-8)
    after = np.linspace(command.end, command.end + 20.0, 101)
    np.testing.assert_allclose(response(TWO_MASS, command, after), 5.0, atol=1e-7)


def test_too_few_pulses_leave_the_upper_side_open() -> None:
    found = minimum_time(posed(TWO_MASS, None, 1))
    assert found.status is Status.BRACKETED
    assert found.upper is None
    assert found.reason is not None
    assert "no command with such pulses was found" in found.reason
    assert "their own image about the middle" in found.reason
    assert found.certificate is not None
    assert check(found.certificate).outcome is Outcome.PROVED, "the lower side by itself"


@pytest.mark.slow
def test_from_an_initial_state() -> None:
    found, command = proven(posed(PENDULUM, "1.0", displacement=Fraction(0), initial=(Fraction(3), Fraction(0))))
    assert min(pulses(command)) >= 1.0
    after = np.linspace(command.end, command.end + 5.0, 11)
    np.testing.assert_allclose(response(PENDULUM, command, after, begin=(Fraction(3), Fraction(0))), 0.0, atol=1e-9)
    assert found.lower > 1.0


def test_what_is_no_width_or_goes_with_none_is_refused() -> None:
    for width, number, more in (("0", None, {}), (None, 0, {}), ("1", None, {"sample_time": Fraction(1, 2)})):
        with pytest.raises(ManeuverError, match="puls"):
            posed(RIGID, width, number, **more)


@pytest.mark.parametrize(
    ("more", "place"),
    [
        ("pulse_width = 1\nsample_time = 0.1", "limits.sample_time"),
        ("pulses = 3\n[command]\ntail = true", "command.tail"),
        ("pulses = 3\nrate = [-1, 1]", "limits.rate"),
    ],
)
def test_studies_that_contradict_themselves(more: str, place: str, tmp_path: Path) -> None:
    text = f"[plant]\nnumerator = [1]\ndenominator = [1, 0, 0]\n[maneuver]\ndisplacement = 1\n[limits]\ninput = [-1, 1]\n{more}\n"
    assert "contradicts limits.pulse" in mistakes(tmp_path, text)[place]


def test_a_table_would_scale_thrusters_and_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "s.toml"
    file.write_text(
        "[plant]\nnumerator = [1]\ndenominator = [1, 0, 0]\n[maneuver]\ndisplacement = 1\n[limits]\ninput = [-1, 1]\npulses = 3\n"
    )
    with pytest.raises(StudyError, match="thrusters are on or off"):
        tabulate(load_study(file), (Fraction(1), Fraction(2)))


@pytest.mark.parametrize(
    ("segments", "words"),
    [
        ([(0.0, 1.0), (1.0, -1.0)], ""),
        ([(0.0, 1.0), (0.4, -1.0)], "a pulse of 0.4 s"),
        ([(0.0, 0.5), (1.0, -1.0)], "thrusters give"),
        ([(0.0, 1.0), (1.0, -1.0), (2.0, 1.0), (3.0, -1.0)], "4 pulses"),
    ],
)
def test_a_command_file_is_held_to_the_pulses(segments: list[tuple[float, float]], words: str, tmp_path: Path) -> None:
    command = Command(segments[-1][0] + 1.0, tuple(Segment(*pair) for pair in segments), Tail(0.0))
    (tmp_path / "command.json").write_text(json.dumps(command.to_dict()))
    text = "[plant]\nnumerator = [1]\ndenominator = [1, 0, 0]\n[maneuver]\ndisplacement = 1\n[limits]\ninput = [-1, 1]\n"
    text += 'pulse_width = 0.5\npulses = 3\n[command]\nkind = "file"\nfile = "command.json"\n'
    if not words:
        assert read(tmp_path, text).command.given == command
    else:
        assert words in mistakes(tmp_path, text)["command.file"]
