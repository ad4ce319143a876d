"""A linear plant from a response: the eigensystem realisation finds the poles, least squares the rest. The one module that uses control.

The response to a pulse of one sample is, from its second sample on, a sequence C A^k (A B) of the plant sampled with a held input. A
Hankel matrix of it has the plant's order as its rank; its singular values show that, and its factors give A (J.-N. Juang and R. S. Pappa,
J. Guidance 8 (1985) 620). Holding the input maps a pole p to z = e^{ph}: its logarithm leads back exactly, unless z lies on the negative
real axis, where the plant is faster than the sampling can tell, or at 0, which is a delay and no pole at all.

With the poles known, the output is linear in everything else, so the residues and the feed-through come from least squares in the
modal coordinates of `relaxations.moments`, with the exact response to the input that was applied, jumps included.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from relaxations.moments import Basis
from relaxations.plants import Pole

Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]

NOISE_FLOOR = 1e-14  # of the largest singular value: below this there is nothing but rounding
MOST_ORDERS = 6  # orders that are tried: those behind the largest gaps of the singular values
WORSE = 1.5  # by how much a simpler structure may fit worse: noise favours the one with more freedom
SLOW = 1.0  # |p| · (length of the record) below which a pole may be an integrator, |Re p| · length below which a mode may be undamped
ENOUGH = 1e-12  # of the largest output: a structure that fits as well as this fits
CLOSE = 0.01  # relative distance of poles that may be one
LIVELY = 1e-5  # |z| of a pole that dies within one sample


@dataclass(frozen=True, slots=True)
class Record:
    """A response in deviations: the input is `levels[i]` from `starts[i]` [s] on (0 before), `output` its values at `times`.

    Where the input jumps, the output is that before the jump.
    """

    times: Reals
    starts: Reals
    levels: Reals
    output: Reals

    @property
    def size(self) -> float:
        """The largest deviation of the output."""
        return float(np.abs(self.output).max(initial=0.0))

    @property
    def before(self) -> Reals:
        """The input just before each of the times."""
        index = np.searchsorted(self.starts, self.times, side="left") - 1
        return np.where(index < 0, 0.0, self.levels[np.maximum(index, 0)])


@dataclass(frozen=True, slots=True)
class Model:
    """`y = weights · M + D u` with the moments M of the input at `poles`; `relative_degree` of its leading Markov parameters are exactly 0.

    `spread` [rad/s] is the standard error of each pole, `rms` of the fit, output units.
    """

    poles: tuple[Pole, ...]
    weights: Reals
    feedthrough: float
    relative_degree: int
    rms: float
    spread: Reals
    notes: tuple[str, ...] = ()

    def predict(self, record: Record) -> Reals:
        """The output at the record's times, for its input."""
        return _regressors(self.poles, record) @ np.append(self.weights, self.feedthrough)

    def error(self, record: Record) -> float:
        """The largest distance from the record, over its largest deviation."""
        with np.errstate(over="ignore", invalid="ignore"):
            worst = float(np.abs(self.predict(record) - record.output).max()) / record.size
        return worst if math.isfinite(worst) else math.inf

    @property
    def matrices(self) -> tuple[Reals, Reals, Reals, float]:
        """A (n, n), B (n,), C (n,), D in modal coordinates: a block for each pole."""
        basis = Basis(self.poles)
        change = np.array([basis.derivative(unit) for unit in np.eye(basis.size)]).reshape(basis.size, basis.size)
        return change, basis.rows([0.0])[:, 0], self.weights, self.feedthrough


def orders(values: Reals) -> tuple[int, ...]:
    """The orders worth trying: where the singular values drop most, in ascending order; 0 where there are none."""
    if values[0] == 0.0:
        return (0,)
    known = np.maximum(values, NOISE_FLOOR * values[0])
    gaps = known[:-1] / known[1:]
    above = [k + 1 for k in np.argsort(-gaps, kind="stable").tolist() if gaps[k] > 1.5 and 4 * (k + 1) <= len(values)]
    return tuple(sorted(above[:MOST_ORDERS]))


def identify(pulse: Record, realization: Reals, order: int) -> Model | None:
    """The plant of this order that fits the response to a pulse of one sample; None if it has a pole that no continuous plant has.

    `realization` comes from `realize`. Poles that the fit cannot tell from the origin, from the imaginary axis or from one another are
    put there, and leading Markov parameters that it cannot tell from zero are zero; each with a note.
    """
    step = float(pulse.times[1] - pulse.times[0])
    matrix = realization[:order, :order]  # the factors are nested: the realisation of any lower order is a corner of it
    if not np.isfinite(matrix).all():
        return None
    values: Complexes = np.linalg.eigvals(matrix).astype(np.complex128)
    if np.any(np.abs(values) < LIVELY) or np.any((values.imag == 0.0) & (values.real < 0.0)):
        return None
    poles = [Pole(complex(p), 1) for p in sorted((np.log(values) / step).tolist(), key=abs) if p.imag >= 0.0]
    with np.errstate(all="ignore"):
        best = _fitted(poles, pulse, 0)
        return None if best is None else _simplified(best, pulse)


def realize(pulse: Record) -> tuple[Reals, Reals]:
    """Of a response to a pulse of one sample: A of the balanced realisation of a large order, the Hankel matrix's singular values."""
    import control  # here: it brings matplotlib along

    # Of the first sample C B + D only the sum is known: the sequence starts behind it, with the input matrix A B.
    sequence = np.concatenate([[0.0], pulse.output[2:]]) / pulse.size
    rows = (len(sequence) - 1) // 2
    if not sequence.any():
        return np.zeros((0, 0)), np.zeros(rows)
    with np.errstate(all="ignore"):  # beyond the rank it divides by nothing
        sampled, values = control.eigensys_realization(sequence, max(rows // 4, 1), m=rows, n=len(sequence) - 1 - rows)
    return np.asarray(sampled.A, dtype=float), np.asarray(values, dtype=float)


def _regressors(poles: Sequence[Pole], record: Record) -> Reals:
    """What each weight, and last the feed-through, contributes to the output: shape (times, n + 1)."""
    basis = Basis(tuple(poles))
    table = np.zeros((len(record.times), basis.size + 1))
    for start, jump in zip(record.starts, np.diff(record.levels, prepend=0.0), strict=True):
        acting = record.times > start
        table[acting, :-1] += jump * basis.rows(record.times[acting] - start, 1).T
    table[:, -1] = record.before
    return table


def _fitted(poles: Sequence[Pole], record: Record, relative_degree: int) -> Model | None:
    """Least squares of weights and feed-through, with the first Markov parameters D, CB, CAB … zero; None if the poles cannot be used."""
    table = _regressors(poles, record)
    sizes = np.abs(table).max(axis=0)
    if not np.isfinite(table).all():
        return None
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    free = np.eye(table.shape[1])
    if relative_degree:
        conditions = _markov(poles, relative_degree) / sizes
        conditions /= np.linalg.norm(conditions, axis=1, keepdims=True)
        if not np.isfinite(conditions).all():
            return None
        free = np.linalg.svd(conditions)[2][relative_degree:].T
    solution = np.linalg.lstsq(table / sizes @ free, record.output, rcond=1e-15)[0]
    coefficients = free @ solution / sizes
    rms = float(np.sqrt(np.mean((table @ coefficients - record.output) ** 2)))
    n = len(coefficients) - 1
    return Model(
        tuple(poles), coefficients[:n], 0.0 if relative_degree else float(coefficients[n]), relative_degree, rms, np.zeros(len(poles))
    )


def _markov(poles: Sequence[Pole], count: int) -> Reals:
    """Rows that give D, CB, CAB … from weights and feed-through: shape (count, n + 1)."""
    basis = Basis(tuple(poles))
    change = np.array([basis.derivative(unit) for unit in np.eye(basis.size)]).reshape(basis.size, basis.size)
    rows, impulse = [np.append(np.zeros(basis.size), 1.0)], basis.rows([0.0])[:, 0]
    while len(rows) < count:
        rows.append(np.append(impulse, 0.0))
        impulse = change @ impulse
    return np.array(rows)


def _simplified(model: Model, record: Record) -> Model:
    """The simplest structure that fits as well: integrators, undamped modes, and as many Markov parameters zero as possible."""
    length, floor = float(record.times[-1]), ENOUGH * record.size
    allowed = max(WORSE * model.rms, floor)
    notes: list[str] = []

    def attempt(poles: list[Pole], relative_degree: int, note: str) -> bool:
        nonlocal model
        found = _fitted(poles, record, relative_degree)
        if found is None or found.rms > allowed:
            return False
        model = found
        notes.append(f"{note}: the fit is as good with it (rms {found.rms:.2g}, {allowed / WORSE:.2g} without)")
        return True

    slow = [pole for pole in model.poles if abs(pole.value) * length < SLOW]
    while slow:
        many = sum(2 if pole.is_flexible else 1 for pole in slow)
        rest = [pole for pole in model.poles if pole not in slow]
        if attempt([Pole(0j, many), *rest], 0, f"{many} pole{'s' * (many > 1)} at the origin"):
            break
        slow = slow[:-1]
    for merged in _merged(model.poles):
        attempt(merged, 0, "poles that coincide")
    for pole in [p for p in model.poles if p.is_flexible and abs(p.value.real) * length < SLOW]:
        undamped = [Pole(complex(0.0, p.value.imag), 1) if p is pole else p for p in model.poles]
        attempt(undamped, 0, f"no damping of the mode at {pole.value.imag:.6g} rad/s")
    for degree in range(Basis(model.poles).size, 0, -1):
        if attempt(list(model.poles), degree, f"relative degree {degree}"):
            break
    return replace(model, notes=tuple(notes))


def _merged(poles: Sequence[Pole]) -> Iterator[list[Pole]]:
    """The poles with two that are close put together: a pair and its conjugate on the real axis, or two neighbours."""
    for pole in poles:
        rest = [p for p in poles if p is not pole]
        if pole.is_flexible and abs(pole.value.imag) < CLOSE * abs(pole.value):
            yield [*rest, Pole(complex(pole.value.real, 0.0), 2 * pole.multiplicity)]
        for other in rest:
            if abs(pole.value - other.value) < CLOSE * abs(pole.value) and abs(pole.value) <= abs(other.value):
                middle = (pole.value + other.value) / 2.0
                yield [*(p for p in rest if p is not other), Pole(middle, pole.multiplicity + other.multiplicity)]


def polished(model: Model, record: Record) -> Model:
    """The poles that are not structure moved to the least squares of the fit, with their standard errors."""
    scales = [abs(pole.value) for pole in model.poles]

    def poles_at(changes: Reals) -> list[Pole]:
        steps, moved = iter(changes.tolist()), []
        for pole, scale in zip(model.poles, scales, strict=True):
            value = pole.value
            if value:
                value += scale * (1j * next(steps) if value.imag else 0.0) + scale * (next(steps) if value.real else 0.0)
            moved.append(Pole(value, pole.multiplicity))
        return moved

    def residuals(changes: Reals) -> Reals:
        found = _fitted(poles_at(changes), record, model.relative_degree)
        if found is None:
            return np.full(len(record.times), 1e3)
        return (found.predict(record) - record.output) / record.size

    count = sum((pole.value.imag != 0.0) + (pole.value.real != 0.0) for pole in model.poles)
    if not count or len(record.times) <= 2 * Basis(model.poles).size:
        return model
    done = least_squares(residuals, np.zeros(count), xtol=1e-15, ftol=1e-12, gtol=1e-15, max_nfev=20)
    found = _fitted(poles_at(done.x), record, model.relative_degree)
    if found is None or found.rms > model.rms:
        found, changes = model, np.zeros(count)
    else:
        changes = done.x
    jacobian = np.array([(residuals(changes + d) - residuals(changes - d)) / 2e-6 for d in 1e-6 * np.eye(count)]).T
    freedom = len(record.times) - count - Basis(model.poles).size
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * (found.rms / record.size) ** 2 * len(record.times) / max(freedom, 1)
    errors, spread = iter(np.sqrt(np.diag(covariance)).tolist()), []
    for pole, scale in zip(model.poles, scales, strict=True):
        parts = (pole.value.imag != 0.0) + (pole.value.real != 0.0)
        spread.append(scale * math.hypot(*(next(errors) for _ in range(parts))))
    return replace(found, spread=np.array(spread), notes=model.notes)
