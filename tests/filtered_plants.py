"""Filters in front of plants, simulated by matrix exponentials: nothing in common with moments or partial fractions."""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import expm
from scipy.signal import tf2ss

from relaxations.cancelling.prefilters import Prefilter
from relaxations.plants import LinearPlant


def settled(plant: LinearPlant, done: Prefilter, beyond: float = 3.0) -> tuple[float, float]:
    """Matrix exponentials of plant and terms together: the output's worst distance from 1 after the last delay, and its size before."""
    numerator, denominator = (
        [float(c.p) / float(c.q) for c in reversed(p.coeffs())] for p in (plant.numerators[plant.output], plant.denominator)
    )
    a, b, c, d = tf2ss(numerator, denominator)
    n, size = len(a), len(a) + 1 + sum(2 * (term.power + 1) for term in done.terms)
    system = np.zeros((size, size))  # plant, steps, and a real Jordan chain of each term's integral's derivative
    system[:n, :n], system[:n, n] = a, b[:, 0]
    at, heads = n + 1, []
    for term in done.terms:
        block, m = np.array([[term.rate.real, -term.rate.imag], [term.rate.imag, term.rate.real]]), term.power + 1
        for k in range(m):
            system[at + 2 * k : at + 2 * k + 2, at + 2 * k : at + 2 * k + 2] = block
            if k + 1 < m:
                system[at + 2 * k : at + 2 * k + 2, at + 2 * k + 2 : at + 2 * k + 4] = np.eye(2)
        system[n, at] += 1.0  # the step level grows by the real part of the chain's head
        heads.append((at + 2 * (m - 1), term.coefficient * math.factorial(term.power)))
        at += 2 * m
    x, since, worst, largest = np.zeros(size), 0.0, 0.0, 0.0
    events = sorted({*done.delays})
    looks = done.duration + np.linspace(1e-9, beyond * done.duration + 10.0, 60)
    for instant in sorted({*events, *looks}):
        x = expm(system * (instant - since)) @ x
        since = instant
        y = float((c @ x[:n] + d[0] * x[n])[0])
        if instant in looks:
            worst, largest = max(worst, abs(y - 1.0)), max(largest, abs(x).max())
        if instant in events:
            x[n] += done.gains[done.delays.index(instant)]
            for term, (place, value) in zip(done.terms, heads, strict=True):
                if term.start == instant:
                    x[place], x[place + 1] = x[place] + value.real, x[place + 1] + value.imag
    return worst, largest
