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


@pytest.mark.parametrize("make", [lambda: Stream(derivative_shaper(MODE, 2), 0.013, 0.5), lambda: VaryingStream(falling(), 0.013, 0.5)])
def test_a_refused_block_leaves_the_filter_as_it_was(make):
    samples = np.random.default_rng(8).normal(size=300)
    stream = make()
    parts = [stream(samples[:100])]
    for bad in ([math.inf], [1.0, math.nan], 3.0):
        with pytest.raises(ShaperError):
            stream(bad)
        assert len(stream([])) == 0
    parts += [stream(samples[k : k + 1]) for k in range(100, 200)]
    parts += [stream(samples[200:])]
    assert np.array_equal(np.concatenate(parts), make()(samples))


def test_memory_stays_as_long_as_the_shaper():
    stream = Stream(derivative_shaper(MODE, 1), 0.01)
    for size in (0, 1, 7, 1_000_000, 1):
        stream(np.zeros(size))
        assert len(stream._memory) == stream.taps[-1][0]
        assert stream._memory.base is None or len(stream._memory.base) <= len(stream._memory) + size


def changing() -> Schedule:
    """From zv to zvd to three impulses of another mode, and back."""
    kinds = [derivative_shaper(MODE), derivative_shaper(MODE, 1), derivative_shaper(Mode(9.0, 0.1), 1), derivative_shaper(MODE)]
    return Schedule((1.0, 2.0, 3.0, 5.0), tuple(kinds))


def test_nothing_jumps_where_kinds_change_and_outside_of_the_schedule():
    """The rate of the output is bounded whatever the step; of a filter that is changed at once (the other half of the pair) it is not."""
    speed, jumps, changed = 1.0, [], []
    for step in (0.01, 0.001):
        instants = step * np.arange(round(8.0 / step))
        ramp = speed * np.minimum(instants, 6.0)
        shaped = VaryingStream(changing(), step)(ramp)
        jumps.append(np.abs(np.diff(shaped)).max() / step)
        at = round(2.0 / step)
        halves = Stream(derivative_shaper(MODE), step), Stream(derivative_shaper(MODE, 1), step)
        changed.append(np.abs(np.diff(np.concatenate([halves[0](ramp)[:at], halves[1](ramp)[at:]]))).max() / step)
        early, late = (Stream(derivative_shaper(MODE), step)(ramp) for _ in range(2))
        assert shaped[instants < 1.0] == pytest.approx(early[instants < 1.0], abs=1e-12), "held before the schedule begins"
        assert shaped[instants > 5.0] == pytest.approx(late[instants > 5.0], abs=1e-12), "held behind its end"
    assert max(jumps) <= 3.0 * speed
    assert jumps[1] == pytest.approx(jumps[0], rel=0.05)
    assert changed[1] > 5.0 * changed[0] > 50.0 * speed
    assert changing().at(np.linspace(-1.0, 9.0, 101))[1].sum(axis=0) == pytest.approx(np.ones(101), abs=1e-14)


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


DECAYING = Shaper((0.0,), (0.5,), (ShaperTerm(0.0, -1 + 0j, 0, 0.5 + 0j),))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Stream(derivative_shaper(MODE), 0.0), ["0.0", "positive"]),
        (lambda: VaryingStream(falling(), math.nan), ["nan"]),
        (lambda: VaryingStream(Schedule((0.0,), (DECAYING,)), 0.1), ["FMU"]),
        (lambda: Schedule((0.0, 0.0), (derivative_shaper(MODE), derivative_shaper(MODE, 1))), ["ascend"]),
        (lambda: Schedule((0.0, math.nan), (derivative_shaper(MODE), derivative_shaper(MODE))), ["ascend", "nan"]),
        (lambda: Stream(derivative_shaper(MODE), 0.1)(1.0), ["shape (n,)", "()"]),
        (lambda: Stream(derivative_shaper(MODE), 0.1)([[1.0], [2.0]]), ["(2, 1)"]),
        (lambda: Stream(derivative_shaper(MODE), 0.1)(["one"]), ["row of numbers", "one"]),
        (lambda: VaryingStream(falling(), 0.1)([0.0, math.nan]), ["sample 1", "nan"]),
        (lambda: Schedule((), ()), ["one shaper for each"]),
    ],
)
def test_mistakes_are_named(make, words: list[str]):
    with pytest.raises(ShaperError) as caught:
        make()
    assert all(word in str(caught.value) for word in words)
