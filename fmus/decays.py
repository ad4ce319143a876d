"""Modes from a measured decay: what a machine does after a push, or after a command that ended.

    y(t) = rest + Σ Re(c_i e^{p_i t}),   p_i = -ζ_i ω_i + j ω_i √(1 - ζ_i²)

The eigensystem realisation (`fmus.identification`) of the evenly spaced samples gives first poles, and so does the periodogram of what
fewer modes leave, where samples have gaps; ω and ζ are then moved to the least
squares of all samples, amplitudes and rest eliminated, and their standard errors are read from the fit. How many modes there are is decided
by Schwarz's criterion: one more has to explain more than noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from fmus.errors import DecayError
from fmus.identification import Record, realize
from relaxations.shaping.modes import Mode

Reals = NDArray[np.float64]

MOST_MODES = 4
FEWEST = 16  # samples
REALIZED, TRIED, FITTED = 600, 800, 4000  # samples that are realised, on which numbers of modes are tried, and that are fitted
FURTHER = (0, 4, 10)  # orders beyond two a mode: noise takes some
FAINT = 0.02  # of the largest amplitude: a smaller mode is none that a shaper should be made for
STRAIGHT = 1e-6  # of a record: what a parabola leaves of it where it only drifts
DRIFT = "the record holds no vibration, only a slow drift"
FLOOR = 1e-7  # of the largest value: no measurement is better, and rounding is no mode
BESIDE = 3.0  # turns in the record by which a frequency differs from one that is told apart from it without doubt
COARSE = 2.8  # ω times the step: closer to π a mode cannot be told from its mirror image
WIDEST, SLIGHT = 0.95, 0.01  # damping ratios: the largest one, and that with which one more mode is tried
GROWING, POOR = 1e-9, 0.05  # a damping that ends at its bound, and how much a fit may leave then


@dataclass(frozen=True, slots=True)
class DecayMode:
    """A mode, the standard errors of its frequency [rad/s] and damping ratio, and its amplitude at the start."""

    mode: Mode
    frequency_error: float
    damping_error: float
    amplitude: float


@dataclass(frozen=True, slots=True)
class Decay:
    """The modes by descending amplitude, the value at rest, and the root mean square of what the fit leaves; units of the signal.

    `share`: of the root mean square about the mean, how much of it the fit leaves: 0 for a pure decay, 1 for noise.
    """

    modes: tuple[DecayMode, ...]
    rest: float
    rms: float
    samples: int
    duration: float
    share: float = 0.0


@dataclass(frozen=True, slots=True)
class _Fit:
    frequencies: Reals
    dampings: Reals
    coefficients: Reals
    errors: Reals
    rms: float


def identify_decay(times: Sequence[float] | Reals, values: Sequence[float] | Reals) -> Decay:
    """The modes in samples `values` (n,) at ascending `times` (n,) [s] of a free decay.

    Raises `DecayError` for a record that is too short, that does not move, or that holds no vibration.
    """
    t, y = np.asarray(times, dtype=float), np.asarray(values, dtype=float)
    _require(t, y)
    t, whole = t - t[0], float(np.abs(y).max())
    y = y / whole  # a signal may be of any size: squares of it need not fit
    middle = float(y.mean())
    unit = float(np.abs(y - middle).max())
    y = (y - middle) / unit
    stride = -(-len(t) // FITTED)
    t, y = t[::stride], y[::stride]
    size = float(np.abs(y - y.mean()).max())
    if float(np.std(y - np.polyval(np.polyfit(t, y, 2), t))) <= STRAIGHT * float(np.std(y)):  # what fits it best is of rounding's choice
        raise DecayError(DRIFT)
    step, even = _even(t, y)
    even = even - even.mean()
    matrix = _realized(even, step)
    few = slice(None, None, -(-len(t) // TRIED))
    best: tuple[float, _Fit] | None = None
    for count in range(1, MOST_MODES + 1):
        starts = _starts(matrix, even, step, count) + ([] if best is None else _with_another(best[1], t[few], y[few]))
        fits = [fit for start in starts if (fit := _fitted(start, t[few], y[few])) is not None]
        if not fits:
            continue
        fit = min(fits, key=lambda one: one.rms)
        many = len(t[few])
        score = many * math.log(max(fit.rms, FLOOR * size) ** 2) + (4 * count + 1) * math.log(many)
        if best is not None and score >= best[0]:
            break
        best = score, fit
        if fit.rms <= FLOOR * size:
            break
    # Noise has "modes" that die at once or explain next to nothing: without any the record is at rest but for noise.
    if best is None or best[1].rms > 0.9 * float(np.std(y)):
        raise DecayError("the record holds no vibration that decays: start it after the push, and let it last for several periods")
    fit = _fitted(np.concatenate([best[1].frequencies, best[1].dampings]), t, y) or best[1]
    sizes = np.hypot(fit.coefficients[1::2], fit.coefficients[2::2])
    count = len(fit.frequencies)
    kept = [i for i in np.argsort(-sizes).tolist() if sizes[i] >= FAINT * sizes.max() and fit.frequencies[i] * t[-1] > 2.0 * math.pi]
    if not kept:
        slowest = 2.0 * math.pi / float(fit.frequencies[int(sizes.argmax())])
        if slowest > 10.0 * t[-1]:
            raise DecayError(DRIFT)
        raise DecayError(f"the record lasts {t[-1]:.4g} s, less than the period of its vibration, about {slowest:.4g} s")
    share = fit.rms / float(np.std(y))
    if min(fit.dampings[i] for i in kept) < GROWING and share > POOR:
        raise DecayError("the vibration does not decay in this record: begin it behind the push, and end it before the next one")
    apart = float(t[-1]) / (len(t) - 1)
    if (fastest := max(float(fit.frequencies[i]) for i in kept)) * apart > COARSE:
        raise DecayError(
            f"samples {apart:.4g} s apart are too few for a vibration of about {fastest / (2.0 * math.pi):.4g} Hz, which looks "
            "like a slower one there: sample more than three times a period"
        )
    size = whole * unit
    modes = tuple(
        DecayMode(
            Mode(float(fit.frequencies[i]), float(fit.dampings[i])),
            float(fit.errors[i]),
            float(fit.errors[count + i]),
            float(sizes[i]) * size,
        )
        for i in kept
    )
    return Decay(modes, (float(fit.coefficients[0]) * unit + middle) * whole, fit.rms * size, len(t), float(t[-1]), share)


def _require(t: Reals, y: Reals) -> None:
    if len(t) != len(y) or len(t) < FEWEST:
        raise DecayError(f"a decay has at least {FEWEST} samples, a time and a value each; this one has {min(len(t), len(y))}")
    if not (np.isfinite(t).all() and np.isfinite(y).all()):
        raise DecayError("a decay holds finite numbers only")
    if np.diff(t).min() <= 0.0:
        place = int(np.argmin(np.diff(t)))
        raise DecayError(f"times of a decay ascend: {t[place + 1]!r} s follows {t[place]!r} s")
    if y.min() == y.max():
        raise DecayError("the record stands still: nothing decays in it")


def _even(t: Reals, y: Reals) -> tuple[float, Reals]:
    """A step [s] and evenly spaced values, not too many."""
    at = np.linspace(0.0, t[-1], len(t))
    even = np.interp(at, t, y)
    factor = len(even) // REALIZED
    if factor > 1:
        from scipy.signal import decimate  # here: it takes long to load, and few have a measured decay

        even = decimate(even - even[-1], factor, ftype="fir") + even[-1]
    return float(t[-1] / (len(t) - 1)) * max(factor, 1), np.asarray(even, dtype=float)


def _realized(even: Reals, step: float) -> Reals:
    """A of the realisation of evenly spaced samples, whose corners are those of lower orders."""
    with np.errstate(all="ignore"):
        # The realisation begins behind the second sample of a response to a pulse: the decay is put there.
        instants: Reals = np.arange(len(even) + 2, dtype=np.float64) * step
        padded = np.concatenate([[0.0, 0.0], even])
        return realize(Record(instants, np.zeros(1), np.zeros(1), padded))[0]


def _starts(matrix: Reals, even: Reals, step: float, count: int) -> list[Reals]:
    """First frequencies and dampings (2 count,) from a realisation of these samples, one start for each order tried."""
    starts = []
    for order in (2 * count + more for more in FURTHER):
        corner = matrix[:order, :order]
        if len(corner) < 2 * count or not np.isfinite(corner).all():
            continue
        poles = np.log(np.linalg.eigvals(corner).astype(complex)) / step
        kept = [p for p in poles.tolist() if 1e-9 < p.imag < COARSE / step and p.real < 0.05 * abs(p)]
        if len(kept) < count:
            continue
        table: NDArray[np.complex128] = np.exp(np.multiply.outer(step * np.arange(len(even)), np.array(kept, dtype=np.complex128)))
        weights = np.linalg.lstsq(np.hstack([table.real, -table.imag]), even, rcond=None)[0]
        sizes = np.hypot(weights[: len(kept)], weights[len(kept) :]) * np.sqrt(np.mean(np.abs(table) ** 2, axis=0))
        chosen = [kept[i] for i in np.argsort(-sizes).tolist()[:count]]
        starts.append(np.array([abs(p) for p in chosen] + [min(max(-p.real / abs(p), 1e-4), 0.9) for p in chosen]))
    return starts


def _with_another(fit: _Fit, t: Reals, y: Reals) -> list[Reals]:
    """The modes found so far and one where the periodogram (Lomb, Scargle) of what they leave is highest: it needs no even samples.

    None beside a mode that is there: what is left of that one is no other, but tells that it does not decay as a mode does.
    """
    from scipy.signal import lombscargle  # here, too

    left = _table(fit.frequencies, fit.dampings, t) @ fit.coefficients - y
    lowest = 2.0 * math.pi / float(t[-1])
    tried = np.arange(lowest, max(COARSE * (len(t) - 1) / float(t[-1]), 2.0 * lowest), 0.25 * lowest)
    highest = float(tried[int(lombscargle(t, left - left.mean(), tried).argmax())])
    if np.abs(fit.frequencies - highest).min() < BESIDE * lowest:
        return []
    return [np.concatenate([fit.frequencies, [highest], fit.dampings, [SLIGHT]])]


def _table(frequencies: Reals, dampings: Reals, t: Reals) -> Reals:
    """1, and of each mode the decaying cosine and sine: shape (n, 1 + 2 modes)."""
    columns = [np.ones_like(t)]
    for omega, zeta in zip(frequencies, dampings, strict=True):
        decay, phase = np.exp(-zeta * omega * t), omega * math.sqrt(1.0 - zeta**2) * t
        columns += [decay * np.cos(phase), decay * np.sin(phase)]
    return np.array(columns).T


def _fitted(start: Reals, t: Reals, y: Reals) -> _Fit | None:
    """Least squares in frequencies and dampings, amplitudes and rest eliminated."""
    count = len(start) // 2
    scale = np.concatenate([start[:count], np.ones(count)])

    def solved(x: Reals) -> tuple[Reals, Reals]:
        table = _table(x[:count] * scale[:count], x[count:], t)
        coefficients: Reals = np.linalg.lstsq(table, y, rcond=None)[0].astype(np.float64)
        return coefficients, table @ coefficients - y

    def left_over(x: Reals) -> Reals:
        basis = np.linalg.qr(_table(x[:count] * scale[:count], x[count:], t))[0]
        return basis @ (basis.T @ y) - y

    first = np.concatenate([np.ones(count), start[count:]])
    low, high = np.concatenate([np.full(count, 0.5), np.zeros(count)]), np.concatenate([np.full(count, 2.0), np.full(count, WIDEST)])
    done = least_squares(left_over, first, bounds=(low, high), x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=40)
    coefficients, left = solved(done.x)
    rms = float(np.sqrt(np.mean(left**2)))
    if not math.isfinite(rms):
        return None
    freedom = max(len(t) - 4 * count - 1, 1)
    covariance = np.linalg.pinv(done.jac.T @ done.jac) * float(left @ left) / freedom
    return _Fit(done.x[:count] * scale[:count], done.x[count:], coefficients, np.sqrt(np.diag(covariance)) * scale, rms)
