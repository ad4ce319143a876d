"""Results as a verification writes them, one of each verdict: what page and JUnit tests render. Made up, but consistent."""

from __future__ import annotations

import copy
from typing import Any

MANEUVER_TIME = 9.14867432411053

COMMAND: dict[str, Any] = {
    "format": "slewcert-command/1",
    "maneuver_time": MANEUVER_TIME,
    "segments": [
        {"start": 0.0, "level": 1.0, "slope": 0.0},
        {"start": 2.47308124713921, "level": -1.0, "slope": 0.0},
        {"start": 3.31204461811044, "level": 1.0, "slope": 0.0},
        {"start": 4.57433716205526, "level": -1.0, "slope": 0.0},
        {"start": 5.83662970600009, "level": 1.0, "slope": 0.0},
        {"start": 6.67559307697132, "level": -1.0, "slope": 0.0},
    ],
    "tail": {"steady": 0.0, "terms": []},
}

STIFFNESSES = (0.7, 0.76, 0.82, 0.88, 0.94, 1.0, 1.06, 1.12, 1.18, 1.24, 1.3)
RESIDUALS = (0.04633, 0.02902, 0.01598, 0.00694, 0.00172, 3.1e-10, 0.00163, 0.00638, 0.01398, 0.02418, 0.03671)


def _run(number: int, stiffness: float, residual: float, nominal: bool = False) -> dict[str, Any]:
    name = f"{number:04d}-nominal" if nominal else f"{number:04d}-stiffness-{stiffness:g}"
    return {
        "run": name,
        "parameters": {"stiffness": stiffness},
        "nominal": nominal,
        "status": "finished",
        "detail": "",
        "verdict": "pass",
        "quantities": {
            "residual_vibration": {"value": residual, "error": 1e-9},
            "maneuver_time": {"value": MANEUVER_TIME, "error": 0.0},
            "peak_rate": {"value": None, "error": None},
        },
        "log": f"runs/{name}.mcap" if nominal or stiffness == 0.7 else None,
        "sha256": f"{number:02d}" * 32 if nominal or stiffness == 0.7 else None,
    }


def _requirement(name: str, text: str, quantity: str, limit: float, value: float, unit: str = "", **more: Any) -> dict[str, Any]:
    base = {
        "id": name,
        "text": text,
        "quantity": quantity,
        "scope": "nominal",
        "min": None,
        "max": limit,
        "unit": unit,
        "value": value,
        "error": 1e-9,
        "limit": limit,
        "margin": limit - value,
        "verdict": "pass",
        "worst_run": "0000-nominal",
        "reason": "",
    }
    return base | more


def _passing() -> dict[str, Any]:
    table = [_run(0, 1.0, 3.1e-10, nominal=True)]
    table += [_run(i, k, r) for i, (k, r) in enumerate(zip(STIFFNESSES, RESIDUALS, strict=True), start=1)]
    return {
        "format": "slewcert-results/1",
        "title": "Two-mass spring, 5 m slew",
        "version": "0.1.0",
        "verdict": "pass",
        "study": {"file": "two_mass.toml", "sha256": "7b85f56e9d78e48e" * 4},
        "plant": {
            "name": "two_mass",
            "fmu": "two_mass.fmi3.fmu",
            "sha256": "93f22931a81aab28" * 4,
            "fmi_version": "3.0",
            "tool": "slewcert 0.1.0",
            "input": {"name": "force", "unit": "N"},
            "output": {"name": "position_2", "unit": "m"},
            "parameters": {"mass_1": 1.0, "mass_2": 1.0, "stiffness": 1.0},
            "poles": [[0.0, 0.0, 2], [0.0, -1.4142135623730951, 1], [0.0, 1.4142135623730951, 1]],
            "modes": [{"frequency": 1.4142135623730951, "damping": 0.0}],
        },
        "task": {"displacement": 5.0, "input_limits": [-1.0, 1.0], "robustness": 1, "rest": "state"},
        "bound": {
            "status": "proved",
            "maneuver_time": {"lower": 9.14867432411051, "upper": MANEUVER_TIME},
            "command": COMMAND,
            "switches": 5,
            "fuel": MANEUVER_TIME,
            "certificate": "certificate.json",
            "seconds": 0.21,
            "reason": None,
        },
        "command": COMMAND,
        "simulation": {"step": 0.08, "stop": 98.0, "slowest_period": 4.442882938158366, "decayed": False, "interface": "co-simulation"},
        "requirements": [
            _requirement(
                "SLEW-001",
                "Residual vibration stays below 5 % of the move for stiffness within 30 %.",
                "residual_vibration",
                0.05,
                0.04633,
                scope="box",
                worst_run="0001-stiffness-0.7",
            ),
            _requirement("SLEW-002", "The move takes at most 9.2 s.", "maneuver_time", 9.2, MANEUVER_TIME, "s", error=0.0),
            _requirement("SLEW-003", "The FMU behaves as the linear plant the proof is about.", "model_mismatch", 1e-6, 2.43e-11),
            _requirement(
                "SLEW-004", "The end point is reached.", "final(position_2)", 5.01, 5.0000000003, "m", min=4.99, margin=0.0099999997
            ),
        ],
        "runs": {"total": 12, "passed": 12, "failed": 0, "errors": 0},
        "run_table": table,
        "uncertainty": [{"parameter": "stiffness", "unit": "N/m", "values": [0.7, 1.3], "samples": 11}],
        "unproven": [
            "The residual vibration between the sampled stiffnesses.",
            "That the machine behaves as its FMU does.",
        ],
        "trust_base": [
            "python-flint 0.9.0 (ball arithmetic), CPython 3.11.7 and the checker (412 lines) for the bracket of the minimum time.",
            "The FMU's own integrator for everything simulated.",
        ],
        "notes": ["The input cannot excite one rigid-body mode; it was dropped."],
        "environment": {"python": "3.11.7", "cvxpy": "1.9.3", "clarabel": "0.11.1", "fmpy": "0.3.32"},
    }


def _failing() -> dict[str, Any]:
    data: dict[str, Any] = _passing() | {"verdict": "fail", "title": "Two-mass spring, 5 m slew, nothing robust"}
    first = data["requirements"][0]
    first.update(value=0.18120000031, margin=-0.13120000031, verdict="fail", reason="0.1812 is above 0.05")
    data["bound"] = data["bound"] | {
        "status": "bracketed",
        "maneuver_time": {"lower": 9.1486, "upper": MANEUVER_TIME},
        "certificate": None,
        "reason": "the upper side is not proven: the command's switch times were repaired, not refined",
    }
    for row in data["run_table"]:
        if abs(row["parameters"]["stiffness"] - 1.0) > 0.15:
            row["quantities"]["residual_vibration"]["value"] *= 4
            if row["quantities"]["residual_vibration"]["value"] > 0.05:
                row["verdict"] = "fail"
    data["run_table"][1]["quantities"]["residual_vibration"]["value"] = 0.18120000031
    failed = sum(r["verdict"] == "fail" for r in data["run_table"])
    data["runs"] = {"total": 12, "passed": 12 - failed, "failed": failed, "errors": 0}
    return data


def _undecided() -> dict[str, Any]:
    data: dict[str, Any] = _passing() | {"verdict": "undecided", "title": "Two-mass spring, limit at the edge"}
    reason = "the limit 0.04633 lies within 0.04633 ± 1e-09"
    data["requirements"][0].update(max=0.04633, limit=0.04633, margin=0.0, verdict="undecided", reason=reason)
    data["run_table"][1]["verdict"] = "undecided"
    data["runs"] = {"total": 12, "passed": 11, "failed": 0, "errors": 0}
    return data


def _error() -> dict[str, Any]:
    data: dict[str, Any] = _passing() | {"verdict": "error", "title": "Two-mass spring, an FMU that crashes"}
    detail = "The FMU ended its process (SIGSEGV in fmi3DoStep at 3.28 s)."
    for requirement in data["requirements"][:1] + data["requirements"][2:]:
        requirement.update(value=None, error=None, margin=None, verdict="error", reason=detail)
    data["run_table"][3].update(status="crashed", detail=detail, verdict="error", quantities={})
    data["runs"] = {"total": 12, "passed": 11, "failed": 0, "errors": 1}
    return data


def _impossible() -> dict[str, Any]:
    """No command exists: a certificate of that, no runs, overall a failure."""
    data: dict[str, Any] = _passing() | {
        "verdict": "fail",
        "title": "Two-mass spring, limits too narrow",
        "command": None,
        "simulation": None,
    }
    data["bound"] = data["bound"] | {
        "status": "impossible",
        "maneuver_time": None,
        "command": None,
        "switches": None,
        "fuel": None,
        "reason": "no command within the limits brings the plant to rest there",
    }
    return data | {"requirements": [], "runs": {"total": 0, "passed": 0, "failed": 0, "errors": 0}, "run_table": [], "uncertainty": []}


_MAKERS = {"pass": _passing, "fail": _failing, "undecided": _undecided, "error": _error, "impossible": _impossible}
KINDS = tuple(_MAKERS)


def results(kind: str = "pass") -> dict[str, Any]:
    """Results of one of `KINDS`, fresh: tests may change them."""
    return copy.deepcopy(_MAKERS[kind]())
