"""Too little fuel: a budget U of `∫ |u| dt` is less than what every command needs, whatever its time.

pole      From moments m at first, at a pole p with Re p > 0 or on the imaginary axis, `∫_0^T e^{p(T - t)} u dt = -e^{pT} m` where the plant
          rests without input, and at the origin `target - m`. So |m|, or |target - m|, is at most `∫ |e^{-pt} u| dt ≤ U`.
costate   With `|p(s)| ≤ μ` for all s ≥ 0, p = λᵀ b, a move in T seconds has `λᵀ target - λᵀ drift(T) ≤ μ U` and the price of the tail's
          limits, drift(T) being what an initial state has become by then: false for all T if the wave λᵀ drift stays below the rest.
"""

from __future__ import annotations

from itertools import accumulate
from math import factorial
from typing import Any

from flint import acb, arb, arb_mat, fmpq, fmpq_poly

from relaxations.checking.balls import Root, System, Wave, on_axis
from relaxations.checking.reading import Undecided


def lasting(system: System) -> list[Root]:
    """The poles that do not decay; raises `Undecided` where one is not told from the imaginary axis."""
    beside = [root for root in system.roots if not (root.value.is_zero() or root.value.real < 0 or root.value.real > 0)]
    for plant in system.task.plants if beside else ():
        if len(beside) != on_axis(fmpq_poly(list(plant.denominator[::-1]))):
            raise Undecided("a pole is not told from the imaginary axis at this precision")
    return [root for root in system.roots if not root.value.real < 0]


def by_pole(system: System, fuel: fmpq) -> bool:
    """Whether one pole asks for more fuel than there is."""
    stay, asked = lasting(system), []
    rows = accumulate((root.size for root in system.roots), initial=0)
    places = accumulate((root.multiplicity for root in system.roots), initial=0)
    for root, row, at in zip(system.roots, rows, places, strict=False):
        first = system.begin[at] if system.begin else None
        if root.value.is_zero():
            asked.append(system.target[row, 0] - (first.real if first is not None else 0))
        elif first is not None and system.rest == 0 and any(root is one for one in stay):
            asked.append(abs(first))
    return not system.zeros and any(abs(one) > fuel for one in asked)


def by_costate(system: System, numbers: arb_mat, price: arb, limit: fmpq) -> bool:
    """Whether a costate that is nowhere larger than `limit` asks, for every T, for more than it costs."""
    fuel, stay = system.task.limits.fuel, lasting(system)
    gain = sum((a * b for a, b in zip(numbers.entries(), system.target.entries(), strict=True)), arb(0))
    room = gain - limit * fuel - price
    if not (room > 0 or system.begin):
        return False
    p = Wave.of(system.roots, numbers.entries())
    keeps(p, stay, arb(-limit), arb(limit), "the costate is not told from the price of the fuel")
    if system.begin:
        keeps(
            drifting(system, p), stay, None, room - abs(room) * fmpq(1, 2**40), "what the start asks for less is not told from what is left"
        )
    return True


def drifting(system: System, p: Wave) -> Wave:
    """`λᵀ drift(T)`, what an initial state takes off what a costate asks for: with the chains c of λ and m of the moments at first,
    `Re Σ_j Σ_{k≥j} c_k m_{k-j} T^j/j! e^{pT}` at each root."""
    chains, at, numbers = p.rows.tolist()[0], 0, []
    for root in system.roots:
        c, m = (row[at : at + root.multiplicity] for row in (chains, system.begin))
        for j in range(root.multiplicity):
            total = sum((c[k] * m[k - j] for k in range(j, root.multiplicity)), acb(0))
            numbers += [total.real, total.imag][: 1 + root.flexible]
        at += root.multiplicity
    return Wave.of(system.roots, numbers)


def keeps(wave: Wave, stay: list[Root], low: arb | None, high: arb, otherwise: str) -> None:
    """Prove that a wave is between two levels (None: no matter how low) for all s ≥ 0; raises `Undecided` with a sentence."""
    chains, resting, end = iter(wave.rows.tolist()[0]), arb(0), arb(1)
    terms: list[tuple[Root, int, acb]] = []
    for root in wave.roots:
        lasts = any(root is one for one in stay)
        for k in range(root.multiplicity):
            c = next(chains)
            if lasts and (k or root.value.real > 0):
                if not c.is_zero():
                    raise Undecided("a costate may grow with the time to go")
            elif root.value.is_zero():
                resting += c.real
            else:
                terms.append((root, k, c))
    for _ in range(100):
        total = arb(0)
        for root, k, c in terms:
            if any(root is one for one in stay):
                total += abs(c)
            elif -root.value.real * end >= k:  # s^k e^{-as} falls from here on
                total += abs(c) * end**k / factorial(k) * (root.value.real * end).exp()
            else:
                total = arb("inf")
        if resting + total <= high and (low is None or resting - total >= low):
            break
        end *= 2
    else:
        raise Undecided(f"{otherwise} in the long run")
    waiting = [(arb(0), end)]
    while waiting:
        a, b = waiting.pop()
        c, value, _, values = wave.over(a, b)
        if values <= high and (low is None or values >= low):
            continue
        if not (a < c < b and value <= high and (low is None or value >= low)):
            raise Undecided(otherwise)
        waiting += [(a, c), (c, b)]


def too_little(system: System, witness: Any, moved: Any) -> bool:
    """Whether it is proven that no command within the budget does it; `moved` makes costate and price of a witness."""
    fuel = system.task.limits.fuel
    if fuel is None:
        return False
    if by_pole(system, fuel):
        return True
    if not witness or witness.fuel == 0 or witness.steps or witness.ramps:  # those speak of another inequality
        return False
    numbers, price = moved(system, witness)
    return by_costate(system, numbers, price, witness.fuel)
