"""Hostile certificates, and what the checker needs: whatever a file holds, a check ends, by counted work."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from flint import acb, arb
from forgery import certificate, changed, command, costate, proven, proven_tail, task
from marks import slow

from relaxations.checking import balls, claims
from relaxations.checking.balls import Root
from relaxations.checking.claims import Outcome, check
from relaxations.checking.reading import Undecided

INTEGRATOR = task(["1"], ["1", "0"])
ONE = costate((("0", "0"), [("1", "0")]))


def mignotte(degree: int, digits: int) -> list[str]:
    """s^n - 2 (10^digits s - 1)²: two roots 10^(-digits (n+2)/2) apart, which isolation to the end would spend hours on."""
    a = 10**digits
    return ["1", *["0"] * (degree - 3), str(-2 * a * a), str(4 * a), "-2"]


LONG = "9" * 2000
HOSTILE: dict[str, Callable[[], bytes]] = {
    "close poles": lambda: certificate(task(["1"], mignotte(20, 100)), lower="1", witnesses=(ONE, None)),
    "many close poles": lambda: certificate(task(["1"], mignotte(200, 19)), lower="1", witnesses=(ONE, None)),
    "close zeros": lambda: certificate(
        task(mignotte(20, 100), ["1", *["0"] * 24, "1"], rest="output", limits=("-10", "10")), lower="1", witnesses=(ONE, None)
    ),
    "long numbers": lambda: certificate(
        task([LONG], ["1", *[f"1/{LONG[:-1]}{i}" for i in range(1, 10, 2)] * 20]), lower="1", witnesses=(ONE, None)
    ),
    "far horizon": lambda: certificate(task(["1"], ["1", "0", "1"], "0.5"), lower=LONG, witnesses=(SWING, None)),
    "fast and far": lambda: certificate(task(["1"], ["1", "0", "1" + "0" * 1000], "0.5"), lower="1000000", witnesses=(SWING, None)),
    "no costate": lambda: certificate(task(["1"], ["1", "0", "1"], "0.5"), lower="1", witnesses=(costate(), None)),
    "many oscillations": lambda: certificate(task(["1"], ["1", "0", "1"], "0.5"), lower="10000000", witnesses=(SWING, None)),
    "many segments": lambda: certificate(
        task(["1"], ["1", "0"]),
        upper="100000",
        witnesses=(None, command("100000", [(str(i), ("1", "-1")[i % 2]) for i in range(100_000)], [["time", 0, 0]])),
    ),
    "too many segments": lambda: certificate(
        task(["1"], ["1", "0"]), upper="1", witnesses=(None, command("1", [("0", "1")] * 100_001, [["time", 0, 0]]))
    ),
    "many segments and poles": lambda: certificate(
        task(["1"], ["1", *["0"] * 198, "1", "0"], zeros={}),
        upper="100000",
        witnesses=(None, command("100000", [(str(i), "0.1") for i in range(20_000)], [["level", i, 0] for i in range(200)])),
    ),
    "many names": lambda: certificate(
        task(["1"], ["1", "0"], zeros={f"mode[{i}]": 1 for i in range(100_000)}), lower="1", witnesses=(ONE, None)
    ),
    "tiny radius": lambda: certificate(
        INTEGRATOR, upper="2", witnesses=(None, command("1.5", [("0", "1")], [["time", 0, 0]], "1/" + LONG))
    ),
    "huge radius": lambda: certificate(INTEGRATOR, upper="2", witnesses=(None, command("1.5", [("0", "1")], [["time", 0, 0]], LONG))),
    "many further zeros": lambda: certificate(
        task(["1"], ["1", *["0"] * 29, "1"], "0.5", zeros={f"mode[{i}]": 20 for i in range(1, 16)}), lower="1", witnesses=(ONE, None)
    ),
    "slow zero": lambda: changed(
        proven_tail("real_zero"),
        lambda data: (
            data["task"]["plants"][0].update(numerator=["1", "1/" + LONG]),
            data["upper"]["tail"][0].update(near=["0", "0"]),
        ),
    ),
    "ringing zeros": lambda: changed(
        proven_tail("complex_zeros"), lambda data: data["task"]["plants"][0].update(numerator=["1", "0.000000000000001", "3"])
    ),
    "many contacts": lambda: changed(
        proven_tail("real_zero"),
        lambda data: data["lower"].update(tail=[{"time": str(i), "upper": "0", "lower": "0"} for i in range(10_000)]),
    ),
}
TRUE = ("huge radius", "many contacts")  # these two claim what is
SWING = costate((("0", "1"), [("1", "-1")]))


@pytest.mark.parametrize("name", [slow(name) if name.endswith((" segments", " names")) else name for name in HOSTILE])
def test_a_hostile_certificate_is_given_up(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a tenth of the work, which changes nothing but the time that it takes."""
    monkeypatch.setattr(claims, "WORK", claims.WORK / 10)
    monkeypatch.setattr(claims, "MOST_WORK", claims.MOST_WORK / 100)
    found = check(HOSTILE[name]())
    assert found.outcome is not Outcome.PROVED or name in TRUE
    assert found.bits <= 1024


def test_work_is_counted_not_timed() -> None:
    balls.work["left"] = 10.0
    Root(acb(-1), 1).impulse(arb(1))
    with pytest.raises(Undecided, match="more work"):
        Root(acb(-1), 1).impulse(arb(1))


def test_every_check_has_its_own_budget() -> None:
    balls.work["left"] = 0.0
    assert check(proven("two_mass_1")).outcome is Outcome.PROVED


@pytest.mark.slow
@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_certificate_costs_half_a_minute_at_most(name: str) -> None:
    balls.work["left"] = float("inf")  # whoever was here before
    found = check(HOSTILE[name]())
    assert found.outcome is not Outcome.PROVED or name in TRUE
    assert found.seconds < 100.0  # a hang would take hours; the machine may be busy


def test_the_checker_stands_alone(tmp_path: Path) -> None:
    """python-flint and the standard library, and nothing of the solver."""
    script = """
import sys
from pathlib import Path
from relaxations.checking.claims import check, claim
found = check(Path(sys.argv[1]).read_bytes())
print(found.outcome.value, claim(found) != "")
loaded = {name.split(".")[0] for name in sys.modules}
print(sorted(loaded & {"numpy", "scipy", "cvxpy", "clarabel", "rfc8785", "pydantic", "matplotlib", "fmpy"}))
print(sorted(name for name in sys.modules if name.startswith(("relaxations", "suite", "reports", "fmus"))))
"""
    path = tmp_path / "certificate.json"
    path.write_bytes(proven("two_mass_1"))
    done = subprocess.run([sys.executable, "-c", script, path], capture_output=True, text=True, check=True)
    outcome, foreign, own = done.stdout.splitlines()
    assert (outcome, foreign) == ("proved True", "[]")
    assert all(name == "relaxations" or name.startswith("relaxations.checking") for name in json.loads(own.replace("'", '"')))
