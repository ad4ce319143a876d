from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fault_plants import build_fault

from fmus.archives import Fmu, open_archive
from fmus.build import build
from fmus.errors import ArchiveError, DescriptionError, LinearizationError
from fmus.linearization import linearize
from fmus.workers import Worker

K, M1, M2, C = 3.0, 2.0, 0.5, 0.25
PARAMETERS = {"stiffness": K, "mass_1": M1, "mass_2": M2, "damping": C}
A = [[0, 1, 0, 0], [-K / M1, -C / M1, K / M1, C / M1], [0, 0, 0, 1], [K / M2, C / M2, -K / M2, -C / M2]]
B = [0, 1 / M1, 0, 0]


@pytest.fixture(scope="module", params=["2.0", "3.0"])
def fmu(request: pytest.FixtureRequest) -> Fmu:
    return open_archive(build("two_mass", request.param))


@pytest.fixture(scope="module")
def worker() -> Iterator[Worker]:
    with Worker() as one:
        yield one


def without_derivatives(fmu: Fmu) -> Fmu:
    capabilities = replace(fmu.description.capabilities, directional_derivatives=False)
    return replace(fmu, description=replace(fmu.description, capabilities=capabilities))


def test_directional_derivatives_are_the_equations(fmu: Fmu, worker: Worker) -> None:
    plant = linearize(fmu, "force", "position_2", PARAMETERS, worker=worker)
    assert plant.method == "directional derivatives"
    assert plant.states == ("position_1", "velocity_1", "position_2", "velocity_2")
    np.testing.assert_allclose(plant.A, A, rtol=1e-15, atol=0.0)  # one division each: the last place may differ
    np.testing.assert_allclose(plant.B, B, rtol=1e-15, atol=0.0)
    assert plant.C.tolist() == [0, 0, 1, 0]
    assert plant.D == 0.0
    assert not plant.rates.any()


def test_finite_differences_agree(fmu: Fmu, worker: Worker) -> None:
    plant = linearize(without_derivatives(fmu), "force", "spring", PARAMETERS, worker=worker)
    assert plant.method == "finite differences"
    # Rounding, ε·|f|/h with |f| ≤ 6·6e-6 (both points are h from the origin): a few ε; ten times that is allowed.
    np.testing.assert_allclose(plant.A, A, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(plant.B, B, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(plant.C, [-1, 0, 1, 0], rtol=0.0, atol=1e-13)
    assert plant.D == 0.0


def test_the_operating_point_is_where_it_was_put(fmu: Fmu, worker: Worker) -> None:
    state = {"position_2": 0.5, "velocity_1": -0.25}
    plant = linearize(fmu, "force", "spring", {"stiffness": 2.0}, initial_state=state, initial_input=1.5, worker=worker)
    assert plant.x.tolist() == [0.0, -0.25, 0.5, 0.0]
    assert (plant.u, plant.y) == (1.5, 0.5)
    assert plant.rates.tolist() == [-0.25, 1.5 + 2.0 * 0.5, 0.0, -2.0 * 0.5]


def test_works_without_a_worker_and_between_runs(fmu: Fmu, worker: Worker) -> None:
    alone = linearize(fmu, "force", "position_2", PARAMETERS)
    shared = linearize(fmu, "force", "position_2", PARAMETERS, worker=worker)
    np.testing.assert_array_equal(alone.A, shared.A)
    with pytest.raises(ValueError, match="read-only"):
        alone.A[0, 0] = 1.0


def test_a_refusal_is_an_error_with_the_fmus_words(fmu: Fmu, worker: Worker) -> None:
    with pytest.raises(LinearizationError, match="mass_1"):
        linearize(fmu, "force", "position_2", {"mass_1": -1.0}, worker=worker)
    linearize(fmu, "force", "position_2", worker=worker)


def test_entries_that_are_no_numbers_are_refused() -> None:
    faulty = open_archive(build_fault("nan"))
    with pytest.raises(LinearizationError, match="not finite"):
        linearize(without_derivatives(faulty), "force", "position_2", {"stiffness": 1e308, "mass_1": 1e-308})


def test_names_that_do_not_exist_are_corrected(fmu: Fmu, worker: Worker) -> None:
    with pytest.raises(DescriptionError, match="did you mean 'force'"):
        linearize(fmu, "forse", "position_2", worker=worker)
    with pytest.raises(DescriptionError, match="did you mean 'position_2'"):
        linearize(fmu, "force", "positon_2", worker=worker)
    with pytest.raises(DescriptionError, match="did you mean 'stiffness'"):
        linearize(fmu, "force", "position_2", {"stifness": 1.0}, worker=worker)


def test_a_missing_file_is_said(fmu: Fmu, tmp_path: Path) -> None:
    gone = replace(fmu, path=tmp_path / "gone.fmu")
    with pytest.raises(ArchiveError, match="cannot be unpacked"):
        linearize(gone, "force", "position_2")
