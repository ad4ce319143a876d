"""Exported commands and shapers coupled with a shipped plant by another engine, libcosim, against the closed-form response.

Its fixed-step algorithm steps all FMUs at once and hands outputs on afterwards. A command's output belongs to the point that was reached,
so it is not late; a shaper cannot know its input at that point, so what it hands on is late by one step h, all of it by the same. The
plant therefore moves as the shaped command does, h later, exactly; nothing is approximated as long as every switch falls on a step.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from exported import Reals, write_command, write_shaper
from independent import StateSpace
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave

from fmus.build import build
from relaxations.commands import Command, Segment, Tail
from relaxations.plants import LinearPlant
from relaxations.response import response
from relaxations.shaping.shapers import Shaper, ShaperTerm, shape
from suite.taking_away import Wanted, take_away

STEP = 0.1  # s
# half a period of the spring is 22 steps, so that a shaper's impulses fall on steps: ω = π/2.2, stiffness ω²/2 for two masses of 1 kg
HALF = 2.2
STIFFNESS = (math.pi / HALF) ** 2 / 2
PLANT = LinearPlant.from_transfer([repr(STIFFNESS)], ["1", "0", repr(2 * STIFFNESS), "0", "0"])
MOVE = Command(3.0, (Segment(0.0, 1.0), Segment(1.5, -1.0)), Tail(0.0))  # rest to rest for a rigid body, by 2.25 m / 2
ZV = Shaper((0.0, HALF), (0.5, 0.5))
# the plant keeps 1e-13 of a state a step, and rounding grows with the square of time; measured: 4e-15 m
INTEGRATION = 1e-13


class Engine:
    """An execution of libcosim with an observer; time in nanoseconds, which is all it knows."""

    def __init__(self, execution: CosimExecution) -> None:
        self.execution = execution
        self.observer = CosimObserver.create_last_value()
        execution.add_observer(self.observer)

    @staticmethod
    def of(paths: dict[str, Path]) -> Engine:
        execution = CosimExecution.from_step_size(step_size=round(STEP * 1e9))
        for name, path in paths.items():
            execution.add_local_slave(CosimLocalSlave(fmu_path=str(path), instance_name=name))
        return Engine(execution)

    def place(self, element: str, variable: str) -> tuple[int, int]:
        index = self.execution.slave_index_from_instance_name(element)
        assert index is not None
        return index, next(v.reference for v in self.execution.slave_variables(index) if v.name.decode() == variable)

    def connect(self, start: tuple[str, str], end: tuple[str, str]) -> None:
        assert self.execution.connect_real_variables(*self.place(*start), *self.place(*end)) == 0

    def start(self, element: str, variable: str, value: float) -> None:
        assert self.execution.real_initial_value(*self.place(element, variable), value)

    def run(self, steps: int, watched: tuple[str, str]) -> Reals:
        """The variable's values after each step."""
        index, reference = self.place(*watched)
        found = []
        for _ in range(steps):
            assert self.execution.step()
            found += self.observer.last_real_values(index, [reference])
        return np.array(found)


@pytest.fixture(autouse=True)
def quiet() -> None:
    log_output_level(CosimLogLevel.FATAL)


def coupled(folder: Path, command: Command, shaper: Shaper, steps: int) -> Reals:
    """position_2 of the shipped plant, after each step."""
    paths = {
        "command": write_command(folder, command, "2.0"),
        "shaper": write_shaper(folder, shaper, "2.0"),
        "plant": build("two_mass", "2.0"),
    }
    engine = Engine.of(paths)
    engine.connect(("command", "u"), ("shaper", "reference"))
    engine.connect(("shaper", "shaped"), ("plant", "force"))
    engine.start("plant", "stiffness", STIFFNESS)
    return engine.run(steps, ("plant", "position_2"))


def points(steps: int) -> Reals:
    return np.asarray(STEP * np.arange(1, steps + 1), dtype=np.float64)


def test_a_shaper_of_impulses_gives_our_trajectory(tmp_path: Path) -> None:
    found = coupled(tmp_path, MOVE, ZV, 120)
    ours = shape(MOVE, ZV).shifted(STEP)
    times = points(120)
    assert found == pytest.approx(response(PLANT, ours, times), abs=INTEGRATION)
    assert found == pytest.approx(StateSpace.of(PLANT).states(ours, times) @ StateSpace.of(PLANT).C, abs=INTEGRATION)
    still = found[times > ours.end + 1e-9]
    assert np.ptp(still) < INTEGRATION, "shaped, the plant rests after the move"
    assert np.ptp(response(PLANT, MOVE, times)[times > 5.0]) > 0.1, "not shaped, it swings"


def test_another_delay_is_told_apart(tmp_path: Path) -> None:
    """The tolerance is no cover: no delay, or two steps, miss by ten orders more."""
    found = coupled(tmp_path, MOVE, ZV, 60)
    for wrong in (0.0, 2 * STEP):
        difference = found - response(PLANT, shape(MOVE, ZV).shifted(wrong), points(60))
        assert np.abs(difference).max() > 1e10 * INTEGRATION


def test_a_shaper_with_a_decaying_term_gives_our_trajectory(tmp_path: Path) -> None:
    """The engine samples the decaying part and holds it: the same staircase, from the closed form, moves the plant likewise."""
    shaper = Shaper((0.0, 1.1), (0.5, 0.25), (ShaperTerm(1.1, -2 + 0j, 0, 0.5 + 0j),))
    found = coupled(tmp_path, Command(0.0, (), Tail(1.0)), shaper, 100)
    times = points(100)
    exact = shape(Command(0.0, (), Tail(1.0)), shaper)
    # what is read at a point is what was just before it: at the second impulse, its left side
    before = np.where(np.abs(times - 1.1) < 1e-9, 0.5, exact(times))
    segments = tuple(Segment(time, level) for time, level in zip(times.tolist(), before.tolist(), strict=True))
    staircase = Command(99 * STEP, segments[:-1], Tail(segments[-1].level))
    assert found == pytest.approx(response(PLANT, staircase, times), abs=40 * INTEGRATION)  # it runs 20 m away


def test_an_ssp_is_loaded_and_gives_our_trajectory(tmp_path: Path) -> None:
    """The engine reads the system from the archive; a command in it moves the plant without any delay."""
    (tmp_path / "move.json").write_text(json.dumps(MOVE.to_dict()))
    take_away(tmp_path / "move.json", Wanted(plant="two_mass.fmi2", out=tmp_path / "system.ssp"))
    engine = Engine(CosimExecution.from_ssp_file(str(tmp_path / "system.ssp"), step_size=round(STEP * 1e9)))
    assert engine.execution.num_slaves() == 2
    engine.start("plant", "stiffness", STIFFNESS)
    found = engine.run(100, ("plant", "position_2"))
    assert found == pytest.approx(response(PLANT, MOVE, points(100)), abs=INTEGRATION)
