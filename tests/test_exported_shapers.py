"""The shaper as an FMU: any reference, any steps, both readings, against quadrature; its memory, its events, its state."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from exported import VERSIONS, drive, held, lines, set_boolean, write_shaper
from fmpy import simulate_fmu
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu
from independent_shaping import known_shapers, shaped
from marks import first, slow
from raw_fmus import RawFmu

from fmus.archives import open_archive
from fmus.compiling import FmiVersion
from relaxations.shaping.shapers import Pulse, Shaper

SHAPERS = {
    **known_shapers(),
    "pulses": Shaper((), (), (), (Pulse(0.0, 0.2, 2.5), Pulse(0.6, 0.25, 2.0))),
    "pulses of both signs": Shaper((), (), (), (Pulse(0.0, 0.7, 2.0), Pulse(0.3, 0.4, -1.5), Pulse(1.1, 0.1, 2.0))),
}
ZV = SHAPERS["zv"]  # 0.6 at 0 s, 0.4 at 0.5 s
Fmus = Mapping[str, Path]
# Of a shaped value of size 1: a few hundred sums, and exponentials of arguments up to 30, each with its rounding.
ROUNDING = 1e-13


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Fmus:
    """Every shaper once, the FMI versions in turn; ZV in both. Compiled when it is asked for first."""

    class Written(dict[str, Path]):
        def __missing__(self, name: str) -> Path:
            shapers = {**SHAPERS, "zv2.0": ZV, "zv3.0": ZV}
            third = name.endswith("3.0") or (list(shapers).index(name) % 2 and not name.endswith("2.0"))
            folder = tmp_path_factory.mktemp(re.sub(r"\W", "-", name))
            self[name] = write_shaper(folder, shapers[name], "3.0" if third else "2.0")
            return self[name]

    return Written()


def steps(seed: int, count: int = 60) -> tuple[list[float], list[float]]:
    """Communication points from 0 with steps between a microsecond and 0.6 s, and values with repetitions."""
    random = np.random.default_rng(seed)
    widths = 10.0 ** random.uniform(-6, -0.2, count)
    values = np.repeat(random.normal(size=count // 2), 2)
    return [0.0, *np.cumsum(widths).tolist()], values.tolist()


def independent(shaper: Shaper, reference: Callable, times: list[float], rest: float = 0.0) -> list[float]:
    return [shaped(shaper, reference, times, t, rest) for t in times[1:]]


@pytest.mark.parametrize("linear", [False, slow(True)])
@pytest.mark.parametrize("name", first(5, SHAPERS))
def test_shapes_any_reference_at_any_steps(fmus: Fmus, name: str, linear: bool, tmp_path: Path) -> None:
    times, values = steps(len(name))
    with RawFmu(fmus[name], tmp_path) as fmu:
        set_boolean(fmu, "linear", linear)
        fmu.initialize({"rest": 0.3, "reference": values[0]})
        outputs = drive(fmu, times, values)
    reference = (lines if linear else held)(times, values, 0.3)
    assert outputs == pytest.approx(independent(SHAPERS[name], reference, times, 0.3), abs=ROUNDING)


@pytest.mark.parametrize("version", VERSIONS)
def test_passes_validation_and_says_what_it_is(fmus: Fmus, version: FmiVersion) -> None:
    assert validate_fmu(str(fmus[f"zv{version}"])) == []
    description = open_archive(fmus[f"zv{version}"]).description
    assert {v.name: (v.causality, v.unit, v.start) for v in description.variables if v.name != "time"} == {
        "rest": ("parameter", "N", 0.0),
        "linear": ("parameter", "", 0.0),
        "reference": ("input", "N", 0.0),
        "shaped": ("output", "N", None),
    }
    assert description.capabilities.model_exchange is None, "a delay is no differential equation"


@pytest.mark.parametrize("name", ["zv", "pole-zero"])
def test_on_a_grid_all_jumps_are_late_by_the_same_step(fmus: Fmus, name: str, tmp_path: Path) -> None:
    """Steps of 0.1 s: the impulse at 0.5 s falls on a communication point, and rounding of sums like 0.7 + 0.5 must not move it.

    What is read after a step is what is shaped just before that point. So an importer that hands it on for the next step delays every
    jump by exactly one step, the first impulse of each like all others, and the shaped signal keeps its form.
    """
    times = [0.1 * n for n in range(60)]
    values = [float(n // 3 % 4) for n in range(60)]
    with RawFmu(fmus[name], tmp_path) as fmu:
        fmu.initialize()
        outputs = drive(fmu, times, values)
    expected = independent(SHAPERS[name], held(times, values), times)
    assert outputs == pytest.approx(expected, abs=ROUNDING)
    if name == "zv":
        early = np.array([*values, values[-1]])
        late = [0.6 * early[n] + (0.4 * early[n - 5] if n >= 5 else 0.0) for n in range(len(outputs))]
        assert outputs == pytest.approx(late, abs=1e-15)


@pytest.mark.parametrize("version", VERSIONS)
def test_before_the_input_of_a_point_is_known_and_after(fmus: Fmus, version: FmiVersion, tmp_path: Path) -> None:
    with RawFmu(fmus[f"zv{version}"], tmp_path) as fmu:
        fmu.initialize({"rest": 1.0, "reference": 2.0})
        assert fmu.get(["shaped"]) == [1.0], "just before the start"
        fmu.set({"reference": 2.0})
        assert fmu.get(["shaped"]) == [pytest.approx(1.6)], "just after it"
        fmu.step(0.0, 0.5)
        assert fmu.get(["shaped"]) == [pytest.approx(1.6)], "just before the second impulse"
        fmu.set({"reference": 2.0})
        assert fmu.get(["shaped"]) == [pytest.approx(2.0)], "just after it"


def test_derivatives_of_the_reference_are_honoured(fmus: Fmus, tmp_path: Path) -> None:
    """FMI 2.0: a ramp from -1 with slope 2, given by value and derivative, in uneven steps; then held without derivative."""
    times = [0.0, 0.3, 0.35, 1.2, 2.0]
    with RawFmu(fmus["zv2.0"], tmp_path) as fmu:
        fmu.initialize({"rest": -1.0})
        outputs = []
        for now, until in itertools.pairwise(times):
            fmu.set({"reference": -1.0 + 2.0 * now})
            fmu.set_input_derivatives("reference", [2.0])
            fmu.step(now, until - now)
            outputs += fmu.get(["shaped"])
        assert outputs == pytest.approx(independent(ZV, lambda t: -1.0 + 2.0 * np.maximum(t, 0.0), times, -1.0), abs=1e-14)
        assert fmu.get(["reference"]) == [pytest.approx(3.0)]
        fmu.step(2.0, 1.0)
        assert fmu.get(["shaped"]) == [pytest.approx(3.0)]
        with pytest.raises(FMICallException):
            fmu.set_input_derivatives("reference", [2.0, 1.0])


# -- memory ------------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("linear", [False, True])
def test_the_memory_is_a_ring(linear: bool, tmp_path: Path) -> None:
    """Seven pieces are just enough for 0.58 s in steps of 0.1 s, however long the run; six are not."""
    shaper = Shaper((0.0, 0.2, 0.58), (0.5, 0.3, 0.2))
    times = [0.1 * n for n in range(200)]
    values = np.random.default_rng(5).normal(size=199).tolist()
    with RawFmu(write_shaper(tmp_path, shaper, "2.0", history=7, linear=linear), tmp_path / "unpacked") as fmu:
        fmu.initialize()
        outputs = drive(fmu, times, values)
    # instants near 20 s are rounded to 4e-15 s, and the lines rise by up to 40 a second
    assert outputs == pytest.approx(independent(shaper, (lines if linear else held)(times, values), times), abs=2e-13)
    with RawFmu(write_shaper(tmp_path, shaper, "2.0", history=6, linear=linear), tmp_path / "less") as fmu:
        fmu.initialize()
        with pytest.raises(FMICallException):
            drive(fmu, times, values)


def test_too_many_changes_are_an_error_and_not_a_wrong_signal(tmp_path: Path) -> None:
    result = []
    path = write_shaper(tmp_path, ZV, "2.0", history=4)
    with RawFmu(path, tmp_path / "unpacked") as fmu:
        fmu.initialize()
        with pytest.raises(FMICallException):
            drive(fmu, [0.1 * n for n in range(20)], [float(n) for n in range(20)])
    with pytest.raises(FMICallException):
        simulate_fmu(
            str(path),
            stop_time=2.0,
            output_interval=0.1,
            input=np.array([(0.0, 0.0), (2.0, 2.0)], dtype=[("time", float), ("reference", float)]),
            logger=lambda *words: result.append(words[-1].decode()),
        )
    assert any("more than 4 times within the 0.5 s" in words and "--history" in words for words in result), result


@pytest.mark.slow
def test_a_reference_that_stays_takes_no_room(tmp_path: Path) -> None:
    with RawFmu(write_shaper(tmp_path, ZV, "3.0", history=2), tmp_path / "unpacked") as fmu:
        fmu.initialize()
        assert drive(fmu, [1e-4 * n for n in range(10_000)], [1.0] * 10_000)[-1] == 1.0


# -- state -------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["zv2.0", "zv3.0", "pole-zero", "repeated", "pulses"])
def test_state_is_saved_restored_serialised_and_reset(fmus: Fmus, name: str, tmp_path: Path) -> None:
    times, values = steps(3)
    with RawFmu(fmus[name], tmp_path / "one") as fmu, RawFmu(fmus[name], tmp_path / "two") as other:
        fmu.initialize()
        first = drive(fmu, times[:31], values[:30])
        state = fmu.save()
        rest = drive(fmu, times[30:], values[30:])
        fmu.restore(state)
        assert drive(fmu, times[30:], values[30:]) == rest, "the same bits again"
        other.initialize()
        other.restore(other.deserialize(fmu.serialize(state)))
        assert drive(other, times[30:], values[30:]) == rest, "in another instance"
        fmu.release(state)
        fmu.reset()
        fmu.initialize()
        assert drive(fmu, times, values) == first + rest


def test_instances_do_not_know_of_each_other(fmus: Fmus, tmp_path: Path) -> None:
    """Several of one library in one process, stepped in turn."""
    runs = [steps(seed) for seed in range(4)]
    alone = []
    for index, (times, values) in enumerate(runs):
        with RawFmu(fmus["pair"], tmp_path / f"alone{index}") as fmu:
            fmu.initialize()
            alone.append(drive(fmu, times, values))
    library = RawFmu(fmus["pair"], tmp_path / "together")
    together = [library, *(library.another() for _ in runs[1:])]
    outputs: list[list[float]] = [[] for _ in runs]
    for fmu in together:
        fmu.initialize()
    for n in range(60):
        for fmu, (times, values), found in zip(together, runs, outputs, strict=True):
            found += drive(fmu, times[n : n + 2], values[n : n + 1])
    for fmu in together[1:]:
        fmu.fmu.fmi2FreeInstance(fmu.fmu.component) if fmu.is_fmi2 else fmu.fmu.fmi3FreeInstance(fmu.fmu.component)
    library.fmu.freeInstance()
    assert outputs == alone


# -- events, and a foreign importer ------------------------------------------------------------------------------------------


def test_event_mode_brings_every_jump_to_the_importer(tmp_path: Path) -> None:
    """Steps of 1 s, and jumps of the reference at 0 s and 1 s: the delayed ones at 0.3, 0.7, 1.3 and 1.7 s end a step early."""
    shaper = Shaper((0.0, 0.3, 0.7), (0.5, 0.3, 0.2))
    with RawFmu(write_shaper(tmp_path, shaper, "3.0"), tmp_path / "unpacked", event_mode=True) as fmu:
        fmu.initialize()
        assert fmu.handle_event({"reference": 1.0}) == pytest.approx(0.3)
        seen = [(0.0, *fmu.get(["shaped"]))]
        now = 0.0
        while now < 2.0:
            end = float(np.floor(now + 1e-9)) + 1.0
            needed, _, _, now = fmu.step(now, end - now)
            assert needed == (abs(now - round(now)) > 1e-9), "at whole seconds only the importer knows of a jump"
            before = fmu.get(["shaped"])[0]
            fmu.handle_event({"reference": -1.0 if now > 1.0 - 1e-9 else 1.0})
            seen.append((now, before, fmu.get(["shaped"])[0]))
    times, *_ = zip(*seen, strict=False)
    assert times == pytest.approx([0.0, 0.3, 0.7, 1.0, 1.3, 1.7, 2.0], rel=1e-15)
    assert [s[-1] for s in seen] == pytest.approx([0.5, 0.8, 1.0, 0.0, -0.6, -1.0, -1.0])
    assert [s[1] for s in seen[1:]] == pytest.approx([0.5, 0.8, 1.0, 0.0, -0.6, -1.0])


@pytest.mark.parametrize("version", VERSIONS)
def test_a_foreign_importer_shapes_a_signal(fmus: Fmus, version: FmiVersion) -> None:
    """FMPy samples the signal at each communication point and reads the output before it gives the next input."""
    times = 0.1 * np.arange(81)
    signal = np.array(list(zip(times, np.sin(times), strict=True)), dtype=[("time", float), ("reference", float)])
    result = simulate_fmu(str(fmus[f"zv{version}"]), stop_time=8.0, output_interval=0.1, input=signal, output=["shaped"])
    points = np.array(result["time"])
    assert len(points) == 81
    expected = [0.0, *independent(ZV, held(points.tolist(), np.sin(points).tolist()), points.tolist())]
    # its interpolation of the signal rounds, and FMI 2.0 gets the derivative along with the value
    assert np.array(result["shaped"]) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("version", VERSIONS)
def test_a_run_may_start_at_any_time(fmus: Fmus, version: FmiVersion) -> None:
    result = simulate_fmu(
        str(fmus[f"zv{version}"]),
        start_time=100.0,
        stop_time=101.0,
        output_interval=0.125,
        start_values={"reference": 1.0},
        output=["shaped"],
    )
    assert np.array(result["shaped"]) == pytest.approx([0.0, 0.6, 0.6, 0.6, 0.6, 1.0, 1.0, 1.0, 1.0], abs=1e-15)
