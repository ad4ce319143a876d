"""Decaying terms on a stream of samples: an exponential filter in closed form, its memory one number for each power.

    X_k(t) = ∫_0^∞ τ^k/k! e^{zτ} r(t - τ) dτ,   r linear between samples

From one sample to the next `X[n] = E X[n-1] + b_1 r[n] + b_0 r[n-1]` with `E_kj = h^(k-j)/(k-j)! e^{zh}`; at an instant between two samples
the same step, shorter, is made from the one before it. For such r that is exact. It is computed in real numbers, sample after sample, so
that blocks of any length give the same to the last bit.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from relaxations.moments import Basis
from relaxations.plants import Pole
from relaxations.shaping.shapers import ShaperTerm

Reals = NDArray[np.float64]


class Decay:
    """One term of an impulse response on samples, `sample_time` [s] apart, `delay` whole ones and a `part` of one after its reference."""

    def __init__(self, term: ShaperTerm, sample_time: float, delay: int, part: float, rest: float) -> None:
        count = term.power + 1
        self.delay = delay
        self._weight = term.coefficient * math.factorial(term.power)
        self._advance, self._now, self._before = _step(term.rate, count, sample_time)
        self._state = np.array([rest / (-term.rate) ** (k + 1) for k in range(count)])  # at the sample before
        self._part = part
        self._short = _step(term.rate, count, (1.0 - part) * sample_time) if part else None

    def __call__(self, now: Reals, before: Reals) -> Reals:
        """The term's share (n,) for samples r[n - delay] and r[n - delay - 1], each of shape (n,)."""
        from scipy.signal import lfilter  # here: it takes long to load, and most shapers have impulses alone

        if not len(now):
            return np.zeros(0)
        earlier, chains = [], []
        for k in range(len(self._state)):
            parts = []
            for part in ("real", "imag"):
                drive = getattr(self._now[k], part) * now
                drive += getattr(self._before[k], part) * before
                parts.append(drive)
            for j in range(k):
                _add(parts, self._advance[k - j], earlier[j])
            turned, _ = lfilter([1.0], [1.0, -self._advance[0]], parts[0] + 1j * parts[1], zi=[self._advance[0] * self._state[k]])
            chains.append((turned.real, turned.imag))
            earlier.append((np.append(self._state[k].real, turned.real[:-1]), np.append(self._state[k].imag, turned.imag[:-1])))
        self._state = np.array([complex(re[-1], im[-1]) for re, im in chains])
        if self._short is None:
            return self._weight.real * chains[-1][0] - self._weight.imag * chains[-1][1]
        advance, last, first = self._short
        at = self._part * before + (1.0 - self._part) * now  # the reference at the instant between
        top = len(self._state) - 1
        total = [getattr(last[top], part) * at + getattr(first[top], part) * before for part in ("real", "imag")]
        for j in range(top + 1):
            _add(total, advance[top - j], earlier[j])
        return self._weight.real * total[0] - self._weight.imag * total[1]


def _add(total: list[Reals], factor: complex, value: tuple[Reals, ...]) -> None:
    """A complex product, in real numbers: vectorised complex ones round differently at the end of a block."""
    total[0] += factor.real * value[0]
    total[0] -= factor.imag * value[1]
    total[1] += factor.real * value[1]
    total[1] += factor.imag * value[0]


def _step(rate: complex, count: int, time: float) -> tuple[list[complex], list[complex], list[complex]]:
    """`E_kj` by k - j, and the weights of the sample now and of the one `time` [s] before, by k."""
    advance = [time**i / math.factorial(i) * np.exp(rate * time) for i in range(count)]
    pole = Pole(complex(rate), count + 1)
    rows = Basis((pole,)).rows(np.array([time]), 1)[:, 0]
    integrals = [complex(a, b) for a, b in zip(rows[::2], rows[1::2], strict=True)] if pole.is_flexible else [complex(a) for a in rows]
    before = [(k + 1) * integrals[k + 1] / time for k in range(count)]  # ∫ τ/time · τ^k/k! e^{zτ}
    return [complex(x) for x in advance], [integrals[k] - before[k] for k in range(count)], before
