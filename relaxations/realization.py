"""From matrices that are known to some digits only to the exact plant that they stand for.

A plant that was linearised or identified has no exact multiplicities: a rigid-body mode comes out as two poles at ±1e-8, an undamped one
with a damping of -1e-17, a state that nothing excites as one that nearly nothing excites. What the matrices cannot tell from such a
structure, given the uncertainty of their entries, is taken for it; every such decision is a note of the plant.

How uncertain the poles are is found by changing the entries at random within their uncertainty: unlike a derivative of the poles, this
also holds where they meet. A pole that is known not to move by that is left exactly as the matrices have it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from flint import acb, acb_mat, fmpq, fmpq_poly
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from relaxations.plants import LinearPlant, precision

Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]

DRAWS, SEED = 16, 0  # changed copies of the matrices; always the same ones
WIDE = 3.0  # what lies within so many times the largest change seen could be elsewhere
COARSE = 0.1  # of a pole's magnitude: a pole less certain than this is no pole that could be put anywhere
BITS = 128  # of the changed copies' poles: their own rounding is none


@dataclass(frozen=True, slots=True)
class Realization:
    """The exact plant, and of each pole of the matrices (n,), as computed, how far it moves within their uncertainty [rad/s]."""

    plant: LinearPlant
    poles: Complexes
    spread: Reals


def realize(
    A: Reals,
    B: Reals,
    C: Reals,
    D: float,
    uncertainty: Reals,
    sizes: Reals | None = None,
    *,
    relative_degree: int = 0,
    name: str = "output",
) -> Realization:
    """The plant `ẋ = A x + B u`, `y = C x + D u` (A n×n, B and C of length n), with the structure that the numbers cannot tell it from.

    `uncertainty` (n+1, n+1) bounds the error of each entry of [A B; C D], `sizes` (n+1,) are natural sizes of states and input. The first
    `relative_degree` of D, CB, CAB … are known to be zero but for rounding. Raises `PlantError` as `LinearPlant.from_state_space` does.
    """
    n = len(B)
    errors, matrix = uncertainty, np.block([[A, B[:, None]], [C[None, :], np.array([[D]])]])
    plant, notes = _exact(matrix, name), ()
    reduced = _excited(matrix, errors, np.ones(n + 1) if sizes is None else sizes)
    if len(reduced[0]) - 1 < plant.order:
        # Else the exact reduction, which keeps every bit, has dropped as many.
        matrix, errors = reduced
        plant = _exact(matrix, name)
        notes = (f"{n - plant.order} of {n} modes are not excited by the input, as far as the numbers tell, and were dropped",)
    order = len(matrix) - 1
    draws = [matrix + errors * changes for changes in np.random.default_rng(SEED).uniform(-1.0, 1.0, (DRAWS, *matrix.shape))]
    poles = np.array([pole for p in plant.poles for pole in _each(p.value, p.multiplicity)], dtype=complex)
    moved = np.array([_matched(poles, _eigenvalues(draw[:order, :order])) for draw in draws]).reshape(DRAWS, len(poles))
    spread = np.abs(moved - poles).max(axis=0, initial=0.0)
    denominator, more = _structured(plant, poles, moved, spread)
    numerator, dropped = _shortened(plant, draws, relative_degree)
    if dropped > relative_degree:
        notes += (f"the first {dropped} of D, CB, CAB … cannot be told from zero: taken as exactly zero",)
    numerators = {key: numerator if key in ("output", name) else value for key, value in plant.numerators.items()}
    if "output_rate" in numerators or (numerator.degree() < plant.order):
        numerators["output_rate"] = fmpq_poly([0, 1]) * numerator
    exact = replace(plant, denominator=denominator, numerators=numerators, notes=(*plant.notes, *notes, *more))
    return Realization(exact, poles, spread)


def _each(value: complex, multiplicity: int) -> list[complex]:
    return [value] * multiplicity + ([value.conjugate()] * multiplicity if value.imag else [])


def _eigenvalues(matrix: Reals) -> Complexes:
    """Of a few more bits than doubles have."""
    if not len(matrix):
        return np.zeros(0, dtype=complex)
    with precision(BITS):
        found = acb_mat([[acb(float(x)) for x in row] for row in matrix]).eig(algorithm="approx")
        return np.array([complex(float(z.real.mid()), float(z.imag.mid())) for z in found])


def _matched(poles: Complexes, changed: Complexes) -> Complexes:
    """The changed poles in the order of `poles`, each beside its nearest (of a copy that lost one to rounding: the nearest there is)."""
    distance = np.abs(poles[:, None] - changed[None, :])
    rows, columns = linear_sum_assignment(distance)
    result = changed[distance.argmin(axis=1)] if len(changed) else poles.copy()
    result[rows] = changed[columns]
    return result


def _exact(matrix: Reals, name: str) -> LinearPlant:
    """The plant of [A B; C D] in exactly these numbers."""
    rows = [[Fraction(x) for x in row] for row in matrix.tolist()]
    return LinearPlant.from_state_space(
        [row[:-1] for row in rows[:-1]], [row[-1] for row in rows[:-1]], rows[-1][:-1], rows[-1][-1], name=name
    )


def _excited(matrix: Reals, errors: Reals, sizes: Reals) -> tuple[Reals, Reals]:
    """The part of [A B; C D] that the input excites beyond the errors, in an orthonormal basis of its Krylov space, and its errors."""
    n = len(matrix) - 1
    scale = np.append(sizes[:n], 1.0)
    scaled, errors = matrix * scale / scale[:, None], errors * scale / scale[:, None]
    rounding = n * np.finfo(float).eps
    vector, length = scaled[:n, n], float(np.linalg.norm(scaled[:n, n]))
    # Each new direction is measured against what its entries may be wrong by.
    basis, tolerance = [], 10.0 * float(np.linalg.norm(errors[:n, n]))
    while len(basis) < n and length > tolerance:
        basis.append(vector / length)
        vector = scaled[:n, :n] @ basis[-1]
        tolerance = 10.0 * float(np.linalg.norm(errors[:n, :n] @ np.abs(basis[-1])) + rounding * np.linalg.norm(vector))
        for _ in range(2):  # orthogonal to the last bit
            for q in basis:
                vector = vector - q * (q @ vector)
        length = float(np.linalg.norm(vector))
    inner = np.zeros((n + 1, len(basis) + 1))
    inner[:n, :-1], inner[n, -1] = np.array(basis).T.reshape(n, len(basis)), 1.0
    small = inner.T @ scaled @ inner
    return small, np.abs(inner).T @ errors @ np.abs(inner) + rounding * np.abs(small)


def _structured(plant: LinearPlant, poles: Complexes, moved: Complexes, spread: Reals) -> tuple[fmpq_poly, tuple[str, ...]]:
    """The denominator with poles put together, onto the origin and onto the axes where they cannot be told from being there."""
    notes: list[str] = []
    factors, kept = fmpq_poly([1]), True
    for group in _clusters(poles, spread):
        value = complex(poles[group].mean())
        width = WIDE * float(np.abs(moved[:, group].mean(axis=1) - value).max(initial=0.0))
        if len(group) > 1 and len({complex(p) for p in poles[group]}) == 1 and not abs(value) <= width:
            width = 0.0  # exactly one pole, exactly repeated
        mirrored = any(abs(poles[i].conjugate() - poles[j]) == 0.0 for i in group for j in group)
        if mirrored:
            value = complex(value.real, 0.0)
        target = value
        if abs(value) <= width:
            target = 0j
        elif value.imag and 0.0 < abs(value.real) <= WIDE * float(np.abs(moved[:, group].mean(axis=1).real - value.real).max(initial=0.0)):
            target = complex(0.0, value.imag)
        if np.any(poles[group] != target):
            kept = False
            notes += _told(poles[group], spread[group], target)
        if target.imag < 0.0:
            continue  # its conjugate's factor holds both
        real, size = fmpq(*Fraction(target.real).as_integer_ratio()), Fraction(target.real) ** 2 + Fraction(target.imag) ** 2
        factor = fmpq_poly([fmpq(size.numerator, size.denominator), -2 * real, 1]) if target.imag else fmpq_poly([-real, 1])
        for _ in group:
            factors *= factor
    return (plant.denominator, ()) if kept else (factors, tuple(dict.fromkeys(notes)))


def _told(found: Complexes, spread: Reals, target: complex) -> list[str]:
    """Where poles were put, and how far that is."""
    if target.imag < 0.0:
        return []
    far = float(np.abs(found - target).max())
    count = f"{len(found)} poles" if len(found) > 1 else "a pole"
    place = "the origin" if target == 0 else f"{target.real:.6g}" if not target.imag else f"{target.real:.6g} ± {target.imag:.6g}i rad/s"
    cannot = f"cannot be told from {'one' if len(found) > 1 and target else 'being'} there (uncertainty {spread.max():.1g} rad/s)"
    return [f"{count} within {far:.1g} rad/s of {place} {cannot}: taken as exactly there"]


def _clusters(poles: Complexes, spread: Reals) -> list[list[int]]:
    """Poles that cannot be told apart, as lists of indices."""
    near = np.abs(poles[:, None] - poles[None, :]) <= WIDE * np.maximum(spread[:, None], spread[None, :])
    small = (spread[:, None] <= COARSE * np.abs(poles)[:, None]) | (np.abs(poles)[:, None] <= WIDE * spread[:, None])
    near &= small & small.T
    waiting, groups = set(range(len(poles))), []
    while waiting:
        group, frontier = set(), {min(waiting)}
        while frontier:
            group |= frontier
            frontier = {j for i in frontier for j in range(len(poles)) if near[i, j]} - group
        groups.append(sorted(group))
        waiting -= group
    return groups


def _shortened(plant: LinearPlant, draws: Sequence[Reals], relative_degree: int) -> tuple[fmpq_poly, int]:
    """The controlled output's numerator without leading coefficients that are none, and how many of D, CB, CAB … vanish with them."""
    numerator, order = plant.numerators[plant.output], plant.order
    coefficients = numerator.coeffs()
    coefficients, dropped = coefficients[: max(order + 1 - relative_degree, 1)], 0
    while len(coefficients) > 1:
        power = order + 1 - len(coefficients)  # the leading coefficient is the first of D, CB, CAB … that is not exactly zero
        value = float(coefficients[-1])
        if value and abs(value) > WIDE * max(abs(_markov(draw, power) - value) for draw in draws):
            break
        dropped = power + 1 if value else dropped
        coefficients.pop()
    return fmpq_poly(coefficients), dropped


def _markov(matrix: Reals, power: int) -> float:
    """D, CB, CAB, … for power 0, 1, 2, …"""
    if power == 0:
        return float(matrix[-1, -1])
    vector = matrix[:-1, -1]
    for _ in range(power - 1):
        vector = matrix[:-1, :-1] @ vector
    return float(matrix[-1, :-1] @ vector)
