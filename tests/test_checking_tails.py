"""The checker's upper side, piece by piece: which numbers are unknown, and a tail within its limits for all later time."""

from __future__ import annotations

import random
from fractions import Fraction
from typing import Any

import flint
import pytest
from flint import acb, arb, fmpq
from forgery import certificate, changed, command, number, opened, proven, proven_tail, system, task, written

from relaxations.checking import balls, upper
from relaxations.checking.balls import Root, Wave
from relaxations.checking.claims import Outcome, check
from relaxations.checking.reading import Refuted, Undecided, read


@pytest.fixture(autouse=True)
def _enough_work() -> None:
    balls.work["left"] = 1e8


def outcome(content: bytes) -> Outcome:
    return check(content).outcome


INTEGRATOR = task(["1"], ["1", "0"])

# Unknowns: what is claimed is about the solution, not about what is written.


@pytest.mark.parametrize(("claimed", "expected"), [("1.000001", Outcome.PROVED), ("0.95", Outcome.REFUTED), ("1.2", Outcome.PROVED)])
@pytest.mark.parametrize("near", ["0.9", "1.4"])
def test_an_unknown_duration_is_the_solutions(near: str, claimed: str, expected: Outcome) -> None:
    rough = command(near, [("0", "1")], [["time", 0, 0]], radius="1/2")
    assert outcome(certificate(INTEGRATOR, upper=claimed, witnesses=(None, rough))) is expected


@pytest.mark.parametrize(("time", "expected"), [("1.05", Outcome.PROVED), ("0.95", Outcome.REFUTED)])
def test_an_unknown_level_is_the_solutions(time: str, expected: Outcome) -> None:
    """Written is 0.99, needed are 1/1.05 and 1/0.95, which is beyond the limit."""
    rough = command(time, [("0", "0.99")], [["level", 0, 0]], radius="1/10")
    assert outcome(certificate(INTEGRATOR, upper="2", witnesses=(None, rough))) is expected


@pytest.mark.parametrize(("claimed", "believed"), [("4.218", True), ("4.2178", False), ("4.217", False)])
def test_rough_switch_times_prove_a_little_less(claimed: str, believed: bool) -> None:
    """Four digits of every instant, a duration of 4.2174: the solution, 4.21787, is within a thousandth of that."""

    def rough(data: dict[str, Any]) -> None:
        command = data["upper"]
        command |= {"maneuver_time": "4.2174", "radius": "1/1000"}
        for segment in command["segments"]:
            segment["start"] = written(round(number(segment["start"]), 4))
        data["claim"] |= {"lower": None, "upper": claimed}

    assert (outcome(changed(proven("two_mass_1"), rough)) is Outcome.PROVED) is believed


@pytest.mark.parametrize("seed", range(12))
def test_a_rough_command_never_beats_the_minimum_time(seed: int) -> None:
    """Newton's step from three digits lands near the solution, on either side of it; the test must enclose it."""
    rng = random.Random(seed)

    def rough(data: dict[str, Any]) -> None:
        command = data["upper"]
        command |= {"maneuver_time": written(number(command["maneuver_time"]) + Fraction(rng.randint(-99, 99), 10**5)), "radius": "1/500"}
        for segment in command["segments"][1:]:
            segment["start"] = written(number(segment["start"]) + Fraction(rng.randint(-99, 99), 10**5))
        data["claim"] |= {"lower": None, "upper": written(number(data["claim"]["upper"]) * (1 - Fraction(1, 10**10)))}

    for name in ("two_mass_1", "oscillator", "real_mode"):
        assert outcome(changed(proven(name), rough)) is not Outcome.PROVED


def test_an_initial_rest_that_is_not_zero() -> None:
    """The same integrator at rest at u = 1 within [0, 2]: inputs are absolute."""
    shifted = task(["1"], ["1", "0"], limits=("0", "2"), initial_input="1")
    for level, expected in (("2", Outcome.PROVED), ("1", Outcome.INCONCLUSIVE), ("3/2", Outcome.REFUTED), ("3", Outcome.REFUTED)):
        go = command("1", [("0", level)], [["time", 0, 0]])
        assert outcome(certificate(shifted, upper="1.001", witnesses=(None, go))) is expected


def test_unknowns_of_a_tail_stand_where_their_names_say() -> None:
    """One real zero and one double pair: coefficients c_0 and c_1 of the pair are two numbers each."""
    of = task(["1", "5", "14", "22", "21", "9"], ["1"] + ["0"] * 6, rest="output")  # (s+1)(s²+2s+3)²
    plant = system(of)
    assert sorted((root.multiplicity, root.flexible) for root in plant.zeros) == [(1, False), (2, True)]
    pair = {"near": ["-1", "1.4"], "coefficients": [["2", "3"], ["4", "5"]]}
    single = {"near": ["-1", "0"], "coefficients": [["6", "0"]]}
    names = [["im", 0, 1], ["re", 0, 1], ["im", 0, 0], ["re", 0, 0], ["re", 1, 0], ["time", 0, 0], ["start", 1, 0], ["level", 1, 0]]
    witness = command("8", [("0", "1/2"), ("7", "1/3")], names, tail=[pair, single])
    found = read(certificate(of, upper="9", witnesses=(None, witness)))
    with flint.ctx.workprec(128):
        numbers, unknowns = upper.as_written(plant.task, plant.zeros, found.upper)
    assert [numbers[place] for place in unknowns] == [5, 4, 3, 2, 6, 8, 7, fmpq(1, 3)]


# A tail on an interval.


def wave(*numbers: Any, rate: Any = -1, multiplicity: int = 1) -> Wave:
    value = rate if isinstance(rate, acb) else acb(arb(fmpq(rate)))
    return Wave.of((Root(value, multiplicity),), [fmpq(x) for x in numbers])


@pytest.mark.parametrize("sign", [1, -1])
def test_a_tail_beyond_a_limit_is_refuted_wherever_it_moves(sign: int) -> None:
    with flint.ctx.workprec(128):
        for first in (None, fmpq(2 * sign)):
            with pytest.raises(Refuted):  # falls back to its rest from twice the room
                upper.inside(wave(2 * sign), arb(0), arb(5), (fmpq(1), fmpq(1)), first)
        for first in (None, fmpq(sign)):
            with pytest.raises(Refuted):  # a stable tail backwards: grows out of the room
                upper.inside(wave(sign, rate=1), arb(0), arb(5), (fmpq(2), fmpq(2)), first)
        upper.inside(wave(sign), arb(0), arb(5), (fmpq(2), fmpq(2)), None)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_tail_may_touch_a_limit_at_first_only_if_its_value_is_exact(sign: int) -> None:
    room = (fmpq(1), fmpq(1))
    with flint.ctx.workprec(128):
        upper.inside(wave(sign), arb(0), arb(5), room, fmpq(sign))
        third = fmpq(sign, 3)  # a ball here: not told from the limit
        upper.inside(wave(third), arb(0), arb(5), (fmpq(1, 3), fmpq(1, 3)), third)
        with pytest.raises(Undecided):
            upper.inside(wave(third), arb(0), arb(5), (fmpq(1, 3), fmpq(1, 3)), None)
        with pytest.raises((Refuted, Undecided)):  # touches, then leaves slowly
            upper.inside(wave(third, rate=fmpq(1, 2)), arb(0), arb(5), (fmpq(1, 3), fmpq(1, 3)), third)
        with pytest.raises((Refuted, Undecided)):  # "first" is of no use later
            upper.inside(wave(sign), arb(1), arb(5), (fmpq(1, 9), fmpq(1, 9)), fmpq(0))


def test_every_part_of_an_interval_is_looked_at() -> None:
    """1.05 e^{-r/2} cos 3r leaves the room at the very beginning only; the rest needs subdivision."""
    ringing = wave(fmpq(21, 20), 0, rate=acb(arb("-0.5"), 3))
    with flint.ctx.workprec(128):
        with pytest.raises(Refuted):
            upper.inside(ringing, arb(0), arb(8), (fmpq(1), fmpq(1)), None)
        upper.inside(ringing, arb(0), arb(8), (fmpq(11, 10), fmpq(11, 10)), None)
        late = wave(fmpq(21, 20), 0, rate=acb(arb("0.5"), 3))  # the same backwards: at the very end only
        with pytest.raises(Refuted):
            upper.inside(late, arb(-8), arb(0), (fmpq(1), fmpq(1)), None)


def test_settling_is_about_the_tail_itself_and_its_room() -> None:
    with flint.ctx.workprec(128):
        slow = wave(1, rate=fmpq(-1, 10))
        assert not upper.settled(slow, arb(1), fmpq(1, 2), fmpq(1, 2))  # 0.9
        assert upper.settled(slow, arb(7), fmpq(1, 2), fmpq(1, 2))  # 0.497
        assert upper.settled(slow, arb(7), fmpq(1, 2), fmpq(1, 3))  # it is above its rest: the room below does not count
        assert not upper.settled(slow, arb(7), fmpq(1, 3), fmpq(1, 2))
        assert not upper.settled(wave(-1, rate=fmpq(-1, 10)), arb(7), fmpq(1, 2), fmpq(1, 3))
        assert not upper.settled(wave(fmpq(1, 2)), arb(9), fmpq(0), fmpq(3))  # above its rest, and no room there
        assert upper.settled(wave(fmpq(-1, 2)), arb(9), fmpq(0), fmpq(3))
        assert not upper.settled(wave(fmpq(-1, 2)), arb(9), fmpq(0), fmpq(1, 10**6))
        assert not upper.settled(wave(fmpq(-1, 2)), arb(9), fmpq(0), fmpq(0))


def test_a_faster_term_of_higher_power_may_outweigh_the_slowest_one_late() -> None:
    """-e^{-r} + r e^{-1.01 r}/10 is negative up to r = 12 and positive from there to r = 358: not settled where it first looks so."""
    roots = (Root(acb(-1), 1), Root(acb(arb("-1.01")), 2))
    with flint.ctx.workprec(128):
        tail = Wave.of(roots, [fmpq(-1), fmpq(0), fmpq(1, 10)])
        assert not any(upper.settled(tail, arb(r), fmpq(0), fmpq(3)) for r in range(1, 350))
        assert upper.settled(tail, arb(1000), fmpq(0), fmpq(3))
        assert tail(arb(100))[0] > 0


def test_a_tail_settles_from_where_all_its_envelopes_fall() -> None:
    with flint.ctx.workprec(128):
        rising = Wave.of((Root(acb(arb("-0.01")), 2),), [fmpq(0), fmpq(1, 100)])
        assert not upper.settled(rising, arb(1), fmpq(1, 10), fmpq(1, 10))  # 0.01 r e^{-r/100} is small at r = 1 and 0.37 at r = 100
        assert upper.settled(rising, arb(1000), fmpq(1, 10), fmpq(1, 10))
        slow_pair = Wave.of((Root(acb(-1, 1), 1), Root(acb(-2), 1)), [fmpq(-1), fmpq(0), fmpq(1)])
        assert not any(upper.settled(slow_pair, arb(r), fmpq(0), fmpq(9)) for r in range(1, 50))  # it oscillates through its rest


@pytest.mark.parametrize(("numbers", "fine"), [([-1, 0, 0], True), ([1, 0, 0], False), ([-1, 0, fmpq(1, 10)], False)])
def test_a_tail_without_room_on_one_side(numbers: list[Any], fine: bool) -> None:
    with flint.ctx.workprec(128):
        tail = Wave.of((Root(acb(-1), 1), Root(acb(-2), 2)), [fmpq(x) for x in numbers])
        assert upper.settled(tail, arb(10), fmpq(0), fmpq(3)) is (fine or numbers[0] == -1)
        assert upper.settled(tail, arb(10), fmpq(3), fmpq(0)) is (numbers[0] == 1)


# The tail of a command for all later time.


def limited(numbers: list[Any], numerator: list[str], denominator: list[str], segments: int = 1, **others: Any) -> None:
    """Check a tail (deviations) of a plant after any segments."""
    plant = system(task(numerator, denominator, rest="output", **others))
    with flint.ctx.workprec(128):
        before: list[upper.Number] = [fmpq(segments), *(fmpq(i) for i in range(segments)), *[fmpq(0)] * segments]
        upper.tail_limits(plant, segments, [*before, *(fmpq(x) for x in numbers)])


def test_a_tails_first_value_counts() -> None:
    limited([1], ["1", "1"], ["1", "0", "0"], limits=("-1.1", "1.1"))
    limited([0], ["1", "1"], ["1", "0", "0"])
    for coefficient in (fmpq(11, 10), fmpq(-11, 10), 1000):
        with pytest.raises(Refuted):
            limited([coefficient], ["1", "1"], ["1", "0", "0"])
    with pytest.raises(Refuted):
        limited([1], ["1", "1"], ["1", "0", "0"], limits=("-0.5", "0.5"))


def test_a_tails_late_peak_counts() -> None:
    """c r² e^{-r/100}/2 peaks at r = 200, beyond the slowest time constant, where the search for a settled tail begins."""
    triple = ["1000000", "30000", "300", "1"]
    height = fmpq(1, 2706)  # peak 1.0003
    with pytest.raises(Refuted):
        limited([0, 0, height], triple, ["1", "0", "0", "0", "0"])
    limited([0, 0, height * fmpq(999, 1000)], triple, ["1", "0", "0", "0", "0"])


def test_the_rest_of_a_tail_with_little_room_is_followed_far() -> None:
    """Room 1e-6 above the rest: e^{-r} is within it from r = 13.8 on, and leaves the limits until then."""
    with pytest.raises(Refuted):
        limited([1], ["1", "1"], ["1", "5", "6"], displacement="333333/2000000")
    limited([-1], ["1", "1"], ["1", "5", "6"], displacement="333333/2000000")
    limited([-1], ["1", "1"], ["1", "5", "6"], displacement="1/6")  # no room above, and none needed
    with pytest.raises(Undecided):
        limited([fmpq(1, 1000)], ["1", "1"], ["1", "5", "6"], displacement="1/6")


@pytest.mark.parametrize(
    ("time", "within", "fine"),
    [("2", "0.14", True), ("2", "0.13", False), ("0", "1", True), ("0", "0.999", False), ("1/3", "0.72", True), ("1/3", "0.71", False)],
)
def test_a_tails_length_counts(time: str, within: str, fine: bool) -> None:
    """e^{-r} is 0.135 at r = 2 and 0.717 at r = 1/3; before that only the wide limits count."""
    length = {"time": time, "within": within}
    others: dict[str, Any] = {"limits": ("-1.000001", "1.000001"), "tail_length": length}
    if fine:
        limited([1], ["1", "1"], ["1", "0", "0"], **others)
    else:
        with pytest.raises(Refuted):
            limited([1], ["1", "1"], ["1", "0", "0"], **others)


@pytest.mark.parametrize("time", ["0.001", "1", "3"])
def test_the_wide_limits_count_before_the_tails_length(time: str) -> None:
    with pytest.raises(Refuted):
        limited([fmpq(11, 10)], ["1", "1"], ["1", "0", "0"], tail_length={"time": time, "within": "1"})


def test_the_wide_limits_count_until_the_tails_length_begins() -> None:
    """3 r e^{-r} is 1.1 at r = 1, and little from r = 4 on."""
    double, length = ["1", "2", "1"], {"time": "4", "within": "0.5"}
    with pytest.raises(Refuted):
        limited([0, 3], double, ["1", "0", "0", "0"], tail_length=length)
    limited([0, 3], double, ["1", "0", "0", "0"], tail_length=length, limits=("-1.2", "1.2"))


def test_room_is_the_fraction_of_the_nearer_limits_distance() -> None:
    plant = system(task(["1", "1"], ["1", "5", "6"], "1/12", rest="output", limits=("-1", "3"), tail_length={"time": "2", "within": "0.1"}))
    assert plant.room(fmpq(1)) == (fmpq(5, 2), fmpq(3, 2))
    assert plant.room(fmpq(2)) == (fmpq(3, 20), fmpq(3, 20))


def test_a_feed_through_says_nothing_about_a_tail_after_a_move() -> None:
    """u(0+) = Δ/D is known only if nothing came before."""
    with pytest.raises(Refuted):
        limited([fmpq(3, 5)], ["1", "1"], ["1", "2"], displacement="0.25")


def test_a_tail_length_added_to_a_proven_command_is_not_believed() -> None:
    """The command's tail is longer than that."""

    def shorten(data: dict[str, Any], time: str, within: str) -> None:
        data["task"]["limits"]["tail_length"] = {"time": time, "within": within}
        data["claim"]["lower"] = None

    for name in ("real_zero", "pitch", "complex_zeros"):
        content = proven_tail(name)
        assert outcome(changed(content, lambda data: shorten(data, "0", "1/1000"))) is Outcome.REFUTED
        assert outcome(changed(content, lambda data: shorten(data, "1/2", "1/1000"))) is Outcome.REFUTED
        assert outcome(changed(content, lambda data: shorten(data, "100000", "1"))) is Outcome.PROVED


# A command that is all tail.


@pytest.mark.parametrize("name", ["at_once_on_a_limit", "at_once_on_the_other", "at_once_amplified"])
def test_a_tail_that_begins_on_a_limit_is_proven(name: str) -> None:
    data = opened(proven_tail(name))
    assert data["claim"] == {"lower": "0", "upper": "0", "impossible": None}
    for side, less in ((0, Fraction(-999_999, 10**6)), (1, Fraction(999_999, 10**6))):
        content = changed(proven_tail(name), lambda data, i=side, x=less: data["task"]["limits"]["input"].__setitem__(i, written(x)))
        touched = name == "at_once_on_the_other"
        assert outcome(content) is (Outcome.REFUTED if touched == (side == 0) else Outcome.PROVED)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_tail_that_begins_on_a_limit_and_goes_on_beyond_is_not(sign: int) -> None:
    """(s²+s+3)/(s²+3s/2+1): u(0+) = 1, and it rises at first, with slope 1/2."""

    def tighten(data: dict[str, Any]) -> None:
        data["task"]["limits"]["input"] = ["-1", "1"]
        if sign < 0:  # the mirrored task
            data["task"]["displacement"] = "-1"
            for chain in data["upper"]["tail"]:
                chain["coefficients"] = [[written(-number(x)) for x in c] for c in chain["coefficients"]]

    assert outcome(proven_tail("at_once_and_rising")) is Outcome.PROVED
    assert outcome(changed(proven_tail("at_once_and_rising"), tighten)) in (Outcome.REFUTED, Outcome.INCONCLUSIVE)


# (s + 2)³ over a plant with other poles: outputs whose coefficients backwards, or every other one, are multiples of (s + 2)³.
TRIPLE = (["1", "6", "12", "8"], ["1", "5", "11", "15", "9", "3", "1"])


@pytest.mark.parametrize("above", [["8", "12", "6", "1"], ["1"], ["6", "5", "12", "7", "8"], ["5", "1"], ["1", "2"], ["3", "4"]])
def test_what_a_tail_of_a_triple_zero_does_to_an_output(above: list[str]) -> None:
    """`Σ_{k≥l} G^(k-l)(z)/(k-l)! c_k` at z = -2, the derivatives by exact division of power series about it."""
    posed = system(task(*TRIPLE, "1", rest="output", outputs={"w": above}, deflection={"w": "50"}))
    answer, *_ = posed.after("w")
    (zero,) = posed.zeros
    assert zero.multiplicity == 3

    def about(written: list[str]) -> list[Fraction]:
        """The coefficients of N(-2 + x), lowest first, by repeated division."""
        rest, found = [Fraction(c) for c in written], []
        for _ in range(3):
            quotient = [Fraction(0)]
            for c in rest:
                quotient.append(c - 2 * quotient[-1])
            found.append(quotient[-1])
            rest = quotient[1:-1]
        return found

    n, d, gains = about(above), about(TRIPLE[1]), []
    for k in range(3):
        gains.append((n[k] - sum((gains[i] * d[k - i] for i in range(k)), Fraction(0))) / d[0])
    numbers = [Fraction(3), Fraction(-1, 2), Fraction(5, 4)]
    found = answer([acb(fmpq(c.numerator, c.denominator)) for c in numbers], zero)
    for at, value in enumerate(found):
        expected = sum((gains[k - at] * numbers[k] for k in range(at, 3)), Fraction(0))
        assert value.real.overlaps(arb(fmpq(expected.numerator, expected.denominator)))
        assert float(value.real.rad()) < 1e-12
        assert expected or above == ["1", "2"]  # which leaves out the first derivative alone


def test_an_exact_command_needs_no_tail() -> None:
    """1 for 1 s and -1 for 1 s move the double integrator by 1 as they are: that a tail is written beside them changes nothing."""
    of = task(["1", "1"], ["1", "0", "0"], rest="output")
    for tail in ([], [{"near": ["-1", "0"], "coefficients": [["1/2", "0"]]}]):
        witness = command("2", [("0", "1"), ("1", "-1")], [], tail=tail)
        assert check(certificate(of, upper="2", witnesses=(None, witness))).outcome is Outcome.PROVED
