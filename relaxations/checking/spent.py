"""Too little fuel: a budget U of `∫ |u| dt` is less than what every command needs, whatever its time.

pole      From moments m at first, at a pole p with Re p > 0 or on the imaginary axis, `∫_0^T e^{p(T - t)} u dt = -e^{pT} m` where the plant
          rests without input, and at the origin `target - m`. So |m|, or |target - m|, is at most `∫ |e^{-pt} u| dt ≤ U`.
costate   With `|p(s)| ≤ μ` for all s ≥ 0, p = λᵀ b, a move from rest has `λᵀ target ≤ μ U` and the price of the tail's limits.
"""

from __future__ import annotations

from itertools import accumulate
from math import factorial
from typing import Any

from flint import arb, arb_mat, fmpq, fmpq_poly

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
    """Whether a costate that is nowhere larger than `limit` asks for more than it costs; for moves from rest."""
    fuel, stay = system.task.limits.fuel, lasting(system)
    gain = sum((a * b for a, b in zip(numbers.entries(), system.target.entries(), strict=True)), arb(0))
    if system.begin or not gain > limit * fuel + price:
        return False
    if any(root.multiplicity > 1 or root.value.real > 0 for root in stay):
        raise Undecided("a costate may grow with the time to go")
    p, end = Wave.of(system.roots, numbers.entries()), arb(1)
    chains = iter(p.rows.tolist()[0])
    terms = [(root, k, next(chains)) for root in system.roots for k in range(root.multiplicity)]
    for _ in range(100):
        total = arb(0)
        for root, k, c in terms:
            if any(root is one for one in stay):
                total += abs(c)
            elif -root.value.real * end >= k:  # s^k e^{-as} falls from here on
                total += abs(c) * end**k / factorial(k) * (root.value.real * end).exp()
            else:
                total = arb("inf")
        if total <= limit:
            break
        end *= 2
    else:
        raise Undecided("the costate is not told from the price of the fuel in the long run")
    waiting = [(arb(0), end)]
    while waiting:
        a, b = waiting.pop()
        c, value, _, values = p.over(a, b)
        if abs(values) <= limit:
            continue
        if not (a < c < b and abs(value) <= limit):
            raise Undecided("the costate is not told from the price of the fuel")
        waiting += [(a, c), (c, b)]
    return True


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
