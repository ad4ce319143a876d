"""Filters with poles on a stream of samples: blocks against the whole, quadrature, and a plant that they leave at rest."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from marks import slow
from scipy.signal import cont2discrete, lfilter

from relaxations.cancelling.closed_forms import pole_first, pole_last
from relaxations.cancelling.prefilters import Prefilter
from relaxations.cancelling.requests import Request, cancelling
from relaxations.errors import ShaperError
from relaxations.plants import LinearPlant
from relaxations.shaping.modes import Mode
from relaxations.shaping.shapers import ShaperTerm
from relaxations.shaping.streams import Schedule, Stream, VaryingStream

MIXED = Prefilter(
    (0.0, 0.37, 1.0),
    (0.3, 0.2, 0.1),
    (ShaperTerm(0.37, -0.8 + 2j, 1, 0.3 - 0.2j), ShaperTerm(1.0, -0.5 + 0j, 2, 0.4 + 0j), ShaperTerm(0.0, -3 + 0j, 0, 0.4 + 0j)),
)
FILTERS = {
    "mixed": MIXED,
    "pole last": pole_last(Mode(1.4, 0.02), [-1.0]),
    "pole first": pole_first(Mode(1.4, 0.02), [-1.0]),
    "repeated": pole_last(Mode(2.0, 0.1), [-0.7, -0.7]),
    "a shaper": pole_last(Mode(2.0, 0.1), [-0.7 + 1j, -0.7 - 1j]).shaper(),
}


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("seed", range(3))
def test_blocks_are_the_whole_to_the_last_bit(name: str, seed: int) -> None:
    random = np.random.default_rng(seed)
    samples, step = random.normal(size=700), float(random.uniform(0.01, 0.3))
    whole = Stream(FILTERS[name], step, rest=0.7)(samples)
    running, at, parts = Stream(FILTERS[name], step, rest=0.7), 0, []
    while at < len(samples):
        count = int(random.integers(0, 40))
        parts.append(running(samples[at : at + count]))
        at += count
    assert np.array_equal(np.concatenate(parts), whole)


def test_the_memory_is_bounded() -> None:
    running = Stream(MIXED, 0.01)
    for _ in range(50):
        running(np.ones(200))
    assert len(running._memory) == 101  # the last delay, and one sample


@pytest.mark.parametrize("step", [slow(0.1), slow(0.083)])
def test_it_is_the_convolution_with_lines_between_samples(step: float) -> None:
    random = np.random.default_rng(5)
    samples = random.normal(size=200)
    found = Stream(MIXED, step, rest=0.5)(samples)
    times = step * np.arange(200)

    def reference(t: Any) -> Any:
        return np.interp(t, np.r_[-step, times], np.r_[0.5, samples])

    lags = np.linspace(0.0, 64.0, 1_600_001)  # e^{-0.5·64} is left; the trapezoidal rule errs by some 2e-8 at 500 kinks: h² weighted
    for n in range(3, 200, 64):
        expected = sum(gain * reference(np.array([times[n] - delay]))[0] for delay, gain in zip(MIXED.delays, MIXED.gains, strict=True))
        for term in MIXED.terms:
            weight = (term.coefficient * lags**term.power * np.exp(term.rate * lags)).real
            expected += np.trapezoid(weight * reference(times[n] - term.start - lags), lags)
        assert found[n] == pytest.approx(expected, abs=5e-8)


def test_at_rest_it_is_the_static_gain() -> None:
    assert Stream(MIXED, 0.07, rest=2.0)(np.full(5, 2.0)) == pytest.approx(2.0 * MIXED.gain, rel=1e-12)


def test_any_reference_leaves_the_plant_at_rest_once_it_stands_still() -> None:
    """The filtered samples drive the plant, lines between them, by an independent discretisation (first-order hold)."""
    plant = LinearPlant.from_transfer(["1.151", "0.1774"], [1, "0.739", "2.072", "0.1774"])
    done = cancelling(plant, Request(1, "last+step"))
    step = 1e-3
    times = step * np.arange(9000)
    reference = np.where(times < 2.0, 0.1 * times**2 + 0.2 * np.sin(3.0 * times), 0.1 * 4.0 + 0.2 * np.sin(6.0))
    driven = Stream(done, step)(reference)
    system: Any = cont2discrete(([1.151, 0.1774], [1, 0.739, 2.072, 0.1774]), step, method="foh")

    def answer(transfer: Any, samples: np.ndarray) -> Any:
        return lfilter(np.ravel(transfer[0]), np.ravel(transfer[1]), samples)

    late = answer(system, driven)[times > 2.0 + done.duration + 2 * step]
    assert np.abs(late - reference[-1]).max() < 1e-6  # h² of what lines between samples leave of the exponential
    assert np.abs(answer(system, reference)[times > 2.0 + done.duration] - reference[-1]).max() > 0.1


def test_what_cannot_be_streamed_is_told() -> None:
    with pytest.raises(ShaperError, match="sample time is positive"):
        Stream(MIXED, 0.0)
    with pytest.raises(ShaperError, match="schedule on a stream"):
        VaryingStream(Schedule((0.0,), (pole_last(Mode(2.0, 0.1), [-0.7]).shaper(),)), 0.1)
