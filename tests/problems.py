"""Maneuvers with known answers: every method meets every one of them, and the command line shows them.

Each knows its minimum time to the digits that were computed independently (Newton's method in 25 and more digits on the switch times, or a
closed form), and where it comes from. State rest throughout: no tails.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial
from math import acos, e, log, pi, sqrt

from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.plants import Exact, LinearPlant, exact

PATENT = "Tuttle and Seering, time-optimal commands for flexible systems"
BY_HAND = "closed form"


@dataclass(frozen=True)
class Known:
    """A maneuver and its minimum time [s]: None where no command reaches the target, in any time.

    `error` is half a unit of the last digit given. `switches` are the instants [s] at which the time-optimal command jumps inside the move,
    to the same digits (empty: not given).
    """

    name: str
    plant: Callable[[], LinearPlant]
    displacement: Exact
    time: float | None
    source: str
    limits: tuple[Exact, Exact] = (-1, 1)
    rest: Exact = 0
    robustness: int | Mapping[str, int] = 0
    switches: tuple[float, ...] = field(default=())
    fuel: Exact | None = None
    error: float = 5e-11

    @property
    def maneuver(self) -> Maneuver:
        return Maneuver(exact(self.displacement), Limits.of(*self.limits, self.fuel), exact(self.rest), self.robustness)

    def problem(self) -> Problem:
        return problem([self.plant()], self.maneuver)


def chain(masses: int) -> LinearPlant:
    """Free-free chain of unit masses and unit springs: force on the first mass, the last one's position is the output."""
    n = masses
    A = [[0] * (2 * n) for _ in range(2 * n)]
    for i in range(n):
        A[i][n + i] = 1
        for neighbour in {i - 1, i + 1} & set(range(n)):
            A[n + i][neighbour] += 1
            A[n + i][i] -= 1
    B = [0] * (2 * n)
    B[n] = 1
    rows = {f"position_{i + 1}": [int(j == i) for j in range(2 * n)] for i in range(n)}
    return LinearPlant.from_state_space(A, B, rows[f"position_{n}"], 0, rows)


def two_mass(output: int = 2, stiffness: Exact = 1, damping: Exact = 0, mass_1: Exact = 1, mass_2: Exact = 1) -> LinearPlant:
    """Two masses joined by a spring, force on the first; the output is the position of mass 1 or 2."""
    k, c, m1, m2 = map(exact, (stiffness, damping, mass_1, mass_2))
    A = [[0, 0, 1, 0], [0, 0, 0, 1], [-k / m1, k / m1, -c / m1, c / m1], [k / m2, -k / m2, c / m2, -c / m2]]
    rows = {"position_1": [1, 0, 0, 0], "position_2": [0, 1, 0, 0], "spring": [-1, 1, 0, 0]}
    return LinearPlant.from_state_space(A, [0, 0, 1 / m1, 0], rows[f"position_{output}"], 0, rows)


def transfer(numerator: list[Exact], denominator: list[Exact]) -> Callable[[], LinearPlant]:
    return partial(LinearPlant.from_transfer, numerator, denominator)


OSCILLATOR = transfer([1], [1, 0, 1])

FACTS = (
    Known("two_mass_1", two_mass, 1, 4.2178665105, PATENT, switches=(1.0026784304, 2.1089332552, 3.2151880801)),
    Known("two_mass_5", two_mass, 5, 6.6627284203, PATENT, switches=(2.5904230854, 3.3313642102, 4.0723053349)),
    Known(
        "two_mass_robust",
        two_mass,
        1,
        5.8659584390,
        PATENT,
        robustness=1,
        switches=(0.7123986326, 1.6563451326, 2.9329792195, 4.2096133064, 5.1535598064),
    ),
    # 6.51077680015111: the same with 400 bits, two switches and T.
    Known("chain_3", partial(chain, 3), 1, 6.5107768002, PATENT),
    Known("chain_4", partial(chain, 4), 2, 9.5933833916, PATENT),
    Known("chain_6", partial(chain, 6), 3, 14.7227905482, PATENT),
    Known("chain_8", partial(chain, 8), 4, 19.7430923674, PATENT),
    # 27.07837246156424: Newton's method at 400 bits on the eleven unknowns of the antisymmetric command (ten switches and T; the equations
    # Σ a_i cos(ω_k (t_i - T/2)) = 0 for ω_k = 2 sin(kπ/22), and Σ a_i (T - t_i)²/2 = 55), with a costate that changes sign 21 times.
    Known("chain_11", partial(chain, 11), 5, 27.0783724616, PATENT),
    Known("chain_12", partial(chain, 12), 2, 28.4927336597, PATENT),
    Known("real_mode", transfer([1], [1, 1, 0]), 1, -2 * log(1 - sqrt(1 - 1 / e)) - 1, BY_HAND, error=1e-14),
    Known("rigid_body", transfer([1], [1, 0, 0]), 1, 2.0, BY_HAND, switches=(1.0,), error=1e-14),
    # T = √(2Δ(a+b)/(ab)) with limits [-b, a]
    Known("rigid_body_asymmetric", transfer([1], [1, 0, 0]), 2, sqrt(2 * 2 * 4 / 3), BY_HAND, limits=(-1, 3), error=1e-14),
    # cos ω t_2 = [F_min (F_max - F_ss) + F_ss²/2] / [F_max (F_min - F_ss)] with F_ss = 1/2, the 1996 paper's (20) mended
    Known("oscillator", OSCILLATOR, "0.5", acos(0.375 / 1.5), BY_HAND, switches=(0.8127555614,), error=1e-14),
)

AWKWARD = (
    # At Δ = π² the force of one jump leaves the spring at rest, T = √(8Δ); no fraction is π², but this one is to 1e-15.
    Known("two_mass_one_switch", two_mass, Fraction(pi**2), sqrt(8) * pi, BY_HAND, error=1e-12),
    # 8.881442376812488 by Newton's method at 300 bits on t_1 and T; the condition number explodes towards π².
    Known("two_mass_near_one_switch", two_mass, "9.86", 8.881442376812, "neighbour of two_mass_one_switch", error=1e-12),
    Known("two_mass_position_1", partial(two_mass, 1), 1, 4.2178665105, "zeros ±j: a rest of the state all the same"),
    Known("one_sided_oscillator", OSCILLATOR, "0.5", acos(-0.25), BY_HAND, limits=(0, 1), error=1e-14),
    # A third of each circle: u = 1 up to radius 1 around the origin, then u = 0 until the mass stands at 1 with no speed.
    Known("both_rests_on_limits", OSCILLATOR, 1, 2 * pi / 3, BY_HAND, limits=(0, 1), error=1e-14),
    Known("one_sided_integrator", transfer([1], [1, 0]), 3, 1.5, BY_HAND, limits=(0, 2), error=1e-14),
    Known("triple_integrator", transfer([1], [1, 0, 0, 0]), 1, 32 ** (1 / 3), BY_HAND, error=1e-13),
    Known("unstable", transfer([1], [1, -1]), "0.9", log(1.9), BY_HAND, error=1e-14),
    Known("decay_to_half", transfer([1], [1, "0.001"]), 500, 1000 * log(2), BY_HAND, error=1e-9),
)

IMPOSSIBLE = (
    Known("one_sided_rigid_body", transfer([1], [1, 0, 0]), 1, None, "a force that cannot pull cannot stop", limits=(0, 1)),
    Known("limit_is_the_rest", transfer([1], [1, 1]), 1, None, "1 - e^(-t) never is 1"),
)

KNOWN = FACTS + AWKWARD
PROBLEMS = KNOWN + IMPOSSIBLE
