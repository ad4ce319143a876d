"""The checker's parts, holes that were there once, and hostile files: whatever a file holds, a check ends, and claims nothing false."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import flint
import forgery
import pytest
from flint import acb, arb, fmpq, fmpq_poly
from forgery import certificate, changed, command, costate, forged, opened, proven, proven_tail, task

from relaxations.checking import balls, lower, upper
from relaxations.checking.balls import Inconclusive, Refuted, Root, Undecided, Wave
from relaxations.checking.claims import Outcome, check, claim, rounded
from relaxations.checking.reading import read
from relaxations.plants import PlantError

INTEGRATOR = task(["1"], ["1", "0"])
ONE = costate((("0", "0"), [("1", "0")]))


def outcome(content: bytes) -> Outcome:
    return check(content).outcome


# Holes that were there once, and others that must not be.


def test_modes_are_ordered_by_their_true_frequencies() -> None:
    """Frequencies 1e-30 apart are equal in double precision, and `mode[1]` is still the slower one, not the first one found."""
    slower, hair = fmpq_poly([1, 0, 1]), fmpq(1, 10**30)
    with _bits(256):
        for other in (fmpq_poly([1 + hair, fmpq(1, 10), 1]), fmpq_poly([1 - hair, fmpq(1, 10), 1])):
            undamped_first = other[0] > 1
            for root in balls.further(balls.isolated(slower * other), {"mode[1]": 1}):
                assert (root.multiplicity == 2) == (bool(root.value.real.contains(0)) == undamped_first)


def test_modes_of_one_frequency_have_no_order() -> None:
    twins = balls_of([1, 0, 1], [1, fmpq(1, 10), 1])
    with _bits(128):
        with pytest.raises(Undecided):
            balls.further(twins, {"mode[1]": 1})
        assert [root.multiplicity for root in balls.further(twins, {"mode[1]": 1, "mode[2]": 1})] == [2, 2]
        three = balls_of([1, 0, 1], [1, fmpq(1, 10), 1], [fmpq(1, 4), 0, 1])
        assert sorted(root.multiplicity for root in balls.further(three, {"mode[1]": 3})) == [1, 1, 4]


def balls_of(*factors: list[Any]) -> tuple[Root, ...]:
    product = fmpq_poly([1])
    for factor in factors:
        product *= fmpq_poly(factor)
    with _bits(128):
        return balls.isolated(product)


@pytest.mark.parametrize("places", [3, 20, 37, 38, 39, 40, 41, 60, 200])
@pytest.mark.parametrize("bits", [64, 128, 256])
def test_a_zero_beside_the_imaginary_axis_is_never_taken_for_one_on_it(places: int, bits: int) -> None:
    """The first of two zeros is on the axis, the second a hair left of it, beside or far from the first."""
    hair = fmpq(1, 10**places)
    for square in (1 + hair * hair, fmpq(4)):
        with _bits(bits):
            try:
                found = balls.stable(fmpq_poly([1, 0, 1]) * fmpq_poly([square, 2 * hair, 1]))
            except Inconclusive:
                continue
            assert len(found) == 1
            assert found[0].value.real < 0


def test_zeros_on_the_axis_are_no_stable_ones() -> None:
    with _bits(128):
        assert balls.stable(fmpq_poly([1, 0, 1]) * fmpq_poly([2, 0, 1]) ** 2) == ()
        quadruple = balls.stable(fmpq_poly([4, 0, 0, 0, 1]))  # ±1 ± j: common to N(s) and N(-s), and not on the axis
        assert [root.value.real < 0 for root in quadruple] == [True]
        assert [root.multiplicity for root in balls.stable(fmpq_poly([1, 1]) ** 3 * fmpq_poly([-1, 1]))] == [3]


def test_a_faster_term_of_higher_power_may_outweigh_the_slowest_one_late() -> None:
    """-e^{-r} + r e^{-1.01 r}/10 is negative up to r = 12 and positive from there to r = 358: not settled where it first looks so."""
    roots = (Root(acb(-1), 1), Root(acb(arb("-1.01")), 2))
    with _bits(128):
        tail = Wave.of(roots, [fmpq(-1), fmpq(0), fmpq(1, 10)])
        assert not any(upper.settled(tail, arb(r), fmpq(0), fmpq(3)) for r in range(1, 350))
        assert upper.settled(tail, arb(1000), fmpq(0), fmpq(3))
        assert tail(arb(100))[0] > 0


def test_a_tail_settles_from_where_all_its_envelopes_fall() -> None:
    with _bits(128):
        rising = Wave.of((Root(acb(arb("-0.01")), 2),), [fmpq(0), fmpq(1, 100)])
        assert not upper.settled(rising, arb(1), fmpq(1, 10), fmpq(1, 10))  # 0.01 r e^{-r/100} is small at r = 1 and 0.37 at r = 100
        assert upper.settled(rising, arb(1000), fmpq(1, 10), fmpq(1, 10))
        slow_pair = Wave.of((Root(acb(-1, 1), 1), Root(acb(-2), 1)), [fmpq(-1), fmpq(0), fmpq(1)])
        assert not any(upper.settled(slow_pair, arb(r), fmpq(0), fmpq(9)) for r in range(1, 50))  # it oscillates through its rest


@pytest.mark.parametrize(("numbers", "fine"), [([-1, 0, 0], True), ([1, 0, 0], False), ([-1, 0, fmpq(1, 10)], False)])
def test_a_tail_without_room_on_one_side(numbers: list[Any], fine: bool) -> None:
    with _bits(128):
        tail = Wave.of((Root(acb(-1), 1), Root(acb(-2), 2)), [fmpq(x) for x in numbers])
        assert upper.settled(tail, arb(10), fmpq(0), fmpq(3)) is (fine or numbers[0] == -1)
        assert upper.settled(tail, arb(10), fmpq(3), fmpq(0)) is (numbers[0] == 1)


def test_the_whole_claim_is_printed() -> None:
    words = claim(read(proven_tail("short_tail")))
    assert "From 1 s after T on, the input stays within 0.05 of the nearer limit's distance" in words
    assert "in less than" in words
    assert "at most" in words
    robust = claim(read(proven("two_mass_robust")))
    assert "further zeros of the command: 1 at mode[1]" in robust
    assert "state rest" in robust
    assert "in any time" in claim(read(certificate(task(["1"], ["1", "1"]), impossible="remainder")))
    record = check(proven("two_mass_1")).to_dict()
    assert record["task"] == opened(proven("two_mass_1"))["task"]
    printed = [Decimal(record["maneuver_time"][side]) for side in ("lower", "upper")]
    assert printed[0] < printed[1]
    assert all(abs(value - Decimal("4.2178665105")) < Decimal("1e-10") for value in printed)
    assert check(certificate(task(["1"], ["1", "1"]), impossible="remainder")).to_dict()["impossible"] is True
    assert "maneuver_time" not in check(certificate(INTEGRATOR, lower="2", witnesses=(ONE, None))).to_dict()


@pytest.mark.parametrize("value", [Fraction(1, 3), Fraction(2, 3), Fraction(10**40, 7), Fraction(1, 7 * 10**30), Fraction(0), Fraction(12)])
def test_printed_bounds_are_rounded_to_the_safe_side(value: Fraction) -> None:
    exact = fmpq(value.numerator, value.denominator)
    below, above = (Fraction(rounded(exact, rounding) or "") for rounding in ("ROUND_FLOOR", "ROUND_CEILING"))
    assert below <= value <= above
    assert above - below <= value / 10**15
    assert "E" not in (rounded(exact, "ROUND_FLOOR") or "")


def test_the_precision_outside_is_left_alone() -> None:
    before = flint.ctx.prec
    for content in (proven("two_mass_1"), b"", certificate(INTEGRATOR, lower="2", witnesses=(ONE, None))):
        check(content)
        assert flint.ctx.prec == before


def test_the_horizon_may_be_any_fraction() -> None:
    assert outcome(certificate(INTEGRATOR, lower="2/3", witnesses=(ONE, None))) is Outcome.PROVED
    assert outcome(certificate(INTEGRATOR, lower="4/3", witnesses=(ONE, None))) is Outcome.REFUTED


# Whatever the file holds, a check ends.


def _bits(bits: int) -> Any:
    return flint.ctx.workprec(bits)


def mignotte(degree: int, digits: int) -> list[str]:
    """s^n - 2 (10^digits s - 1)²: two roots 10^(-digits (n+2)/2) apart, which isolation to the end would spend hours on."""
    a = 10**digits
    return ["1", *["0"] * (degree - 3), str(-2 * a * a), str(4 * a), "-2"]


LONG = "9" * 2000
HOSTILE: dict[str, Callable[[], bytes]] = {
    "close poles": lambda: certificate(task(["1"], mignotte(20, 100)), lower="1", witnesses=(ONE, None)),
    "many close poles": lambda: certificate(task(["1"], mignotte(200, 19)), lower="1", witnesses=(ONE, None)),
    "close zeros": lambda: certificate(
        task(mignotte(20, 100), ["1", *["0"] * 24, "1"], rest="output", limits=("-10", "10")), lower="1", witnesses=(ONE, None)
    ),
    "long numbers": lambda: certificate(
        task([LONG], ["1", *[f"1/{LONG[:-1]}{i}" for i in range(1, 10, 2)] * 20]), lower="1", witnesses=(ONE, None)
    ),
    "far horizon": lambda: certificate(task(["1"], ["1", "0", "1"], "0.5"), lower=LONG, witnesses=(SWING, None)),
    "fast and far": lambda: certificate(task(["1"], ["1", "0", "1" + "0" * 1000], "0.5"), lower="1000000", witnesses=(SWING, None)),
    "no costate": lambda: certificate(task(["1"], ["1", "0", "1"], "0.5"), lower="1", witnesses=(costate(), None)),
    "many oscillations": lambda: certificate(task(["1"], ["1", "0", "1"], "0.5"), lower="10000000", witnesses=(SWING, None)),
    "many segments": lambda: certificate(
        task(["1"], ["1", "0"]),
        upper="100000",
        witnesses=(None, command("100000", [(str(i), ("1", "-1")[i % 2]) for i in range(100_000)], [["time", 0, 0]])),
    ),
    "too many segments": lambda: certificate(
        task(["1"], ["1", "0"]), upper="1", witnesses=(None, command("1", [("0", "1")] * 100_001, [["time", 0, 0]]))
    ),
    "many segments and poles": lambda: certificate(
        task(["1"], ["1", *["0"] * 198, "1", "0"], zeros={}),
        upper="100000",
        witnesses=(None, command("100000", [(str(i), "0.1") for i in range(20_000)], [["level", i, 0] for i in range(200)])),
    ),
    "many names": lambda: certificate(
        task(["1"], ["1", "0"], zeros={f"mode[{i}]": 1 for i in range(100_000)}), lower="1", witnesses=(ONE, None)
    ),
    "tiny radius": lambda: certificate(
        INTEGRATOR, upper="2", witnesses=(None, command("1.5", [("0", "1")], [["time", 0, 0]], "1/" + LONG))
    ),
    "huge radius": lambda: certificate(INTEGRATOR, upper="2", witnesses=(None, command("1.5", [("0", "1")], [["time", 0, 0]], LONG))),
    "many further zeros": lambda: certificate(
        task(["1"], ["1", *["0"] * 29, "1"], "0.5", zeros={f"mode[{i}]": 20 for i in range(1, 16)}), lower="1", witnesses=(ONE, None)
    ),
    "slow zero": lambda: changed(
        proven_tail("real_zero"),
        lambda data: (
            data["task"]["plants"][0].update(numerator=["1", "1/" + LONG]),
            data["upper"]["tail"][0].update(near=["0", "0"]),
        ),
    ),
    "ringing zeros": lambda: changed(
        proven_tail("complex_zeros"), lambda data: data["task"]["plants"][0].update(numerator=["1", "0.000000000000001", "3"])
    ),
    "many contacts": lambda: changed(
        proven_tail("real_zero"),
        lambda data: data["lower"].update(tail=[{"time": str(i), "upper": "0", "lower": "0"} for i in range(10_000)]),
    ),
}
SWING = costate((("0", "1"), [("1", "1")]))


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_certificate_costs_some_seconds_at_most(name: str) -> None:
    content = HOSTILE[name]()
    begun = time.perf_counter()
    found = check(content)
    assert found.outcome is not Outcome.PROVED or name in ("huge radius", "many contacts")  # these two claim what is true
    assert time.perf_counter() - begun < 20.0  # a hang would take hours; the machine may be busy
    assert found.bits <= 1024


def test_work_is_counted_not_timed() -> None:
    balls.work["left"] = 10.0
    Root(acb(-1), 1).impulse(arb(1))
    with pytest.raises(Inconclusive, match="more work"):
        Root(acb(-1), 1).impulse(arb(1))


# The parts.


def test_the_jacobian_is_the_residuals_derivative() -> None:
    """Over a box: the mean value theorem holds between any two of its points (a wrong column would prove what does not exist)."""
    posed = task(["1", "5", "6"], ["1", "1", "1", "1", "0", "0"], rest="output", zeros={"mode[1]": 1, "real[1]": 1})
    system_task = read(certificate(posed, lower="1", witnesses=(costate(), None))).task
    balls.work["left"] = 1e9
    with _bits(128):
        system = balls.system(system_task)
        n, step = 3, fmpq(1, 1000)
        written_command: list[upper.Number] = [fmpq(5), fmpq(0), fmpq(1), fmpq(3), fmpq(1), fmpq(-1), fmpq(1, 2), fmpq(1, 5), fmpq(-1, 7)]
        at = upper.residual(system, n, written_command)
        for place in range(len(written_command)):
            other: list[upper.Number] = [value + (step if i == place else 0) for i, value in enumerate(written_command)]
            box: list[upper.Number] = [
                arb(value).union(arb(value + step)) if i == place else value for i, value in enumerate(written_command)
            ]
            slopes = upper.derivative(system, n, box, place) * arb(step)
            change = upper.residual(system, n, other) - at
            assert all(slope.overlaps(x) for slope, x in zip(slopes.entries(), change.entries(), strict=True))
            assert any(not x.contains(0) for x in change.entries())
            assert max(float(slope.rad()) for slope in slopes.entries()) < 1e-3  # the enclosure says something


def test_a_tails_columns_are_what_its_input_does() -> None:
    """At an unstable pole `-∫_0^∞ e^{-pr} t(r) dr` is the one state from which x' = p x + t(r) does not blow up."""
    posed = task(["1", "4", "9", "10"], ["1", "-3", "2", "0"], rest="output")
    with _bits(128):
        balls.work["left"] = 1e9
        system = balls.system(read(certificate(posed, lower="1", witnesses=(costate(), None))).task)
        course = [Wave.of(system.zeros, [fmpq(int(i == j)) for i in range(3)]) for j in range(3)]
        place = 0
        for root in system.roots:
            if root.value.real > 0:
                for j, wave in enumerate(course):
                    rate = root.value

                    def integrand(r: acb, _: bool, wave: Wave = wave, rate: acb = rate) -> acb:
                        total = acb(0)
                        for zero, c in zip(wave.roots, wave.rows.tolist()[0], strict=True):
                            one, other = c * (zero.value * r).exp(), c.conjugate() * (zero.value.conjugate() * r).exp()
                            total += (one + other) / 2
                        return total * (-rate * r).exp()

                    expected = -acb.integral(integrand, 0, 60).real
                    assert abs(system.columns[place, j] - expected) < 1e-15
            place += root.size


def test_an_instant_may_not_leave_its_order() -> None:
    """1/s²: u = 1, -1 with the second arc before the first one's start; the moments are right, the command is none."""
    out_of_order = command("2", [("0", "1"), ("3", "-1")], [["time", 0, 0], ["start", 1, 0]])
    found = check(certificate(task(["1"], ["1", "0", "0"]), upper="4", witnesses=(None, out_of_order)))
    assert found.outcome is not Outcome.PROVED
    with pytest.raises(Refuted):
        upper.at_most(fmpq(3), fmpq(2), "")
    with pytest.raises(Undecided):
        upper.at_most(arb(1, 1), fmpq(1), "")
    upper.at_most(fmpq(1), fmpq(1), "")


def test_levels_beyond_the_limits_are_refuted() -> None:
    fast = command("0.5", [("0", "2")], [["time", 0, 0]])
    assert outcome(certificate(INTEGRATOR, upper="1", witnesses=(None, fast))) is Outcome.REFUTED
    unknown = command("0.5", [("0", "2")], [["level", 0, 0]])
    assert outcome(certificate(INTEGRATOR, upper="1", witnesses=(None, unknown))) is Outcome.REFUTED


def test_a_command_far_from_a_solution_is_refuted() -> None:
    wrong = command("0.5", [("0", "1")], [["time", 0, 0]])
    assert outcome(certificate(INTEGRATOR, upper="2", witnesses=(None, wrong))) is Outcome.REFUTED


def test_singular_unknowns_are_inconclusive() -> None:
    twice = command("2", [("0", "1"), ("1", "1")], [["start", 1, 0]])
    assert outcome(certificate(INTEGRATOR, upper="2", witnesses=(None, twice))) is Outcome.INCONCLUSIVE


def test_a_costate_that_proves_nothing_is_refuted() -> None:
    backwards = costate((("0", "0"), [("-1", "0")]))
    assert outcome(certificate(INTEGRATOR, lower="0.5", witnesses=(backwards, None))) is Outcome.REFUTED
    assert outcome(certificate(INTEGRATOR, lower="0.5", witnesses=(costate(), None))) is Outcome.REFUTED


def test_a_costate_is_moved_onto_the_tails_equalities() -> None:
    """However it is written, p satisfies them in balls: with one zero and one pole less than two nothing remains of it."""
    posed = read(proven_tail("double_zero"))
    balls.work["left"] = 1e9
    with _bits(128):
        system = balls.system(posed.task)
        numbers = lower.costate(system, posed.lower)
        excess = system.columns.transpose() * numbers
        for contact in posed.lower.tail:
            shapes = balls.flat(system.zeros, lambda zero, at=contact.time: zero.impulse(arb(at)))
            excess += shapes * arb(contact.upper - contact.lower)
        assert all(x.contains(0) and float(x.rad()) < 1e-30 for x in excess.entries())


def test_the_checker_stands_alone(tmp_path: Path) -> None:
    """python-flint and the standard library, and nothing of the solver."""
    script = """
import sys
from pathlib import Path
from relaxations.checking.claims import check_file, claim
found = check_file(Path(sys.argv[1]))
print(found.outcome.value, claim(found.certificate) != "")
loaded = {name.split(".")[0] for name in sys.modules}
print(sorted(loaded & {"numpy", "scipy", "cvxpy", "clarabel", "rfc8785", "pydantic", "matplotlib", "fmpy"}))
print(sorted(name for name in sys.modules if name.startswith(("relaxations", "suite", "reports", "fmus"))))
"""
    path = tmp_path / "certificate.json"
    path.write_bytes(proven("two_mass_1"))
    done = subprocess.run([sys.executable, "-c", script, path], capture_output=True, text=True, check=True)
    modules = ["", ".checking", ".checking.balls", ".checking.claims", ".checking.lower", ".checking.reading", ".checking.upper"]
    assert done.stdout.splitlines() == ["proved True", "[]", str([f"relaxations{name}" for name in modules])]


def test_a_plant_error_is_no_way_out() -> None:
    """A certificate about a plant without rest state is malformed, as the plant itself is refused."""
    with pytest.raises(PlantError):
        forgery.transfer([1, 0], [1, 1, 1])().rest_input(Fraction(1))
    assert outcome(certificate(task(["1", "0"], ["1", "1", "1"]), lower="1", witnesses=(ONE, None))) is Outcome.MALFORMED
    assert forged(opened(proven("rigid_body"))) == proven("rigid_body")
