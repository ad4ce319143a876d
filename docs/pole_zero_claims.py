"""What the paper on pole-zero cancelling (post-actuation) shapers says, beside what is computed here; and what tails are worth.

    .venv/bin/python docs/pole_zero_claims.py          prints the first table of docs/papers.md on them
    .venv/bin/python docs/pole_zero_claims.py tails    prints the second one

Singh: Pole-Zero, Zero-Pole Canceling Input Shapers, J. Dynamic Systems, Measurement, and Control 134 (2012) 011015. Numbers of it are
reproduced if they are ours, rounded to the digits that the paper gives, and corrected if they are off by one in the last of them.
Tails: Tuttle and Seering, US patent 6,505,085, whose claims have no numbers; each is shown on the paper's aircraft with |r| ≤ 0.3 instead.
Filters are designed numerically and satisfy their equations to rounding; minimum times are proven from both sides (asserted).
"""

from __future__ import annotations

import cmath
import math
import sys
from collections.abc import Iterator, Sequence
from decimal import Decimal
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np
from fuel_claims import CORRECTED, NOT, REPRODUCED, Claim, judged, table
from numpy.typing import NDArray

from relaxations.bounds import Bound, Status
from relaxations.cancelling.closed_forms import pole_first, pole_last, step_and_pole_last
from relaxations.cancelling.prefilters import Prefilter
from relaxations.cancelling.requests import Request, cancelling, cascaded, staged
from relaxations.cancelling.structures import Bounds
from relaxations.errors import ShaperError
from relaxations.limits import Limits
from relaxations.maneuvers import Maneuver, problem
from relaxations.plants import LinearPlant
from relaxations.proofs import minimum_time
from relaxations.response import response
from relaxations.shaping.modes import Mode
from suite.design import design
from suite.loading import load_study

PROBLEMS = Path(__file__).parents[1] / "suite" / "problems"
TURN = 0.2  # rad, the aircraft's
ROOT_2 = math.sqrt(2.0)
HARMONIC = Mode(1.0, 0.0)  # of the sweeps: frequency 1 rad/s, no damping
AFTER = np.linspace(0.0, 60.0, 6001)  # s after a move
Reals = NDArray[np.float64]


@cache
def pitch(damping: Fraction = Fraction(739, 1000)) -> LinearPlant:
    """The closed loop (55), with another coefficient of s²."""
    return LinearPlant.from_transfer(["1.151", "0.1774"], [1, damping, "2.072", "0.1774"])


@cache
def filters() -> dict[str, Prefilter]:
    """(58), (61), (62) with (63) and (64), and (65), for a reference of 1."""
    bounded = cancelling(pitch(), Request(2, zeros=(), bounds=Bounds(gains=(-0.35 / TURN, 2.0 / TURN))))
    stages = staged(pitch(), [("mode[1]", None), ("real[1]", bounded.duration - staged(pitch(), [("mode[1]", None)])[0].duration)])
    return {
        "cancelling": cancelling(pitch(), Request(1, "last+step")),
        "steps": bounded,
        "cascade": cascaded(stages),
        "mode": stages[0],
        "real": stages[1],
        "robust": cancelling(pitch(), Request(2, "last+step", robustness=1)),
    }


def reference(name: str) -> Reals:
    """What a filter makes of the turn, every 10 ms for a minute."""
    return TURN * filters()[name].reference(AFTER)


def elevator(name: str, damping: Fraction = Fraction(739, 1000)) -> Reals:
    """The elevator's deflection: the loop's gain is 1."""
    return reference(name) - course(name, damping, AFTER)


def course(name: str, damping: Fraction, times: Reals) -> Reals:
    """The pitch [rad] of one plant, in closed form."""
    return response(pitch(damping), filters()[name].command(TURN), times)


def eleven() -> tuple[Fraction, ...]:
    """The coefficients of s² that the paper simulates: ± 30 %."""
    return tuple(Fraction(739, 1000) * (1 + Fraction(3 * k, 50)) for k in range(-5, 6))


def left(name: str) -> float:
    """The largest swing after the move of eleven plants, of the turn."""
    times = filters()[name].duration + AFTER
    return max(float(np.abs(course(name, damping, times) - TURN).max()) / TURN for damping in eleven())


def numbers(claim: str, paper: Sequence[str], found: Sequence[float], digits: int = 10) -> Claim:
    """Numbers of the paper against ours: all as rounded, or one off by one in its last digit."""
    steps = [10.0 ** int(Decimal(text).as_tuple().exponent) for text in paper]
    off = [round((float(text) - value) / step) for text, value, step in zip(paper, found, steps, strict=True)]
    exact = [round(value / step) == round(float(text) / step) for text, value, step in zip(paper, found, steps, strict=True)]
    verdict = REPRODUCED if all(exact) else CORRECTED if all(abs(miss) <= 1 for miss in off) else NOT
    return Claim(claim, ", ".join(paper), ", ".join(f"{value:.{digits}f}" for value in found), verdict)


def claims() -> Iterator[Claim]:
    """All of them, in the order of the paper."""
    yield from one_zero()
    yield from on_samples()
    yield from two_zeros()
    yield from aircraft()


def one_zero() -> Iterator[Claim]:
    """Section 2."""
    mode = Mode(ROOT_2, 0.0)
    done, usual = pole_last(mode, [-1.0]), pole_last(mode, [])
    first = math.atan(-ROOT_2) / ROOT_2  # of (10) with n = 0
    turns = [n for n in range(6) if abs(pole_like(first + n * math.pi / ROOT_2)) < 1e-12]
    told = f"n = {', '.join(map(str, turns))} … alone: sine and cosine have signs"
    yield judged("(10): T = (nπ + arctan …)/ω_d for an integer n", "any n", told, holds=turns == list(range(6)), otherwise=CORRECTED)
    assert abs(done(complex(0.0, ROOT_2))) < 1e-14
    yield numbers("(15): gains and T [s]", ["0.7321", "1.2679", "1.5459"], [done.gains[0], done.terms[0].coefficient.real, done.duration])
    yield numbers("(16): the shaper that leaves the zero alone", ["1.0", "1.0", "2.22144"], [*usual.gains, usual.duration])
    saved = 100.0 * (1.0 - done.duration / usual.duration)
    yield judged("2.1.1: the maneuver takes less by", "30 %", f"{saved:.1f} %", holds=round(saved) == 30)
    alphas = 1.0 / np.linspace(1e-6, 8.0, 400)
    swept = [pole_last(HARMONIC, [-a]) for a in alphas.tolist()]
    times, gains = np.array([one.duration for one in swept]), np.array([one.gains[0] / one.gain for one in swept])
    falls = bool((np.diff(times) < 0).all() and (np.diff(gains) < 0).all())
    ends = f"T {times[0]:.4f} to {times[-1]:.4f} s, A {gains[0]:.4f} to {gains[-1]:.4f}"
    yield judged("Figs. 1, 2: from the shaper's, T and A fall with 1/α", "yes", ends, holds=falls and abs(times[0] - math.pi) < 1e-5)
    ahead = [pole_first(HARMONIC, [-a]) for a in (1.0 / np.linspace(0.05, 8.0, 200)).tolist()]
    shares = [sum(term.gain for term in one.terms if term.start == 0.0) / one.gain for one in ahead]
    yield judged("(24): A is -(ω² + α²) without damping, whatever T", "yes", f"to {_first_error():.0e}", holds=_first_error() < 1e-12)
    yield judged("Fig. 5: the pole's share at once is above 1", "yes", f"{min(shares):.3f} to {max(shares):.1f}", holds=min(shares) > 1.0)


def pole_like(delay: float) -> float:
    """What is left of (5) at the pole of the example (14) with this T [s], at the A > 0 that (11) gives: relative."""
    p = complex(0.0, ROOT_2)
    step = 1.0 / abs(p + 1.0)
    return float(abs(step * (p + 1.0) + cmath.exp(-p * delay)))


def _first_error() -> float:
    """How far (17) with A = -(ω² + α²) is from cancelling, relative, over α and ω: by the filter's own value at the pole."""
    worst = 0.0
    for omega in (0.5, 1.0, 3.0):
        for alpha in (0.2, 1.0, 4.0):
            done = pole_first(Mode(omega, 0.0), [-alpha])
            ratio = done.gains[1] / done.terms[0].coefficient.real  # A/1 in (17), scaled alike
            worst = max(worst, abs(abs(ratio) * math.sqrt(omega**2 + alpha**2) - 1.0), abs(done(complex(0.0, omega))))
    return float(worst)


def on_samples() -> Iterator[Claim]:
    """Section 2.3."""
    singular = []
    for n in (1, 2, 3):
        try:
            step_and_pole_last(HARMONIC, [-1.0], n * math.pi)
        except ShaperError:
            singular.append(n)
    yield judged("(29) is singular where ω_d T is a multiple of π", "yes", f"refused for n = {singular}", holds=singular == [1, 2, 3])
    # The gains' sum is [tan(T/2) - α]/(1 + α²), so that K = 0 once in 2π: tan(T/2) = -1/α. As A_1 = 1/((1 + α²) sin T) before all gains are
    # divided by K, K has the sign of the gain A_1 / K times that of sin T.
    counts = set()
    for alpha in np.geomspace(0.05, 20.0, 25).tolist():
        found = 0
        for low, high in ((0.003, math.pi - 1e-4), (math.pi + 1e-4, 2.0 * math.pi - 0.003)):  # at π it changes its sign through infinity
            grid = np.linspace(low, high, 450)
            signs = [math.copysign(1.0, step_and_pole_last(HARMONIC, [-alpha], t).gains[0] * math.sin(t)) for t in grid.tolist()]
            found += int(np.count_nonzero(np.diff(signs)))
        counts.add(found)
    told = "once in 2π for any α, at 2π - 2 arctan 1/α" if counts == {1} else f"{counts} times in 2π"
    yield judged("Fig. 7: K is 0 at T =", "1.4716, 4.4168, 7.7548, 10.70", told, holds=counts == {2})  # twice in 2π
    all_positive = []
    for t in np.arange(0.01, 2.0 * math.pi, 0.005).tolist():
        one = step_and_pole_last(HARMONIC, [-1.0], t)
        if min(*one.gains, one.terms[0].coefficient.real) >= 0.0:
            all_positive.append(t)
    least = pole_last(HARMONIC, [-1.0]).duration
    told = f"T from {all_positive[0]:.2f} to {all_positive[-1]:.2f} s; (13) takes {least:.4f} s"
    holds = 0.0 <= all_positive[0] - least <= 0.006 and math.pi - all_positive[-1] <= 0.006
    yield judged("Fig. 8: the gains are positive over a range of T", "yes", told, holds=holds)


def two_zeros() -> Iterator[Claim]:
    """Section 3."""
    zero = complex(-1.0, ROOT_2)
    done, usual = cancelling(LinearPlant.from_transfer([1, 2, 3], [1, 0, 2]), Request(1)), pole_last(Mode(ROOT_2, 0.0), [])
    scale = done.terms[0].coefficient / (2.0 / (2j * zero.imag))  # of a partial fraction of 1/(s² + 2s + 3)
    yield numbers("(40): gains and T [s]", ["0.3333", "1.0000", "1.3510"], [done.gains[0], scale.real, done.duration])
    yield numbers("(41): the shaper that leaves the zeros alone", ["2.22144"], [usual.duration])
    times, gains = [], []
    for damping in np.linspace(0.02, 0.98, 25).tolist():
        for frequency in np.linspace(2.0, 10.0, 33).tolist():
            z = frequency * complex(-damping, math.sqrt(1.0 - damping**2))
            one = pole_last(HARMONIC, [z, z.conjugate()])
            times.append(one.duration)
            gains.append(one.gains[0] / one.gain)
    told = f"T {min(times):.3f} to {max(times):.3f} s, the shaper's {math.pi:.3f} s"
    yield judged("Fig. 9: it always outperforms the standard shaper", "yes", told, holds=max(times) < math.pi)
    told = f"{min(gains):.3f} to {max(gains):.3f}"
    yield judged("Fig. 10: its gain is both below and above 0.5", "yes", told, holds=min(gains) < 0.5 < max(gains))
    real = cancelling(LinearPlant.from_transfer([1, 3, 2], [1, 0, 2]), Request(1))
    block = real.terms[0].coefficient.real  # 1/((s + 1)(s + 2)) = 1/(s + 1) - 1/(s + 2)
    yield numbers("(47): gains and T [s]", ["0.3204", "1.3592", "1.1107"], [real.gains[0], block, real.duration])


def aircraft() -> Iterator[Claim]:
    """Section 5."""
    poles, made = [pole.value for pole in pitch().poles], filters()
    seen = [poles[1].real, poles[1].imag, poles[0].real, pitch().zeros[0].value.real]
    yield numbers("(56): poles and zero", ["-0.3255", "1.3816", "-0.0881", "-0.15413"], seen, 6)
    done = made["cancelling"]
    found = [TURN * done.gains[0], TURN * done.gains[1], TURN * done.terms[0].coefficient.real, done.duration]
    yield numbers("(58): gains, term and T [s]", ["0.2198", "0.0993", "-0.0184", "2.3673"], found)
    done = made["steps"]
    found = [*(TURN * gain for gain in done.gains), *done.delays[1:]]
    yield numbers("(61): gains and T [s], steps alone", ["0.8735", "-0.350", "-0.3235", "1.5783", "4.2744"], found)
    yield numbers("(63): the mode's filter", ["0.6770", "0.3229", "2.2739"], [*made["mode"].gains, made["mode"].duration])
    yield numbers("(64): the real pole's filter", ["6.1916", "-5.1916", "2.0004"], [*made["real"].gains, made["real"].duration], 7)
    saved = 100.0 * (1.0 - made["cancelling"].duration / made["steps"].duration)
    yield judged("5: the maneuver takes less than with traditional shapers by", "about 45 %", f"{saved:.1f} %", holds=abs(saved - 45) < 1)
    peaks = {name: float(np.abs(reference(name)).max()) for name in ("cancelling", "steps", "cascade")}
    told = ", ".join(f"{value:.3f}" for value in peaks.values()) + " rad"
    holds = peaks["cancelling"] < 0.5 * min(peaks["steps"], peaks["cascade"])
    yield judged("Fig. 15: its reference is much smaller than both traditional ones", "yes", told, holds=holds)
    ranges = {name: float(np.ptp(elevator(name))) for name in ("cancelling", "steps", "cascade", "robust")}
    told = ", ".join(f"{ranges[name]:.3f}" for name in ("cancelling", "steps", "cascade")) + " rad"
    holds = ranges["cancelling"] < min(ranges["steps"], ranges["cascade"])
    yield judged("Fig. 16: its elevator moves over less than both", "yes", told, holds=holds)
    done = made["robust"]
    found = [*(TURN * gain for gain in done.gains), TURN * done.terms[0].coefficient.real, *done.delays[1:]]
    yield numbers("(65): gains, term and T [s]", ["0.1458", "0.1263", "0.0210", "-0.0144", "2.2521", "4.8108"], found)
    told = f"{ranges['robust']:.3f} against {ranges['cancelling']:.3f} rad"
    yield judged("Fig. 18: robust, the elevator moves over less", "yes", told, holds=ranges["robust"] < ranges["cancelling"])
    told = f"{100 * left('robust'):.2f} against {100 * left('cancelling'):.2f} % of the turn"
    yield judged(
        "Fig. 19: of eleven plants (± 30 %) the robust one leaves less", "much less", told, holds=left("robust") < 0.5 * left("cancelling")
    )


def proven(bound: Bound) -> float:
    """A minimum time [s] that is proven from both sides."""
    assert bound.status is Status.PROVED
    assert bound.upper is not None
    assert bound.upper / bound.lower - 1.0 < 1e-12
    return bound.upper


@cache
def problem_time(name: str) -> float:
    """Of a problem of the collection."""
    return proven(design(load_study(PROBLEMS / f"{name}.toml")).bound)


def tails() -> Iterator[Claim]:
    """Claims of the patent on the aircraft, |r| ≤ 0.3 rad, and what no filter can beat."""
    state, tail = problem_time("pitch_state"), problem_time("pitch_tail")
    told = f"{tail:.10f} s instead of {state:.10f} s"
    yield judged("21, 23: with a tail along the zeros a move is faster", "yes", told, holds=tail < state)
    short = problem_time("pitch_tail_short")
    yield judged("18 to 20, 34: a shorter tail takes longer", "yes", f"5 % after 10 s: {short:.10f} s", holds=tail < short < state)
    insensitive = problem_time("pitch_tail_insensitive")
    told = f"5 % for a zero within 10 %: {insensitive:.10f} s"
    yield judged("17, 42: insensitive to the zero's place takes longer", "yes", told, holds=tail < insensitive < state)
    robust = problem_time("pitch_tail_robust")
    told = f"a further zero at the mode: {robust:.10f} s"
    yield judged("40, 41: insensitive to the poles takes longer", "yes", told, holds=tail < robust)
    for name, further, equation in (("cancelling", 0, "(58)"), ("robust", 1, "(65)")):
        level = Fraction(float(np.abs(reference(name)).max())) * (1 + Fraction(1, 10**9))
        within = Maneuver(Fraction(1, 5), Limits(-level, level), robustness=further, tail=True)
        least, done = proven(minimum_time(problem([pitch()], within))), filters()[name]
        told = f"{least:.4f} s, {100 * (done.duration / least - 1):.1f} % less than {done.duration:.4f} s"
        yield judged(
            f"any command within ± {float(level):.4f} rad, the levels of {equation}", "not longer", told, holds=least <= done.duration
        )


if __name__ == "__main__":
    table(tails() if sys.argv[1:] == ["tails"] else claims())
