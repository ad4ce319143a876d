"""A study whose values carry units is the same study as one in plain numbers; what has another dimension is told with what is valid."""

from __future__ import annotations

import json
from decimal import Decimal
from pathlib import Path

import pytest
from array_plant import build_chain
from click.testing import CliRunner
from small_studies import results
from study_texts import PLANT, mistakes, read

from reports import logs
from suite.cli import main
from suite.review import ReviewStatus, review
from suite.study import Study
from suite.study_units import PLACES

MIXED = """
[plant]
fmu = "two_mass"
input = "force"
output = "position_2"
parameters = { stiffness = "0.001 N/mm", mass_1 = "1000 g" }
initial = { input = "0 kN" }
[maneuver]
displacement = "5000 mm"
[limits]
input = ["-0.001 kN", 1]
[command]
start = "250 ms"
[simulation]
step = "50 ms"
observe = "0.2 min"
timeout = "20 s"
[[uncertainty]]
parameter = "stiffness"
range = ["0.8 N/m", "1.2e-3 kN/m"]
samples = 3
[[requirement]]
id = "RESIDUAL"
quantity = "residual_vibration"
max = "50 %"
[[requirement]]
id = "SPRING"
quantity = "peak(spring)"
min = 1
max = 5000
unit = "mm"
[[requirement]]
id = "TIME"
quantity = "maneuver_time"
max = "8000 ms"
[[requirement]]
id = "FUEL"
quantity = "fuel"
max = "0.1 kN.s"
[[requirement]]
id = "RATE"
quantity = "peak_rate"
max = "1 N/ms"
"""

SAME = """
[plant]
fmu = "two_mass"
input = "force"
output = "position_2"
parameters = { stiffness = 1, mass_1 = 1 }
initial = { input = 0 }
[maneuver]
displacement = 5
[limits]
input = [-1, 1]
[command]
start = 0.25
[simulation]
step = 0.05
observe = 12
timeout = 20
[[uncertainty]]
parameter = "stiffness"
range = [0.8, 1.2]
samples = 3
[[requirement]]
id = "RESIDUAL"
quantity = "residual_vibration"
max = 0.5
[[requirement]]
id = "SPRING"
quantity = "peak(spring)"
min = 0.001
max = 5
[[requirement]]
id = "TIME"
quantity = "maneuver_time"
max = 8
[[requirement]]
id = "FUEL"
quantity = "fuel"
max = 100
[[requirement]]
id = "RATE"
quantity = "peak_rate"
max = 1000
"""


def chain_study(fmu: Path, displacement: str, limits: str = "[-1, 1]", settings: str = "") -> str:
    return f"""[plant]
fmu = "{fmu}"
input = "force[1]"
output = "x[3]"
parameters = {{ {settings} }}
[maneuver]
displacement = {displacement}
[limits]
input = {limits}
"""


def essence(study: Study) -> tuple[object, ...]:
    assert study.plant.fmu is not None
    plant = (study.plant.fmu.parameters, study.plant.initial_input, study.plant.input_unit, study.plant.output_unit)
    return plant, study.maneuver, study.limits, study.command, study.simulation, study.uncertainties, study.requirements


def test_units_change_nothing_but_how_it_is_written(tmp_path: Path) -> None:
    mixed, same = read(tmp_path, MIXED), read(tmp_path, SAME)
    assert essence(mixed) == essence(same)
    assert same.conversions == ()
    written = {c.path: (c.written, c.value, c.unit) for c in mixed.conversions}
    assert written["maneuver.displacement"] == ("5000 mm", 5, "m")
    assert written["limits.input[1]"] == ("-0.001 kN", -1, "N")
    assert written["uncertainty[1].range[2]"] == ("1.2e-3 kN/m", Decimal("1.2"), "N/m")
    assert written["requirement[2].max"] == ("5000 mm", 5, "m")
    assert written["requirement[4].max"] == ("0.1 kN.s", 100, "N·s")
    assert written["requirement[5].max"] == ("1 N/ms", 1000, "N/s")
    assert len(written) == 17


@pytest.mark.parametrize(
    ("old", "new", "path", "words"),
    [
        ("5000 mm", "5 kg", "maneuver.displacement", '"kg" is no unit of the kind of "m"; valid are m, mm, um, in'),
        ("5000 mm", "5 meterz", "maneuver.displacement", '"meterz" is no unit that is known; valid are m, mm, um, in'),
        ("-0.001 kN", "-1 N.m", "limits.input[1]", "valid are N, kN, lbf"),
        ("0.001 N/mm", "1 N", "plant.parameters.stiffness", "valid are N/m, N/mm"),
        ("0.001 N/mm", "stiff", "plant.parameters.stiffness", "must be a number"),
        ("250 ms", "1 Hz", "command.start", "valid are s, ms, min"),
        ("50 %", "5 mm", "requirement[1].max", "no pure number"),
        ('unit = "mm"', 'unit = "kg"', "requirement[2].unit", 'measured in "m", to which this cannot be converted'),
        ("0.8 N/m", "0.8 m", "uncertainty[1].range[1]", "valid are N/m, N/mm"),
        ("0.1 kN.s", "1 N", "requirement[4].max", 'no unit of the kind of "N·s"'),
        ("5000 mm", "-0 mm", "maneuver.displacement", "must not be 0"),
        ("5000 mm", "1e200 mm", "maneuver.displacement", "must be 0 or of a magnitude"),
        ("5000 mm", "5", "maneuver.displacement", "must be a number"),
        ("5000 mm", "five mm", "maneuver.displacement", "must be a number"),
    ],
)
def test_what_cannot_be_converted_is_one_mistake_at_its_place(tmp_path: Path, old: str, new: str, path: str, words: str) -> None:
    assert old in MIXED
    found = mistakes(tmp_path, MIXED.replace(old, new))
    assert words in found[path]
    assert found[path].count("\n") == 1, "told once"


def test_all_mistakes_at_once(tmp_path: Path) -> None:
    text = MIXED.replace("5000 mm", "5 kg").replace("250 ms", "1 Hz").replace("0.8 N/m", "0.8 m")
    assert set(mistakes(tmp_path, text)) == {"maneuver.displacement", "command.start", "uncertainty[1].range[1]"}


def test_an_fmu_that_cannot_be_opened_is_the_only_mistake(tmp_path: Path) -> None:
    found = mistakes(tmp_path, MIXED.replace('"two_mass"', '"nowhere.fmu"'))
    assert list(found) == ["plant.fmu"]


def test_a_variable_without_a_unit_takes_plain_numbers(tmp_path: Path) -> None:
    chain = build_chain(tmp_path, (' start="0" unit="N"', ' start="0"'))
    text = chain_study(chain, '"1 mm"', '["-1 N", 1]')
    assert 'the FMU declares no unit for "force"; give a plain number' in mistakes(tmp_path, text)["limits.input[1]"]


def test_units_that_only_the_fmu_knows(tmp_path: Path) -> None:
    own = '<Unit name="tick"><BaseUnit m="1" factor="0.25"/></Unit><Unit name="m"><BaseUnit m="1"/><DisplayUnit name="pace" factor="2"/>'
    chain = build_chain(tmp_path, ('<Unit name="m"><BaseUnit m="1"/>', own))
    text = chain_study(chain, '"3 tick"')
    assert read(tmp_path, text).maneuver.displacement == Decimal("0.75")
    assert read(tmp_path, text.replace("3 tick", "3 pace")).maneuver.displacement == Decimal("1.5")


def test_a_plant_of_numbers_has_times_and_frequencies_with_units_and_no_others(tmp_path: Path) -> None:
    modal = '[plant]\nrigid = 1\nmodes = [{ frequency = "2 Hz", damping = "2 %", gain = -1 }]\n'
    task = "[maneuver]\ndisplacement = 1\n[limits]\ninput = [-1, 1]\n"
    study = read(tmp_path, modal + task)
    ((frequency, damping, _),) = study.plant.source.modes  # type: ignore[union-attr]
    assert str(frequency).startswith("12.5663706143591729538505735331180115367")
    assert damping == Decimal("0.02")
    assert study.conversions[0].unit == "rad/s"
    found = mistakes(tmp_path, PLANT + task.replace("= 1\n", '= "1 mm"\n'))
    assert "given as numbers, which have no unit" in found["maneuver.displacement"]


def test_an_unclear_frequency_is_refused(tmp_path: Path) -> None:
    modal = '[plant]\nmodes = [{ frequency = "2 1/s", gain = 1 }]\n[maneuver]\ndisplacement = 1\n[limits]\ninput = [-1, 1]\n'
    assert "must be greater" not in mistakes(tmp_path, modal)["plant.modes[1].frequency"]


def test_names_of_items_are_no_units(tmp_path: Path) -> None:
    chain = build_chain(tmp_path)
    text = chain_study(chain, "1", settings='material = "hard", stiffness = [1, "0.002 kN/m", "3 N/m"]')
    study = read(tmp_path, text)
    assert study.plant.fmu is not None
    assert study.plant.fmu.parameters == {"material": 2, "stiffness[1]": 1, "stiffness[2]": 2, "stiffness[3]": 3}


def test_every_place_is_a_key_of_the_schema() -> None:
    from suite.schema import KEYS, NESTED

    for place in PLACES:
        section, *rest = [part for part in place.split(".") if part != "[]"]
        assert rest[0] in KEYS[section], place
        if len(rest) > 1 and rest[1] != "*" and rest[0] in NESTED:
            assert rest[1] in NESTED[rest[0]].model_fields, place


@pytest.mark.slow
def test_the_report_tells_what_was_written(tmp_path: Path) -> None:
    file = tmp_path / "study.toml"
    file.write_text(MIXED, encoding="utf-8")
    done = CliRunner().invoke(main, ["verify", str(file), "--out", str(tmp_path / "out"), "--json"], catch_exceptions=False)
    assert json.loads(done.stdout)["runs"]["total"] == 3
    record = results(tmp_path / "out")
    assert record["units"][0] == {"path": "plant.parameters.stiffness", "written": "0.001 N/mm", "value": 1.0, "unit": "N/m"}
    assert [entry["si"] for entry in record["requirements"]] == [None] * 5, "this FMU speaks SI"
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "maneuver.displacement: 5000 mm = 5\u00a0m" in page


IN_MILLIMETRES = """
[simulation]
observe = 12
[[requirement]]
id = "PEAK"
quantity = "peak(x[3])"
max = "7 mm"
[[requirement]]
id = "FINAL"
quantity = "final(x[1])"
min = 1
max = 9
unit = "mm"
[[requirement]]
id = "TIME"
quantity = "maneuver_time"
max = 20
"""


def test_the_report_shows_both_where_the_fmu_does_not_speak_si(tmp_path: Path) -> None:
    """Elements of an array in millimetres, driven, judged and logged; every value in the FMU's unit and in SI."""
    change = ('causality="output" initial="exact" start="0" unit="m"', 'causality="output" initial="exact" start="0" unit="mm"')
    file = tmp_path / "study.toml"
    chain = build_chain(tmp_path, change, twin=True)
    file.write_text(chain_study(chain, '"0.005 m"') + IN_MILLIMETRES, encoding="utf-8")
    done = CliRunner().invoke(main, ["verify", str(file), "--out", str(tmp_path / "out")], catch_exceptions=False)
    record = results(tmp_path / "out")
    peak, final, time = record["requirements"]
    assert record["task"]["displacement"] == 5.0
    assert (peak["max"], peak["unit"], peak["verdict"]) == (7.0, "mm", "pass")
    assert peak["si"] == {"value": peak["value"] / 1000, "min": None, "max": 0.007, "unit": "m"}
    assert final["value"] == pytest.approx(5.0, abs=1e-6), "at rest every mass has moved as far"
    assert final["si"]["min"] == 0.001
    assert time["si"] is None
    assert f"in SI units: PEAK: {peak['si']['value']:.6g} m, ≤ 0.007" in done.stdout
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "≤ 0.007\u00a0m" in page
    log = logs.read_log(tmp_path / "out/runs/0000-nominal.mcap")
    assert [log.signal(f"/plant/{name}").variables[:3] for name in ("output", "state")] == [
        ("x[3]", "x[1]", "x[2]"),
        ("x[1]", "x[2]", "x[3]"),
    ]
    assert review(tmp_path / "out").status is ReviewStatus.CONFIRMED
