"""Commands: values between and at the jumps, fuel, shifting, and the command file."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from relaxations.commands import FORMAT, Command, Segment, Tail, TailTerm
from relaxations.errors import CommandError

BANG_BANG = Command(2.0, (Segment(0.0, 1.0), Segment(1.0, -1.0)), Tail(0.0))
SLOPING = Command(
    3.0,
    (Segment(0.5, 2.0, -2.0), Segment(2.0, 0.25), Segment(3.0, -1.0, 0.5)),
    Tail(0.5, (TailTerm(-1.0 + 2.0j, 1, 0.3 - 0.1j), TailTerm(-0.5 + 0.0j, 0, 1.0 + 0.0j))),
)
TAIL_ONLY = Command(0.0, (), Tail(2.0, (TailTerm(-1.0 + 0.0j, 0, -2.0 + 0.0j),)))


def test_a_jump_belongs_to_what_follows_it():
    times = np.array([-1.0, 0.0, math.nextafter(1.0, 0.0), 1.0, math.nextafter(2.0, 0.0), 2.0, 9.0])
    np.testing.assert_array_equal(BANG_BANG(times, rest=7.0), [7.0, 1.0, 1.0, -1.0, -1.0, 0.0, 0.0])


def test_slopes_count_from_their_own_segments_start():
    np.testing.assert_array_equal(SLOPING([0.0, 0.5, 1.5, 2.0, 3.0, 3.25], rest=0.5), [0.5, 2.0, 0.0, 0.25, -1.0, -0.875])


def test_the_tail_counts_from_the_end_of_the_move():
    assert SLOPING.start == 0.5
    assert SLOPING.end == 3.5
    r = 0.7
    expected = 0.5 + ((0.3 - 0.1j) * r * np.exp((-1 + 2j) * r)).real + math.exp(-0.5 * r)
    assert float(SLOPING(3.5 + r)) == pytest.approx(expected, rel=1e-14)  # a few roundings


def test_breakpoints_are_ascending_and_hold_start_and_end():
    assert SLOPING.breakpoints == (0.5, 2.0, 3.0, 3.5)
    assert TAIL_ONLY.breakpoints == (0.0,)


def test_a_command_without_segments_is_its_tail():
    np.testing.assert_allclose(TAIL_ONLY([0.0, 1.0]), [0.0, 2.0 - 2.0 * math.exp(-1.0)], rtol=1e-15)
    assert TAIL_ONLY.fuel() == 0.0


@pytest.mark.parametrize("rest", [-1.5, 0.0, 0.25, 3.0])
def test_fuel_is_the_integral_of_the_distance_from_rest(rest: float):
    pieces = [(*BANG_BANG.breakpoints, BANG_BANG), (*SLOPING.breakpoints, SLOPING)]
    for *points, command in pieces:
        # Trapezoids on 60 000 points: exact on straight pieces, but for the cells with a kink, at most 3 of (5e-5)² · slope.
        fine = np.unique(np.concatenate([np.linspace(a, math.nextafter(b, a), 20_000) for a, b in itertools.pairwise(points)]))
        values = np.abs(command(fine, rest) - rest)
        assert command.fuel(rest) == pytest.approx(float(np.trapezoid(values, fine)), abs=2e-8)


def test_fuel_with_slopes_by_quadrature():
    exact = sum(
        quad(lambda t: abs(float(SLOPING(t))), a, b, points=[1.5] if a < 1.5 < b else None)[0]
        for a, b in [(0.5, 2.0), (2.0, 3.0), (3.0, 3.5)]
    )
    assert SLOPING.fuel() == pytest.approx(exact, rel=1e-9)


def test_shifting_moves_the_segments_and_leaves_the_rest():
    later = SLOPING.shifted(0.25)  # exact in binary
    assert later.maneuver_time == SLOPING.maneuver_time
    assert later.end == SLOPING.end + 0.25
    times = np.linspace(0.0, 5.0, 41)
    np.testing.assert_array_equal(later(times + 0.25, rest=0.5), SLOPING(times, rest=0.5))


def test_commands_cannot_be_changed():
    with pytest.raises(FrozenInstanceError):
        BANG_BANG.maneuver_time = 1.0  # type: ignore[misc]


@pytest.mark.parametrize("command", [BANG_BANG, SLOPING, TAIL_ONLY], ids=["bang_bang", "sloping", "tail_only"])
def test_the_command_file_keeps_every_bit(command: Command):
    text = json.dumps(command.to_dict())
    assert Command.from_json(text) == command


finite = st.floats(-1e6, 1e6)


@given(
    st.lists(st.tuples(st.floats(1e-6, 10.0), finite, finite), min_size=1, max_size=6),
    st.lists(st.tuples(st.floats(-50.0, -1e-6), finite, st.integers(0, 3), finite, finite), max_size=3),
    finite,
)
def test_any_command_survives_its_file(pieces: list, terms: list, steady: float):
    starts = np.cumsum([0.0] + [width for width, _, _ in pieces])
    segments = tuple(Segment(float(s), level, slope) for s, (_, level, slope) in zip(starts, pieces, strict=False))
    tail = Tail(steady, tuple(TailTerm(complex(re, im), power, complex(x, y)) for re, im, power, x, y in terms))
    command = Command(float(starts[-1]), segments, tail)
    assert Command.from_json(json.dumps(command.to_dict())) == command


@pytest.mark.parametrize(
    ("time", "segments", "tail", "said"),
    [
        (1.0, (), Tail(0.0), "without segments"),
        (-1.0, (Segment(0.0, 1.0),), Tail(0.0), "negative"),
        (math.nan, (Segment(0.0, 1.0),), Tail(0.0), "finite"),
        (1.0, (Segment(0.0, math.inf),), Tail(0.0), "finite"),
        (1.0, (Segment(0.0, 1.0),), Tail(math.nan), "finite"),
        (1.0, (Segment(0.0, 1.0), Segment(0.0, 2.0)), Tail(0.0), "ascending"),
        (1.0, (Segment(0.5, 1.0), Segment(0.25, 2.0)), Tail(0.0), "ascending"),
        (1.0, (Segment(0.0, 1.0), Segment(1.5, 2.0)), Tail(0.0), "within"),
        (1.0, (Segment(-0.5, 1.0),), Tail(0.0), "within"),
        (1.0, (Segment(0.0, 1.0),), Tail(0.0, (TailTerm(0.0 + 1.0j, 0, 1.0 + 0.0j),)), "decays"),
        (1.0, (Segment(0.0, 1.0),), Tail(0.0, (TailTerm(-1.0 + 0.0j, -1, 1.0 + 0.0j),)), "decays"),
    ],
)
def test_malformed_commands_are_refused(time: float, segments: tuple[Segment, ...], tail: Tail, said: str):
    with pytest.raises(CommandError, match=said):
        Command(time, segments, tail)


GOOD = BANG_BANG.to_dict()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "JSON"),
        ("[]", "format"),
        ("3", "format"),
        (json.dumps({**GOOD, "format": "slewcert-command/2"}), FORMAT),
        (json.dumps({**GOOD, "maneuver_time": "soon"}), "malformed"),
        (json.dumps({**GOOD, "maneuver_time": 10**400}), "malformed"),
        (json.dumps({**GOOD, "maneuver_time": math.nan}), "finite"),
        (json.dumps({**GOOD, "segments": 3}), "malformed"),
        (json.dumps({**GOOD, "segments": [{"level": 1.0}]}), "malformed"),
        (json.dumps({k: v for k, v in GOOD.items() if k != "tail"}), "malformed"),
        (json.dumps({**GOOD, "tail": {"steady": 0.0, "terms": [{"rate": [-1.0], "coefficient": [1.0, 0.0]}]}}), "malformed"),
        (json.dumps({**GOOD, "tail": {"steady": 0, "terms": [{"rate": [-1, 0], "power": 0.5, "coefficient": [1, 0]}]}}), "malformed"),
    ],
)
def test_malformed_files_say_what_is_wrong(text: str, said: str):
    with pytest.raises(CommandError, match=said):
        Command.from_json(text)


def test_a_slope_and_terms_may_be_left_out_of_a_file():
    text = json.dumps({"format": FORMAT, "maneuver_time": 1, "segments": [{"start": 0, "level": 1}], "tail": {"steady": 0}})
    assert Command.from_json(text) == Command(1.0, (Segment(0.0, 1.0),), Tail(0.0))
