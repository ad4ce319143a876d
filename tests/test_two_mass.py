"""What every plant's FMU does, beyond its equations, on the plant `two_mass`: states saved and restored, inputs with slopes, refusals."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from numpy.typing import NDArray
from raw_fmus import Interface, RawFmu
from scipy.linalg import expm

from fmus.build import PLANTS, FmiVersion, build
from fmus.twins import TwinMatrices, linear_plant, read_twin

VERSIONS: tuple[FmiVersion, ...] = ("2.0", "3.0")
FOLDER = PLANTS / "two_mass"
TWIN = (FOLDER / "twin.toml").read_text(encoding="utf-8")
STATES = ("position_1", "velocity_1", "position_2", "velocity_2")
PARAMETERS = {"mass_1": 2.0, "mass_2": 0.5, "stiffness": 0.7, "damping": 0.3}
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


@pytest.mark.parametrize("parameters", [{}, PARAMETERS])
def test_small_motions_are_as_exact_as_large_ones(open_fmu: Open, parameters: Mapping[str, float]) -> None:
    """A linear plant's motion scales with its input; what the integrator may miss must scale too."""
    with open_fmu("3.0") as large, open_fmu("3.0") as small:
        whole, part = run(large, parameters, step=0.7), run(small, parameters, step=0.7, scale=1e-4)
    np.testing.assert_allclose(part, 1e-4 * whole, rtol=0, atol=1e-14 * np.abs(whole).max())  # 1e-10 of the small motion


@pytest.mark.parametrize("version", VERSIONS)
def test_a_restored_state_continues_with_the_same_bits(open_fmu: Open, version: FmiVersion) -> None:
    def onward(fmu: RawFmu) -> list[list[float]]:
        rows = []
        for k in range(20, 40):
            fmu.step(k * 0.1, 0.1)
            rows.append(fmu.get([*STATES, "spring", "force", "time"]))
        return rows

    with open_fmu(version) as fmu, open_fmu(version) as other:
        fmu.initialize(PARAMETERS)
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
