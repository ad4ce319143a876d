"""Arrays, structural parameters and values that are no real numbers, on an FMU that forgives nothing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from array_plant import build_chain, positions

from fmus.archives import open_archive
from fmus.descriptions import Description
from fmus.errors import DescriptionError, FmuError
from fmus.stepping import Experiment, RunStatus, Trajectory
from fmus.variables import element_indices
from fmus.workers import Worker
from relaxations.commands import Command, Segment, Tail

PUSH = Command(2.0, (Segment(0.0, 1.0),), Tail(1.0))
PATIENCE = 60.0
ROUNDING = 1e-11  # Runge-Kutta of 1 ms on frequencies up to 4 rad/s: (4e-3)^5/120 a step, 2000 steps, amplitudes below 3


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_chain(tmp_path_factory.mktemp("chain"))


@pytest.fixture(scope="module")
def description(chain: Path) -> Description:
    return open_archive(chain).description


@pytest.fixture(scope="module")
def worker() -> Iterator[Worker]:
    with Worker() as one:
        yield one


def experiment(chain: Path, **changes: object) -> Experiment:
    usual = Experiment(chain, "force[1]", ("x[1]", "x[2]", "x[3]"), {}, 0.0, {}, PUSH, stop=2.0, step=0.1)
    return replace(usual, **changes)


def finished(worker: Worker, asked: Experiment) -> Trajectory:
    outcome = worker.run(asked, PATIENCE)
    assert (outcome.status, outcome.detail) == (RunStatus.FINISHED, "")
    assert outcome.trajectory is not None
    return outcome.trajectory


def test_an_element_of_an_array_is_driven_and_read(chain: Path, worker: Worker) -> None:
    run = finished(worker, experiment(chain))
    np.testing.assert_allclose(run.values, positions(run.times, [1.0] * 3, [1.0, 0.0, 0.0]), rtol=0.0, atol=ROUNDING)
    assert np.abs(run.values[-1] - run.values[-1, 0]).min(initial=1.0, where=[False, True, True]) > 0.1, "the masses differ"


def test_a_structural_parameter_changes_the_size(chain: Path, worker: Worker) -> None:
    names = tuple(f"x[{i}]" for i in range(1, 6))
    parameters = {"n": 5.0, "stiffness[2]": 4.0, "anchored": 1.0}
    run = finished(worker, experiment(chain, outputs=names, input="force[4]", parameters=parameters))
    exact = positions(run.times, [1.0, 4.0, 1.0, 1.0, 1.0], [0.0, 0.0, 0.0, 1.0, 0.0], anchored=True)
    np.testing.assert_allclose(run.values, exact, rtol=0.0, atol=ROUNDING)
    again = finished(worker, experiment(chain))
    np.testing.assert_allclose(again.values, positions(again.times, [1.0] * 3, [1.0, 0.0, 0.0]), atol=ROUNDING, err_msg="as before")


def test_integers_enumerations_truth_values_and_other_inputs_are_set(chain: Path, worker: Worker) -> None:
    parameters = {"gain": -2.0, "material": 2.0, "force[3]": 0.5}
    run = finished(worker, experiment(chain, parameters=parameters))
    np.testing.assert_allclose(run.values, positions(run.times, [4.0] * 3, [-2.0, 0.0, -1.0]), rtol=0.0, atol=ROUNDING)
    still = finished(worker, experiment(chain, parameters={"enabled": 0.0}))
    assert np.abs(still.values).max() == 0.0


def test_start_values_of_single_states_are_set(chain: Path, worker: Worker) -> None:
    state = {"x[2]": 0.3, "v[3]": -1.0}
    run = finished(worker, experiment(chain, initial_state=state))
    start = np.array([0.0, 0.3, 0.0, 0.0, 0.0, -1.0])
    np.testing.assert_allclose(run.values, positions(run.times, [1.0] * 3, [1.0, 0.0, 0.0], start=start), rtol=0.0, atol=ROUNDING)


def test_elements_of_several_arrays_of_several_types_are_logged_in_the_order_asked(chain: Path, worker: Worker) -> None:
    run = finished(
        worker, experiment(chain, outputs=("state[3,1]", "count", "moved[1]", "state[1,2]", "x[1]", "moved[3]", "v[1]"), stop=0.5)
    )
    columns = dict(zip(("x3", "count", "moved1", "v1", "x1", "moved3", "v1 too"), run.values.T, strict=True))
    exact = positions(run.times, [1.0] * 3, [1.0, 0.0, 0.0])
    np.testing.assert_allclose(columns["x3"], exact[:, 2], atol=ROUNDING)
    np.testing.assert_array_equal(columns["moved1"], exact[:, 0] > 1e-3)
    np.testing.assert_array_equal(columns["moved3"], exact[:, 2] > 1e-3)
    assert columns["moved1"].any()
    np.testing.assert_array_equal(columns["v1"], columns["v1 too"])
    assert set(columns["count"]) == {3.0}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"input": "force"}, r"type Float64\[3\]; a command drives a single real input; name one element, such as force\[1\]"),
        ({"input": "enabled"}, "type Boolean; a command drives a single real input"),
        ({"input": "label"}, "type String; a command drives"),
        ({"input": "force[4]"}, r"'force' has no element \[4\]; its elements are force\[1\] … force\[3\]"),
        ({"input": "force[0]"}, r"no element \[0\]"),
        ({"outputs": ("x",)}, r"such as x\[1\]"),
        ({"outputs": ("state[2]",)}, r"no element \[2\]; its elements are state\[1,1\] … state\[3,2\]"),
        ({"outputs": ("count[1]",)}, "single value and has no elements"),
        ({"outputs": ("stat[1,1]",)}, "no variable 'stat"),
        ({"parameters": {"force[1]": 1.0}}, "driven by the command"),
        ({"parameters": {"n": 2.5}}, "whole numbers"),
        ({"parameters": {"n": 2e6}}, "at most 1000000"),
        ({"parameters": {"n": 2.0}, "outputs": ("x[3]",)}, r"no element \[3\]"),
        ({"parameters": {"gain": 2.0**31}}, "whole numbers -2147483648"),
        ({"parameters": {"material": 3.0}}, r'valid are "soft" \(1\), "hard" \(2\)'),
        ({"parameters": {"anchored": 0.5}}, "valid are true and false"),
        ({"parameters": {"label": 1.0}}, "String and keeps its start value"),
        ({"parameters": {"x[1]": 1.0}}, "not parameter"),
    ],
)
def test_what_cannot_be_is_refused_in_words(chain: Path, worker: Worker, changes: dict[str, object], words: str) -> None:
    with pytest.raises(FmuError, match=words):
        worker.run(experiment(chain, **changes), PATIENCE)


def test_an_array_that_is_given_in_parts_needs_start_values_for_the_rest(tmp_path: Path, worker: Worker) -> None:
    partly = build_chain(tmp_path, ('start="1" unit="N/m"', 'start="1 2 3" unit="N/m"'))
    run = finished(worker, experiment(partly, parameters={"stiffness[3]": 0.5}))
    np.testing.assert_allclose(run.values, positions(run.times, [1.0, 2.0, 0.5], [1.0, 0.0, 0.0]), rtol=0.0, atol=ROUNDING)
    with pytest.raises(
        DescriptionError, match=r"no start values for the 4 elements of 'stiffness'; set stiffness\[2\], stiffness\[3\] too"
    ):
        worker.run(experiment(partly, parameters={"n": 4.0, "stiffness[1]": 1.0, "stiffness[4]": 1.0}), PATIENCE)
    whole = {"n": 4.0, **{f"stiffness[{i}]": 1.0 + i for i in range(1, 5)}}
    run = finished(worker, experiment(partly, parameters=whole))
    np.testing.assert_allclose(run.values, positions(run.times, [2.0, 3.0, 4.0, 5.0], [1.0, 0.0, 0.0, 0.0])[:, :3], rtol=0.0, atol=ROUNDING)


def test_the_description_knows_sizes_states_and_items(description: Description) -> None:
    assert description.state_names == ("x[1]", "x[2]", "x[3]", "v[1]", "v[2]", "v[3]")
    larger = description.resized({"n": 4.0, "gain": 2.0})
    assert larger.state_names[-1] == "v[4]"
    assert (larger.find("state").shape, larger.find("n").start) == ((4, 2), 4.0)
    assert larger.find("stiffness").starts == (1.0,) * 4
    assert description.find("state[3,2]").element == replace(larger.find("state[3,2]").element, size=6)  # type: ignore[type-var]
    assert description.find("der(x)[2]").derivative_of == "x[2]"
    assert description.resized({"gain": 2.0}) is description
    assert description.find("material").items == (("soft", 1), ("hard", 2))
    assert (description.find("material").number("hard"), description.find("anchored").number(True)) == (2, 1)
    with pytest.raises(DescriptionError, match="at least -9 and at most 9"):
        description.find("gain").within(10)


def test_a_name_with_brackets_of_its_own_is_no_element(tmp_path: Path) -> None:
    flat = open_archive(build_chain(tmp_path, ('name="count"', 'name="x[1]"'))).description
    assert flat.find("x[1]").type == "UInt64", "tools flatten arrays: the variable of that very name comes first"
    assert flat.find("x[2]").element is not None


@pytest.mark.parametrize(
    ("name", "parts"),
    [("a[1]", ("a", (1,))), ("a.b[ 2, 3 ]", ("a.b", (2, 3))), ("a", None), ("[1]", None), ("a[1][2]", ("a[1]", (2,))), ("a[,]", None)],
)
def test_reads_indices(name: str, parts: object) -> None:
    assert element_indices(name) == parts
