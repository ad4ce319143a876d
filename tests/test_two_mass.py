"""The plant `two_mass`: the binary against its twin, FMI 2.0 against 3.0, co-simulation against model exchange."""

from __future__ import annotations

import csv
import ctypes
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import read_model_description, simulate_fmu
from fmpy.fmi1 import FMICallException
from numpy.typing import NDArray
from raw_fmus import Interface, RawFmu
from reference_traces import BANG_BANG, reference_trace
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from fmus.build import PLANTS, FmiVersion, build
from fmus.twins import TwinMatrices, linear_plant, read_twin

VERSIONS: tuple[FmiVersion, ...] = ("2.0", "3.0")
FOLDER = PLANTS / "two_mass"
TWIN = (FOLDER / "twin.toml").read_text(encoding="utf-8")
STATES = ("position_1", "velocity_1", "position_2", "velocity_2")
DERIVATIVES = tuple(f"der({x})" for x in STATES)
OUTPUTS = ("position_1", "position_2", "spring")
# The nominal plant, and plants with every parameter away from its start value: slow, fast, and of very different masses.
PARAMETERS = (
    {},
    {"mass_1": 2.0, "mass_2": 0.5, "stiffness": 0.7, "damping": 0.3},
    {"mass_1": 0.125, "mass_2": 3.7, "stiffness": 250.0, "damping": 0.01},
)
JUMPS = ((0.0, 1.0), (1.003, -1.0), (2.1, 1.0), (3.2, -1.0), (4.2, 0.0))  # start [s] and level [N]

Open = Callable[..., RawFmu]


@pytest.fixture
def open_fmu(tmp_path: Path) -> Open:
    """Opens instances; each has its own folder."""
    count = iter(range(1000))

    def opened(version: FmiVersion, interface: Interface = "CoSimulation", token: str | None = None) -> RawFmu:
        return RawFmu(build("two_mass", version), tmp_path / str(next(count)), interface, token)

    return opened


def communication_points(step: float, stop: float) -> list[tuple[float, float, float]]:
    """(start, end, force) of each step: the regular points united with the jumps."""
    points = sorted({*(k * step for k in range(int(stop / step) + 1)), *(start for start, _ in JUMPS), stop})
    return [(a, b, next(level for start, level in reversed(JUMPS) if start <= a)) for a, b in pairwise(points)]


def exact_step(twin: TwinMatrices, state: NDArray[np.float64], force: float, step: float) -> NDArray[np.float64]:
    augmented = np.zeros((5, 5))
    augmented[:4, :4] = np.array(twin.A, dtype=float)
    augmented[:4, 4] = np.array(twin.B, dtype=float) * force
    return np.asarray(expm(augmented * step), dtype=np.float64)[:4] @ np.append(state, 1.0)


def run(fmu: RawFmu, parameters: Mapping[str, float], step: float = 0.05, stop: float = 40.0, scale: float = 1.0) -> NDArray[np.float64]:
    fmu.initialize(parameters)
    rows = []
    for start, end, force in communication_points(step, stop):
        fmu.set({"force": scale * force})
        fmu.step(start, end - start)
        rows.append(fmu.get(STATES))
    return np.array(rows)


@pytest.mark.parametrize("scale", [1.0, 1e-4])
@pytest.mark.parametrize("step", [0.05, 0.7, 40.0])
@pytest.mark.parametrize("parameters", PARAMETERS)
@pytest.mark.parametrize("version", VERSIONS)
def test_follows_the_twin_exactly(open_fmu: Open, version: FmiVersion, parameters: Mapping[str, float], step: float, scale: float) -> None:
    twin = read_twin(TWIN, parameters)
    with open_fmu(version) as fmu:
        found = run(fmu, parameters, step, scale=scale)
    state, expected = np.zeros(4), []
    for start, end, force in communication_points(step, 40.0):
        state = exact_step(twin, state, scale * force, end - start)
        expected.append(state)
    displacement = abs(expected[-1][2])
    # 1e-10 of the move is what the reference itself (hundreds of rounded matrix exponentials) is good for.
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * displacement)


def test_both_versions_give_the_same_bits(open_fmu: Open) -> None:
    with open_fmu("2.0") as second, open_fmu("3.0") as third:
        assert np.array_equal(run(second, PARAMETERS[1]), run(third, PARAMETERS[1]))


@pytest.mark.parametrize("version", VERSIONS)
def test_model_exchange_and_co_simulation_agree(open_fmu: Open, version: FmiVersion) -> None:
    with open_fmu(version) as slave:
        stepped = run(slave, PARAMETERS[1], stop=6.0)
    with open_fmu(version, "ModelExchange") as model:
        model.initialize(PARAMETERS[1])
        if model.is_fmi2:
            model.fmu.enterContinuousTimeMode()
        else:
            model.fmu.updateDiscreteStates()
            model.fmu.enterContinuousTimeMode()

        def slope(time: float, state: NDArray[np.float64]) -> NDArray[np.float64]:
            model.fmu.setTime(time)
            model.fmu.setContinuousStates(np.ascontiguousarray(state).ctypes.data_as(pointer), 4)
            result = np.zeros(4)
            read = model.fmu.getDerivatives if model.is_fmi2 else model.fmu.getContinuousStateDerivatives
            read(result.ctypes.data_as(pointer), 4)
            return result

        pointer = ctypes.POINTER(ctypes.c_double)
        state, rows = np.zeros(4), []
        for start, end, force in communication_points(0.05, 6.0):
            model.set({"force": force})
            state = solve_ivp(slope, (start, end), state, method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
            rows.append(state)
    np.testing.assert_allclose(stepped, rows, rtol=0, atol=1e-10)  # DOP853's own tolerance, over 120 steps


@pytest.mark.parametrize("interface", ["CoSimulation", "ModelExchange"])
@pytest.mark.parametrize("version", VERSIONS)
def test_a_foreign_importer_reproduces_the_reference(version: FmiVersion, interface: str) -> None:
    rows = read_reference()
    # FMPy takes a jump as two rows of exactly the same time; at the start it wants the value after it only.
    levels = [level for _, level in BANG_BANG]
    jumps = [(float(t), level) for (t, _), pair in zip(BANG_BANG[1:], pairwise(levels), strict=True) for level in pair]
    signal = np.array([(0.0, levels[0]), *jumps, (12.0, levels[-1])], dtype=[("time", float), ("force", float)])
    result = simulate_fmu(
        str(build("two_mass", version)),
        stop_time=12.0,
        output_interval=0.1,
        relative_tolerance=1e-10,
        input=signal,
        output=[*STATES, "spring"],
        fmi_type=interface,
    )
    for row in rows:
        nearest = result[np.argmin(np.abs(result["time"] - row["time"]))]
        assert nearest["time"] == pytest.approx(row["time"], abs=1e-12)
        for name in (*STATES, "spring"):
            # CVODE holds its relative tolerance of 1e-10 a step only; co-simulation does not depend on it.
            assert nearest[name] == pytest.approx(row[name], abs=1e-11 if interface == "CoSimulation" else 2e-8)


def read_reference() -> list[dict[str, float]]:
    with (FOLDER / "reference.csv").open(encoding="utf-8") as file:
        return [{name: float(x) for name, x in row.items()} for row in csv.DictReader(file)]


def test_the_reference_is_what_ball_arithmetic_gives() -> None:
    assert (FOLDER / "reference.csv").read_text(encoding="utf-8") == reference_trace("two_mass")


@pytest.mark.parametrize("interface", ["CoSimulation", "ModelExchange"])
@pytest.mark.parametrize("parameters", PARAMETERS)
@pytest.mark.parametrize("version", VERSIONS)
def test_directional_derivatives_are_the_twins_matrices(
    open_fmu: Open, version: FmiVersion, parameters: Mapping[str, float], interface: Interface
) -> None:
    twin = read_twin(TWIN, parameters)
    with open_fmu(version, interface) as fmu:
        # The linearisation of a linear plant is the same everywhere, so the state may be anything.
        fmu.initialize({**parameters, "position_1": 0.3, "velocity_2": -1.1, "force": 0.7})
        A = [[fmu.directional(d, x) for x in STATES] for d in DERIVATIVES]
        B = [fmu.directional(d, "force") for d in DERIVATIVES]
        C = {y: [fmu.directional(y, x) for x in STATES] for y in OUTPUTS}
        D = {y: fmu.directional(y, "force") for y in OUTPUTS}
        if not fmu.is_fmi2:
            unknowns = [fmu.references[name] for name in (*DERIVATIVES, *OUTPUTS)]
            for i, row in enumerate([*A, *C.values()]):
                seed = [float(i == k) for k in range(len(unknowns))]
                assert fmu.fmu.getAdjointDerivative(unknowns, [fmu.references[x] for x in STATES], seed, 4) == row
    # Equal, not close: each entry is one rounded quotient of the same two numbers.
    assert [[float(x) for x in row] for row in twin.A] == A
    assert [float(x) for x in twin.B] == B
    assert {y: [float(x) for x in row] for y, (row, _) in twin.outputs.items()} == C
    assert {y: float(d) for y, (_, d) in twin.outputs.items()} == D


@pytest.mark.parametrize("parameter", ["mass_1", "mass_2", "stiffness", "damping"])
def test_directional_derivatives_by_parameters(open_fmu: Open, parameter: str) -> None:
    point = {"mass_1": 2.0, "mass_2": 0.5, "stiffness": 0.7, "damping": 0.3, "force": 0.9, "position_2": 0.4, "velocity_1": -0.6}
    step = 1e-5

    def derivatives(change: float) -> NDArray[np.float64]:
        with open_fmu("3.0") as fmu:
            fmu.initialize({**point, parameter: point[parameter] + change})
            return np.array(fmu.get(DERIVATIVES))

    with open_fmu("3.0") as fmu:
        fmu.initialize(point)
        found = [fmu.directional(d, parameter) for d in DERIVATIVES]
    # Central differences: an error of step² times a third derivative below 100, and of rounding, 1e-16 / step.
    np.testing.assert_allclose(found, (derivatives(step) - derivatives(-step)) / (2 * step), rtol=0, atol=1e-8)
    assert np.any(np.array(found) != 0.0)


@pytest.mark.parametrize("version", VERSIONS)
def test_the_model_structure_names_exactly_the_dependencies_that_exist(version: FmiVersion) -> None:
    description: Any = read_model_description(str(build("two_mass", version)))
    twin = read_twin(TWIN, PARAMETERS[1])
    rows = {f"der({x})": (*a, b) for x, a, b in zip(twin.states, twin.A, twin.B, strict=True)}
    rows |= {y: (*c, d) for y, (c, d) in twin.outputs.items()}
    declared = {u.variable.name: {v.name for v in u.dependencies} for u in (*description.outputs, *description.derivatives)}
    assert declared == {name: {x for x, entry in zip((*twin.states, "force"), row, strict=True) if entry} for name, row in rows.items()}


@pytest.mark.parametrize("version", VERSIONS)
def test_a_restored_state_continues_with_the_same_bits(open_fmu: Open, version: FmiVersion) -> None:
    def onward(fmu: RawFmu) -> list[list[float]]:
        rows = []
        for k in range(20, 40):
            fmu.step(k * 0.1, 0.1)
            rows.append(fmu.get([*STATES, "spring", "force", "time"]))
        return rows

    with open_fmu(version) as fmu, open_fmu(version) as other:
        fmu.initialize(PARAMETERS[1])
        fmu.set({"force": 1.0})
        for k in range(20):
            fmu.step(k * 0.1, 0.1)
        state = fmu.save()
        first = onward(fmu)
        fmu.restore(state)
        assert onward(fmu) == first
        content = fmu.serialize(state)
        fmu.release(state)
        other.initialize()
        copy = other.deserialize(content)
        other.restore(copy)
        other.release(copy)
        assert onward(other) == first
        for damaged in (content[:-1], b"x" + content[1:]):
            with pytest.raises(FMICallException):
                other.deserialize(damaged)


@pytest.mark.parametrize("version", VERSIONS)
def test_reset_brings_the_start_values_back(open_fmu: Open, version: FmiVersion) -> None:
    with open_fmu(version) as fmu:
        first = run(fmu, {}, stop=5.0)
        fmu.reset()
        assert fmu.get(["mass_1", "stiffness", *STATES, "force"]) == [1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        assert np.array_equal(run(fmu, {}, stop=5.0), first)
        fmu.fmu.terminate()


@pytest.mark.parametrize("version", VERSIONS)
def test_initial_states_can_be_set(open_fmu: Open, version: FmiVersion) -> None:
    """A stretched spring, released: spring(t) = 2 cos(√2 t) while the centre of mass stays."""
    with open_fmu(version) as fmu:
        fmu.initialize({"position_1": -1.0, "position_2": 1.0})
        assert fmu.get(["spring"]) == [2.0]
        fmu.step(0.0, 3.0)
        assert fmu.get(["spring"])[0] == pytest.approx(2.0 * np.cos(np.sqrt(2.0) * 3.0), abs=1e-13)


def test_input_derivatives_are_followed_exactly_and_for_one_step(open_fmu: Open) -> None:
    """A polynomial force: the exact response comes from the twin with a chain of integrators in front of its input."""
    derivatives = [0.5, -1.5, 2.0, -3.0, 4.0]
    twin = read_twin(TWIN)
    chain = np.zeros((10, 10))
    chain[:4, :4], chain[:4, 4] = np.array(twin.A, dtype=float), np.array(twin.B, dtype=float)
    chain[4:9, 5:] = np.eye(5)
    after = np.asarray(expm(chain * 1.25), dtype=np.float64) @ [0.0, 0.0, 0.0, 0.0, 0.25, *derivatives]
    with open_fmu("2.0") as fmu:
        fmu.initialize()
        fmu.set({"force": 0.25})
        fmu.set_input_derivatives("force", derivatives)
        fmu.step(0.0, 1.25)
        np.testing.assert_allclose(fmu.get([*STATES, "force"]), after[:5], rtol=0, atol=1e-12)
        held = exact_step(twin, after[:4], after[4], 0.5)
        fmu.step(1.25, 0.5)
        np.testing.assert_allclose(fmu.get(STATES), held, rtol=0, atol=1e-12)
        with pytest.raises(FMICallException):
            fmu.set_input_derivatives("force", [0.0] * 6)
        with pytest.raises(FMICallException):
            fmu.set_input_derivatives("spring", [0.0])


@pytest.mark.parametrize("version", VERSIONS)
def test_refuses_what_makes_no_sense(open_fmu: Open, version: FmiVersion, capfd: pytest.CaptureFixture[str]) -> None:
    with open_fmu(version) as fmu:
        with pytest.raises(FMICallException):  # before the initialization
            fmu.step(0.0, 0.1)
        for values in ({"mass_1": 0.0}, {"stiffness": np.nan}, {"position_1": np.inf}, {"spring": 1.0}, {"der(position_1)": 1.0}):
            with pytest.raises(FMICallException):
                fmu.set(values)
        fmu.initialize(stop=1.0)
        refused = ({"force": np.nan}, {"stiffness": 2.0}, {"position_1": 1.0}, {"force": 2.0, "mass_1": 2.0}, {"time": 1.0})
        for values in refused:
            with pytest.raises(FMICallException):
                fmu.set(values)
        assert fmu.get(["force"]) == [0.0], "a refused call must not set half of its values"
        for time, step in ((0.0, 0.0), (0.0, -0.1), (0.0, np.nan), (0.1, 0.1), (0.0, 1.1)):
            with pytest.raises(FMICallException):
                fmu.step(time, step)
        fmu.step(0.0, 1.0)
    messages = capfd.readouterr().out
    assert "stiffness can be set before the end of the initialization only" in messages
    assert "force must be finite, not nan" in messages


@pytest.mark.parametrize("interface", ["CoSimulation", "ModelExchange"])
@pytest.mark.parametrize("version", VERSIONS)
def test_refuses_the_description_of_another_build(open_fmu: Open, version: FmiVersion, interface: Interface) -> None:
    with pytest.raises(Exception, match="Failed to instantiate"):
        open_fmu(version, interface, token="{00000000-0000-0000-0000-000000000000}")


def test_the_twin_is_the_textbooks_plant() -> None:
    plant = linear_plant(read_twin(TWIN), "position_2")
    assert plant.rigid_order == 2
    assert [(p.value, p.multiplicity) for p in plant.flexible] == [(complex(0, np.sqrt(2.0)), 1)]
    assert {"position_1", "position_2", "spring"} <= plant.numerators.keys()
