"""No sequence on so many samples leaves nothing and deflects no mode beyond a limit: a combination of the conditions is proven impossible.

Impulses A_k at kh, k ≤ n, have partial sums S_k within [low, high], S_n = 1. Nothing is left where `F_i = Σ A_k z_i(kh) = 0` with
`z_i(t) = (t - nh)^j e^{κ_i ω_i (t - nh)}`, and just before and just after each instant the deflection `e = Σ A_k g(mh - kh)` of every mode
is within the limit d, `g(τ) = y(τ) - 1` with the unit step's response y. For any weights

    Re Σ y_i* F_i + Σ λ_m e_m - d Σ |λ_m| ≤ 0

The left side is linear in the partial sums: if it is positive at its least over all S_k within their bounds, there is no such sequence, on
fewer samples neither, for a sequence may wait.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import flint
from flint import acb, arb, fmpq

BITS = 128


@dataclass(frozen=True, slots=True)
class Left:
    """The weight (re, im) of derivative number `power` of what is left of mode number `mode`."""

    mode: int
    power: int
    weight: tuple[Fraction, Fraction]


@dataclass(frozen=True, slots=True)
class Strayed:
    """The weight of the deflection of mode number `mode` at sample `sample`, just `after` or just before it."""

    mode: int
    sample: int
    after: bool
    weight: Fraction


@dataclass(frozen=True, slots=True)
class Asked:
    """The task: modes (frequency [rad/s], damping), derivatives that vanish, sample time [s], samples, limit, bounds of the sums."""

    modes: tuple[tuple[Fraction, Fraction], ...]
    derivatives: int
    interval: Fraction
    count: int
    limit: Fraction
    sums: tuple[Fraction, Fraction]


def none_on_samples(asked: Asked, left: Sequence[Left], strayed: Sequence[Strayed]) -> bool:
    """Whether it is proven that no sequence does what is asked; False: not proven."""
    if not _sound(asked, left, strayed):
        return False
    before, flint.ctx.prec = flint.ctx.prec, BITS
    try:
        return bool(_least(asked, left, strayed) > 0)
    finally:
        flint.ctx.prec = before


def _sound(asked: Asked, left: Sequence[Left], strayed: Sequence[Strayed]) -> bool:
    modes = range(len(asked.modes))
    return (
        all(frequency > 0 and 0 <= damping < 1 for frequency, damping in asked.modes)
        and asked.interval > 0
        and asked.count > 0
        and asked.limit >= 0
        and asked.sums[0] <= asked.sums[1]
        and all(one.mode in modes and 0 <= one.power <= asked.derivatives for one in left)
        and all(one.mode in modes and 0 <= one.sample <= asked.count for one in strayed)
    )


def _arb(number: Fraction) -> arb:
    return arb(fmpq(number.numerator, number.denominator))


def _least(asked: Asked, left: Sequence[Left], strayed: Sequence[Strayed]) -> arb:
    """The left side at its least."""
    n, step = asked.count, _arb(asked.interval)
    q = [arb(0) for _ in range(n + 1)]
    for number, (frequency, damping) in enumerate(asked.modes):
        omega, zeta = _arb(frequency), _arb(damping)
        root = (1 - zeta * zeta).sqrt()
        direction = acb(zeta, root)
        for one in (one for one in left if one.mode == number):
            weight = acb(_arb(one.weight[0]), -_arb(one.weight[1]))
            for k in range(n + 1):
                since = (k - n) * step
                q[k] += (weight * since**one.power * (direction * omega * since).exp()).real
        start, pole = acb(-1, zeta / root), acb(-zeta, root) * omega
        course = [(start * (pole * (m * step)).exp()).real for m in range(n + 1)]
        for one in (one for one in strayed if one.mode == number):
            weight = _arb(one.weight)
            for k in range(one.sample + 1 if one.after else one.sample):
                q[k] += weight * course[one.sample - k]
    total = q[n] - _arb(asked.limit) * sum((abs(_arb(one.weight)) for one in strayed), arb(0))
    low, high = map(_arb, asked.sums)
    for k in range(n):
        change = q[k] - q[k + 1]
        below, above = (low * change).lower(), (high * change).lower()
        total += below if below < above else above
    return total
