"""Several limits in one task: known answers, another program's answers to random ones, tighter ones, must and must not, lies."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise
from math import sqrt
from typing import Any

import proving
import pytest
from box_tasks import TWIN, axis
from forgery import changed
from marks import first
from problems import transfer, two_mass
from random_limits import limiting

from fmus.twins import twin_family
from relaxations.bounds import Bound, Status
from relaxations.checking.claims import Outcome, check
from relaxations.errors import ManeuverError
from relaxations.initial import from_output
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import LinearPlant
from relaxations.proofs import minimum_time
from relaxations.robust.boxes import Box

SLOPED = 1e-4  # the gap where ramps meet limits of outputs: the grid knows where they begin and end to a cell
INTEGRATOR, CART, SPRING = (transfer([1], [1, 0])(), transfer([1], [1, 0, 0])(), two_mass())
PENDULUM = transfer([1], [1, 0, 1])()
Numbers = tuple[float | str, ...]


def bound(plant: LinearPlant, displacement: str, start: Numbers = (), step: str | None = None, **limits: Any) -> Bound:
    begin = from_output(plant, [Fraction(x) for x in start]) if start else None
    maneuver = Maneuver(
        Fraction(displacement), Limits.of(-1, 1, **limits), sample_time=None if step is None else Fraction(step), initial=begin
    )
    return minimum_time(problem([plant], maneuver))


def sides(found: Bound, gap: float = SLOPED) -> tuple[float, float]:
    return proving.sides(found, gap)


def holds(time: float, found: Bound) -> bool:
    lower, upper = sides(found)
    return lower * (1 - 1e-14) <= time <= upper * (1 + 1e-14)


RATE = ("-4", "4")


@pytest.mark.slow
def test_a_cart_of_limited_speed_acceleration_and_jerk() -> None:
    # T = Δ/v + v/a + a/j
    assert holds(1 / 0.5 + 0.5 + 0.25, bound(CART, "1", rate=RATE, deflection={"output_rate": "0.5"}))


@pytest.mark.slow
def test_an_emergency_stop() -> None:
    # From the speed 1 to rest, |a| ≤ 1 and |jerk| ≤ 4: T = v/a + a/j; a quarter of that speed: a triangle, v = j (T/2)².
    assert holds(1.25, bound(INTEGRATOR, "0", ("1",), rate=RATE))
    assert holds(2 * sqrt(0.0625 / 4), bound(INTEGRATOR, "0", ("0.0625",), rate=RATE))
    # It goes 1 unit far by itself (1/2 v²/a + v a/(2 j)) and takes 2 with a start at the limit of its speed: some of it is coasted.
    assert holds(2 + 0.5 * 1, bound(CART, "2", ("0", "1"), deflection={"output_rate": "1"}))


@pytest.mark.slow
def test_a_swinging_load_must_not_swing_further() -> None:
    # y(0) = 2 and no further: it is at its limit at first, and the fastest stop keeps to it; towards the limit it must be held.
    free = bound(PENDULUM, "0", ("2", "0.5"))
    assert free.upper is not None
    same = bound(PENDULUM, "0", ("2", "0.5"), deflection={"output": "2.5"})
    assert (same.lower, same.upper) == pytest.approx((free.lower, free.upper), rel=1e-12)
    sides(bound(PENDULUM, "0", ("1.5", "0"), deflection={"output": "1.5"}), 1e-9)
    tight = sides(bound(SPRING, "0.5", ("0", "0", "0.1", "0.1"), deflection={"spring": "0.2"}), 1e-3)
    assert tight[0] > bound(SPRING, "0.5", ("0", "0", "0.1", "0.1")).upper  # type: ignore[operator]


def test_samples_of_limited_steps_and_speed() -> None:
    # 1/s, ∫u = 1, steps of at most 1/4 from one sample of 1/8 s to the next, the last one to 0: u = 1/4, 1/2, 3/4, 1, …, 1/2, 1/4.
    # n samples do at most 1/8 (n - 3) for n ≥ 7.
    found = bound(INTEGRATOR, "0.99", step="1/8", rate=("-2", "2"))
    assert found.lower == found.upper == 11 / 8
    fewer = bound(INTEGRATOR, "1.01", step="1/8", rate=("-2", "2"))
    assert fewer.lower == fewer.upper == 12 / 8
    # A cart at 7/100 s a sample: no command takes less than 2.5 s (test_deflection_limits), 36 samples are the first that do it.
    found = bound(CART, "1", step="0.07", deflection={"output_rate": "0.5"})
    assert found.upper == pytest.approx(2.52, rel=1e-15)
    assert found.lower == pytest.approx(2.52, rel=1e-15)


@pytest.mark.parametrize("seed", first(1, range(3)))
def test_random_limits_of_sampled_commands_against_another_program(seed: int) -> None:
    compared_with_samples(seed, ())


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3, 150))
def test_more_random_limits_of_sampled_commands_against_another_program(seed: int) -> None:
    compared_with_samples(seed, ())


def compared_with_samples(seed: int, must: tuple[str, ...]) -> None:
    """HiGHS finds a command of so many samples, and none of one sample less; it looks at outputs eight times in each."""
    case = limiting(seed, ("sample_time", *must))
    step, other = float(case.problem.maneuver.sample_time or 0), case.other(looks=8)
    found = minimum_time(case.problem)
    if found.status is Status.IMPOSSIBLE:
        assert other.fraction(300 * step, 300) < 1
        return
    lower, upper = sides(found, 1e-14)
    count = round(upper / step)
    assert round(lower / step) == count
    assert other.fraction(count * step, count) >= 1 - 1e-7
    assert count == 1 or other.fraction((count - 1) * step, count - 1) < 1 + 1e-7


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(40))
def test_random_limits_against_another_program(seed: int) -> None:
    case = limiting(1000 + seed)
    if case.problem.maneuver.sample_time is not None:
        compared_with_samples(1000 + seed, tuple(name for name in case.names if name != "sample_time"))
        return
    found = minimum_time(case.problem)
    if found.status is Status.IMPOSSIBLE:
        assert case.other(looks=2).fraction(30.0, 100) < 1
        return
    lower, upper = sides(found, 1e-3)
    time = case.other(looks=2).time(0.9 * lower, 1.1 * upper, 100, 1e-4)
    # A grid of 100 cells takes longer, and its outputs are limited twice in each only.
    assert lower * (1 - 2e-3) <= time <= upper * (1 + 1e-2)


@pytest.mark.slow
def test_tighter_limits_take_no_less_time_together() -> None:
    speeds = [sides(bound(CART, "1", step="1/20", rate=RATE, deflection={"output_rate": v}), 0.1) for v in ("0.9", "0.7", "0.5")]
    rates = [sides(bound(CART, "1", step="1/20", rate=(f"-{r}", r), deflection={"output_rate": "0.7"}), 0.1) for r in ("20", "8", "4")]
    fuels = [sides(bound(CART, "1", step="1/20", rate=RATE, fuel=u), 0.1) for u in ("1.9", "1.5", "1.2")]
    for times in (speeds, rates, fuels):
        assert all(later[0] >= earlier[1] * (1 - 1e-15) for earlier, later in pairwise(times))
        assert times[0] != times[-1]


@pytest.mark.slow
def test_halved_sample_times_and_higher_rates_fall_towards_what_is_free_of_them() -> None:
    free = bound(CART, "1", deflection={"output_rate": "0.5"})
    halved = [sides(bound(CART, "1", step=f"1/{n}", rate=("-100", "100"), deflection={"output_rate": "0.5"}), 0.1) for n in (7, 14, 28)]
    assert all(after[1] <= before[1] for before, after in pairwise(halved))
    assert free.lower <= halved[-1][0] <= free.lower + 2 / 28
    rates = [sides(bound(INTEGRATOR, "0", ("1",), rate=(f"-{r}", r))) for r in ("4", "32", "256")]
    assert all(after[1] < before[0] for before, after in pairwise(rates))
    assert 1 <= rates[-1][0] <= rates[-1][1] < 1.005


def test_what_makes_no_sense_together() -> None:
    def refused(words: str, plant: LinearPlant = SPRING, displacement: str = "1", start: Numbers = (), **others: Any) -> None:
        begin = from_output(plant, [Fraction(x) for x in start]) if start else None
        limits = Limits.of("-2", "2", **others)
        with pytest.raises(ManeuverError, match=words):
            problem([plant], Maneuver(Fraction(displacement), limits, initial=begin))

    refused("at first 'spring' deviates by", start=("0", "0", "1", "0"), deflection={"spring": "0.3"})
    refused("at its final rest 'output' deviates by 1", PENDULUM, deflection={"output": "0.9"}, rate=RATE)
    refused("would use fuel for ever", PENDULUM, "0.5", fuel="1", rate=RATE)


# Tails. The input of (s + 1)/s² goes on along e^{-r} after the move; another output, 1/s², then moves on by c e^{-r}.

ZERO = LinearPlant.from_transfer([1, 1], [1, 0, 0])
WITH_POSITION = LinearPlant(ZERO.denominator, {**ZERO.numerators, "position": ZERO.denominator * 0 + 1}, ZERO.output, ZERO.notes)
PITCH = transfer(["1.151", "0.1774"], [1, "0.739", "2.072", "0.1774"])()


def tailed(plant: LinearPlant, displacement: str, start: Numbers = (), high: str = "1", **limits: Any) -> Bound:
    begin = from_output(plant, [Fraction(x) for x in start]) if start else None
    low, high_ = -Fraction(high), Fraction(high)
    return minimum_time(problem([plant], Maneuver(Fraction(displacement), Limits.of(low, high_, **limits), tail=True, initial=begin)))


@pytest.mark.slow
def test_a_tail_of_limited_slope() -> None:
    free = tailed(ZERO, "1")
    assert free.upper is not None
    times = [sides(tailed(ZERO, "1", rate=(f"-{r}", r)), 1e-3) for r in ("400", "16", "4")]
    assert all(later[0] > earlier[1] for earlier, later in pairwise(times))
    assert free.lower < times[0][0] < free.upper * 1.01
    found = tailed(ZERO, "1", rate=RATE)
    assert found.command is not None
    assert found.command.tail.terms
    last, end = found.command.segments[-1], found.command.maneuver_time
    (term,) = found.command.tail.terms
    assert last.level + last.slope * (end - last.start) == pytest.approx(term.coefficient.real, abs=1e-9)  # it does not jump
    assert abs(term.coefficient.real) <= 1.0
    assert found.certificate is not None
    dropped = changed(found.certificate, lambda data: data["lower"].update(ramps=[], steps=[]))
    assert check(dropped).outcome is not Outcome.PROVED


def test_a_tail_must_not_move_another_output_too_far() -> None:
    # It comes to rest at 1, by way of 1 + c: c = 1/2 in the fastest of all commands.
    assert WITH_POSITION.partial("position") is not None
    free, loose = tailed(ZERO, "1"), tailed(WITH_POSITION, "1", deflection={"position": "2"})
    assert free.upper is not None
    assert (loose.lower, loose.upper) == pytest.approx((free.lower, free.upper), rel=1e-9)
    assert free.command is not None
    moved = 1 + free.command.tail.terms[0].coefficient.real
    limit = f"{max(moved, 1.0) * 0.5 + 0.5:.4g}" if moved > 1 else "1.001"
    tight = tailed(WITH_POSITION, "1", deflection={"position": limit})
    assert tight.status is Status.PROVED, tight.reason
    assert tight.upper is not None
    assert tight.upper >= free.lower


@pytest.mark.slow
def test_a_start_and_a_tail() -> None:
    free = sides(tailed(ZERO, "1", ("0.2", "0.3")), 1e-9)
    assert free[1] < tailed(ZERO, "1").lower  # on its way already
    sides(tailed(PITCH, "0.2", ("0.05", "0", "0"), "0.3", rate=("-0.3", "0.3")), 1e-3)
    hidden = LinearPlant.from_transfer([1, 2], [1, 3, 2])
    with pytest.raises(ManeuverError, match="modes that the output cannot see"):
        problem([hidden], Maneuver(Fraction(1, 2), Limits.of(-1, 1), tail=True, initial=(Fraction(1), Fraction(0))))


@pytest.mark.slow
def test_samples_of_limited_steps_for_a_box() -> None:
    stiffness = axis("stiffness", "0.2")
    family = twin_family(TWIN, "x2", ["stiffness"], {"damping": "0"})

    def robust(rate: tuple[str, str] | None) -> tuple[float, float]:
        box = Box((stiffness,), family, Fraction(1, 20))
        maneuver = Maneuver(Fraction(1), Limits.of(-1, 1, rate=rate), box=box, sample_time=Fraction(1, 10))
        return sides(minimum_time(problem([family.member([Fraction(1)])], maneuver)), 0.05)

    assert robust(("-3", "3"))[0] > robust(None)[1]  # 5.4 s without
