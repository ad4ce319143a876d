"""Plants: every form becomes the same exact object, and what cannot be used is refused by name."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from flint import ctx, fmpq_poly
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from problems import chain, two_mass
from scipy.signal import residue

from relaxations.errors import PlantError
from relaxations.plants import LinearPlant, Pole, exact, precision

transfer, zeros_poles, modes = LinearPlant.from_transfer, LinearPlant.from_zeros_poles, LinearPlant.from_modes


def same(a: LinearPlant, b: LinearPlant) -> bool:
    return a.denominator == b.denominator and dict(a.numerators) == dict(b.numerators)


def product(*factors: Sequence[Fraction | int]) -> list[Fraction]:
    """Coefficients of a product of polynomials, highest power first, exact."""
    result = [Fraction(1)]
    for factor in factors:
        result = [
            sum((result[i] * factor[k - i] for i in range(len(result)) if 0 <= k - i < len(factor)), Fraction(0))
            for k in range(len(result) + len(factor) - 1)
        ]
    return result


# One plant in all its forms.


def test_every_form_of_a_plant_is_the_same_plant():
    # 1/s² + 3/(s² + 0.04 s + 4) = (4 s² + 0.04 s + 4) / (s² (s² + 0.04 s + 4)): ω = 2, ζ = 0.01
    by_modes = modes(1, [(2, "0.01", 3)])
    by_polynomials = transfer([4, "0.04", 4], [1, Decimal("0.04"), 4, 0, 0])
    scaled = transfer([8, "0.08", 8], [2, "0.08", 8, 0, 0])
    A = [[0, 1, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1], [0, 0, -4, Fraction(-4, 100)]]
    by_matrices = LinearPlant.from_state_space(A, [0, 1, 0, 1], [1, 0, 3, 0])
    assert same(by_modes, by_polynomials)
    assert same(by_modes, scaled)
    assert same(by_modes, by_matrices)


def test_roots_and_polynomials_agree_exactly():
    # (s+2)((s+1)²+9) / (s (s+0.5) ((s+0.1)²+4))
    by_roots = zeros_poles([-2, (-1, 3), (-1, -3)], [0, "-0.5", ("-0.1", 2), ("-0.1", -2)], Fraction(7, 3))
    numerator = product([1, 2], [1, 2, 10], [Fraction(7, 3)])
    denominator = product([1, 0], [1, Fraction(1, 2)], [1, Fraction(1, 5), Fraction(401, 100)])
    assert same(by_roots, transfer(numerator, denominator))


def test_text_and_decimals_are_read_exactly_and_floats_as_the_binary_numbers_they_are():
    assert exact("0.1") == exact(Decimal("0.1")) == Fraction(1, 10)
    assert exact(0.1) != Fraction(1, 10)
    assert exact("1e-3") == Fraction(1, 1000)


@pytest.mark.parametrize("number", ["nan", "inf", float("nan"), float("-inf"), Decimal("NaN"), Decimal("Infinity"), "one", "", "1/0"])
def test_what_is_no_finite_number_is_refused(number: float | str | Decimal):
    with pytest.raises(PlantError, match="finite"):
        transfer([1], [1, number])


@given(st.lists(st.integers(-9, 9), min_size=2, max_size=5), st.lists(st.integers(-9, 9), min_size=1, max_size=3), st.integers(1, 50))
def test_scaling_both_polynomials_changes_nothing(denominator: list[int], numerator: list[int], factor: int):
    denominator[0] = denominator[0] or 1
    numerator = numerator[-len(denominator) :]
    if not any(numerator):
        numerator[-1] = 1
    scaled = transfer([Fraction(c, factor) for c in numerator], [Fraction(c, factor) for c in denominator])
    assert same(scaled, transfer(numerator, denominator))


# Poles, zeros and multiplicities.


def test_multiplicities_are_exact_however_close_the_roots():
    near = Fraction(1, 10**9)
    plant = zeros_poles([], [-1, -1, -1, -1 - near, 0, 0], 1)
    assert [(p.value, p.multiplicity) for p in plant.poles] == [(0j, 2), (-1 + 0j, 3), (complex(-1 - 1e-9), 1)]


def test_repeated_conjugate_pairs_are_one_pole_each():
    plant = zeros_poles([], [("-0.1", 1), ("-0.1", -1)] * 3 + [(0, 2), (0, -2)] * 2, 1)
    assert [p.multiplicity for p in plant.poles] == [3, 2]
    assert plant.poles[1].value == 2j
    assert plant.order == 10


def test_poles_on_the_imaginary_axis_have_no_real_part_at_all():
    assert all(p.value.real == 0.0 for p in chain(7).poles)
    # (s² + 2)² (s² + 3): irrational places, still exactly on the axis; its neighbour at -1e-12 is not.
    plant = transfer([1], product([1, 0, 2], [1, 0, 2], [1, 0, 3]))
    assert [p.value.real for p in plant.poles] == [0.0, 0.0]
    assert [p.multiplicity for p in plant.poles] == [2, 1]
    near = transfer([1], [1, "2e-12", 2])
    assert near.poles[0].value.real == pytest.approx(-1e-12, rel=1e-15)


def test_a_mirrored_pair_off_the_axis_is_not_taken_for_one_on_it():
    plant = transfer([1], product([1, Fraction(2, 10**10), 4], [1, Fraction(-2, 10**10), 4]))
    assert sorted(p.value.real for p in plant.poles) == pytest.approx([-1e-10, 1e-10], rel=1e-15)


def test_natural_frequencies_of_a_chain_are_those_of_the_textbook():
    n = 11
    found = [p.natural_frequency for p in chain(n).flexible]
    expected = 2 * np.sin(np.arange(1, n) * np.pi / (2 * n))
    np.testing.assert_allclose(found, expected, rtol=4e-16)  # correctly rounded on both sides, but for the sine


def test_modes_are_counted_by_ascending_frequency_and_real_poles_by_magnitude():
    plant = zeros_poles([], [-5, "-0.2", 0, (-1, 3), (-1, -3), (0, 1), (0, -1)], 1)
    assert plant.rigid_order == 1
    assert [p.value for p in plant.real] == [-0.2 + 0j, -5 + 0j]
    assert [p.value for p in plant.flexible] == [1j, -1 + 3j]
    assert plant.flexible[1].damping_ratio == pytest.approx(1 / np.sqrt(10), rel=1e-15)
    assert plant.poles[0] == Pole(0j, 1)


def test_zeros_come_with_their_multiplicity():
    plant = zeros_poles([-1, -1, (0, 2), (0, -2)], [-3, -4, -5, -6, -7], 1)
    assert [(z.value, z.multiplicity) for z in plant.zeros] == [(-1 + 0j, 2), (2j, 1)]


@pytest.mark.parametrize(
    ("plant", "unstable"),
    [
        (transfer([1], [1, 0, 1]), False),
        (transfer([1], [1, 0, 0]), False),
        (transfer([1], [1, -1]), True),
        (transfer([1], [1, 0, 2, 0, 1]), True),
        (transfer([1], [1, "-1e-9", 1]), True),
    ],
)
def test_unstable_plants_are_known_as_such(plant: LinearPlant, unstable: bool):
    assert plant.is_unstable is unstable


# Partial fractions.


@pytest.mark.parametrize(
    "plant",
    [
        transfer([1, 3], [1, 6, 11, 6]),
        transfer([1, 0, 5], [1, "0.3", 4, 0, 0]),
        transfer([2, 1], [1, 3, 3, 1]),  # a triple pole
        transfer([1, 2, 3], [1, "0.1", 1]),  # feed-through
        two_mass(),
    ],
)
def test_residues_a_vs_b_scipy(plant: LinearPlant):
    s = np.array([0.3 + 0.4j, -0.7 + 2.1j, 5.0 + 0.0j, 0.01 - 3.0j])
    partial = plant.partial()
    ours = np.full(s.shape, partial.feedthrough, dtype=complex)
    for pole, residues in zip(plant.poles, partial.residues, strict=True):
        for k, r in enumerate(residues, 1):
            ours += r / (s - pole.value) ** k
            if pole.is_flexible:
                ours += np.conj(r) / (s - np.conj(pole.value)) ** k
    numerator, denominator = floats(plant.numerators[plant.output]), floats(plant.denominator)
    np.testing.assert_allclose(ours, np.polyval(numerator, s) / np.polyval(denominator, s), rtol=1e-13)
    theirs = np.zeros(s.shape, dtype=complex)
    residues, poles, direct = residue(numerator, denominator, tol=1e-4)
    seen: dict[complex, int] = {}
    for r, p in zip(residues, poles, strict=True):
        near = next((q for q in seen if abs(q - p) < 1e-3), p)
        seen[near] = seen.get(near, 0) + 1
        theirs += r / (s - p) ** seen[near]
    # SciPy finds repeated roots to the third root of rounding and clusters them.
    np.testing.assert_allclose(ours, theirs + np.polyval(direct, s), rtol=1e-4)


def test_residues_of_nearly_equal_poles_keep_every_digit():
    # 1/((s+1)(s+1+ε)) has residues ±1/ε; in doubles the subtraction would leave six digits.
    plant = zeros_poles([], [-1, "-1.0000000001"], 1)
    (first,), (second,) = plant.partial().residues
    assert first.real == pytest.approx(1e10, rel=1e-15)
    assert second.real == pytest.approx(-1e10, rel=1e-15)


def floats(polynomial: fmpq_poly) -> NDArray[np.float64]:
    return np.array([int(c.p) / int(c.q) for c in reversed(polynomial.coeffs())])


# Outputs.


def test_output_and_its_rate_exist_in_every_form():
    plant = two_mass()
    assert set(plant.numerators) == {"output", "output_rate", "position_1", "position_2", "spring"}
    assert plant.numerators["output_rate"] == fmpq_poly([0, 1]) * plant.numerators["output"]
    assert plant.numerators["spring"] == plant.numerators["position_2"] - plant.numerators["position_1"]


def test_a_fed_through_output_has_no_rate():
    assert set(transfer([1, 2], [1, 1]).numerators) == {"output"}


def test_an_unknown_output_names_those_that_exist():
    with pytest.raises(PlantError, match="position_1, position_2, spring"):
        two_mass().partial("position_3")


# Rest.


def test_the_rest_input_is_exact():
    assert transfer([1], [1, 0, "0.3"]).rest_input(Fraction(1, 7)) == Fraction(3, 70)
    assert two_mass().rest_input(Fraction(5)) == 0


def test_a_zero_at_the_origin_is_refused():
    with pytest.raises(PlantError, match="zero at the origin"):
        transfer([1, 0], [1, 1, 1]).rest_input(Fraction(1))
    with pytest.raises(PlantError, match="zero at the origin"):  # a common factor s counts
        transfer([1, 0], [1, 1, 0]).rest_input(Fraction(1))


# What cannot be used.


def test_an_improper_plant_is_refused_with_both_degrees():
    with pytest.raises(PlantError, match=r"improper.*degree 2.*only 1"):
        transfer([1, 0, 0], [1, 1])
    assert transfer([0, 0, 1], [1, 1]).order == 1  # leading zeros are no degree


@pytest.mark.parametrize("numerator", [[0], [0, 0], []])
def test_an_input_that_does_not_reach_the_output_is_refused(numerator: list[int]):
    with pytest.raises(PlantError, match="does not reach"):
        transfer(numerator, [1, 1])


@pytest.mark.parametrize("denominator", [[0], [0, 0, 0], []])
def test_a_zero_denominator_is_refused(denominator: list[int]):
    with pytest.raises(PlantError, match="denominator is zero"):
        transfer([1], denominator)


@pytest.mark.parametrize("poles", [[(0, 1)], [(0, 1), (0, 1)], [(0, 1), (0, -2)], [("-0.1", 1), (0, -1)]])
def test_complex_roots_without_their_conjugates_are_refused(poles: list[tuple[str | int, int]]):
    with pytest.raises(PlantError, match="conjugate"):
        zeros_poles([], poles, 1)


@pytest.mark.parametrize(
    ("A", "B", "C"), [([[1, 2]], [1], [1]), ([[1]], [1, 2], [1]), ([[1, 0], [0, 1]], [1, 1], [1]), ([[1, 0], [0]], [1, 1], [1, 1])]
)
def test_matrices_that_do_not_fit_are_refused(A: list[list[int]], B: list[int], C: list[int]):
    with pytest.raises(PlantError, match="n×n"):
        LinearPlant.from_state_space(A, B, C)


# Hidden modes.


def test_a_mode_that_the_input_cannot_excite_is_dropped_with_a_note():
    plant = LinearPlant.from_state_space([[-1, 0, 0], [0, 0, 1], [0, -4, 0]], [1, 0, 0], [1, 1, 0])
    assert plant.order == 1
    assert plant.notes == ("2 of 3 modes cannot be excited by the input and were dropped",)


def test_a_mode_that_the_output_cannot_see_is_kept():
    plant = LinearPlant.from_state_space([[-1, 0], [0, -2]], [1, 1], [1, 0])
    assert plant.order == 2
    assert plant.notes == ()
    assert transfer([1, 2], [1, 3, 2]).order == 2


def test_two_equal_modes_move_as_one():
    plant = modes(1, [(2, "0.1", 3), ("2.0", "0.10", 4), (5, 0, 1)])
    assert same(plant, modes(1, [(2, "0.1", 7), (5, 0, 1)]))
    assert "were joined" in plant.notes[0]
    # The same plant in matrices loses the same mode, by exact reduction.
    A = [[0, 1, 0, 0], [-4, 0, 0, 0], [0, 0, 0, 1], [0, 0, -4, 0]]
    assert same(LinearPlant.from_state_space(A, [0, 1, 0, 1], [3, 0, 4, 0]), modes(0, [(2, 0, 7)]))


@pytest.mark.parametrize("frequency", [0, -1, "-0.5"])
def test_a_mode_without_a_frequency_is_refused(frequency: int | str):
    with pytest.raises(PlantError, match="frequency"):
        modes(1, [(frequency, 0, 1)])


def test_nearly_uncontrollable_is_not_uncontrollable():
    plant = LinearPlant.from_state_space([[-1, 0], [0, -2]], [1, Fraction(1, 10**30)], [1, 1])
    assert plant.order == 2


def test_reduction_does_not_depend_on_coordinates():
    # x = S z with a dense S: the same plant, and the same dropped mode.
    A, B, C = [[-1, 2, 0], [0, -3, 1], [0, 0, -5]], [1, 1, 0], [1, 0, 7]
    S = np.array([[2, 1, 0], [1, 1, 3], [0, 5, 1]], dtype=object)
    determinant = Fraction(2 * (1 - 15) - 1 * 1)
    adjugate = np.array([[1 - 15, -1, 3], [-1, 2, -6], [5, -10, 1]], dtype=object)
    inverse = adjugate / determinant
    assert (S @ inverse == np.eye(3)).all()
    changed = LinearPlant.from_state_space(
        (inverse @ np.array(A) @ S).tolist(), (inverse @ np.array(B)).tolist(), (np.array(C) @ S).tolist()
    )
    original = LinearPlant.from_state_space(A, B, C)
    assert original.order == 2
    assert same(changed, original)


def test_precision_is_set_inside_its_block_only():
    before = ctx.prec
    with precision(300):
        assert ctx.prec == 300
    assert ctx.prec == before
