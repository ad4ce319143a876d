"""A shaper that follows a varying mode: the definition, no jumps but the reference's, a rigid body that rests, and less vibration."""

from __future__ import annotations

import math
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from small_studies import SHIPPED

from relaxations.commands import Command, Segment, Tail
from relaxations.errors import ShaperError
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import LinearPlant
from relaxations.shaping.following import followed, following_move
from relaxations.shaping.impulses import derivative_shaper
from relaxations.shaping.modes import Mode
from relaxations.shaping.shapers import shape
from relaxations.shaping.streams import Schedule
from suite.design import design
from suite.errors import StudyError
from suite.loading import load_study

MOVE = Command(6.0, (Segment(0.0, 1.0), Segment(3.0, -1.0)), Tail(0.0))


def frequency(t: float) -> float:
    return 2.0 + 0.5 * math.sin(min(t, 8.0) * math.pi / 16.0)


def rising(derivatives: int = 1) -> Schedule:
    instants = np.linspace(0.0, 8.0, 33)
    return Schedule.of(instants.tolist(), [Mode(frequency(t), 0.01) for t in instants], lambda mode: derivative_shaper(mode, derivatives))


def test_the_command_is_the_definition():
    schedule = rising()
    found = followed(MOVE, schedule, 0.0)
    at = np.linspace(0.003, found.end + 1.0, 1777)
    times, amplitudes = schedule.at(at)
    expected = (amplitudes * np.array([MOVE(at - row) * (at >= row) for row in times])).sum(axis=0)
    assert np.abs(found(at) - expected).max() < 1e-12


def test_what_does_not_vary_is_the_convolution():
    shaper = derivative_shaper(Mode(2.0, 0.05), 2)
    found = followed(MOVE, Schedule((0.0, 4.0), (shaper, shaper)))
    at = np.linspace(0.003, 14.0, 997)
    assert np.abs(found(at) - shape(MOVE, shaper)(at)).max() < 1e-12


def test_it_jumps_only_where_the_reference_does():
    found = followed(MOVE, rising())
    starts = [segment.start for segment in found.segments]
    ends = [s.level + s.slope * (end - s.start) for s, end in zip(found.segments, [*starts[1:], found.end], strict=True)]
    jumps = [abs(after.level - before) for before, after in zip(ends, found.segments[1:], strict=False)]
    assert sum(jump > 1e-9 for jump in jumps) == 3 * 3 - 1 - 1  # three impulses of three switches; not the first of all, nor the last


def test_the_rigid_body_rests_where_it_should_and_the_mode_swings_less():
    rigid = problem([LinearPlant.from_transfer([1], [1, 0, 0])], Maneuver(Fraction(9), Limits.of(-1, 1)))
    reference, command = following_move(rigid, MOVE, rising())
    assert reference.maneuver_time != MOVE.maneuver_time

    def left(command: Command) -> tuple[float, float, float]:
        """Position and velocity of the rigid body, and energy of an oscillator that the input drives while its frequency varies."""

        def motion(t: float, x: np.ndarray) -> list[float]:
            u = float(command(t))
            return [x[1], u, x[3], u - frequency(t) ** 2 * x[2] - 0.02 * frequency(t) * x[3]]

        x, begin = np.zeros(4), 0.0
        for end in (*command.breakpoints[1:], command.end):
            if end > begin:
                inside = np.nextafter(end, begin)
                x = solve_ivp(motion, (begin, inside), x, rtol=1e-10, atol=1e-12, max_step=0.1).y[:, -1]
                begin = end
        return float(x[0]), float(x[1]), math.hypot(x[2] * frequency(command.end), x[3])

    position, velocity, swing = left(command)
    assert position == pytest.approx(9.0, abs=1e-6)
    assert velocity == pytest.approx(0.0, abs=1e-6)
    fixed = left(shape(MOVE, derivative_shaper(Mode(frequency(0.0), 0.01), 1)))
    assert swing < 0.35 * fixed[2]


def test_what_cannot_be_followed_is_told():
    with pytest.raises(ShaperError, match="constant levels"):
        followed(Command(1.0, (Segment(0.0, 0.0, 1.0),), Tail(1.0)), rising())
    fast = Schedule.of([0.0, 0.1], [Mode(2.0), Mode(0.5)], lambda mode: derivative_shaper(mode, 0))
    with pytest.raises(ShaperError, match="read backwards"):
        followed(MOVE, fast)


@pytest.mark.parametrize(
    ("line", "place", "words"),
    [
        ('follow = { parameter = "lenght", times = [0, 1], values = [8, 7] }', "command.follow.parameter", "length"),
        ('follow = { parameter = "length", times = [1, 0], values = [8, 7] }', "command.follow.times", "ascending"),
        ('follow = { parameter = "length", times = [0, 1], values = [8] }', "command.follow.values", "as many as the times, 2"),
        ('follow = { parameter = "length", times = [0, 0.01], values = [1, 8] }', "command.follow", "read backwards"),
        ('modes = ["1Hz:0"]\nfollow = { parameter = "length", times = [0, 1], values = [8, 7] }', "command.follow", "contradicts modes"),
    ],
)
def test_mistakes_in_a_study_are_told(tmp_path: Path, line: str, place: str, words: str):
    text = (SHIPPED / "gantry_crane_follow_fail.toml").read_text()
    (tmp_path / "study.toml").write_text(text.replace("# follow = nothing: the modes are those of the start", line))
    with pytest.raises(StudyError) as caught:
        design(load_study(tmp_path / "study.toml"))
    (mistake,) = caught.value.mistakes
    assert mistake.path == place
    assert words in mistake.message
