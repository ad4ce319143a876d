"""Every shipped plant: binary against twin and reference, FMI 2.0 against 3.0, co-simulation against model exchange, physics."""

from __future__ import annotations

import ctypes
import tomllib
from collections.abc import Callable, Mapping
from fractions import Fraction
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import read_model_description, simulate_fmu
from nonlinear_plants import MODELS, parameters
from numpy.typing import NDArray
from raw_fmus import Interface, RawFmu
from reference_traces import SIGNALS, read_reference, reference_trace, twin_text
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from fmus.build import PLANTS, build, shipped
from fmus.compiling import FmiVersion
from fmus.twins import TwinMatrices, read_twin

VERSIONS: tuple[FmiVersion, ...] = ("2.0", "3.0")
INTERFACES: tuple[Interface, ...] = ("CoSimulation", "ModelExchange")
LINEAR = tuple(name for name in shipped() if name not in MODELS)
# Parameters away from their start values, by factors that nothing has in common, and what is zero at the start.
NOT_ZERO = {"two_mass": {"damping": 0.3}, "chain": {"damping": 0.3}, "gantry_crane": {"friction": 300.0}}
FIXED = {"thruster_torque"}  # enters no equation: it says which torques are refused
# A fast plant of very different masses.
EXTREME = {"two_mass": {"mass_1": 0.125, "mass_2": 3.7, "stiffness": 250.0, "damping": 0.01}}

Open = Callable[..., RawFmu]


@pytest.fixture
def open_fmu(tmp_path: Path) -> Open:
    """Opens instances; each has its own folder."""
    count = iter(range(1000))

    def opened(name: str, version: FmiVersion = "3.0", interface: Interface = "CoSimulation") -> RawFmu:
        return RawFmu(build(name, version), tmp_path / str(next(count)), interface)

    return opened


def changed(name: str) -> dict[str, float]:
    """Every parameter of a plant away from its start value, such that it still makes sense."""
    rng = np.random.default_rng(7)
    start = {**parameters(name), **NOT_ZERO.get(name, {})}
    return {parameter: float(value * rng.uniform(0.85, 1.15)) for parameter, value in start.items() if parameter not in FIXED}


def sets(*names: str) -> list[Any]:
    """(plant, parameters) for each plant: the nominal one, another one, and the extreme one if there is one."""
    cases = [(name, which) for name in names for which in ({}, changed(name), EXTREME.get(name)) if which is not None]
    return [pytest.param(name, which, id=f"{name}-{len(which)}") for name, which in cases]


@cache
def description(name: str, version: FmiVersion = "3.0") -> Any:
    return read_model_description(str(build(name, version)))


def variables(name: str, *causalities: str) -> list[str]:
    return [v.name for v in description(name).modelVariables if v.causality in causalities]


def states(name: str) -> list[str]:
    return [u.variable.derivative.name for u in description(name).derivatives]


def outputs(name: str) -> list[str]:
    """The outputs that are no states."""
    return [v for v in variables(name, "output") if v not in states(name)]


def inputs(name: str, level: float) -> dict[str, float]:
    """The value of each input while the driven one is at `level`."""
    twin = read_twin(twin_text(name))
    return {**dict.fromkeys(variables(name, "input"), 0.0), **SIGNALS[name].held, twin.input: level}


def exact_step(twin: TwinMatrices, state: NDArray[np.float64], level: float, step: float) -> NDArray[np.float64]:
    return _transition(twin.A, twin.B, level, step) @ np.append(state, 1.0)


@cache
def _transition(A: tuple[tuple[Fraction, ...], ...], B: tuple[Fraction, ...], level: float, step: float) -> NDArray[np.float64]:
    n = len(B)
    augmented = np.zeros((n + 1, n + 1))
    augmented[:n, :n], augmented[:n, n] = np.array(A, dtype=float), np.array(B, dtype=float) * level
    return np.asarray(expm(augmented * step), dtype=np.float64)[:n]


def communication_points(name: str, step: float, stop: float) -> list[tuple[float, float, float]]:
    """(start, end, level) of each step; `step` and `stop` are in the plant's units of time."""
    unit = float(Fraction(SIGNALS[name].unit))
    jumps = [(float(start), float(level)) for start, level in SIGNALS[name].jumps()]
    regular = (round(k * step * unit, 12) for k in range(int(stop / step) + 1))
    points = sorted({*regular, *(start for start, _ in jumps if start < stop * unit), stop * unit})
    return [(a, b, next(level for start, level in reversed(jumps) if start <= a)) for a, b in pairwise(points)]


def run(fmu: RawFmu, name: str, values: Mapping[str, float], step: float = 0.05, stop: float = 6.0) -> NDArray[np.float64]:
    """The states after each communication step."""
    fmu.initialize({**values, **inputs(name, 0.0)})
    driven, rows = read_twin(twin_text(name)).input, []
    for start, end, level in communication_points(name, step, stop):
        fmu.set({driven: level})
        fmu.step(start, end - start)
        rows.append(fmu.get(states(name)))
    return np.array(rows)


# Motion


@pytest.mark.parametrize("step", [0.05, 0.7, 40.0])
@pytest.mark.parametrize(("name", "values"), sets(*LINEAR))
def test_follows_the_twin_exactly(open_fmu: Open, name: str, values: Mapping[str, float], step: float) -> None:
    twin = read_twin(twin_text(name), values)
    with open_fmu(name) as fmu:
        found = run(fmu, name, values, step, stop=10.0)
    state, expected = np.zeros(len(twin.states)), []
    for start, end, level in communication_points(name, step, 10.0):
        state = exact_step(twin, state, level, end - start)
        expected.append(state)
    columns = [states(name).index(x) for x in twin.states]
    # 1e-10 of the motion is what the reference itself (hundreds of rounded matrix exponentials) is good for.
    np.testing.assert_allclose(
        found[:, columns] / np.abs(expected).max(axis=0), expected / np.abs(expected).max(axis=0), rtol=0, atol=1e-10
    )


@pytest.mark.parametrize("name", shipped())
def test_both_versions_give_the_same_bits(open_fmu: Open, name: str) -> None:
    with open_fmu(name, "2.0") as second, open_fmu(name, "3.0") as third:
        assert np.array_equal(run(second, name, changed(name)), run(third, name, changed(name)))


@pytest.mark.parametrize("name", shipped())
def test_model_exchange_and_co_simulation_agree(open_fmu: Open, name: str) -> None:
    version = VERSIONS[shipped().index(name) % 2]  # `test_both_versions_give_the_same_bits` covers the other one
    n, driven = len(states(name)), read_twin(twin_text(name)).input
    with open_fmu(name, version) as slave:
        stepped = run(slave, name, changed(name), step=0.2)
    size = np.abs(stepped).max(axis=0)
    with open_fmu(name, version, "ModelExchange") as model:
        model.initialize({**changed(name), **inputs(name, 0.0)})
        model.start_continuous_time()

        def slope(time: float, state: NDArray[np.float64]) -> NDArray[np.float64]:
            model.fmu.setTime(time)
            model.fmu.setContinuousStates(np.ascontiguousarray(state * size).ctypes.data_as(pointer), n)
            result = np.zeros(n)
            read = model.fmu.getDerivatives if model.is_fmi2 else model.fmu.getContinuousStateDerivatives
            read(result.ctypes.data_as(pointer), n)
            return result / size

        pointer = ctypes.POINTER(ctypes.c_double)
        state, rows = np.zeros(n), []
        for start, end, level in communication_points(name, 0.2, 6.0):
            model.set({driven: level})
            state = solve_ivp(slope, (start, end), state, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
            rows.append(state)
    np.testing.assert_allclose(stepped / size, rows, rtol=0, atol=1e-9)  # DOP853's own tolerance, over 30 steps


@pytest.mark.parametrize("interface", INTERFACES)
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("name", shipped())
def test_a_foreign_importer_reproduces_the_reference(name: str, version: FmiVersion, interface: str) -> None:
    names, rows = read_reference(name)
    signal, driven = SIGNALS[name], names[1]
    jumps = [(float(start), float(level)) for start, level in signal.jumps()]
    # FMPy takes a jump as two rows of exactly the same time; at the start it wants the value after it only.
    table = [(time, level) for (_, before), (time, after) in pairwise(jumps) for level in (before, after)]
    drive = np.array([jumps[0], *table, (rows[-1, 0], jumps[-1][1])], dtype=[("time", float), (driven, float)])
    result = simulate_fmu(
        str(build(name, version)),
        stop_time=rows[-1, 0],
        output_interval=float(Fraction(signal.step) * Fraction(signal.unit)),
        relative_tolerance=1e-10,
        start_values=dict(signal.held),
        input=drive,
        output=names[2:],
        fmi_type=interface,
    )
    nearest = [int(np.argmin(np.abs(result["time"] - time))) for time in rows[:, 0]]
    np.testing.assert_allclose(result["time"][nearest], rows[:, 0], rtol=0, atol=1e-12)
    jumping = {u.variable.name for u in description(name, version).outputs if driven in {v.name for v in u.dependencies or ()}}
    at_jumps = np.isin(rows[:, 0], [start for start, _ in jumps])
    for output, column in zip(names[2:], rows.T[2:], strict=True):
        # CVODE holds its relative tolerance of 1e-10 a step only; co-simulation does not depend on it, and the reference of a
        # nonlinear plant is right to 1e-11. Where an output jumps with the input, FMPy records what it was before.
        tolerance = 1e-6 if interface == "ModelExchange" else 1e-10
        compared = ~at_jumps if output in jumping else slice(None)
        error = np.abs(result[output][nearest] - column)[compared].max()
        assert error <= tolerance * np.abs(column).max(), output


@pytest.mark.parametrize("name", shipped())
def test_the_reference_is_what_the_equations_give(name: str) -> None:
    if name not in MODELS:  # ball arithmetic: the same digits everywhere
        assert (PLANTS / name / "reference.csv").read_text(encoding="utf-8") == reference_trace(name)
        return
    _, rows = read_reference(name)
    again = np.array([line.split(",") for line in reference_trace(name).split()[1:]], dtype=float)
    np.testing.assert_allclose(again / np.abs(rows).max(axis=0), rows / np.abs(rows).max(axis=0), rtol=0, atol=1e-11)


# Linearisation


@pytest.mark.parametrize(("name", "values"), sets(*shipped()))
@pytest.mark.parametrize("interface", INTERFACES)
@pytest.mark.parametrize("version", VERSIONS)
def test_directional_derivatives_are_the_twins_matrices(
    open_fmu: Open, version: FmiVersion, name: str, values: Mapping[str, float], interface: Interface
) -> None:
    twin = read_twin(twin_text(name), values)
    rows = {f"der({x})": (*a, b) for x, a, b in zip(twin.states, twin.A, twin.B, strict=True)}
    rows |= {y: (*c, d) for y, (c, d) in twin.outputs.items()}
    # The linearisation of a linear plant is the same everywhere, so its state may be anything.
    point = {x: 0.1 * (i + 1) for i, x in enumerate(twin.states)} if name in LINEAR else {}
    with open_fmu(name, version, interface) as fmu:
        fmu.initialize({**values, **point})
        found = {unknown: [fmu.directional(unknown, known) for known in (*twin.states, twin.input)] for unknown in rows}
        if not fmu.is_fmi2:
            unknowns = [fmu.references[unknown] for unknown in rows]
            for unknown in rows:
                seed = [float(unknown == each) for each in rows]
                backward = fmu.fmu.getAdjointDerivative(unknowns, [fmu.references[x] for x in twin.states], seed, len(twin.states))
                assert backward == found[unknown][:-1]
    for unknown, row in rows.items():
        # A few roundings of sums and products, and of a cosine in the nonlinear plants.
        np.testing.assert_allclose(found[unknown], [float(x) for x in row], rtol=2e-14, atol=1e-14 * max(map(abs, row)), err_msg=unknown)


@pytest.mark.parametrize("name", shipped())
def test_directional_derivatives_are_right_everywhere(open_fmu: Open, name: str) -> None:
    """By every state, input and parameter, in the midst of a motion, against differences of what the binary itself calculates."""
    rng = np.random.default_rng(11)
    nominal = {u.variable.derivative.name: float(u.variable.derivative.nominal or 1.0) for u in description(name).derivatives}
    point = changed(name) | {x: size * rng.uniform(0.2, 1.0) for x, size in nominal.items()}
    point |= {u: value or 0.5 for u, value in inputs(name, float(Fraction(SIGNALS[name].level))).items()}
    unknowns = [*(f"der({x})" for x in states(name)), *outputs(name)]
    with open_fmu(name) as fmu:

        def at(known: str, change: float) -> NDArray[np.float64]:
            fmu.reset()
            fmu.initialize({**point, known: point[known] + change})
            return np.array(fmu.get(unknowns))

        size, by = np.abs(at(next(iter(point)), 0.0)), {}
        for known, value in point.items():
            h = 1e-3 * abs(value)
            wide, narrow = ((at(known, k * h) - at(known, -k * h)) / (2 * k * h) for k in (1.0, 0.5))
            fmu.reset()
            fmu.initialize(point)
            by[known] = [fmu.directional(unknown, known) for unknown in unknowns]
            # Extrapolated central differences: their error is 1e-12 of the fifth derivative, and 1e-13 of the value by rounding.
            np.testing.assert_allclose(by[known], (4 * narrow - wide) / 3, rtol=1e-8, atol=1e-9 * size.max() / abs(value), err_msg=known)
    idle = {"spacecraft": ["angle", "propellant"]}.get(name, [])  # no output but themselves; what was burnt acts back on nothing
    assert [known for known, column in by.items() if not np.any(column)] == idle, "each of the others matters somewhere"


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("name", shipped())
def test_the_model_structure_names_exactly_the_dependencies_that_exist(open_fmu: Open, name: str, version: FmiVersion) -> None:
    rng = np.random.default_rng(13)
    knowns = [*states(name), *variables(name, "input")]
    point = changed(name) | {x: rng.uniform(0.1, 0.3) for x in knowns}
    found = description(name, version)
    with open_fmu(name, version) as fmu:
        fmu.initialize(point)
        for unknown in (*found.outputs, *found.derivatives):
            matters = {x for x in knowns if fmu.directional(unknown.variable.name, x)}
            if unknown.dependencies is None:  # an array's elements are said to depend on everything
                assert "size" in tomllib.loads((PLANTS / name / "plant.toml").read_text(encoding="utf-8"))
            else:
                assert {v.name for v in unknown.dependencies} == matters, unknown.variable.name


@pytest.mark.parametrize("name", shipped())
def test_twin_and_fmu_have_the_same_parameters(name: str) -> None:
    written = tomllib.loads((PLANTS / name / "twin.toml").read_text(encoding="utf-8"))
    others = {v.name: float(v.start) for v in description(name).modelVariables if v.causality == "input" and v.name != written["input"]}
    assert {key: float(Fraction(value)) for key, value in written["parameters"].items()} == {**parameters(name), **others}
    assert set(read_twin(twin_text(name)).outputs) <= set(variables(name, "output"))
