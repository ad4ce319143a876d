"""Nothing leaks over 10,000 runs: folders, files, threads, processes, libraries, memory; not in the parent, not in the FMU's process.

Run with `-s` to see the counts.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import pytest
from fault_plants import build_fault
from test_workers import children, experiment, finished

from fmus import workers
from fmus.build import build
from fmus.confinement import MEBIBYTE, Confinement
from fmus.stepping import RunStatus
from fmus.workers import Worker

pytestmark = [pytest.mark.slow, pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")]

RUNS = 10_000
SETTLED = 1_000  # runs after which nothing may grow any more
GROWTH = 8.0  # MiB that 9,000 runs may add: fragments of the heap; a leak of 1 kB a run would add 9
FAULTS = ("segfault", "abort", "quit", "error", "fatal", "nan", "discard", "terminate", "warning", "leak", "hang")
EVERY = 25  # runs between two that fail
TIMEOUT = 60.0


@dataclass(frozen=True)
class Counts:
    """What one process holds."""

    folders: int
    files: int
    threads: int
    processes: int
    libraries: int
    memory: float

    def __str__(self) -> str:
        return (
            f"{self.folders:3} folders {self.files:4} open files {self.threads:3} threads {self.processes:2} processes "
            f"{self.libraries:3} FMU libraries {self.memory:8.1f} MiB"
        )


def memory(pid: int | str = "self") -> float:
    """Resident memory [MiB]."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / MEBIBYTE


def libraries(pid: int | str = "self") -> int:
    """Libraries of FMUs that are mapped."""
    lines = Path(f"/proc/{pid}/maps").read_text().splitlines()
    return len({line.split()[-1] for line in lines if "/binaries/" in line})


def own(folder: Path) -> Counts:
    mine = (len(list(folder.iterdir())), len(os.listdir("/proc/self/fd")), threading.active_count(), len(children(os.getpid())))
    return Counts(*mine, libraries(), memory())


def test_10000_runs_with_failures_mixed_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    healthy = (build("two_mass", "2.0"), build("two_mass", "3.0"))
    failing = {name: (build_fault(name, "2.0"), build_fault(name, "3.0")) for name in FAULTS}
    outcomes: Counter[RunStatus] = Counter()
    seen: dict[int, Counts] = {}
    with Worker(Confinement(memory=256 * MEBIBYTE)) as worker:
        for run in range(1, RUNS + 1):
            fails = run % EVERY == EVERY // 2
            name = FAULTS[run // EVERY % len(FAULTS)]
            fmu = (failing[name] if fails else healthy)[run % 2]
            outcome = worker.run(experiment(fmu, stop=2.0), 0.3 if fails and name == "hang" else TIMEOUT)
            outcomes[outcome.status] += 1
            assert fails != (outcome.status is RunStatus.FINISHED), f"run {run}: {outcome.detail}"
            if run % SETTLED == 0:
                seen[run] = own(tmp_path)
                print(f"\nparent after {run:6} runs: {seen[run]}", end="")
    end = own(tmp_path)
    print(f"\nparent at the end:         {end}")
    print("outcomes:", ", ".join(f"{count} {status.name.lower()}" for status, count in sorted(outcomes.items(), key=lambda x: -x[1])))
    assert sum(outcomes.values()) == RUNS
    assert len(outcomes) == 1 + len(FAULTS) - 1, "every way to fail; segfault and abort are both crashes"
    first, last = seen[SETTLED], seen[RUNS]
    assert (last.folders, last.processes) == (1, 1), "those of the present child"
    assert (end.folders, end.processes, end.libraries) == (0, 0, 0)
    assert last.files <= first.files
    assert last.threads <= first.threads + 1, "one may just be ending"
    assert last.memory - first.memory < GROWTH
    assert {c.libraries for c in seen.values()} == {0}, "no FMU is ever loaded here"


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_10000_new_instances_in_one_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, version: str) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(workers, "RECYCLE", RUNS + 1)
    fmu = build("two_mass", version)  # type: ignore[arg-type]
    sizes = {}
    with Worker() as worker:
        for run in range(1, RUNS + 1):
            finished(worker.run(experiment(fmu, stop=2.0), TIMEOUT))
            if run % SETTLED == 0:
                (watcher,) = children(os.getpid())
                (child,) = children(watcher)
                sizes[run] = memory(child)
                counts = f"{libraries(child)} FMU libraries, {len(os.listdir(f'/proc/{child}/fd'))} open files"
                print(f"\nchild after {run:6} new instances of FMI {version}: {sizes[run]:6.1f} MiB, {counts}", end="")
                assert libraries(child) == 1
    print()
    assert sizes[RUNS] - sizes[SETTLED] < GROWTH


RESET = """
import sys
from array import array
from pathlib import Path
sys.path.insert(0, sys.argv[4])
from fmus.interfaces import Instance2, Instance3
from test_leaks import memory, RUNS, SETTLED
library, token, resources, version = sys.argv[1], sys.argv[2], Path(sys.argv[3]), sys.argv[5]
kind = "Real" if version == "2.0" else "Float64"
instance = (Instance2 if version == "2.0" else Instance3)(Path(library), token, "two_mass", resources, lambda *_: None)
instance.instantiate("co_simulation")
first = None
for run in range(1, RUNS + 1):
    instance.set((kind, int(sys.argv[6])), 2.0)
    instance.enter_initialization(2.0, None)
    instance.exit_initialization()
    step = instance.stepper()
    for i in range(4):
        assert not step(0.5 * i, 0.5)
    position = instance.get([(kind, int(sys.argv[7]))])
    first = position if first is None else first
    assert position == first
    instance.terminate()
    instance.reset()
    if run % SETTLED == 0:
        print(run, memory())
"""


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_10000_resets_of_one_instance(tmp_path: Path, version: str) -> None:
    """What a reset leaves behind, in a process of its own without anything else."""
    with Worker() as worker:
        opened = worker._open(build("two_mass", version))  # type: ignore[arg-type]
    opened.extract(tmp_path)
    has = opened.description
    parts = [str(tmp_path / opened.require_platform()), has.guid, str(tmp_path / "resources"), str(Path(__file__).parent), version]
    references = [str(has.find(name).value_reference) for name in ("force", "position_2")]
    path = os.pathsep.join([str(Path(__file__).parent), str(Path(__file__).parents[1])])
    command = [sys.executable, "-c", RESET, *parts, *references]
    done = subprocess.run(command, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    sizes = {int(run): float(size) for run, size in map(str.split, done.stdout.splitlines())}
    print(f"\nafter {SETTLED} and {RUNS} resets of FMI {version}: {sizes[SETTLED]:.1f} and {sizes[RUNS]:.1f} MiB")
    assert sizes[RUNS] - sizes[SETTLED] < GROWTH
