"""Benchmarks of brackets: each prints figures, and where two things are compared their ratio in one run. Times are never judged."""

from __future__ import annotations

import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from relaxations import posing, programs
from relaxations.bounds import Status
from relaxations.checking.claims import check
from relaxations.maneuvers import Limits, Maneuver, problem
from relaxations.plants import LinearPlant, exact
from relaxations.proofs import minimum_time

pytestmark = pytest.mark.benchmark


def chain(masses: int) -> LinearPlant:
    """A free-free chain of unit masses and unit springs: force on the first mass, position of the last; poles: 2 a mass."""
    rows = [[0] * (2 * masses) for _ in range(2 * masses)]
    for i in range(masses):
        rows[i][masses + i] = 1
        for j in (i - 1, i + 1):
            if 0 <= j < masses:
                rows[masses + i][j] += 1
                rows[masses + i][i] -= 1
    column, last = [0] * (2 * masses), [0] * (2 * masses)
    column[masses], last[masses - 1] = 1, 1
    return LinearPlant.from_state_space(rows, column, last)


def median(action: Callable[[], object], times: int) -> float:
    """Median wall-clock seconds of an action."""
    taken = []
    for _ in range(times):
        begun = time.perf_counter()
        action()
        taken.append(time.perf_counter() - begun)
    return statistics.median(taken)


def multiple_shooting(intervals: int) -> float:
    """The minimum time of the two-mass spring (Δ = 1) by CasADi and IPOPT: states at every interval, exact discretisation, free T."""
    casadi = pytest.importorskip("casadi")
    omega = np.sqrt(2.0)
    final, inputs = casadi.SX.sym("T"), casadi.SX.sym("u", intervals)
    states = casadi.SX.sym("x", 4, intervals + 1)
    h = final / intervals
    c, s = casadi.cos(omega * h), casadi.sin(omega * h)
    equations = [states[:, 0], states[:, intervals] - casadi.DM([1, 0, 0, 0])]
    for k in range(intervals):
        x, v, q, w = (states[i, k] for i in range(4))  # centre of mass, its velocity, stretch, its rate
        u = inputs[k]
        settled = -u / omega**2
        step = casadi.vertcat(
            x + h * v + h**2 * u / 4,
            v + h * u / 2,
            settled + (q - settled) * c + w * s / omega,
            -(q - settled) * omega * s + w * c,
        )
        equations.append(states[:, k + 1] - step)
    unknowns = casadi.vertcat(final, inputs, casadi.reshape(states, -1, 1))
    solver = casadi.nlpsol(
        "solver",
        "ipopt",
        {"x": unknowns, "f": final, "g": casadi.vertcat(*equations)},
        {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes"}},
    )
    free = [np.inf] * (4 * (intervals + 1))
    low, high = [0.1, *[-1.0] * intervals, *(-x for x in free)], [20.0, *[1.0] * intervals, *free]
    start = np.concatenate([[5.0], np.where(np.arange(intervals) < intervals / 2, 0.5, -0.5), np.zeros(4 * (intervals + 1))])
    return float(solver(x0=start, lbx=low, ubx=high, lbg=0, ubg=0)["x"][0])


def test_two_mass_against_multiple_shooting(capsys: pytest.CaptureFixture[str]) -> None:
    posed = problem([chain(2)], Maneuver(exact(1), Limits.of(-1, 1)))
    found = minimum_time(posed)
    assert found.status is Status.PROVED
    assert found.gap is not None
    assert found.gap <= 1e-12
    ours = median(lambda: minimum_time(posed), 15)
    error = abs(multiple_shooting(400) - found.lower)
    theirs = median(lambda: multiple_shooting(400), 3)
    with capsys.disabled():
        print(f"\ntwo-mass spring: proven to {found.gap:.1e} in {1e3 * ours:.0f} ms warm; multiple shooting with 400 intervals:", end="")
        print(f" error {error:.0e} in {1e3 * theirs:.0f} ms; ratio {theirs / ours:.0f}")


@pytest.mark.parametrize("masses", [2, 4, 8, 11, 16, 20, 25, 30, 40, 50, 60, 75])
def test_chain(masses: int, capsys: pytest.CaptureFixture[str]) -> None:
    """The second solve; docs/chains.py goes on to 200 poles and draws the picture."""
    posed = problem([chain(masses)], Maneuver(exact(5), Limits.of(-1, 1)))
    minimum_time(posed)
    begun = time.perf_counter()
    found = minimum_time(posed)
    taken = time.perf_counter() - begun
    with capsys.disabled():
        print(f"\nchain of {2 * masses} poles: {found.status.name}, {found.switches} switches, gap {found.gap:.1e}, {taken:.2f} s", end="")


def test_program_on_a_large_grid(capsys: pytest.CaptureFixture[str]) -> None:
    cells = 100_000
    posed = problem([chain(6)], Maneuver(exact(3), Limits.of(-1, 1)))
    begun = time.perf_counter()
    solution = programs.solve(posing.build(posed, np.linspace(0.0, 14.7, cells + 1)))
    taken = time.perf_counter() - begun
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    with capsys.disabled():
        print(f"\nprogram of {cells} cells and {posed.size} rows: {solution.status}, {taken:.1f} s, peak memory {peak:.2f} GB")


def test_check_as_a_process(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "chain.json"
    content = minimum_time(problem([chain(6)], Maneuver(exact(3), Limits.of(-1, 1)))).certificate
    assert content is not None
    file.write_bytes(content)
    inside = median(lambda: check(file.read_bytes()), 5)

    def process(*words: str) -> float:
        return median(lambda: subprocess.run([sys.executable, *words], check=True, capture_output=True), 7)

    bare, aid, whole = process("-c", "pass"), process("-m", "suite", "--help"), process("-m", "suite", "check", str(file))
    with capsys.disabled():
        print(f"\ncheck of 12 poles: {1e3 * inside:.0f} ms in process, {1e3 * whole:.0f} ms as a whole process;", end="")
        print(f" --help takes {aid / bare:.1f} times python -c pass ({1e3 * aid:.0f} and {1e3 * bare:.0f} ms)")


@pytest.mark.parametrize("name", ["two_mass_fuel", "spacecraft"])
def test_a_sweep_of_two_hundred_budgets(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Figures of `slewcert fuel`: three kinds, processor time; two hundred budgets are to take a minute on one core."""
    from suite.fuel_plans import plan
    from suite.fuel_sweeps import sweep
    from suite.loading import load_study

    begun = time.process_time()
    done = sweep(plan(load_study(Path(__file__).parents[2] / "suite" / "studies" / f"{name}.toml")))
    taken = time.process_time() - begun
    points = [point for curve in done.curves for point in curve.points]
    proven, gap = sum(point.status == "proved" for point in points), max(point.bound.gap or 0.0 for point in points)
    budgets = len(done.curves[0].points)
    with capsys.disabled():
        print(f"\n{name}: {budgets} budgets, {len(points)} minimum times, {proven} proven, largest gap {gap:.1e},", end="")
        print(f" {taken:.1f} s of processor time")


def test_a_table_of_a_hundred_displacements(tmp_path: Path) -> None:
    """Figures of `slewcert table`: the two-mass spring, and a sampled one; a hundred rows are to take a minute at most."""
    from suite.loading import load_study
    from suite.tables import displacements, tabulate

    problems = Path(__file__).parents[2] / "suite" / "problems"
    for name, asked in (("two_mass_5", "0.1:10:100"), ("two_mass_sampled", "0.1:10:100"), ("chain_06", "0.1:10:100")):
        begun = time.perf_counter()
        table = tabulate(load_study(problems / f"{name}.toml"), displacements(asked))
        taken = time.perf_counter() - begun
        gap = max(row.bound.gap or 0.0 for row in table.rows)
        print(f"{name}: {len(table.rows)} displacements in {taken:.1f} s, {table.proven} proven, largest gap {gap:.1e}")
        assert table.proven == len(table.rows)
