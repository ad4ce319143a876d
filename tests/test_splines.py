"""Splines: shaped in closed form, against the definition of the convolution, quadrature and dense samples; their files and mistakes."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from independent_shaping import known_shapers, shaped
from scipy.interpolate import BSpline, CubicSpline

from relaxations.errors import CommandError, ShaperError
from relaxations.shaping.impulses import derivative_shaper
from relaxations.shaping.modes import Mode
from relaxations.shaping.shapers import as_pulses, shape
from relaxations.shaping.splines import Spline, shape_spline
from relaxations.shaping.streams import Stream

MODE = Mode(2 * math.pi, 0.05)
CHANCE = np.random.default_rng(11)
JUMPING = Spline(np.array([0.2, 0.7, 1.9, 2.4]), CHANCE.normal(size=(3, 4)), 0.4)  # jumps of every order at every knot
MOVE = Spline.through([0.0, 0.5, 1.2, 2.0], [0.0, 0.3, 0.9, 1.0])
SHAPERS = {
    "zvd": derivative_shaper(MODE, 1),
    "negative": known_shapers()["negative"],
    "pulses": as_pulses(derivative_shaper(MODE, 1), 0.13),
    "one impulse": known_shapers()["one impulse"],
}


@pytest.mark.parametrize("name", SHAPERS)
@pytest.mark.parametrize("spline", [JUMPING, MOVE], ids=["jumping", "smooth"])
def test_a_shaped_spline_is_the_convolution(spline: Spline, name: str):
    """Against the definition with quadrature (which integrates cubics exactly), at instants that are no knots."""
    done = shape_spline(spline, SHAPERS[name])
    assert done.degree == spline.degree + (name == "pulses")
    for time in (-0.5, 0.0, 0.31, 0.777, 1.31, 2.03, 2.71, 3.3, 9.0):
        expected = shaped(SHAPERS[name], spline, spline.knots.tolist(), time, spline.rest)
        assert float(done(time)) == pytest.approx(expected, abs=2e-14 * 50), time  # sums of some tens of numbers of order one


@pytest.mark.parametrize("name", ["zvd", "negative"])
def test_densely_sampled_it_is_what_the_stream_makes_of_the_samples(name: str):
    """The stream reads lines between samples: it is off by r'' h²/8 at most."""
    shaper, spline = SHAPERS[name], MOVE
    bend = max(abs(CubicSpline([0.0, 0.5, 1.2, 2.0], [0.0, 0.3, 0.9, 1.0], bc_type="clamped").derivative(2)(np.linspace(0, 2, 2001))))
    for step in (0.004, 0.002):
        at = step * np.arange(round(4.0 / step))
        missed = np.abs(Stream(shaper, step, spline.rest)(spline(at)) - shape_spline(spline, shaper)(at)).max()
        assert 0.0 < missed <= bend * step**2 / 8.0 * np.abs(shaper.amplitudes).sum() * (1 + 1e-6)


def test_jumps_of_derivatives_are_kept_and_weighted():
    shaper = SHAPERS["zvd"]
    done = shape_spline(JUMPING, shaper)
    assert done.communication_points == pytest.approx(np.unique(np.add.outer(shaper.times, JUMPING.knots)), abs=1e-15)
    for order in range(4):
        instants, jumps = JUMPING.jumps(order)
        assert len(instants) == (4 if order else 3)  # it is held at the end: the value does not jump there, derivatives do
        expected = sorted(
            (t + d, a * jump) for t, jump in zip(instants, jumps, strict=True) for d, a in zip(shaper.times, shaper.amplitudes, strict=True)
        )
        found = sorted(zip(*done.jumps(order), strict=True))
        assert np.array(found) == pytest.approx(np.array(expected), abs=1e-11)
    # A smooth one has jumps of its second derivative at its ends, and of its third at all knots.
    assert len(MOVE.jumps(0)[0]) == len(MOVE.jumps(1)[0]) == 0
    assert MOVE.jumps(2)[0] == pytest.approx([0.0, 2.0])
    assert MOVE.jumps(3)[0] == pytest.approx(MOVE.knots)


def test_it_leaves_the_mode_at_rest_as_the_shaper_says():
    """The mode's phasor at the end, ∫ r'(t) e^{-pt} dt in closed form by parts: jumps of derivatives over powers of the pole."""

    def left(spline: Spline) -> float:
        p = MODE.pole
        return abs(
            sum(
                jump * np.exp(-p * t) / p**order for order in range(spline.degree + 1) for t, jump in zip(*spline.jumps(order), strict=True)
            )
        )

    assert left(JUMPING) > 0.1
    assert left(shape_spline(JUMPING, derivative_shaper(MODE))) < 1e-12


def test_b_splines_are_those_of_scipy():
    knots, degree = np.array([0, 0, 0, 0, 0.5, 0.5, 1.1, 2, 2, 2, 2]), 3
    weights = CHANCE.normal(size=len(knots) - degree - 1)
    mine, theirs = Spline.b_spline(knots, weights, degree), BSpline(knots, weights, degree)
    at = np.linspace(0.0, 1.999, 500)
    assert mine(at) == pytest.approx(theirs(at), abs=1e-13)
    assert (float(mine(-1.0)), float(mine(7.0))) == pytest.approx((weights[0], weights[-1]))
    assert mine.knots == pytest.approx([0.0, 0.5, 1.1, 2.0])
    uniform = Spline.b_spline(np.arange(9.0), weights[:5], 3)  # not clamped: its base interval is [3, 5]
    assert uniform.knots == pytest.approx([3.0, 4.0, 5.0])
    assert uniform(np.array([3.3, 4.9])) == pytest.approx(BSpline(np.arange(9.0), weights[:5], 3)([3.3, 4.9]), abs=1e-14)


def test_points_are_joined_smoothly_and_begin_and_end_at_rest():
    t, y = [0.0, 0.5, 1.2, 2.0], [0.0, 0.3, 0.9, 1.0]
    at = np.linspace(0.0, 1.999, 400)
    assert MOVE(at) == pytest.approx(CubicSpline(t, y, bc_type="clamped")(at), abs=1e-14)
    assert Spline.through(t, y, degree=1)(at) == pytest.approx(np.interp(at, t, y), abs=1e-14)
    assert (MOVE.rest, MOVE.final) == pytest.approx((0.0, 1.0))


def test_files_and_back():
    for spline in (JUMPING, MOVE):
        again = Spline.from_json(json.dumps(spline.to_dict()))
        assert np.array_equal(again.knots, spline.knots)
        assert np.array_equal(again.coefficients, spline.coefficients)
        assert again.rest == spline.rest
    by_points = Spline.from_dict({"format": "slewcert-spline/1", "points": [[0, 0], [0.5, 0.3], [1.2, 0.9], [2, 1]]})
    assert by_points.coefficients == pytest.approx(MOVE.coefficients)
    by_weights = Spline.from_dict({"format": "slewcert-spline/1", "degree": 1, "knots": [0, 0, 1, 1], "coefficients": [0, 2]})
    assert by_weights(0.25) == pytest.approx(0.5)


@pytest.mark.slow
def test_lines_are_as_close_as_they_say_and_switch_at_every_knot():
    for spline in (JUMPING, MOVE):
        for accuracy in (1e-3, 1e-6):
            command = spline.lines(accuracy)
            at = np.linspace(0.0, 3.0, 20011)
            size = np.abs(spline(at) - spline.rest).max()
            assert np.abs(command(at, spline.rest) - spline(at)).max() <= 3.0 * accuracy * size  # the bound's size is that of all terms
            assert set(spline.knots.tolist()) <= set(command.breakpoints)
    # And shaped it is what the shaped spline is.
    shaper, at = SHAPERS["zvd"], np.linspace(0.0, 4.0, 997)
    assert shape(MOVE.lines(1e-8), shaper, MOVE.rest)(at, MOVE.rest) == pytest.approx(shape_spline(MOVE, shaper)(at), abs=3e-8)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"format": "slewcert-command/1"}, ["slewcert-spline/1", "slewcert-command/1"]),
        ({"knots": [0, 1]}, ["KeyError 'coefficients'"]),
        ({"knots": [0, 1, 1], "coefficients": [[1], [2]]}, ["1.0 s follows 1.0 s"]),
        ({"knots": [-1, 1], "coefficients": [[1]]}, ["begins at 0 s or later, not at -1.0 s"]),
        ({"knots": [0, 1], "coefficients": [[1], [2]]}, ["n + 1 knots"]),
        ({"knots": [0, 1], "coefficients": [[1, float("nan")]]}, ["finite"]),
        ({"knots": [0, 1], "coefficients": [[0] * 30]}, ["at most 20, not 29"]),
        ({"knots": [0, 1], "coefficients": []}, ["n + 1 knots"]),
        ({"points": [[0, 1]]}, ["two points"]),
        ({"points": [[0, 1], [0, 2]]}, ["0.0 s follows 0.0 s"]),
        ({"points": [[0, 1], [1, 2]], "degree": 2}, ["not by degree 2"]),
        ({"degree": 3, "knots": [0, 1], "coefficients": [1]}, ["B-spline of degree 3"]),
        ({"degree": -1, "knots": [0, 1], "coefficients": [1]}, ["B-spline of degree -1"]),
        ({"knots": [0, 1], "coefficients": [["a"]]}, ["could not convert"]),
    ],
)
def test_mistakes_are_named(data: dict[str, object], words: list[str]):
    with pytest.raises(CommandError) as caught:
        Spline.from_dict({"format": "slewcert-spline/1", **data})
    assert [word for word in words if word not in str(caught.value)] == []


def test_a_shaper_with_decaying_terms_makes_no_spline():
    with pytest.raises(ShaperError, match="FMU"):
        shape_spline(MOVE, known_shapers()["pole-zero"])
