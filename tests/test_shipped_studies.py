"""The shipped pairs of studies: one passes, its twin differs in one line and fails in one requirement, and why is proven or measured."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from small_studies import SHIPPED, results

from suite.loading import load_study
from suite.verification import verify

# The requirement that the failing twin misses, and by what it was meant to.
MISSED = {
    "aircraft_pitch": ("PITCH-001", "residual_vibration"),
    "aircraft_pitch_shaped": ("SHAPED-001", "residual_vibration"),
    "chain": ("CHAIN-001", "residual_vibration"),
    "disk_drive": ("SEEK-001", "residual_vibration"),
    "disk_drive_sampled": ("SAMPLED-003", "maneuver_time"),
    "gantry_crane": ("CRANE-001", "residual_vibration"),
    "gantry_crane_stop": ("STOP-003", "maneuver_time"),
    "gantry_crane_follow": ("FOLLOW-001", "residual_vibration"),
    "gantry_crane_varying": ("VARYING-001", "residual_vibration"),
    "gantry_crane_hoist": ("HOIST-001", "residual_vibration"),
    "gantry_crane_shaped": ("SHAPED-001", "residual_vibration"),
    "rlc_filter": ("FILTER-001", "residual_vibration"),
    "robot_arm": ("ARM-001", "residual_vibration"),
    "robot_arm_shaped": ("SHAPED-001", "residual_vibration"),
    "spacecraft": ("CRAFT-001", "residual_vibration"),
    "stirred_tanks": ("TANKS-001", "maneuver_time"),
    "thrusters": ("THRUST-003", "maneuver_time"),
    "two_mass": ("SLEW-001", "residual_vibration"),
    "two_mass_further_zero": ("ZERO-001", "residual_vibration"),
    "two_mass_fuel": ("FUEL-001", "fuel"),
    "two_mass_limits": ("LIMITS-001", "peak(velocity_2)"),
    "two_mass_rate": ("RATE-001", "peak_rate"),
    "two_mass_speed_limit": ("SPEED-001", "peak(velocity_2)"),
    "two_mass_spring_limit": ("SPRING-001", "peak(spring)"),
}
# A nonlinear plant whose mode varies, shapers, an FMU that refuses what no thruster can do; the others are for `make slow`.
QUICK = {"gantry_crane_shaped", "robot_arm_shaped", "spacecraft"}
PAIRS = [pytest.param(name, id=name, marks=[] if name in QUICK else [pytest.mark.slow]) for name in MISSED if name != "two_mass"]


def test_every_study_is_half_of_a_pair_that_differs_in_one_line() -> None:
    assert {path.stem for path in SHIPPED.glob("*.toml")} == {stem for name in MISSED for stem in (name, f"{name}_fail")}
    for name in MISSED:
        lines = [(SHIPPED / f"{name}{end}.toml").read_text(encoding="utf-8").splitlines() for end in ("", "_fail")]
        assert len([pair for pair in zip(*lines, strict=True) if pair[0] != pair[1]]) == 1, name
        assert any(f"{MISSED[name][0]} (and nothing else) fails" in " ".join(line.strip("# ") for line in half) for half in lines), name


def outcome(study: Path, folder: Path) -> dict[str, Any]:
    verify(load_study(study), folder, jobs=2)
    return results(folder)


@pytest.mark.parametrize("name", PAIRS)
def test_one_passes_and_its_twin_fails_as_designed(name: str, tmp_path: Path) -> None:
    passing, failing = (outcome(SHIPPED / f"{name}{end}.toml", tmp_path / f"out{end}") for end in ("", "_fail"))
    assert {entry["verdict"] for entry in passing["requirements"]} == {"pass"}
    assert passing["verdict"] == "pass"
    assert failing["verdict"] == "fail"
    assert failing["bound"]["status"] == passing["bound"]["status"] == "proved"
    assert [(e["id"], e["quantity"]) for e in failing["requirements"] if e["verdict"] != "pass"] == [MISSED[name]]


def test_no_command_at_all_could_pass_the_tanks_twin() -> None:
    """Its requirement on the time lies below the proven lower bound of a command without a tail."""
    from suite.design import design

    study = load_study(SHIPPED / "stirred_tanks_fail.toml")
    limit = next(requirement.maximum for requirement in study.requirements if requirement.id == "TANKS-001")
    lower = design(study).bound.lower
    assert limit is not None
    assert lower is not None
    assert lower > limit


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in MISSED if name != "two_mass"])
def test_fmi_2_gives_the_same_verdicts(name: str, tmp_path: Path) -> None:
    text = (SHIPPED / f"{name}.toml").read_text(encoding="utf-8")
    fmu = next(line for line in text.splitlines() if line.startswith("fmu = ")).split('"')[1]
    (tmp_path / "study.toml").write_text(text.replace(f'fmu = "{fmu}"', f'fmu = "{fmu}.fmi2"'), encoding="utf-8")
    assert outcome(tmp_path / "study.toml", tmp_path / "out")["verdict"] == "pass"
