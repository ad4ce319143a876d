"""The checker's enclosures of a varying plant's transition, against closed forms, matrix exponentials and Runge and Kutta's method."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from fractions import Fraction
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import flint
import numpy as np
import pytest
from flint import acb, arb, arb_mat, arb_poly, fmpq
from scipy.integrate import solve_ivp

from relaxations.checking import transitions
from relaxations.checking.reading import Undecided
from relaxations.checking.transitions import Series, Step

pytestmark = pytest.mark.usefixtures("enough_work")


def exact(x: Any) -> fmpq:
    return fmpq(Fraction(x).numerator, Fraction(x).denominator)


def plant(instants: list[Any], A: list[Any], B: list[Any]) -> Any:
    """A schedule as the checker reads it."""
    rows = [[[exact(x) for x in row] for row in a] for a in A]
    return SimpleNamespace(instants=[exact(t) for t in instants], A=rows, B=[[exact(x) for x in b] for b in B])


def followed(schedule: Any, start: list[Any], end: Any, kicks: Any = ()) -> list[Step]:
    return list(transitions.steps(schedule, arb_mat([[arb(exact(x)) for x in start]]), arb(exact(end)), kicks))


def holds(ball: arb, truth: arb, radius: float = 1e-30) -> None:
    """The ball meets the truth and is narrow, as that is."""
    assert ball.overlaps(truth), (ball, truth)
    assert max(float(ball.rad()), float(truth.rad())) < radius, (ball, truth)


def integral(course: Callable[[acb], acb], end: arb) -> arb:
    """From 0, by Arb's quadrature with more digits than are asked for."""
    with flint.ctx.workprec(200):
        return acb.integral(lambda s, _: course(s), acb(0), acb(end)).real


# x' = (a + b t) x + (c + d t) u: q Φ(0, t) B(t) = q e^{-(a t + b t²/2)} (c + d t).
A, B, C, D, LAST = Fraction(1, 2), Fraction(-3, 4), Fraction(2), Fraction(5, 3), Fraction(2)
SCALAR = plant([0, LAST], [[[A]], [[A + B * LAST]]], [[C], [C + D * LAST]])


def scalar(t: Any, late: bool) -> acb:
    """e^{-∫A} B, of a single component."""
    t = acb(t)
    if not late:
        return (-t / 2 + t * t * 3 / 8).exp() * (2 + t * 5 / 3)
    return scalar(2, False) * (t - 2).exp()  # A is -1 from then on, B 16/3


def instants_of(step: Step) -> Iterator[tuple[arb, arb]]:
    """Some times since the begin of a step, and since 0."""
    for share in (Fraction(0), Fraction(1, 3), Fraction(5, 7), Fraction(1)):
        tau = exact(share) * step.length
        yield arb(tau), arb(tau + step.begin)


def test_a_scalar_plant() -> None:
    found = followed(SCALAR, [3], 4)
    assert [step.begin for step in found] == [sum((s.length for s in found[:i]), fmpq(0)) for i in range(len(found))]
    assert any(step.begin == 2 for step in found)
    assert found[-1].begin < 4 <= found[-1].begin + found[-1].length
    for step in found:
        late, begin = bool(step.begin >= 2), acb(step.begin)
        for tau, at in instants_of(step):
            here = 3 * scalar(at, late).real
            first = integral(lambda s, begin=begin, late=late: 3 * scalar(begin + s, late), tau)
            second = integral(lambda s, begin=begin, late=late, tau=tau: 3 * (acb(tau) - s) * scalar(begin + s, late), tau)
            holds(step.impulse(tau)[0, 0], here)
            holds(step.step(tau)[0, 0], first)
            holds(step.ramp(tau)[0, 0], second)
            holds(step.costate.integral(tau), first)
            c, value, slope, values = step.costate.over(tau, tau)
            assert c.overlaps(tau)
            holds(value, here)
            holds(values, here)
            # (g' B - g A B) / B: p' = g (B' - A B)
            steep = here if late else here * ((arb(5) / 3) / (2 + at * 5 / 3) - (arb(1) / 2 - at * 3 / 4))
            holds(slope, steep, 1e-27)


def test_rows_of_a_rotation() -> None:
    """A = (2 + 3t) J with J² = -1 until t = 1, then 5 J: Φ(0, t) turns back by 2t + 3t²/2."""
    schedule = plant([0, 1], [[[0, 2], [-2, 0]], [[0, 5], [-5, 0]]], [[1, 0], [0, 4]])
    found = list(transitions.steps(schedule, arb_mat(2, 2, 1), arb(2)))
    assert found[-1].begin < 2 <= found[-1].begin + found[-1].length
    for step in found:
        for tau, at in instants_of(step):
            turned = bool(step.begin >= 1)
            angle = arb(7) / 2 + 5 * (at - 1) if turned else 2 * at + 3 * at * at / 2
            c, s = angle.cos(), angle.sin()
            b = (arb(0), arb(4)) if turned else (1 - at, 4 * at)  # e^{-θJ}, J = [0 1; -1 0], is [c -s; s c]
            got = step.impulse(tau)
            holds(got[0, 0], c * b[0] - s * b[1])
            holds(got[1, 0], s * b[0] + c * b[1])


def constant(matrix: list[list[Any]], t: Any) -> arb_mat:
    with flint.ctx.workprec(200):
        return (arb_mat([[-arb(exact(x)) for x in row] for row in matrix]) * arb(t)).exp()


JUMPY = [[0, 1, 0], [-4, "-1/5", 1], [2, 0, "-3/2"]]


def test_kicks_change_the_rows_at_their_instants() -> None:
    """A constant matrix: rows q e^{-At}, more rows being added at 0, at 1/3 twice, and at 1; one after the end changes nothing."""
    schedule = plant([0, 1], [JUMPY] * 2, [[1, 2, "-1"]] * 2)
    added = {fmpq(0): [1, 0, 2], fmpq(1, 3): [0, "1/2", 0], fmpq(1): [0, 0, -3], fmpq(9): [5, 5, 5]}
    kicks = [(at, transitions.added(arb_mat([[arb(exact(x)) for x in row]]))) for at, row in added.items()]
    kicks.insert(2, (fmpq(1, 3), lambda rows: rows * 2))
    found = followed(schedule, [0, 1, 0], "3/2", kicks)
    assert {fmpq(0), fmpq(1, 3), fmpq(1)} <= {step.begin for step in found}
    for step in found:
        for tau, at in instants_of(step):
            row = arb_mat([[1, 1, 2]]) * constant(JUMPY, at)
            if step.begin >= fmpq(1, 3):
                row = row * 2 + arb_mat([[0, 1, 0]]) * constant(JUMPY, at - arb(fmpq(1, 3)))
            if step.begin >= 1:
                row += arb_mat([[0, 0, -3]]) * constant(JUMPY, at - 1)
            holds(step.impulse(tau)[0, 0], (row * arb_mat([[1], [2], [-1]]))[0, 0])


@pytest.mark.parametrize("seed", range(4))
def test_random_plants_against_runge_and_kutta(seed: int) -> None:
    rng = np.random.default_rng([91, seed])
    n, count = 2 + seed % 3, 2 + seed % 2

    def short(*shape: int) -> Any:
        return np.round(rng.uniform(-2, 2, shape), 2)

    instants, matrices, columns = np.array([0, 0.75, 1.25, 2.5][:count]), short(count, n, n), short(count, n)
    schedule = plant(
        instants.tolist(),
        [[[str(x) for x in row] for row in a] for a in matrices.tolist()],
        [[str(x) for x in b] for b in columns.tolist()],
    )
    begin, end, at = short(n), float(instants[-1]) + 0.5, fmpq(3, 8)
    kick = short(n)
    found = followed(schedule, [str(x) for x in begin], str(end), [(at, transitions.added(arb_mat([[arb(str(x)) for x in kick]])))])

    def table(values: Any, t: float) -> Any:
        return np.apply_along_axis(lambda v: np.interp(t, instants, v), 0, values)

    def rates(t: float, y: Any) -> Any:
        row, p = y[:n], y[:n] @ table(columns, t)
        return np.concatenate([-row @ table(matrices, t), [p, y[n]]])

    y, edges = np.concatenate([begin, [0, 0]]), sorted({*(float(step.begin.p) / float(step.begin.q) for step in found)})
    assert edges == [float(step.begin.p) / float(step.begin.q) for step in found]
    for step, (s, t) in zip(
        found, pairwise([*edges, float(found[-1].begin.p) / float(found[-1].begin.q) + float(step_length(found[-1]))]), strict=True
    ):
        if s == 0.375:
            y[:n] += kick
        y[n:] = 0
        y = solve_ivp(rates, (s, t), y, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
        tau, size = arb(step.length), 1 + float(np.abs(y).max())
        for ball, truth in ((step.impulse(tau), y[:n] @ table(columns, t)), (step.step(tau), y[n]), (step.ramp(tau), y[n + 1])):
            assert float(ball[0, 0].mid()) == pytest.approx(float(truth), abs=1e-11 * size)
            assert float(ball[0, 0].rad()) < 1e-30 * size


def step_length(step: Step) -> float:
    return float(step.length.p) / float(step.length.q)


# What is left out of the series.


def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Series of 16 coefficients beyond the first, in arithmetic of many digits: what they leave out is much more than rounding."""
    monkeypatch.setattr(transitions, "flint", SimpleNamespace(ctx=SimpleNamespace(prec=4)))


def test_what_a_series_leaves_out_is_bounded_by_the_formula(monkeypatch: pytest.MonkeyPatch) -> None:
    """|q|_w e^{a_0 ρτ + a_1 (ρτ)²/2} / ρ^{K + 1}, by NumPy; of p times |b| and its change over ρτ; K = 16, ρ = 8."""
    coarse(monkeypatch)
    matrices = np.array([[[0.5, 1.0], [-2.0, 0.25]], [[1.0, 1.5], [-4.0, 0.0]], [[0.0, 1.0], [-1.0, -1.0]]])
    columns = np.array([[1.0, 2.0], [0.0, -4.0], [1.0, 1.0]])
    instants = [0.0, 0.5, 2.0]
    schedule = plant(instants, matrices.tolist(), columns.tolist())
    w = np.array([float(x) for x in transitions.weights(schedule)])
    start = np.array([[3.0, -0.5], [1.0, 8.0]])
    found = list(transitions.steps(schedule, arb_mat([[arb(x) for x in row] for row in start.tolist()]), arb(4)))
    assert found[0].begin == 0
    assert {fmpq(1, 2), fmpq(2)} <= {step.begin for step in found}

    def norm(m: Any) -> float:
        return float(np.max(np.abs(m) @ w / w))

    def grown(A: Any, rise: Any, h: float) -> float:
        return (norm(A) + norm(rise) * 4 * h) * h

    for step in found:
        at, length = float(step.begin.p) / float(step.begin.q), step_length(step)
        rows = np.array([[float(x.mid()) for x in row] for row in step.rows[0].tolist()])
        i = sum(at >= t for t in instants) - 1
        A = np.array([[np.interp(at, instants, matrices[:, j, k]) for k in range(2)] for j in range(2)])
        b = np.array([np.interp(at, instants, columns[:, j]) for j in range(2)])
        width = instants[i + 1] - instants[i] if i < 2 else 1.0
        rise, growth = ((matrices[i + 1] - matrices[i]) / width, (columns[i + 1] - columns[i]) / width) if i < 2 else (0 * A, 0 * b)
        far = 8 * length
        kept = np.exp(norm(A) * far + norm(rise) * far**2 / 2) / 8.0**17
        sizes = np.abs(rows) @ w * kept
        assert len(step.rows) == 17
        assert [[float(x.mid()) for x in row] for row in step.left.tolist()] == [[0, 0], [0, 0]]
        radii = np.array([[float(x.rad()) for x in row] for row in step.left.tolist()])
        assert radii == pytest.approx(sizes[:, None] / w, rel=1e-4)
        assert (radii >= sizes[:, None] / w).all()  # it is of times a hair beyond the step, too
        most = float(sizes.max()) * (np.max(np.abs(b) / w) + far * np.max(np.abs(growth) / w))
        assert float(step.beyond.rad()) == pytest.approx(most, rel=1e-4)
        assert float(step.beyond.rad()) >= most
        assert step.beyond.mid() == 0
        # The longest power of 2 that the bound allows, or until the next instant.
        assert grown(A, rise, length) <= 1.5
        assert any(at + length == t for t in instants) or grown(A, rise, 2 * length) > 1.5


@pytest.mark.parametrize("rate", [Fraction(3, 2), Fraction(-3, 2)])
@pytest.mark.parametrize("growth", [0, 2])
def test_what_a_series_leaves_out_is_in_all_that_is_made_of_it(rate: Fraction, growth: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """x' = a x + (1 + growth t) u: what 17 coefficients leave out of e^{-at} is 3·10^-12, and every enclosure is wider than that."""
    coarse(monkeypatch)
    schedule = plant([0, 1], [[[rate]]] * 2, [[1], [1 + growth]])
    step = followed(schedule, [1], 1)[0]
    assert step.length == 1
    a = acb(exact(rate))

    def g(t: Any) -> Any:
        return (-a * t).exp() * (1 + growth * t)

    one, p = arb(1), step.costate
    assert abs(p.polynomial(one) - g(acb(1)).real) > arb("1e-13")
    _, value, slope, values = p.over(one, one)
    rate_of = -a * g(acb(1)) + growth * (-a).exp()
    first, second = integral(g, one), integral(lambda t: (1 - t) * g(t), one)
    for ball, truth in (
        *((step.impulse(one)[0, 0], g(acb(1)).real), (value, g(acb(1)).real), (values, g(acb(1)).real), (slope, rate_of.real)),
        *((step.step(one)[0, 0], first), (p.integral(one), first), (step.ramp(one)[0, 0], second)),
    ):
        assert ball.contains(truth)
        assert 1e-13 < float(ball.rad()) < 1e-7
    # The next step begins with a row that knows as little.
    after = followed(schedule, [1], 2)[1]
    assert after.rows[0][0, 0].contains((-a).exp().real)
    assert float(after.rows[0][0, 0].rad()) == pytest.approx(float(step.left[0, 0].rad()), rel=1e-6)


def test_integrals_of_what_is_left_out() -> None:
    """± b of p is ± b τ of its integral and ± b τ²/2 of the integral of that."""
    nothing = arb_mat(1, 1)
    step = Step(fmpq(0), fmpq(4), [nothing] * 3, (nothing, nothing), nothing, arb(0, 1))
    for tau in (1, 3):
        for ball, radius in ((step.step(arb(tau)), tau), (step.ramp(arb(tau)), tau * tau / 2)):
            assert ball[0, 0].mid() == 0
            assert float(ball[0, 0].rad()) == pytest.approx(radius, rel=1e-6)


# Series.


QUADRATIC = Series(arb_poly([1, -2, 3]), arb(0, 1e-3), arb(0, 1e-2))


def test_a_series_over_an_interval() -> None:
    """1 - 2s + 3s² on [1/2, 3/2], ± 1/1000, its slope -2 + 6s ± 1/100."""
    c, value, slope, values = QUADRATIC.over(arb("0.5"), arb("1.5"))
    assert c == 1
    assert float(value.mid()) == 2
    assert float(value.rad()) == pytest.approx(1e-3, rel=1e-6)
    assert slope.contains(arb("0.99"))
    assert slope.contains(arb("7.01"))
    assert not slope.contains(arb("0.9"))
    assert not slope.contains(arb("7.1"))
    assert values.contains(arb("0.749"))  # at 1/2
    assert values.contains(arb("4.751"))  # at 3/2
    assert 2 < float(values.rad()) < 4
    a, b = arb("0.1"), arb("0.3")  # balls: the union holds both ends, and the middle is exact
    c, *_ = QUADRATIC.over(a, b)
    assert c.is_exact()
    assert float(c) == pytest.approx(0.2)


def test_a_series_and_its_integral() -> None:
    total = QUADRATIC.integral(arb(2))
    assert float(total.mid()) == 6  # 2 - 4 + 8
    assert float(total.rad()) == pytest.approx(2e-3, rel=1e-6)
    more = QUADRATIC.raised(arb(5))
    assert [float(x.mid()) for x in more.polynomial.coeffs()] == [6, -2, 3]
    assert (more.left.rad(), more.steep.rad()) == (QUADRATIC.left.rad(), QUADRATIC.steep.rad())
    whole = QUADRATIC.integrated(arb(7), arb(2))
    assert [float(x.mid()) for x in whole.polynomial.coeffs()] == [7, 1, -1, 1]
    assert float(whole.left.rad()) == pytest.approx(2e-3, rel=1e-6)
    assert float(whole.left.mid()) == 0
    assert float(whole.steep.rad()) == pytest.approx(1e-3, rel=1e-6)
    lopsided = Series(arb_poly([1]), arb("1.5", "0.5"), arb(0))  # [1, 2]: its integral is anywhere in ±2 length
    assert float(lopsided.integrated(arb(0), arb(3)).left.rad()) == pytest.approx(6, rel=1e-6)


def test_sums_and_products_of_series_of_matrices() -> None:
    series = [arb_mat([[1, 2]]), arb_mat([[3, 4]]), arb_mat([[5, 7]])]
    assert [float(x) for x in transitions.horner(series, arb(10)).entries()] == [531, 742]
    linear = (arb_mat([[1], [10]]), arb_mat([[100], [1000]]))
    assert float(transitions.product(series, linear, 0)[0, 0]) == 21
    assert float(transitions.product(series, linear, 1)[0, 0]) == 43 + 2100
    assert float(transitions.product(series, linear, 2)[0, 0]) == 75 + 4300


def test_weights_make_the_norms_of_all_matrices_small() -> None:
    """About the largest eigenvalue of |A|: of an oscillator at 1000/s, 1000 instead of 10⁶; at least 2^-12, and never 0."""
    fast = plant([0, 1], [[[0, 1], [-(10**6), 0]], [[0, 1], ["-250000", 0]]], [[0, 1]] * 2)
    w = [float(x) for x in transitions.weights(fast)]
    assert max(w) == 1
    assert w[1] / w[0] == pytest.approx(1000, rel=0.05)
    norms = [
        max(sum(abs(float(x)) * v for x, v in zip(row, w, strict=True)) / u for row, u in zip(a, w, strict=True))
        for a in ([[0, 1], [10**6, 0]],)
    ]
    assert max(norms) < 1100
    assert [float(x) for x in transitions.weights(plant([0, 1], [[[0, 0], [0, 0]]] * 2, [[0, 1]] * 2))] == [1, 1]
    chain = [float(x) for x in transitions.weights(plant([0, 1], [[[0, 0], [1, 0]]] * 2, [[0, 1]] * 2))]
    assert chain == [2**-12, 1]
    few = followed(fast, [1, 0], "1/64")
    assert len(few) <= 16  # 1/1024 s each, not 1/2^20 s
    assert len(followed(plant([0, 1], [[[0]]] * 2, [[1]] * 2), [1], 1000)) == 2  # until 1, and then for 2^20 s


def test_sums_with_weights_and_the_largest() -> None:
    assert float(transitions.weighed([arb(-2), arb(3)], [arb(5), arb(7)])) == 31
    assert float(transitions.largest([arb(2), arb("3"), arb(-5)])) == 3
    assert float(transitions.largest([arb(2, 1), arb("2.5")])) == pytest.approx(3)
    assert float(transitions.largest([arb(-1)])) == 0


def test_matrices_that_are_too_large() -> None:
    with pytest.raises(Undecided, match="too large to follow"):
        followed(plant([0, 1], [[[Fraction(10) ** 30]]] * 2, [[1]] * 2), [1], 1)
    assert followed(plant([0, 1], [[[Fraction(2) ** 58]]] * 2, [[1]] * 2), [1], Fraction(1, 2**60))[0].length == fmpq(1, 2**58)
