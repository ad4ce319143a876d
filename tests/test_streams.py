"""Shapers on streams: block by block as on the whole, exact on the sample grid, continuous while the shaper varies."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from relaxations.errors import ShaperError
from relaxations.shaping.impulses import derivative_shaper
from relaxations.shaping.modes import Mode
from relaxations.shaping.sampled import sampled
from relaxations.shaping.shapers import Shaper, ShaperTerm
from relaxations.shaping.streams import Schedule, Stream, VaryingStream

MODE = Mode(2 * math.pi, 0.05)


def in_blocks(stream, samples: np.ndarray, chance: np.random.Generator) -> np.ndarray:
    parts, begin = [], 0
    while begin < len(samples):
        size = int(chance.integers(0, 90))
        parts.append(stream(samples[begin : begin + size]))
        begin += size
    return np.concatenate(parts)


def falling() -> Schedule:
    """The mode slows down, as a load's does while it is lowered."""
    modes = [Mode(2 * math.pi / (1.0 + 0.25 * k), 0.02) for k in range(5)]
    return Schedule.of([2.0 * k for k in range(5)], modes, lambda mode: derivative_shaper(mode, 1))


@pytest.mark.parametrize("make", [lambda: Stream(derivative_shaper(MODE, 2), 0.013, 0.5), lambda: VaryingStream(falling(), 0.013, 0.5)])
def test_block_by_block_is_the_whole_to_the_last_bit(make):
    chance = np.random.default_rng(3)
    samples = np.cumsum(chance.normal(size=1500)) * 0.1
    whole = make()(samples)
    for _ in range(5):
        assert np.array_equal(in_blocks(make(), samples, chance), whole)
    assert whole[0] != 0.0


def test_samples_are_shaped_as_the_definition_says():
    chance = np.random.default_rng(5)
    shaper, step, samples = derivative_shaper(MODE, 1), 0.01, chance.normal(size=400)
    instants = step * np.arange(-200, 400)
    known = np.concatenate([np.full(200, 0.3), samples])
    expected = sum(a * np.interp(instants[200:] - t, instants, known) for t, a in zip(shaper.times, shaper.amplitudes, strict=True))
    assert Stream(shaper, step, 0.3)(samples) == pytest.approx(expected, abs=1e-12)
    held = VaryingStream(Schedule((0.0, 1.0), (shaper, shaper)), step, 0.3)(samples)
    assert held == pytest.approx(expected, abs=1e-12)


def test_a_shaper_on_the_sample_grid_leaves_nothing_of_a_held_stream():
    step = 0.02
    stream = Stream(sampled([(MODE, 1)], step).shaper, step)
    levels = stream(np.ones(200))
    # The held levels are jumps at samples: their phasors at the end.
    jumps = np.diff(np.concatenate([[0.0], levels]))
    left = jumps @ np.exp(MODE.frequency * MODE.direction * (step * np.arange(200) - step * 199))
    assert abs(left) <= 1e-12
    assert levels[-1] == pytest.approx(1.0, abs=1e-12)


def test_nothing_jumps_while_the_shaper_follows_its_schedule():
    schedule, speed = falling(), 1.0
    for step in (0.01, 0.001):
        instants = step * np.arange(round(12.0 / step))
        shaped = VaryingStream(schedule, step)(speed * np.minimum(instants, 5.0))
        # |dy/dt| ≤ speed Σ A |1 - dt_i/dt| + Σ |dA_i/dt| r: no more than a small multiple of the speed, whatever the step.
        assert np.abs(np.diff(shaped)).max() <= 1.6 * speed * step
        assert shaped[-1] == pytest.approx(5.0, abs=1e-12)


def test_the_varying_shaper_leaves_less_than_the_one_for_where_it_began():
    """A pendulum of slowly growing length, its pivot moved: with the schedule of its length, and with the shaper for its first length."""
    rate, gravity = 0.35, 9.81

    def length(t: float) -> float:
        return 1.0 + rate * t

    ends = np.linspace(0.0, 14.0, 57)
    modes = [Mode(math.sqrt(gravity / length(t))) for t in ends]
    step = 0.005
    instants = step * np.arange(2800)
    move = np.clip(0.5 * (instants - 6.0), 0.0, 0.9)

    def swing(shaped: np.ndarray) -> float:
        position = np.interp

        def motion(t: float, x: np.ndarray) -> list[float]:
            gap = position(t, instants, shaped) - x[0]
            # the horizontal place of a light load below the pivot: m x'' = -(g/L) (x - pivot)
            return [x[1], gravity / length(t) * gap]

        solved = solve_ivp(motion, (0.0, 14.0), [0.0, 0.0], t_eval=np.linspace(11.5, 14.0, 200), rtol=1e-8, atol=1e-10, max_step=0.02)
        return float(np.abs(solved.y[0] - 0.9).max())

    schedule = Schedule.of(tuple(ends), modes, derivative_shaper)
    assert swing(VaryingStream(schedule, step)(move)) < 0.5 * swing(Stream(derivative_shaper(modes[0]), step)(move))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Stream(derivative_shaper(MODE), 0.0), ["0.0", "positive"]),
        (lambda: VaryingStream(falling(), math.nan), ["nan"]),
        (lambda: Stream(Shaper((0.0,), (0.5,), (ShaperTerm(0.0, -1 + 0j, 0, 0.5 + 0j),)), 0.1), ["FMU"]),
        (lambda: Schedule((0.0, 0.0), (derivative_shaper(MODE), derivative_shaper(MODE, 1))), ["ascend", "2 and 3"]),
        (lambda: Schedule((), ()), ["one shaper for each"]),
    ],
)
def test_mistakes_are_named(make, words: list[str]):
    with pytest.raises(ShaperError) as caught:
        make()
    assert all(word in str(caught.value) for word in words)
