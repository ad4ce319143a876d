"""Shapers: their file, their convolution, and the commands that they make, against quadrature and known answers."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from independent_shaping import known_shapers, shaped, shaped_command

from relaxations.commands import Command, Segment, Tail, TailTerm
from relaxations.errors import ShaperError
from relaxations.plants import LinearPlant
from relaxations.response import response
from relaxations.shaping.shapers import Shaper, ShaperTerm, convolve, shape

SHAPERS = known_shapers()
STEP = Command(0.0, (), Tail(1.0))
MOVE = Command(3.0, (Segment(0.2, 2.0), Segment(1.2, -1.0, 0.5), Segment(2.2, 0.25)), Tail(0.5))  # starts, slopes and ends off zero
OFF_SWITCHES = (0.1, 0.33, 0.9, 1.31, 2.13, 2.77, 3.41, 4.9, 7.3, 15.1)


def residual(shaper: Shaper, frequency: float, damping: float) -> float:
    """V = |Σ A e^{(ζω + jω_d)(t - t_n)}|, from the definition."""
    rate = complex(damping * frequency, frequency * math.sqrt(1 - damping**2))
    t, a = np.array(shaper.times), np.array(shaper.amplitudes)
    return abs(np.sum(a * np.exp(rate * (t - t[-1]))))


def zv(frequency: float, damping: float) -> Shaper:
    k = math.exp(-damping * math.pi / math.sqrt(1 - damping**2))
    return Shaper((0.0, math.pi / (frequency * math.sqrt(1 - damping**2))), (1 / (1 + k), k / (1 + k)))


@pytest.mark.parametrize("name", SHAPERS)
def test_file_and_back(name: str) -> None:
    shaper = SHAPERS[name]
    assert Shaper.from_json(json.dumps(shaper.to_dict())) == shaper


def test_impulses_alone_are_a_file_and_further_members_are_left_alone() -> None:
    text = '{"format": "slewcert-shaper/1", "times": [0, 0.5], "amplitudes": [0.5, 0.5], "insensitivity": {"0.05": 0.06}}'
    assert Shaper.from_json(text) == Shaper((0.0, 0.5), (0.5, 0.5))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: Shaper((0.0, 0.5), (0.5, 0.4)), "amplitudes sum to 1, not to 0.9"),
        (lambda: Shaper((0.0, 0.5), (1.0,)), "2 times and 1 amplitudes"),
        (lambda: Shaper((0.1, 0.5), (0.5, 0.5)), "begins at 0 s; this one at 0.1 s"),
        (lambda: Shaper((0.0, 0.5, 0.5), (0.5, 0.25, 0.25)), r"ascending order: 0\.5 s follows 0\.5 s"),
        (lambda: Shaper((), ()), "this one is empty"),
        (lambda: Shaper((0.0, math.inf), (0.5, 0.5)), "finite numbers only"),
        (lambda: Shaper((0.0,), (0.5,), (ShaperTerm(0.0, 0j, 0, 1 + 0j),)), "decays: rate 0j with power 0 does not"),
        (lambda: Shaper((0.0,), (0.5,), (ShaperTerm(0.0, -1 + 0j, -1, 1 + 0j),)), "with power -1 does not"),
        (lambda: Shaper((0.0,), (0.5,), (ShaperTerm(0.0, -2 + 0j, 0, 2 + 0j),)), "integrals of the terms sum to 1, not to 1.5"),
        (lambda: Shaper((0.5, 0.2), (0.5, 0.4)), "ascending order: .*; a shaper begins at 0 s.*; amplitudes sum to 1"),
        (lambda: Shaper.from_json("{"), "is JSON"),
        (lambda: Shaper.from_json("[" * 100_000), "is JSON"),
        (lambda: Shaper.from_json("[]"), "this one has 'list'"),
        (lambda: Shaper.from_json('{"format": "slewcert-command/1"}'), "this one has 'slewcert-command/1'"),
        (lambda: Shaper.from_dict({"format": "slewcert-shaper/1", "times": [0]}), "malformed shaper file: KeyError 'amplitudes'"),
        (lambda: Shaper.from_dict({"format": "slewcert-shaper/1", "times": 0, "amplitudes": []}), "malformed shaper file: TypeError"),
    ],
)
def test_mistakes_are_named(call: Callable[[], Any], words: str) -> None:
    with pytest.raises(ShaperError, match=words):
        call()


@given(
    st.lists(st.tuples(st.floats(0.5, 20.0), st.floats(0.0, 0.3)), min_size=2, max_size=4, unique_by=lambda mode: round(mode[0], 1)),
)
def test_what_is_convolved_is_still_at_every_mode(modes: list[tuple[float, float]]) -> None:
    shaper = zv(*modes[0])
    for mode in modes[1:]:
        shaper = convolve(shaper, zv(*mode))
    assert shaper.gain == pytest.approx(1.0, abs=1e-14)
    for frequency, damping in modes:
        # at the last impulse of up to sixteen; a growth of e^{ζω t_n} before it magnifies the rounding of the first ones
        growth = math.exp(damping * frequency * shaper.duration)
        assert residual(shaper, frequency, damping) < 1e-13 * growth


def test_zvd_is_zv_twice() -> None:
    k = math.exp(-0.1 * math.pi / math.sqrt(0.99))
    twice = convolve(zv(3.0, 0.1), zv(3.0, 0.1))
    assert twice.times == pytest.approx([0.0, *(n * math.pi / (3.0 * math.sqrt(0.99)) for n in (1, 2))], rel=1e-15)
    assert twice.amplitudes == pytest.approx(np.array([1, 2 * k, k * k]) / (1 + k) ** 2, rel=1e-15)


@pytest.mark.parametrize("second", SHAPERS)
@pytest.mark.parametrize("first", SHAPERS)
def test_convolution_is_one_after_the_other(first: str, second: str) -> None:
    """The joint shaper on a step, against the second on what the first makes of it, both by quadrature."""
    one, other = SHAPERS[first], SHAPERS[second]
    both = convolve(one, other)
    assert both.gain == pytest.approx(1.0, abs=2e-6)  # these shapers have ten digits each

    def step(t: Any) -> Any:
        return np.where(np.asarray(t) >= 0.0, 1.0, 0.0)

    def after_first(t: Any) -> Any:
        return np.array([shaped(one, step, [0.0], x) if x >= 0.0 else 0.0 for x in t])

    breaks = sorted({0.0, *one.times, *(term.start for term in one.terms)})
    for time in (0.17, 1.9, 4.3):
        expected = shaped(other, after_first, breaks, time)
        assert shaped(both, step, [0.0], time) == pytest.approx(expected, abs=2e-13), time  # two quadratures of 1e-14 each, and their sums


@pytest.mark.parametrize("rest", [0.0, -0.75])
@pytest.mark.parametrize("name", ["zv", "negative", "two modes", "one impulse"])
def test_impulses_shape_any_command_of_segments(name: str, rest: float) -> None:
    done = shape(MOVE, SHAPERS[name], rest)
    assert done(OFF_SWITCHES, rest) == pytest.approx(shaped_command(SHAPERS[name], MOVE, OFF_SWITCHES, rest), abs=1e-14)
    assert done.start == MOVE.start
    assert done.end == pytest.approx(MOVE.end + SHAPERS[name].duration, rel=1e-15)


@pytest.mark.parametrize("rest", [0.0, 0.5])
@pytest.mark.parametrize("name", ["pole-zero", "repeated"])
def test_a_shaped_step_may_have_a_tail(name: str, rest: float) -> None:
    done = shape(STEP, SHAPERS[name], rest)
    assert done.tail.terms
    assert done.tail.steady == pytest.approx(1.0, abs=1e-15)
    assert done(OFF_SWITCHES, rest) == pytest.approx(shaped_command(SHAPERS[name], STEP, OFF_SWITCHES, rest), abs=1e-14)


def test_a_command_with_a_tail_meets_a_filter() -> None:
    """Tail on term of the same rate (a power more) and of another; all exponentials begin at the end."""
    command = Command(0.0, (), Tail(1.0, (TailTerm(-4 + 0j, 0, -0.5 + 0j), TailTerm(-1 + 2j, 1, 0.3 - 0.1j))))
    shaper = Shaper((0.0,), (0.5,), (ShaperTerm(0.0, -4 + 0j, 0, 2 + 0j),))
    done = shape(command, shaper)
    assert {(t.rate, t.power) for t in done.tail.terms} == {(-4 + 0j, 0), (-4 + 0j, 1), (-1 + 2j, 0), (-1 + 2j, 1)}
    assert done(OFF_SWITCHES) == pytest.approx(shaped_command(shaper, command, OFF_SWITCHES), abs=1e-14)


def test_exponentials_before_the_last_switch_are_no_command() -> None:
    with pytest.raises(ShaperError, match=r"decaying terms from 2\.36.* s on and goes on switching until 4\.36.* s.*FMU"):
        shape(Command(2.0, (Segment(0.0, 1.0),), Tail(0.0)), SHAPERS["pole-zero"])
    with pytest.raises(ShaperError, match="goes on switching"):
        shape(STEP, SHAPERS["filter"])


def test_the_pole_zero_shaper_brings_the_pitch_plant_to_rest() -> None:
    """Known answer: this plant's output stands still from the last impulse on, while its input still decays along the zero."""
    plant = LinearPlant.from_transfer(["1.151", "0.1774"], ["1", "0.739", "2.072", "0.1774"])
    done = shape(STEP, SHAPERS["pole-zero"])
    times = np.linspace(done.end, done.end + 20.0, 50)
    # the amplitudes have ten digits
    assert response(plant, done, times) == pytest.approx(np.full(50, 1.0), abs=1e-8)
    assert float(done.tail(0.0)) > 1.05


def test_a_shaped_move_leaves_a_flexible_plant_still() -> None:
    plant = LinearPlant.from_transfer(["4"], ["1", "0.4", "4"])
    done = shape(MOVE, zv(2.0, 0.1))
    times = np.linspace(done.end, done.end + 20.0, 50)
    assert response(plant, done, times) == pytest.approx(np.full(50, 0.5), abs=1e-13)
    assert np.abs(response(plant, MOVE, times) - 0.5).max() > 0.01, "the move alone leaves it swinging"
