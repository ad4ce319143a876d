"""An output that may not overshoot, and has to: its limit is where it comes to rest, and it has a real zero z < 0.

With y_f where it rests, N/D from the input without common factors, and an input that is u_ss from T on,

    ∫_0^∞ (y - y_f) e^{-st} dt + y_f/s = N/D (u_ss/s + V(s)).

At state rest both integrals end at T, so the first and V are entire, and at s = z, where N is 0 and D is not,

    ∫_0^T (y - y_f) e^{-zt} dt = -y_f/z,

which has the sign of y_f; but |y| ≤ |y_f| says that y - y_f has not.
"""

from __future__ import annotations

from flint import fmpq_poly

from relaxations.checking.balls import System, isolated, long
from relaxations.checking.reading import Undecided


def has_to(system: System) -> bool:
    """Whether a limited output has to go beyond where it comes to rest, and may not; for moves from rest to state rest."""
    task = system.task
    if system.begin or task.box is not None or task.rest != "state":
        return False
    (plant,) = task.plants
    for name, limit in task.limits.deflection.items():
        rest = task.displacement * plant.outputs[name][-1] / plant.numerator[-1]
        numerator, denominator = (fmpq_poly(list(written[::-1])) for written in (plant.outputs[name], plant.denominator))
        if rest == 0 or abs(rest) != limit:
            continue
        if long(numerator) or long(denominator):
            raise Undecided("an output's numbers are too long")
        if any(not zero.flexible and zero.value.real < 0 for zero in isolated(numerator // numerator.gcd(denominator))):
            return True
    return False
