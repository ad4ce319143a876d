"""The checker's parts one by one, and holes that were there once."""

from __future__ import annotations

import cmath
from fractions import Fraction
from typing import Any

import flint
import forgery
import pytest
from flint import acb, arb, fmpq, fmpq_poly
from forgery import certificate, changed, command, costate, forged, opened, proven, proven_tail, system, task, written

from relaxations.checking import balls, lower, upper
from relaxations.checking.balls import Root, Wave
from relaxations.checking.claims import Outcome, check
from relaxations.checking.reading import Refuted, Undecided, read
from relaxations.plants import PlantError

INTEGRATOR = task(["1"], ["1", "0"])
ONE = costate((("0", "0"), [("1", "0")]))


def outcome(content: bytes) -> Outcome:
    return check(content).outcome


def _bits(bits: int) -> Any:
    return flint.ctx.workprec(bits)


@pytest.fixture(autouse=True)
def _enough_work() -> None:
    balls.work["left"] = 1e9


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
        mirrored = balls_of([-1, 1], [1, 1])  # ±1, both exact
        with pytest.raises(Undecided):
            balls.further(mirrored, {"real[1]": 1})
        three = balls_of([1, 0, 1], [1, fmpq(1, 10), 1], [fmpq(1, 4), 0, 1])
        assert sorted(root.multiplicity for root in balls.further(three, {"mode[1]": 3})) == [1, 1, 4]


def test_roots_are_those_of_the_exact_polynomial() -> None:
    """Π (s² + k²), k ≤ 80: its coefficients have up to 790 bits, and rounded to the precision it would have other roots."""
    roots = balls_of(*([k * k, 0, 1] for k in range(1, 81)))
    assert len(roots) == 80
    for k, root in enumerate(sorted(roots, key=lambda root: float(root.value.imag.mid())), 1):
        assert root.value.contains(acb(0, k))
        assert float(root.value.imag.rad()) < 1e-36


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
            except Undecided:
                continue
            assert len(found) == 1
            assert found[0].value.real < 0


def test_zeros_on_the_axis_are_no_stable_ones() -> None:
    with _bits(128):
        assert balls.stable(fmpq_poly([1, 0, 1]) * fmpq_poly([2, 0, 1]) ** 2) == ()
        assert len(balls.stable(fmpq_poly([fmpq(-1, 4), 0, 1]))) == 1  # ±1/2: the same, and real
        quadruple = balls.stable(fmpq_poly([4, 0, 0, 0, 1]))  # ±1 ± j: common to N(s) and N(-s), and not on the axis
        assert [root.value.real < 0 for root in quadruple] == [True]
        assert [root.multiplicity for root in balls.stable(fmpq_poly([1, 1]) ** 3 * fmpq_poly([-1, 1]))] == [3]


def test_the_horizon_may_be_any_fraction() -> None:
    assert outcome(certificate(INTEGRATOR, lower="2/3", witnesses=(ONE, None))) is Outcome.PROVED
    assert outcome(certificate(INTEGRATOR, lower="4/3", witnesses=(ONE, None))) is Outcome.REFUTED


# The parts.


@pytest.mark.parametrize("start", [None, ["1", "-0.5", "2", "0.25", "-1"]])
def test_the_jacobian_is_the_residuals_derivative(start: list[str] | None) -> None:
    """Over a box: the mean value theorem holds between any two of its points (a wrong column would prove what does not exist)."""
    others: dict[str, Any] = {"zeros": {"mode[1]": 1, "real[1]": 1}} if start is None else {"initial_state": start}
    posed = task(["1", "5", "6"], ["1", "1", "1", "1", "0", "0"], rest="output", **others)
    plant = system(posed)
    with _bits(128):
        n, step = 3, fmpq(1, 1000)
        written_command: list[upper.Number] = [fmpq(5), fmpq(0), fmpq(1), fmpq(3), fmpq(1), fmpq(-1), fmpq(1, 2), fmpq(1, 5), fmpq(-1, 7)]
        at = upper.residual(plant, n, written_command)
        for place in range(len(written_command)):
            other: list[upper.Number] = [value + (step if i == place else 0) for i, value in enumerate(written_command)]
            box: list[upper.Number] = [
                arb(value).union(arb(value + step)) if i == place else value for i, value in enumerate(written_command)
            ]
            slopes = upper.derivative(plant, n, box, place) * arb(step)
            change = upper.residual(plant, n, other) - at
            assert all(slope.overlaps(x) for slope, x in zip(slopes.entries(), change.entries(), strict=True))
            assert any(not x.contains(0) for x in change.entries())
            assert max(float(slope.rad()) for slope in slopes.entries()) < 1e-3  # the enclosure says something


def test_the_target_is_where_the_plant_stays() -> None:
    """Of 1/(s+2)³ the moments x_k at rest obey 0 = -2 x_0 + u, 0 = -2 x_k + x_{k-1}; of integrators all vanish but the last."""
    held = system(task(["1"], ["1", "6", "12", "8"], "1/16"))  # u = 1/2
    assert held.rest == fmpq(1, 2)
    assert held.target.entries() == [arb("0.25"), arb("0.125"), arb("0.0625")]
    further = system(task(["1"], ["1", "0", "1"], "0.5", zeros={"mode[1]": 1}))
    first, second = (acb(further.target[k, 0], -further.target[k + 1, 0]) for k in (0, 2))
    assert first.overlaps(acb(fmpq(1, 2)) / acb(0, -1))
    assert second.overlaps(acb(fmpq(1, 2)) / acb(0, -1) ** 2)
    moved = system(task(["4"], ["1", "2", "0", "0"], "3"))  # y tends to 2 ∫∫u: x_1 = 3/2
    assert moved.target.entries() == [arb(0), arb("1.5"), arb(0)]


def test_a_tails_columns_are_what_its_input_does() -> None:
    """At an unstable pole `-∫_0^∞ e^{-pr} t(r) dr` is the one state from which x' = p x + t(r) does not blow up."""
    posed = task(["1", "4", "9", "10"], ["1", "-3", "2", "0"], rest="output")
    with _bits(128):
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
    # -1 from 0 on, 1 from -0.4 on, until 0.2: the formula gives the moment 1 that takes 1 s
    before_zero = command("0.2", [("0", "-1"), ("-0.4", "1")], [["time", 0, 0]])
    assert outcome(certificate(INTEGRATOR, upper="0.3", witnesses=(None, before_zero))) is Outcome.REFUTED
    too_late = command("0.6", [("0", "1"), ("0.8", "-1")], [["start", 1, 0]])  # 0.6 - 2 (0.6 - 0.8) is 1
    assert outcome(certificate(INTEGRATOR, upper="0.7", witnesses=(None, too_late))) is Outcome.REFUTED
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


@pytest.mark.parametrize("name", ["real_zero", "pitch", "complex_zeros", "double_zero", "short_tail"])
def test_a_costate_is_moved_onto_the_tails_equalities(name: str) -> None:
    """However roughly it is written: here with two digits; then the equalities hold in balls, and little was moved."""
    posed = read(changed(proven_tail(name), rough_costate))
    with _bits(128):
        system = balls.system(posed.task)
        numbers, _ = lower.costate(system, posed.lower)
        excess = system.columns.transpose() * numbers
        for contact in posed.lower.tail:
            shapes = balls.flat(system.zeros, lambda zero, at=contact.time: zero.impulse(arb(at)))
            excess += shapes * arb(contact.upper - contact.lower)
        assert all(x.contains(0) and float(x.rad()) < 1e-30 for x in excess.entries())
        before = balls.placed(system.roots, posed.lower.costate[0])[0]
        assert max(float(abs(x - y)) for x, y in zip(numbers.entries(), before, strict=True)) < 0.1 * max(map(abs, map(float_of, before)))


def float_of(value: fmpq) -> float:
    return int(value.p) / int(value.q)


def rough_costate(data: dict[str, Any]) -> None:
    """Two digits of each number; the claim, of the lower side alone, five percent less."""
    for chain in data["lower"]["costate"][0]:
        chain["coefficients"] = [[written(Fraction(f"{float(forgery.number(x)):.2g}")) for x in c] for c in chain["coefficients"]]
    data["claim"] |= {"lower": written(forgery.number(data["claim"]["lower"]) * Fraction(95, 100)), "upper": None}


def test_a_rough_costate_proves_a_little_less() -> None:
    """The error is of second order."""
    for name in ("real_zero", "complex_zeros", "double_zero"):
        assert outcome(changed(proven_tail(name), rough_costate)) is Outcome.PROVED


@pytest.mark.parametrize("power", range(12))
def test_taylors_formula_encloses_the_ends(power: int) -> None:
    """s^k/k!, whose Taylor polynomials at 1 have nonnegative terms only: an enclosure over [0, 2] that forgets one misses the right end."""
    with _bits(128):
        p = Wave.of((Root(acb(0), power + 1),), [fmpq(0)] * power + [fmpq(1)])
        c, value, slope, values = p.over(arb(0), arb(2))
        assert c == 1
        assert value.overlaps(p(arb(1))[0])
        for end in (arb(0), arb(2)):
            assert values.overlaps(p(end)[0])
            assert slope.overlaps(p(end)[1])
        if power <= 8:  # no row is a ball then: nothing but the series itself, whose ends are those of p
            assert values.upper() <= p(arb(2))[0] * 1.0001
            assert slope.upper() <= p(arb(2))[1] * 1.0001


def test_a_plant_error_is_no_way_out() -> None:
    """A certificate about a plant without rest state is malformed, as the plant itself is refused."""
    with pytest.raises(PlantError):
        forgery.transfer([1, 0], [1, 1, 1])().rest_input(Fraction(1))
    assert outcome(certificate(task(["1", "0"], ["1", "1", "1"]), lower="1", witnesses=(ONE, None))) is Outcome.MALFORMED
    assert forged(opened(proven("rigid_body"))) == proven("rigid_body")


@pytest.mark.parametrize("name", ["pitch", "complex_zeros", "short_tail"])
def test_every_contact_of_a_tail_counts(name: str) -> None:
    """In halves it is the same; one that weighs nothing changes nothing; one that pulls both ways costs, wherever it stands in the list."""
    content = changed(proven_tail(name), lambda data: data["claim"].update(upper=None))
    (contact,) = opened(content)["lower"]["tail"]

    def with_contacts(*contacts: dict[str, str]) -> Outcome:
        return outcome(changed(content, lambda data: data["lower"].update(tail=list(contacts))))

    half = {"time": contact["time"], **{side: written(forgery.number(contact[side]) / 2) for side in ("upper", "lower")}}
    nothing = {"time": "1/2", "upper": "0", "lower": "0"}
    both = {"time": "1/2", "upper": "100", "lower": "100"}
    assert with_contacts(half, half) is with_contacts(contact, nothing) is with_contacts(nothing, contact) is Outcome.PROVED
    assert with_contacts(contact, both) is with_contacts(both, contact) is Outcome.REFUTED


@pytest.mark.parametrize("name", ["insensitive_real", "insensitive_pair", "insensitive_double"])
def test_what_is_left_of_a_limited_tails_equality_is_priced(name: str) -> None:
    """In floating point, with contacts of its own: the price is that of the contacts and `cap |λᵀ column + Σ (μ⁺ - μ⁻) shape|`."""
    contacts = [{"time": "1/4", "upper": "3", "lower": "1/2"}, {"time": "2", "upper": "0", "lower": "1/3"}]
    posed = read(changed(proven_tail(name), lambda data: data["lower"].update(tail=contacts)))
    with _bits(128):
        system = balls.system(posed.task)
        numbers, price = lower.costate(system, posed.lower)
        left = [float(x.mid()) for x in (system.columns.transpose() * numbers).entries()]
        above, below = system.room(fmpq(0))
        expected, at = 0.0, 0
        for zero, cap in zip(system.zeros, system.caps, strict=True):
            value = complex(float(zero.value.real.mid()), float(zero.value.imag.mid()))
            for power in range(zero.multiplicity):
                pull = sum(
                    net * tau**power * cmath.exp(value * tau) for tau, net in ((0.25, 2.5), (2.0, -1 / 3))
                )  # power 0 or 1: no factorial
                excess = complex(left[at] + pull.real, (left[at + 1] - pull.imag) if zero.flexible else 0.0)
                at += 1 + zero.flexible
                if cap is not None and power == zero.multiplicity - 1:
                    expected += float(cap.mid()) * abs(excess)
                else:
                    assert abs(excess) < 1e-12
        expected += 3 * float_of(above) + (0.5 + 1 / 3) * float_of(below)
        assert float(price.mid()) == pytest.approx(expected, rel=1e-12)


def test_a_tail_is_no_part_of_a_rest_of_the_state() -> None:
    for side in ("lower", "upper"):
        one = changed(proven_tail("pitch"), lambda data, side=side: data["claim"].update({side: None}))
        assert outcome(one) is Outcome.PROVED
        assert outcome(changed(one, lambda data: data["task"].update(rest="state"))) is Outcome.MALFORMED


@pytest.mark.parametrize(
    ("limits", "displacement"), [(("1/2", "1"), "0.7"), (("-1", "-1/2"), "-0.7"), (("-1", "1/2"), "0.7"), (("-1/2", "1"), "-0.7")]
)
def test_limits_that_exclude_the_input_at_a_rest(limits: tuple[str, str], displacement: str) -> None:
    """The initial one, 0, and the final one of 1/(s + 1)."""
    of = task(["1"], ["1", "1"], displacement, limits=limits)
    assert "exclude the input" in check(certificate(of, lower="1/10", witnesses=(costate((("-1", "0"), [("1", "0")])), None))).reason


def test_samples_without_a_box() -> None:
    sampled = {**costate((("0", "0"), [("1", "0")])), "samples": [{"place": ["1"], "residual": [], "deflection": [], "after": []}]}
    assert outcome(certificate(INTEGRATOR, lower="1/2", witnesses=(sampled, None))) is Outcome.MALFORMED
