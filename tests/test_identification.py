"""Plants identified from responses that are computed exactly: their poles, their structure, and what noise leaves of them."""

from __future__ import annotations

import numpy as np
import pytest

from fmus.identification import Model, Record, identify, orders, polished, realize
from relaxations.commands import Command, Segment, Tail
from relaxations.plants import LinearPlant
from relaxations.response import response

MODES = LinearPlant.from_modes(0, [(3, "0.02", 1), (10, "0.05", 4)])
FLOATING = LinearPlant.from_modes("0.5", [(2, "0.01", "-0.5")])
UNDAMPED = LinearPlant.from_modes("0.5", [(2, 0, "-0.5")])
LAG = LinearPlant.from_transfer([2], [1, 3])
THROUGH = LinearPlant.from_transfer([1, 1, 5], [1, "0.2", 4])
REALS = LinearPlant.from_transfer([1, 4], [1, 6, 11, 6])
TRIPLE = LinearPlant.from_transfer([1], [1, 0, 0, 0])
EQUAL = LinearPlant.from_transfer([1], [1, 4, 4])
GROWING = LinearPlant.from_transfer([1], [1, 0, -4])
PLANTS = {
    "two modes": MODES,
    "body with a mode": FLOATING,
    "body with an undamped mode": UNDAMPED,
    "lag": LAG,
    "feed-through": THROUGH,
    "three lags and a zero": REALS,
    "triple integrator": TRIPLE,
    "equal lags": EQUAL,
    "unstable": GROWING,
}


def respond(plant: LinearPlant, starts: list[float], levels: list[float], times: np.ndarray, noise: float = 0.0) -> Record:
    segments = tuple(Segment(start, level) for start, level in zip(starts, levels, strict=True))
    command = Command(starts[-1] - starts[0], segments, Tail(levels[-1]))
    exact = response(plant, command, times, before=True)
    dirt = noise * np.abs(exact).max() * np.random.default_rng(0).standard_normal(len(times))
    return Record(times, np.array(starts), np.array(levels), exact + dirt)


def pulse_of(plant: LinearPlant, noise: float = 0.0, samples: int = 200) -> Record:
    step = 2.0 * np.pi / 20.0 / max([abs(pole.value) for pole in plant.poles if pole.value] or [1.0])
    # An unstable plant is looked at until it has grown by some thousand.
    return respond(plant, [0.0, step], [1.0, 0.0], step * np.arange((24 if plant.is_unstable else samples) + 1), noise)


def identified(plant: LinearPlant, noise: float = 0.0) -> Model:
    pulse = pulse_of(plant, noise)
    matrix, _ = realize(pulse)
    model = identify(pulse, matrix, plant.order)
    assert model is not None
    return polished(model, pulse)


@pytest.mark.parametrize("name", PLANTS)
@pytest.mark.parametrize("noise", [0.0, 1e-8])
def test_poles_and_structure_of_known_plants(name: str, noise: float) -> None:
    plant = PLANTS[name]
    model = identified(plant, noise)
    found = [min(model.poles, key=lambda pole: abs(pole.value - exact.value)) for exact in plant.poles]
    assert len(model.poles) == len(plant.poles)
    assert [pole.multiplicity for pole in found] == [pole.multiplicity for pole in plant.poles]
    for pole, exact in zip(found, plant.poles, strict=True):
        # What is structure (at the origin, undamped) is exact; the slowly varying sum of the three lags, the worst, loses three digits.
        assert (pole.value == 0) == (exact.value == 0)
        assert (pole.value.real == 0.0) == (exact.value.real == 0.0)
        assert abs(pole.value - exact.value) <= 2e3 * max(noise, 2e-15) * abs(exact.value)
    assert model.relative_degree == plant.order - plant.numerators["output"].degree()
    assert model.feedthrough == pytest.approx(plant.partial().feedthrough, rel=1e3 * max(noise, 1e-14))
    # On another input, at instants that are no samples.
    step = float(pulse_of(plant).times[1])
    other = respond(plant, [0.3 * step, 7.2 * step, 31.0 * step], [1.0, -0.7, 0.0], step * 0.37 * np.arange(300))
    assert model.error(other) < 1e3 * max(noise, 1e-13)


@pytest.mark.parametrize("name", PLANTS)
def test_matrices_are_the_model(name: str) -> None:
    plant, model = PLANTS[name], identified(PLANTS[name])
    A, B, C, D = model.matrices
    for s in (1.0 + 2.0j, 5.0j, 7.0):
        found = C @ np.linalg.solve(s * np.eye(len(B)) - A, B) + D
        top, bottom = (np.polyval([float(c) for c in p.coeffs()[::-1]], s) for p in (plant.numerators["output"], plant.denominator))
        assert found == pytest.approx(top / bottom, rel=1e-10)


@pytest.mark.slow
def test_errors_of_poles_are_standard_errors() -> None:
    """Over many records the true pole lies as often within one, two and three of them as it should."""
    clean, ratios = pulse_of(MODES), []
    for seed in range(10):
        dirt = 1e-4 * clean.size * np.random.default_rng(seed).standard_normal(len(clean.times))
        record = Record(clean.times, clean.starts, clean.levels, clean.output + dirt)
        model = identify(record, realize(record)[0], 4)
        assert model is not None
        model = polished(model, record)
        for pole, error in zip(sorted(model.poles, key=lambda p: abs(p.value)), sorted(model.spread), strict=True):
            exact = min(MODES.poles, key=lambda p: abs(p.value - pole.value))
            ratios.append(abs(pole.value - exact.value) / error)
    # Of a circle of standard radius √2: 20 of them have a mean near 0.9, and none is far out.
    assert 0.5 < np.mean(ratios) < 1.3
    assert max(ratios) < 4.0


@pytest.mark.slow
def test_the_gap_of_the_singular_values_shows_the_order() -> None:
    for plant in PLANTS.values():
        _, values = realize(pulse_of(plant, 1e-9))
        assert plant.order in orders(values)
        if plant.order < 3:  # beyond the noise there is nothing
            assert values[plant.order] < 1e-6 * values[0]
    assert orders(np.zeros(5)) == (0,)


def test_a_static_plant_has_no_poles() -> None:
    times = 0.1 * np.arange(101)
    pulse = respond(LinearPlant.from_transfer([3], [1]), [0.0, 0.1], [2.0, 0.0], times)
    matrix, values = realize(pulse)
    model = identify(pulse, matrix, 0)
    assert orders(values) == (0,)
    assert model is not None
    assert (model.poles, model.feedthrough) == ((), pytest.approx(3.0, rel=1e-14))
    assert model.matrices[0].shape == (0, 0)


def test_poles_on_the_negative_real_axis_of_the_sampled_plant_are_refused() -> None:
    """A sampled (-0.5)^k: no plant with as many states does that between the samples."""
    times = np.arange(101.0)
    pulse = Record(times, np.array([0.0, 1.0]), np.array([1.0, 0.0]), np.append(0.0, (-0.5) ** np.arange(100.0)))
    matrix, _ = realize(pulse)
    assert identify(pulse, matrix, 1) is None


def test_a_delay_is_no_pole() -> None:
    times = np.arange(101.0)
    output = np.zeros(101)
    output[4:] = 0.8 ** np.arange(97.0)
    pulse = Record(times, np.array([0.0, 1.0]), np.array([1.0, 0.0]), output)
    matrix, values = realize(pulse)
    assert 3 in orders(values)
    assert identify(pulse, matrix, 3) is None


def test_too_little_damping_is_kept_if_the_record_tells_it() -> None:
    """ζ = 1e-6 moves the response by 1e-4 within 20 periods: noise of 1e-7 tells it from none, noise of 1e-3 does not."""
    plant = LinearPlant.from_modes(0, [(2, "0.000001", 1)])
    (kept,) = identified(plant, 1e-7).poles
    assert kept.damping_ratio == pytest.approx(1e-6, rel=0.1)
    rough = identified(plant, 1e-3)
    assert rough.poles[0].value.real == 0.0
    assert any("no damping" in note for note in rough.notes)
