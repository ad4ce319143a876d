"""What every test shares: how properties are searched, and the last lines of a run, which say what it left out."""

from __future__ import annotations

import hashlib
import os
import pickle
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does, before NumPy is loaded

# The machine's load must not decide a test, and neither may a coin: every run tries the same examples.
settings.register_profile("slewcert", deadline=None, derandomize=True, database=None)
settings.load_profile("slewcert")


@pytest.fixture(scope="session")
def verified(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The evidence folder of the shipped study that passes, made once; copy it before you change anything."""
    from small_studies import SHIPPED  # here, because not every test needs what this imports

    from suite.loading import load_study
    from suite.verification import verify

    base = tmp_path_factory.getbasetemp()
    place = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "verified"  # whichever process comes first makes it
    folder, done = place / "evidence", place / "done"
    try:
        place.mkdir()
    except FileExistsError:
        for _ in range(3000):
            if done.exists():
                break
            time.sleep(0.1)
        return folder
    try:
        verify(load_study(SHIPPED / "two_mass.toml"), folder, jobs=2)
    finally:
        done.touch()
    return folder


@pytest.fixture(scope="session", autouse=True)
def charts_drawn_once() -> Iterator[None]:
    """A chart of data that this process has drawn before comes from memory: drawing is half of the time that a small study takes.

    Equal data gives equal text (test_charts holds the functions themselves, which draw anew), so no other test can tell.
    """
    charts = sys.modules.get("reports.charts")  # where no test wants it, matplotlib is not imported for this
    with pytest.MonkeyPatch.context() as patch:
        for name in ("command_and_response", "sweep", "sensitivity") if charts else ():
            patch.setattr(charts, name, _remembered(getattr(charts, name)))
        yield


def _remembered(draw: Callable[..., str]) -> Callable[..., str]:
    drawn: dict[bytes, str] = {}

    def drawing(*arguments: Any, **options: Any) -> str:
        data = hashlib.sha256(pickle.dumps((arguments, options))).digest()
        if data not in drawn:
            drawn[data] = draw(*arguments, **options)
        return drawn[data]

    return drawing


@pytest.fixture
def enough_work() -> Iterator[None]:
    """The checker's precision and as much work as its parts want, when they are called by themselves."""
    import flint

    from relaxations.checking import balls

    with flint.ctx.workprec(128):
        balls.work["left"] = 1e9
        yield


GROUPS = ("slow", "foreign", "benchmark")
_left_out: Counter[str] = Counter()


LENGTHY = ("uncertain_roots", "varying", "varying_boxes", "verification", "verified_otherwise", "workers", "zero_sensitivity", "tradeoffs")
"""Files that take long and stand late in the alphabet: they go first, so that no worker is left with one at the end."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: item.path.stem.removeprefix("test_") not in LENGTHY)


def pytest_deselected(items: list[pytest.Item]) -> None:
    for item in items:
        _left_out.update(group for group in GROUPS if item.get_closest_marker(group))


def pytest_sessionfinish(session: pytest.Session) -> None:
    if (output := getattr(session.config, "workeroutput", None)) is not None:  # this is a worker of pytest-xdist
        output["left_out"] = dict(_left_out)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: object, error: object) -> None:
    """Every worker collects everything, so the last one's count stands for all."""
    _left_out.clear()
    _left_out.update(getattr(node, "workeroutput", {}).get("left_out", {}))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    if config.option.markexpr in GROUPS:  # one group was asked for: the others were not forgotten
        return
    for group in GROUPS:
        if count := _left_out[group]:
            terminalreporter.write_line(f"left out: {count} {group} test{'s' * (count > 1)} (`make {group}` runs them)")
