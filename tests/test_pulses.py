"""Pulses in place of impulses: nothing is left at the modes, none are shorter, and commands and streams are what quadrature says."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import linprog

from relaxations.checking.worst import worst_residual
from relaxations.commands import Command, Segment, Tail
from relaxations.errors import ImpossibleShaperError, ShaperError
from relaxations.plants import LinearPlant
from relaxations.response import response
from relaxations.shaping.impulses import derivative_shaper
from relaxations.shaping.kinds import make
from relaxations.shaping.modes import Mode
from relaxations.shaping.pulses import at_intervals, pulsed
from relaxations.shaping.requests import Request
from relaxations.shaping.sampled import sampled
from relaxations.shaping.sensitivity import residual, step_response
from relaxations.shaping.shapers import Pulse, Shaper, as_pulses, convolve, shape
from relaxations.shaping.streams import Stream

ONE, TWO = (Mode(2 * math.pi, 0.05),), (Mode(6.0, 0.05), Mode(17.0, 0.02))


def left(shaper: Shaper, mode: Mode) -> float:
    """What the pulses leave of the mode, by quadrature of the definition."""
    rate = mode.frequency * mode.direction
    total = 0j
    for p in shaper.pulses:
        for part, unit in ((np.real, 1), (np.imag, 1j)):
            total += unit * p.height * quad(lambda t, part=part: part(np.exp(rate * (t - shaper.duration))), p.start, p.start + p.width)[0]
    return abs(total)


@pytest.mark.parametrize(("modes", "height", "derivatives"), [(ONE, 2.0, 0), (ONE, 0.7, 1), (TWO, 3.0, 0)])
def test_pulses_of_one_height_are_the_shortest_on_a_grid_of_another_program_too(modes: tuple[Mode, ...], height: float, derivatives: int):
    found = pulsed(modes, height, derivatives)
    assert found.lower is not None
    assert found.shaper.gain == pytest.approx(1.0, abs=1e-12)
    assert {round(p.height, 9) for p in found.shaper.pulses} == {height}
    assert max(left(found.shaper, mode) for mode in modes) < 1e-12
    duration = found.shaper.duration
    assert found.lower <= duration <= found.lower * (1 + 1e-14)
    # HiGHS: on a grid the largest part of the whole pulse that is reachable; 1 is passed where the duration is.
    cells = 800

    def reachable(duration: float) -> float:
        edges = np.linspace(-duration, 0.0, cells + 1)
        middle, width = (edges[1:] + edges[:-1]) / 2, duration / cells
        table = []
        for mode in modes:
            for power in range(derivatives + 1):
                z = (middle / duration) ** power * np.exp(mode.frequency * mode.direction * middle)
                table += [z.real, z.imag]
        best = linprog(-np.full(cells, width), A_eq=np.array(table), b_eq=np.zeros(len(table)), bounds=(0.0, height))
        return -best.fun

    assert reachable(duration * 0.99) < 1.0 < reachable(duration * 1.01)


@pytest.mark.parametrize(("modes", "interval"), [(ONE, 0.1), (TWO, 0.07)])
def test_pulses_begin_at_the_intervals_given_and_end_before_the_next(modes: tuple[Mode, ...], interval: float):
    found = at_intervals(modes, 3.0, interval)
    starts = np.array([p.start for p in found.shaper.pulses]) / interval
    assert np.abs(starts - starts.round()).max() < 1e-12
    assert all(p.width <= interval * (1 + 1e-12) for p in found.shaper.pulses)
    assert {round(p.height, 8) for p in found.shaper.pulses} == {3.0}
    assert max(left(found.shaper, mode) for mode in modes) < 1e-10
    assert found.lower is not None
    assert found.shaper.duration >= found.lower


def test_impulses_drawn_out_leave_nothing_either_also_on_samples():
    drawn = as_pulses(derivative_shaper(ONE[0], 1), 0.2)
    assert left(drawn, ONE[0]) < 1e-13
    step = 0.05
    stairs = as_pulses(sampled([(mode, 0) for mode in TWO], step).shaper, step)
    assert max(left(stairs, mode) for mode in TWO) < 1e-12
    edges = np.array(stairs.excitation[0]) / step
    assert np.abs(edges - edges.round()).max() < 1e-9


def test_where_a_pulse_ends_is_exact_in_what_is_proven():
    """0.7 and 1e-9 sum to no double: of pulses so narrow what rounding their ends changes is 1e-8 of them."""
    shaper = Shaper((), (), (), (Pulse(0.0, 0.5, 1.0), Pulse(0.7, 1e-9, 0.5e9)))
    times, jumps, order = shaper.exact_excitation
    assert times[-1] == Fraction(0.7) + Fraction(1e-9) != Fraction(shaper.excitation[0][-1])
    point = Fraction(3), Fraction(3)
    found = worst_residual(times, jumps, point, (Fraction(0), Fraction(0)), relative=1e-14, order=order)
    # An edge's half difference: e^{jb} - e^{ja} = 2j sin((b - a)/2) e^{j(a + b)/2} takes nothing from each other.
    drawn = [p.height * 2.0 / 3.0 * math.sin(1.5 * p.width) * np.exp(3j * (p.start + p.width / 2.0)) for p in shaper.pulses]
    assert (found.lower, found.upper) == pytest.approx((abs(sum(drawn)),) * 2, rel=1e-13)
    times, jumps, order = shaper.excitation
    rounded = float(residual(times, jumps, 3.0, 0.0, order)[0])
    assert abs(rounded - found.lower) > 1e-10  # what a proof about rounded ends would be wrong by


def test_the_residual_is_that_of_the_definition_and_its_worst_case_is_proven():
    shaper = as_pulses(derivative_shaper(ONE[0], 0), 0.3)
    times, jumps, order = shaper.excitation
    assert order == 1
    sample = []
    for factor, damping in itertools.product((0.8, 0.93, 1.2), (0.0, 0.04)):
        mode = Mode(ONE[0].frequency * factor, damping)
        value = float(residual(times, jumps, mode.frequency, damping, order)[0])
        assert value == pytest.approx(left(shaper, mode), rel=1e-10)
        sample.append(value)
    exact = [Fraction(t) for t in times], [Fraction(a) for a in jumps]
    band = Fraction(0.8 * ONE[0].frequency), Fraction(1.2 * ONE[0].frequency)
    found = worst_residual(*exact, band, (Fraction(0), Fraction(0.04)), relative=1e-9, order=order)
    fine = max(
        float(residual(times, jumps, np.linspace(0.8, 1.2, 2001) * ONE[0].frequency, z, order).max()) for z in np.linspace(0, 0.04, 21)
    )
    assert max(sample) <= found.upper * (1 + 1e-12)  # rounding of the sample
    assert fine <= found.upper * (1 + 1e-12)
    assert found.lower <= fine * (1 + 1e-4)


def test_shaped_steps_have_slopes_and_rest_where_they_should():
    shaper = as_pulses(derivative_shaper(ONE[0], 1), 0.2)
    command = shape(Command(0.0, (), Tail(2.0)), shaper)
    assert command.maneuver_time == pytest.approx(shaper.duration)
    at = np.linspace(0.0, 2.0, 401)
    expected = [2.0 * sum(p.height * min(max(t - p.start, 0.0), p.width) for p in shaper.pulses) for t in at]
    assert command(at) == pytest.approx(np.array(expected), abs=1e-12)
    omega, zeta = ONE[0].frequency, ONE[0].damping
    plant = LinearPlant.from_transfer([omega**2], [1.0, 2 * zeta * omega, omega**2])
    assert response(plant, command, at) == pytest.approx(2.0 * step_response(*shaper.excitation[:2], omega, zeta, at, 1), abs=1e-9)
    with pytest.raises(ShaperError, match="parabola"):
        shape(Command(1.0, (Segment(0.0, 0.0, 1.0),), Tail(1.0)), shaper)


def test_pulses_and_impulses_are_convolved():
    drawn, other = as_pulses(derivative_shaper(TWO[0], 0), 0.1), derivative_shaper(TWO[1], 0)
    both = convolve(drawn, other)
    assert both.gain == pytest.approx(1.0, abs=1e-14)
    assert max(left(both, mode) for mode in TWO) < 1e-13
    with pytest.raises(ShaperError, match="convolve the impulses first"):
        convolve(drawn, drawn)
    assert Shaper.from_dict(both.to_dict()) == both


def test_a_stream_of_pulses_is_their_integral_whatever_the_blocks():
    shaper, step = as_pulses(derivative_shaper(ONE[0], 1), 0.237), 0.01
    chance = np.random.default_rng(8)
    samples = np.cumsum(chance.normal(size=600)) * 0.1
    whole = Stream(shaper, step, 0.4)(samples)
    stream, parts, begin = Stream(shaper, step, 0.4), [], 0
    while begin < len(samples):
        size = int(chance.integers(0, 60))
        parts.append(stream(samples[begin : begin + size]))
        begin += size
    assert np.array_equal(np.concatenate(parts), whole)
    instants, known = step * np.arange(-300, 600), np.concatenate([np.full(300, 0.4), samples])
    fine = np.linspace(0.0, 1.0, 20001)
    for n in (0, 50, 333, 599):
        total = 0.0
        for p in shaper.pulses:
            line = np.interp(n * step - (p.start + p.width * fine), instants, known)
            total += p.height * p.width * np.trapezoid(line, fine)
        assert whole[n] == pytest.approx(total, abs=1e-6)


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: pulsed([], 1.0), ShaperError, "at least one mode"),
        (lambda: pulsed(ONE, 0.0), ShaperError, "height of a pulse is positive"),
        (lambda: at_intervals(ONE, 1.0, 0.6), ImpossibleShaperError, "half a damped period is 0.5006"),
        (lambda: at_intervals(ONE, 1.0, -1.0), ShaperError, "interval is positive"),
        (lambda: as_pulses(derivative_shaper(ONE[0]), 0.0), ShaperError, "width is positive"),
        (lambda: as_pulses(derivative_shaper(ONE[0]), 1e-9), ShaperError, "ends where doubles do not tell: at least .* is possible"),
        (lambda: Shaper((0.0,), (1.0,), (), (Pulse(0.0, 1.0, 1.0),)), ShaperError, "pulses alone"),
        (lambda: Shaper((), (), (), (Pulse(0.0, 0.0, 1.0),)), ShaperError, "a pulse lasts"),
        (lambda: Shaper((), (), (), (Pulse(0.0, 0.5, 1.0),)), ShaperError, "integrals of the pulses sum to 1"),
    ],
)
def test_mistakes_are_named(call, error: type[Exception], words: str):
    with pytest.raises(error, match=words):
        call()


def test_the_command_line_makes_them(tmp_path: Path):
    import json

    from click.testing import CliRunner

    from suite.cli import main

    def run(*words: str):
        return CliRunner().invoke(main, ["shaper", *words], catch_exceptions=False)

    words = ("pulses-zvd", "--mode", "1Hz:0.05", "--height", "2")
    found = json.loads(run(*words, "--json").stdout)
    assert found["times"] == []
    assert found["least_duration"]["lower"] <= found["duration"] <= found["least_duration"]["lower"] * (1 + 1e-14)
    assert run(*words, "--plot", str(tmp_path / "p.svg"), "--save", str(tmp_path / "p.json")).exit_code == 0
    again = json.loads(run("custom", "--mode", "1Hz:0.05", "--impulses", str(tmp_path / "p.json"), "--json").stdout)
    assert again["pulses"] == found["pulses"]
    assert again["worst_residual"] == found["worst_residual"]
    refused = run(*words, "--export", str(tmp_path / "p.cfg"))
    assert refused.exit_code == 2
    assert "this shaper is made of pulses" in refused.stderr
    drawn = json.loads(run("zv", "--mode", "1Hz:0", "--pulse", "0.1", "--json").stdout)
    assert drawn["duration"] == pytest.approx(0.6)
    assert drawn["least_duration"]["lower"] == pytest.approx(0.6, abs=1e-7)
    bands = ("si", "--mode", "1Hz:0.05", "--band", "0.9:1.1@0.01", "--band", "0.7:1.3@0.2", "--json")
    for band in json.loads(run(*bands).stdout)["bands"]:
        assert band["worst_residual"][1] <= band["tolerance"]
    assert run(*bands[:3], "--mode", "3Hz:0", "--band", "1:1.1", "--band", "1:1.2", "--band", "1:1.3").exit_code == 2


@pytest.mark.parametrize(("first", "second", "height", "interval", "derivatives"), [(0.4, 1.3, 3.0, 0.06, 0), (0.5, 1.3, 2.0, 0.09, 1)])
def test_pulses_on_intervals_hold_no_dust(first: float, second: float, height: float, interval: float, derivatives: int):
    """Of 29 and 26 pulses that a solver made some lasted 1e-8 of an interval, and the height of all made up for those left out."""
    modes = [Mode(2 * math.pi * first, 0.05), Mode(2 * math.pi * second, 0.01)]
    shaper = at_intervals(modes, height, interval, derivatives).shaper
    assert min(pulse.width for pulse in shaper.pulses) > 1e-2 * interval
    assert [pulse.height for pulse in shaper.pulses] == pytest.approx([height] * len(shaper.pulses), rel=1e-12)
    assert max(left(shaper, mode) for mode in modes) < 1e-11


@pytest.mark.parametrize(("kind", "width", "proven"), [("zvd", 0.1, True), ("zvd", 1.0, False), ("si", 0.1, True), ("si", 0.9, False)])
def test_why_nothing_is_proven_of_pulses_is_said(kind: str, width: float, proven: bool):
    """Pulses of whole periods leave nothing by themselves, and of 0.9 periods less than the tolerance somewhere in the band."""
    made = make(kind, Request((Mode(2 * math.pi),), pulse=width))
    assert (made.least is not None) == proven
    assert any("says nothing of pulses" in note for note in made.notes) != proven
