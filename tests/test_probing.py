"""FMUs that show nothing but their outputs: identified, compared with what they are, and refused where they are no linear plant."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from made_fmus import linear_fmu, made_fmu, steps_only
from marks import first, slow

from fmus import probing
from fmus.archives import Fmu, open_archive
from fmus.bench import AMPLITUDES
from fmus.blocks import Signal, shaper_block
from fmus.build import FmiVersion, build
from fmus.compiling import host
from fmus.errors import LinearizationError
from fmus.exporting import export
from fmus.linearization import Linearization, linearize
from fmus.stepping import Experiment, Outcome, Probe, RunStatus
from fmus.workers import Worker
from relaxations.shaping.shapers import Shaper

PENDULUM = """
void plant_derivatives(Plant *p) { p->der_angle = p->speed; p->der_speed = -p->gravity * sin(p->angle) - p->friction * p->speed + p->u; }
void plant_outputs(Plant *p) { p->y = sin(p->angle); }
"""
TWO_MODES = """
void plant_derivatives(Plant *p) {
    p->der_a = p->va; p->der_va = p->u - 4.0 * p->a - 0.2 * p->va;
    p->der_b = p->vb; p->der_vb = p->u - 49.0 * p->b - 0.14 * p->vb;
}
void plant_outputs(Plant *p) { p->y = OUTPUT; }
"""
HOOK = """
void plant_derivatives(Plant *p) { p->der_x = p->u - p->x; }
void plant_outputs(Plant *p) { p->y = p->x; }
PlantStatus plant_before_step(Plant *p, double step, const char **message) {
    (void)p, (void)step, (void)message;
    BODY
    return PLANT_OK;
}
"""
EULER = """
void plant_derivatives(Plant *p) { p->der_x = 0.0; p->der_v = 0.0; }
void plant_outputs(Plant *p) { p->y = p->x; }
PlantStatus plant_before_step(Plant *p, double step, const char **message) {
    (void)message;
    for (int i = 0; i < (int)floor(step / 0.001 + 0.5); i++) {
        const double a = p->u - 4.0 * p->x - 0.2 * p->v;
        p->x += 0.001 * p->v;
        p->v += 0.001 * a;
    }
    return PLANT_OK;
}
"""


@pytest.fixture(scope="module")
def worker() -> Iterator[Worker]:
    with Worker() as one:
        yield one


def pendulum(out: Path, **changes: object) -> Fmu:
    path = made_fmu("pendulum", PENDULUM, {"angle": 0.0, "speed": 0.0}, parameters={"gravity": 9.81, "friction": 0.4})
    return open_archive(steps_only(path, out / "pendulum.fmu", **changes))  # type: ignore[arg-type]


def distance(found: Linearization, exact: list[complex]) -> float:
    """Of the farthest pole from the nearest exact one, relative."""
    poles = [pole.value for pole in found.plant("y").plant.poles for _ in range(pole.multiplicity)]
    assert len(poles) == len(exact)
    return max((min(abs(p - e) / abs(e) if e else abs(p) for e in exact) for p in poles), default=0.0)


def transfer(found: Linearization, s: complex) -> complex:
    return complex(found.C @ np.linalg.solve(s * np.eye(len(found.B)) - found.A, found.B) + found.D)


LINEAR = {
    # A, B, C, D, and the poles with Im ≥ 0.
    "two_modes": (
        [[0, 1, 0, 0], [-9, -0.12, 0, 0], [0, 0, 0, 1], [0, 0, -100, -1]],
        *([0, 1, 0, 1], [1, 0, 4, 0], 0.0),
        [complex(-0.06, math.sqrt(9 - 0.06**2)), complex(-0.5, math.sqrt(100 - 0.25))],
    ),
    "floating": ([[0, 1, 0, 0], [-1, -0.01, 1, 0.01], [0, 0, 0, 1], [1, 0.01, -1, -0.01]], [0, 1, 0, 0], [0, 0, 1, 0], 0.0, None),
    "lag": ([[-3.0]], [2.0], [1.0], 0.0, [-3.0]),
    "through": ([[0, 1], [-4, -0.4]], [0, 1], [3, 0], 1.5, [complex(-0.2, math.sqrt(3.96))]),
    "slow_and_fast": (
        [[0, 1, 0, 0], [-1, -0.04, 0, 0], [0, 0, 0, 1], [0, 0, -9e4, -12]],
        *([0, 1, 0, 1], [1, 0, 9e4, 0], 0.0),
        [complex(-0.02, math.sqrt(1 - 0.02**2)), complex(-6, math.sqrt(9e4 - 36))],
    ),
    "direct": ([[-1.0]], [1.0], [0.0], 2.0, []),
}


@pytest.mark.parametrize("name", [slow(name) if name in ("slow_and_fast", "through") else name for name in LINEAR])
def test_linear_plants_are_found_to_ten_digits(name: str, tmp_path: Path, worker: Worker) -> None:
    A, B, C, D, poles = LINEAR[name]
    fmu = open_archive(steps_only(linear_fmu(name, A, B, C, D), tmp_path / "plant.fmu"))
    found = linearize(fmu, "u", "y", worker=worker)
    how = found.identification
    assert (found.method, how is not None) == ("identified", True)
    assert how is not None
    # The integrator solves to the limit of doubles; what is left is rounding, and some hundred of it.
    assert max(how.fit_error, how.check_error) < 1e-11
    if poles is None:  # a body that floats: two poles at the origin, exactly, and the mode
        plant = found.plant("y").plant
        assert plant.rigid_order == 2
        assert plant.numerators["y"].degree() == 1
        poles = [0.0, 0.0, complex(-0.01, math.sqrt(2 - 0.0001))]
    assert distance(found, [complex(p) for p in poles]) < 1e-10
    exact = open_archive(linear_fmu(name, A, B, C, D))
    by_equations = linearize(exact, "u", "y", worker=worker)
    assert by_equations.method == "finite differences"
    for s in (0.7j, 4.0 + 3.0j, 30.0j):
        assert transfer(found, s) == pytest.approx(transfer(by_equations, s), rel=1e-9)


@pytest.mark.parametrize("version", first(1, ["3.0", "2.0"]))
def test_the_shipped_plant_by_all_methods(version: str, tmp_path: Path, worker: Worker) -> None:
    path = build("two_mass", version)  # type: ignore[arg-type]
    changes = {"damping": 0.02, "stiffness": 1.7}
    answers = [
        linearize(open_archive(path), "force", "position_2", changes, method=m, worker=worker) for m in ("derivatives", "differences")
    ]
    stepping = open_archive(steps_only(path, tmp_path / "derivatives.fmu", derivatives=True))
    answers.append(linearize(stepping, "force", "position_2", changes, worker=worker))
    silent = open_archive(steps_only(path, tmp_path / "silent.fmu"))
    answers.append(linearize(silent, "force", "position_2", changes, worker=worker))
    methods = ["directional derivatives", "finite differences", "directional derivatives", "identified"]
    assert [found.method for found in answers] == methods
    for found in answers[1:]:
        for s in (0.3j, 2.0j, 1.0):
            assert transfer(found, s) == pytest.approx(transfer(answers[0], s), rel=1e-10)
        plant = found.plant("position_2").plant
        assert (plant.rigid_order, plant.is_unstable, plant.numerators["position_2"].degree()) == (2, False, 1)


@pytest.mark.slow
@pytest.mark.parametrize(("torque", "variable"), first(1, [(4.905, True), (4.905, False), (0.0, True), (0.0, False)]))
def test_a_pendulum_at_two_operating_points(torque: float, variable: bool, tmp_path: Path, worker: Worker) -> None:
    """s² + f s + g cos θ_0, and the output cos θ_0 θ; non-linear, so that responses are odd parts of small ones."""
    angle = math.asin(torque / 9.81)
    fmu = pendulum(tmp_path, variable=variable)
    found = linearize(fmu, "u", "y", initial_state={"angle": angle}, initial_input=torque, worker=worker)
    pole = complex(-0.2, math.sqrt(9.81 * math.cos(angle) - 0.04))
    # The amplitude balances the cube of the deflection against rounding: some 1e-10.
    assert distance(found, [pole]) < 1e-8
    assert found.D == 0.0
    assert transfer(found, 0.5j) == pytest.approx(math.cos(angle) / (-0.25 + 0.2j + 9.81 * math.cos(angle)), rel=1e-7)
    assert (found.u, found.y) == (torque, pytest.approx(math.sin(angle), abs=1e-12))


@pytest.mark.slow
def test_an_operating_point_that_is_reached_by_settling(tmp_path: Path, worker: Worker) -> None:
    fmu = pendulum(tmp_path)
    found = linearize(fmu, "u", "y", {"friction": 4.0}, initial_input=4.905, settle=math.inf, worker=worker)
    assert 5.0 < found.settled < 20.0  # 2/s: a billionth after 10.4 s
    assert found.y == pytest.approx(0.5, abs=1e-8)
    assert distance(found, [complex(-2.0, math.sqrt(9.81 * math.sqrt(0.75) - 4.0))]) < 1e-7


def test_a_plant_that_does_not_rest_is_refused(tmp_path: Path, worker: Worker) -> None:
    with pytest.raises(LinearizationError, match=r"not at rest where it starts, with input 4\.905: .* let it settle"):
        linearize(pendulum(tmp_path), "u", "y", initial_state={"angle": 0.3}, initial_input=4.905, worker=worker)
    with pytest.raises(LinearizationError, match="not at rest after settling"):
        linearize(pendulum(tmp_path), "u", "y", initial_input=4.905, settle=2.0, worker=worker)


@pytest.mark.slow
def test_an_unstable_operating_point_is_looked_at_shortly(tmp_path: Path, worker: Worker) -> None:
    found = linearize(pendulum(tmp_path), "u", "y", initial_state={"angle": math.pi}, worker=worker)
    assert distance(found, [complex(p) for p in np.roots([1.0, 0.4, -9.81])]) < 1e-5
    assert found.plant("y").plant.is_unstable


@pytest.mark.parametrize(("digits", "known"), first(1, [(6, 1e-6), (3, 2e-3)]))
def test_noise_of_the_output_costs_as_many_digits(digits: int, known: float, tmp_path: Path, worker: Worker) -> None:
    rounded = f"floor((p->a + p->b) * 1e{digits} + 0.5) / 1e{digits}"
    made = made_fmu(f"rounded{digits}", TWO_MODES.replace("OUTPUT", rounded), dict.fromkeys(("a", "va", "b", "vb"), 0.0))
    found = linearize(open_archive(steps_only(made, tmp_path / "rounded.fmu")), "u", "y", worker=worker)
    exact = [complex(-0.1, math.sqrt(4 - 0.01)), complex(-0.07, math.sqrt(49 - 0.07**2))]
    assert distance(found, exact) < known
    how = found.identification
    assert how is not None
    assert 0.01 * 10.0**-digits < how.check_error < 10.0 * 10.0**-digits


def test_an_fmu_is_what_its_own_steps_make_of_it(tmp_path: Path, worker: Worker) -> None:
    """Euler's method of 1 ms takes damping away: the plant of the FMU is log(1 + A δ)/δ, not A."""
    made = made_fmu("euler", EULER, {"x": 0.0, "v": 0.0}, extra="step_hook = true\nvariable_step = false")
    found = linearize(open_archive(steps_only(made, tmp_path / "euler.fmu", variable=False)), "u", "y", worker=worker)
    sampled = np.eye(2) + 0.001 * np.array([[0.0, 1.0], [-4.0, -0.2]])
    exact = np.log(np.linalg.eigvals(sampled).astype(complex)) / 0.001
    assert distance(found, [p for p in exact.tolist() if p.imag > 0.0]) < 1e-10
    assert abs(exact[0] - complex(-0.1, math.sqrt(3.99))) > 1e-3, "and that is another plant"


def test_what_is_laid_down_is_kept(tmp_path: Path, worker: Worker) -> None:
    fmu = pendulum(tmp_path)
    probe = Probe(step=0.05, samples=100, amplitude=0.02, order=2)
    how = linearize(fmu, "u", "y", probe=probe, worker=worker).identification
    assert how is not None
    assert (how.step, how.samples, how.amplitude, how.order) == (0.05, 100, 0.02, 2)
    forced = linearize(fmu, "u", "y", probe=Probe(step=0.05, order=1), worker=worker).identification
    assert forced is not None
    assert forced.order == 1
    assert forced.check_error > 0.1, "and what it is worth is told"


SHAPER = Shaper((0.0, 0.5), (0.54, 0.46))


@pytest.mark.parametrize("version", ["2.0", slow("3.0")])
def test_a_delay_is_refused_wherever_the_record_ends(version: FmiVersion, tmp_path: Path, worker: Worker) -> None:
    """A ZV shaper: half of the step at once, the other half a second later. It has no poles at all, and no order that would do."""
    path = tmp_path / "zv.fmu"
    path.write_bytes(export(shaper_block(SHAPER, "zv", Signal("shaped")), version, (host(),)).content)
    fmu = open_archive(path)
    with pytest.raises(LinearizationError, match=r"misses the response to moves within .* by 0\.\d+ of it .*a delay, which is no pole"):
        linearize(fmu, "reference", "shaped", worker=worker)
    for step in (0.0005, 0.0008):  # records of 0.2 and 0.32 s
        with pytest.raises(LinearizationError, match=r"again after 0\.5\d* s, by 0\.85 of its largest response .* looks longer"):
            linearize(fmu, "reference", "shaped", probe=Probe(step=step), worker=worker)
    forced = linearize(fmu, "reference", "shaped", probe=Probe(step=0.0005, order=0), worker=worker)
    assert any("again after 0.5" in note for note in forced.notes), "who lays down the order is told"
    assert pytest.approx(0.54) == forced.D


@pytest.mark.slow
def test_thrusters_that_are_on_or_off_are_identified_with_what_they_take(worker: Worker) -> None:
    """The spacecraft refuses any torque but ±10 N.m and 0."""
    fmu = open_archive(build("spacecraft"))
    found = linearize(fmu, "torque", "angle", method="identified", worker=worker)
    exact = linearize(fmu, "torque", "angle", method="derivatives", worker=worker)
    assert found.identification is not None
    assert found.identification.amplitude == pytest.approx(10.0)
    for s in (0.3j, 4.17j - 0.01, 2.0):
        assert transfer(found, s) == pytest.approx(transfer(exact, s), rel=1e-9)


def test_an_output_that_does_not_react_is_told(tmp_path: Path, worker: Worker) -> None:
    deaf = steps_only(linear_fmu("deaf", [[-1.0]], [0.0], [1.0]), tmp_path / "deaf.fmu")
    with pytest.raises(LinearizationError, match="'y' does not react to 'u' within 4 s"):
        linearize(open_archive(deaf), "u", "y", worker=worker)


def test_what_is_not_linear_at_any_size_is_refused(tmp_path: Path, worker: Worker) -> None:
    signs = (
        "void plant_derivatives(Plant *p) { p->der_x = (p->u > 0.0) - (p->u < 0.0) - p->x; }\nvoid plant_outputs(Plant *p) { p->y = p->x; }"
    )
    relay = steps_only(made_fmu("relay", signs, {"x": 0.0}), tmp_path / "relay.fmu")
    with pytest.raises(LinearizationError, match="not linear"):
        linearize(open_archive(relay), "u", "y", probe=Probe(step=0.05), worker=worker)


def test_of_a_slow_fmu_that_is_not_linear_no_more_is_tried_than_time_allows(
    tmp_path: Path, worker: Worker, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without time nothing but the first look and the sampling time it led to: every amplitude up and down, a pulse, a check."""
    body = "void plant_derivatives(Plant *p) { p->der_x = fabs(p->u) * p->u - p->x; }\nvoid plant_outputs(Plant *p) { p->y = p->x; }"
    fmu = open_archive(steps_only(made_fmu("square", body, {"x": 0.0}), tmp_path / "square.fmu"))
    runs: list[float] = []
    run = Worker.run

    def counted(self: Worker, experiment: Experiment, timeout: float) -> Outcome:
        runs.append(experiment.stop)
        return run(self, experiment, timeout)

    monkeypatch.setattr(Worker, "run", counted)
    monkeypatch.setattr(probing, "GIVE_UP", 0.0)
    with pytest.raises(LinearizationError, match=r"not linear there.* \(given up after \d+ s: its runs are slow\)"):
        linearize(fmu, "u", "y", worker=worker)
    assert len(runs) <= 1 + 2 * len(AMPLITUDES) + 4


@pytest.mark.slow
def test_an_fmu_that_fails_far_out_is_moved_less(tmp_path: Path, worker: Worker) -> None:
    """It returns Error, or ends its process, as soon as it is deflected by a hundredth: smaller pulses do."""
    for what in ("return PLANT_ERROR", "abort()"):
        hook = HOOK.replace("BODY", f"if (fabs(p->x) > 0.01) {what};")
        made = made_fmu("fragile", hook, {"x": 0.0}, extra="step_hook = true")
        found = linearize(open_archive(steps_only(made, tmp_path / "fragile.fmu")), "u", "y", worker=worker)
        assert distance(found, [-1.0 + 0.0j]) < 1e-8


def test_an_fmu_that_always_fails_is_survived(tmp_path: Path, worker: Worker) -> None:
    made = made_fmu("broken", HOOK.replace("BODY", "abort();"), {"x": 0.0}, extra="step_hook = true")
    with pytest.raises(LinearizationError, match="SIGABRT"):
        linearize(open_archive(steps_only(made, tmp_path / "broken.fmu")), "u", "y", worker=worker)
    made = made_fmu("hanging", HOOK.replace("BODY", "for (;;) {}"), {"x": 0.0}, extra="step_hook = true")
    with pytest.raises(LinearizationError, match="did not answer") as hung:
        linearize(open_archive(steps_only(made, tmp_path / "hanging.fmu")), "u", "y", timeout=0.5, worker=worker)
    assert hung.value.status is RunStatus.HUNG
