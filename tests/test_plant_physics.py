"""The physics of the shipped plants: what is conserved is, energy is accounted for, and poles and zeros are the linearised FMU's."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from nonlinear_plants import MODELS
from numpy.typing import NDArray
from raw_fmus import RawFmu
from reference_traces import twin_text
from scipy.integrate import simpson
from scipy.linalg import eigvals

from fmus.archives import open_archive
from fmus.build import PLANTS, build, shipped
from fmus.linearization import linearize
from fmus.plant_files import read_plant_file
from fmus.twins import linear_plant, read_twin
from fmus.workers import Worker
from relaxations.plants import LinearPlant, Pole

Reals = NDArray[np.float64]
Trace = dict[str, Reals]
Simulate = Callable[..., Trace]


@pytest.fixture
def simulate(tmp_path: Path) -> Simulate:
    """Runs a plant by co-simulation, its first input in pieces of (duration [s], level) with `points` steps each; all its variables."""

    def simulated(
        name: str, pieces: tuple[tuple[float, float], ...], values: Mapping[str, float] | None = None, points: int = 200
    ) -> Trace:
        with RawFmu(build(name), tmp_path / name) as fmu:
            names = list(fmu.references)
            driven = read_twin(open_archive(build(name)).twin or "").input
            fmu.initialize({driven: pieces[0][1], **(values or {})})
            rows, time = [fmu.get(names)], 0.0
            for duration, level in pieces:
                fmu.set({driven: level})
                for k in range(points):
                    fmu.step(time + k * duration / points, duration / points)
                    rows.append(fmu.get(names))
                time += duration
        return dict(zip(names, np.array(rows).T, strict=True))

    return simulated


def impulse(pieces: tuple[tuple[float, float], ...], points: int = 200) -> Reals:
    """∫ of the input up to each row of a trace."""
    steps = [duration * level / points for duration, level in pieces for _ in range(points)]
    return np.concatenate([[0.0], np.cumsum(steps)])


def close(found: Reals, expected: Reals | float, tolerance: float = 1e-11) -> None:
    """Equal to `tolerance` of the largest value: what is left of 13 digits after sums and differences."""
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * np.abs(expected).max())


# Momentum, moles, energy


@pytest.mark.parametrize(("name", "masses"), [("two_mass", ("mass_1", "mass_2")), ("chain", ("mass",) * 3), ("chain_7", ("mass",) * 7)])
def test_springs_and_dampers_change_no_momentum(simulate: Simulate, name: str, masses: tuple[str, ...]) -> None:
    pieces = ((1.5, 1.0), (2.0, -0.7), (1.0, 0.0))
    trace = simulate(name, pieces, {"damping": 0.2})
    momentum = sum(trace[mass] * trace[f"velocity_{i}"] for i, mass in enumerate(masses, 1))
    close(np.asarray(momentum), impulse(pieces))
    assert f"position_{len(masses) + 1}" not in trace


def test_work_on_two_masses_is_their_energy(simulate: Simulate) -> None:
    trace = simulate("two_mass", ((5.0, 0.8),), {"mass_1": 1.3, "stiffness": 0.6})
    kinetic = (trace["mass_1"] * trace["velocity_1"] ** 2 + trace["mass_2"] * trace["velocity_2"] ** 2) / 2
    close(kinetic + trace["stiffness"] * trace["spring"] ** 2 / 2, 0.8 * trace["position_1"])


def test_the_load_swings_at_the_cost_of_the_trolley(simulate: Simulate) -> None:
    """Without friction only the force changes the horizontal momentum, whatever the hoist does."""
    pieces = ((3.0, 3000.0), (4.0, -2000.0), (2.0, 0.0))
    trace = simulate("gantry_crane", pieces, {"hoist": -3.0})
    angle, length = trace["sway_angle"], trace["cable"]
    load = trace["velocity"] + length * np.cos(angle) * trace["sway_rate"] + np.sin(angle) * trace["payout_rate"]
    close(trace["trolley_mass"] * trace["velocity"] + trace["load_mass"] * load, impulse(pieces))
    assert np.ptp(angle) > 0.1, "the motion is large enough to tell a linear crane from this one"


@pytest.mark.parametrize(("name", "level", "moved", "dampers"), [
    ("gantry_crane", 3000.0, "position", {}),
    ("robot_arm", 200.0, "motor_angle", {"damping_1": 0.0, "damping_2": 0.0}),
])  # fmt: skip
def test_work_is_energy_in_the_nonlinear_plants(simulate: Simulate, name: str, level: float, moved: str, dampers: dict[str, float]) -> None:
    trace = simulate(name, ((5.0 if name == "gantry_crane" else 0.2, level),), dampers)
    energy = np.array([MODELS[name].energy(np.array(state)) for state in zip(*(trace[x] for x in MODELS[name].states), strict=True)])
    close(energy - energy[0], level * trace[moved])


def test_tanks_lose_no_mole(simulate: Simulate) -> None:
    pieces = ((300.0, 1.5), (400.0, 0.2))
    trace = simulate("stirred_tanks", pieces)
    held = trace["volume_1"] * trace["concentration_1"] + trace["volume_2"] * trace["concentration_2"]
    lost = trace["outflow"] + trace["decay"] * held
    for piece, (duration, level) in enumerate(pieces):
        rows = slice(200 * piece, 200 * piece + 201)
        # Simpson's rule over 200 intervals, a fifth to a seventh of the fastest time constant in 20 of them: 1e-9.
        close(np.array([held[rows][-1] - held[rows][0] + simpson(lost[rows], dx=duration / 200)]), level * duration, 1e-8)


def test_the_filter_loses_its_energy_in_its_resistors(simulate: Simulate) -> None:
    trace = simulate("rlc_filter", ((1e-3, 0.0),), {"voltage": 10.0, "current": 0.2}, points=2000)
    stored = (trace["inductance"] * trace["current"] ** 2 + trace["capacitance"] * trace["voltage"] ** 2) / 2
    heat = trace["resistance"] * trace["current"] ** 2 + trace["voltage"] * trace["load_current"]
    assert np.all(np.diff(stored) < 0.0)
    close(np.array([stored[0] - stored[-1]]), float(simpson(heat, dx=5e-7)), 1e-8)


def test_the_voice_coil_gives_the_arm_its_momentum(simulate: Simulate) -> None:
    trace = simulate("disk_drive", ((1e-3, 7.0),))
    time, lag = trace["time"], trace["amplifier_lag"]
    amperes = trace["amplifier_gain"] * 7.0 * (time - lag * (1.0 - np.exp(-time / lag)))  # ∫ of the amplifier's step response
    momentum = trace["coil_inertia"] * trace["coil_rate"] + trace["head_inertia"] * trace["head_rate"]
    close(momentum, trace["torque_constant"] * amperes)


def test_the_spacecraft_has_the_momentum_and_has_burnt_the_propellant_of_its_thrusters(simulate: Simulate) -> None:
    pieces = ((3.0, 10.0), (2.0, 0.0), (4.0, -10.0))
    trace = simulate("spacecraft", pieces)
    close(trace["momentum"], impulse(pieces))
    # thrust = torque / lever, and thrust over exhaust velocity is the flow
    burnt = impulse(tuple((duration, abs(level)) for duration, level in pieces)) / 1.5 / (220.0 * 9.80665)
    close(trace["propellant"], burnt)


@pytest.mark.parametrize("torque", [4.0, -9.999, 10.001, 25.0])
def test_no_thruster_is_half_open(simulate: Simulate, torque: float, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(FMICallException):
        simulate("spacecraft", ((0.1, torque),))
    assert "thrusters are on or off: torque must be thruster_torque, 0 or -thruster_torque" in capfd.readouterr().out
    simulate("spacecraft", ((0.1, torque),), {"thruster_torque": abs(torque)})


def test_the_aircraft_ends_where_its_reference_is_and_needs_no_elevator_there(simulate: Simulate) -> None:
    trace = simulate("aircraft_pitch", ((300.0, 0.2),))
    assert trace["elevator"][0] == 0.2
    # The slowest pole is -0.088: 26 time constants.
    assert trace["pitch"][-1] == pytest.approx(0.2, rel=1e-11)
    assert abs(trace["elevator"][-1]) < 1e-12


# Poles and zeros


@pytest.fixture(scope="module")
def worker() -> Iterator[Worker]:
    with Worker() as one:
        yield one


def spread(roots: tuple[Pole, ...]) -> list[complex]:
    """Every root as often as it counts, conjugates too."""
    return [value for r in roots for value in {r.value, r.value.conjugate()} for _ in range(r.multiplicity)]


def same_roots(found: Iterable[complex], expected: list[complex], tolerance: float) -> None:
    """As many, and each one's nearest partner within `tolerance`, or 1e-9 of itself if it is simple."""
    left = [complex(root) for root in found]
    assert len(left) == len(expected)
    for root in expected:
        nearest = min(left, key=lambda other: abs(other - root))
        assert abs(nearest - root) <= (tolerance if expected.count(root) > 1 else 1e-9 * max(abs(z) for z in expected)), (nearest, root)
        left.remove(nearest)


@pytest.mark.parametrize("name", shipped())
def test_poles_and_zeros_of_the_twin_are_those_of_the_linearised_fmu(name: str, worker: Worker) -> None:
    twin = read_twin(twin_text(name))
    output = next(iter(twin.outputs))
    plant: LinearPlant = linear_plant(twin, output)
    found = linearize(open_archive(build(name)), twin.input, output, worker=worker)
    assert found.method == "directional derivatives"
    kept = [found.states.index(x) for x in twin.states]
    A, B, C, n = found.A[np.ix_(kept, kept)], found.B[kept], found.C[kept], len(kept)
    size = max(map(abs, spread(plant.poles)))
    same_roots(np.linalg.eigvals(A), spread(plant.poles), 1e-6 * size)  # a double pole is found to the root of rounding, 1e-8, only
    pencil = np.block([[A, B[:, None]], [C[None, :], np.array([[found.D]])]]), np.diag([1.0] * n + [0.0])
    roots = np.asarray(eigvals(*pencil), dtype=complex)
    same_roots(roots[np.abs(roots) < 1e3 * size], spread(plant.zeros), 1e-8 * size)  # the others are those at infinity, rounded


def test_the_aircraft_is_the_papers() -> None:
    """Singh, J. Dynamic Systems, Measurement, and Control 134 (2012) 011015, (55) and (56)."""
    plant = linear_plant(read_twin(twin_text("aircraft_pitch")), "pitch")
    np.testing.assert_allclose([pole.value for pole in plant.poles], [-0.0881, -0.3255 + 1.3816j], rtol=0, atol=1e-4)  # four digits
    np.testing.assert_allclose([zero.value for zero in plant.zeros], [-0.15413], rtol=0, atol=5e-6)
    numerator = [float(c.p) / float(c.q) for c in plant.numerators["pitch"].coeffs()]
    denominator = [float(c.p) / float(c.q) for c in plant.denominator.coeffs()]
    assert (numerator, denominator) == ([0.1774, 1.151], [0.1774, 2.072, 0.739, 1.0])


def test_the_chains_modes_are_the_textbooks() -> None:
    for size in (2, 5, 12):
        text = twin_text("chain").replace("size = 3", f"size = {size}")
        found = [pole.natural_frequency for pole in linear_plant(read_twin(text), "last").flexible]
        np.testing.assert_allclose(found, 2 * np.sin(np.arange(1, size) * np.pi / (2 * size)), rtol=4e-16)


# Units


@pytest.mark.parametrize("name", shipped())
def test_a_derivative_has_its_states_unit_over_seconds(name: str) -> None:
    plant = read_plant_file(PLANTS / name / "plant.toml")
    units = {v.reference: dict(plant.units[v.unit] or {}) for v in plant.variables}
    for derivative in plant.of_kind("derivative"):
        assert derivative.state is not None
        state = units[derivative.state]
        expected = {**state, "s": state.get("s", 0) - 1}
        assert {k: x for k, x in units[derivative.reference].items() if x} == {k: x for k, x in expected.items() if x}, derivative.name
