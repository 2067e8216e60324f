"""`hil tower commission` with input that it refuses."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any

import pytest

from tests.hil.tower.made_plant import SHEET, files, refused, run, write_points
from tests.twin.tower.made_cell import M_W0, made_points


def commissioned(plant: Path, out: Path, points: Path, sheet: Path | None = None) -> Any:
    return run(
        *("commission", plant / "record", "--cell", 1, "--datasheet", sheet or plant / "datasheet.json"),
        *("--points", points, "--out", out),
    )


def changed_points(path: Path, change: Any) -> None:
    """Write the test points with `change` applied to each row."""
    write_points(path)
    with path.open(newline="") as handle:
        rows = list(csv.DictReader(handle))
    for k, row in enumerate(rows):
        change(k, row)
    with path.open("w", newline="") as handle:
        out = csv.DictWriter(handle, list(rows[0]))
        out.writeheader()
        out.writerows(rows)


def test_a_fan_in_hertz_an_empty_value_and_semicolons_are_named(plant: Path, tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    changed_points(path, lambda k, row: row.update(fan_speed_pct=str(0.5 * float(row["fan_speed_pct"]))))
    assert "the fan's highest speed is 50: is it in Hz?" in refused(commissioned(plant, tmp_path / "c.toml", path))
    changed_points(path, lambda k, row: row.update(water_outlet_C="" if k == 2 else row["water_outlet_C"]))
    assert ":4: water_outlet_C is empty; give the value" in refused(commissioned(plant, tmp_path / "c.toml", path))
    path.write_text(path.read_text().replace(",", ";"))
    assert "separated by semicolons; save it with commas" in refused(commissioned(plant, tmp_path / "c.toml", path))


@pytest.mark.parametrize(("factor", "unit"), [(1000.0, "W"), (1.341, "hp")])
def test_a_fan_s_power_far_above_its_rating_is_named_with_its_likely_unit(
    plant: Path, tmp_path: Path, factor: float, unit: str
) -> None:
    path, sheet = tmp_path / "points.csv", tmp_path / "sheet.json"
    sheet.write_text(json.dumps(SHEET | {"fan": {"rated_power_kW": 40}}))
    changed_points(path, lambda k, row: row.update(fan_power_kW=str(factor * float(row["fan_power_kW"]))))
    assert f"is fan_power_kW in {unit}?" in refused(commissioned(plant, tmp_path / "c.toml", path, sheet))


@pytest.mark.parametrize(
    ("key", "factor", "unit"),
    [
        ("power_at_design_kW", 1.341, "hp"),
        ("power_at_design_kW", 1e-3, "MW"),
        ("rated_power_kW", 1e-3, "MW"),
        ("rated_power_kW", 0.1, "another unit"),
    ],
)
def test_a_fan_s_power_off_the_datasheet_either_way_is_refused(
    plant: Path, tmp_path: Path, key: str, factor: float, unit: str
) -> None:
    path, sheet = tmp_path / "points.csv", tmp_path / "sheet.json"
    sheet.write_text(json.dumps(SHEET | {"fan": {key: 40}}))
    changed_points(path, lambda k, row: row.update(fan_power_kW=str(factor * float(row["fan_power_kW"]))))
    said = refused(commissioned(plant, tmp_path / "c.toml", path, sheet))
    assert f"fan.{key} of {sheet} is 40; is fan_power_kW in {unit}?" in said


def test_an_air_pressure_that_nobody_gives_or_that_differs_is_named(plant: Path, tmp_path: Path) -> None:
    path, sheet = tmp_path / "points.csv", tmp_path / "sheet.json"
    changed_points(path, lambda k, row: row.update(pressure_kPa=""))
    design = {name: value for name, value in SHEET["design"].items() if name != "pressure_kPa"}
    sheet.write_text(json.dumps(SHEET | {"design": design}))
    done = commissioned(plant, tmp_path / "a.toml", path, sheet)
    assert done.exit_code == 0 and "gives the air pressure; 101.325 kPa is taken" in " ".join(done.output.split())
    changed_points(path, lambda k, row: row.update(pressure_kPa="84.1"))
    done = commissioned(plant, tmp_path / "b.toml", path, sheet)
    assert "kPa" not in done.output.split("test points")[1] and "nominal = 84.1" in (tmp_path / "b.toml").read_text()
    done = commissioned(plant, tmp_path / "c.toml", path)
    assert "the test points have 84.1 kPa in the median" in " ".join(done.output.split())


def test_blanks_in_a_heading_are_free_and_decimal_commas_are_named(plant: Path, tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    write_points(path)
    path.write_text(path.read_text().replace(",water_inlet_C", ", water_inlet_C "))
    assert commissioned(plant, tmp_path / "c.toml", path).exit_code == 0
    changed_points(path, lambda k, row: row.update(water_flow_kg_s=row["water_flow_kg_s"].replace(".", ",")))
    assert "write decimals with a point" in refused(commissioned(plant, tmp_path / "d.toml", path))


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [("bypass", "share_when_open", 70.0), ("design", "water_inlet_C", 96.8), ("design", "range_K", 0.0)],
)
def test_a_datasheet_out_of_range_is_named_with_its_file(
    plant: Path, tmp_path: Path, section: str, key: str, value: float
) -> None:
    path, sheet = tmp_path / "points.csv", tmp_path / "sheet.json"
    write_points(path)
    sheet.write_text(json.dumps(SHEET | {section: {**SHEET.get(section, {}), key: value}}))
    said = refused(commissioned(plant, tmp_path / "c.toml", path, sheet))
    assert f"{sheet}: {section}.{key} is {value:g}, outside" in said and "correct the datasheet" in said


def test_a_test_point_off_the_others_is_named_and_none_of_good_ones(plant: Path, tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    write_points(path)
    assert "off the others" not in commissioned(plant, tmp_path / "good.toml", path).output
    changed_points(path, lambda k, row: row.update(water_outlet_C=str(float(row["water_outlet_C"]) + 1.5 * (k == 3))))
    done = commissioned(plant, tmp_path / "c.toml", path)
    assert done.exit_code == 0 and re.search(r"test point T03 is \+1\.[3-7]", done.output)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"water_inlet_C": 60.0}, "outside 0 to 70; it looks like degF"),
        ({"pressure_kPa": 900.0}, "is it in hPa, bar, psi or mmHg?"),
        ({"water_outlet_C": 15.0}, "is not below the inlet"),
        ({"entering_wet_bulb_C": 9.0}, "below the entering wet bulb"),
        ({"fan_speed_pct": -99.5}, "fan_speed_pct"),
        ({"air_flow_kg_s": -made_points()["air_flow_kg_s"][0]}, "air_flow_kg_s is 0, outside 0.01 to 100000"),
    ],
)
def test_bad_test_points_are_refused_with_their_line(
    plant: Path, tmp_path: Path, changed: dict[str, float], says: str
) -> None:
    write_points(tmp_path / "points.csv", **changed)
    done = commissioned(plant, tmp_path / "cell.toml", tmp_path / "points.csv")
    assert says in refused(done) and "points.csv:" in refused(done)
    assert not (tmp_path / "cell.toml").exists()


@pytest.mark.parametrize(
    ("scaled", "says"),
    [
        ({"air_flow_kg_s": 2.2046}, " times the air at this fan_speed_pct by design.water_to_air"),
        ({"fan_power_kW": 1.341}, "is fan_power_kW in hp?"),
        ({"water_flow_kg_s": 15.85}, "water_flow_kg_s of cell 1 is "),
    ],
)
def test_test_points_that_contradict_the_datasheet_are_refused(
    plant: Path, tmp_path: Path, scaled: dict[str, float], says: str
) -> None:
    with (plant / "points.csv").open(newline="") as handle:
        rows = list(csv.DictReader(handle))
    full = max(float(row["fan_power_kW"]) for row in rows)
    for row in rows:
        row.update({name: str(float(row[name]) * factor) for name, factor in scaled.items()})
    with (tmp_path / "points.csv").open("w", newline="") as handle:
        out = csv.DictWriter(handle, list(rows[0]))
        out.writeheader()
        out.writerows(rows)
    (tmp_path / "sheet.json").write_text(json.dumps({**SHEET, "fan": {"rated_power_kW": round(full)}}))
    common = ("commission", plant / "record", "--cell", 1, "--datasheet", tmp_path / "sheet.json")
    done = run(*common, "--points", tmp_path / "points.csv", "--out", tmp_path / "cell.toml")
    assert says in refused(done) and not (tmp_path / "cell.toml").exists()
    done = run(*common, "--points", plant / "points.csv", "--out", tmp_path / "cell.toml")
    assert done.exit_code == 0, done.output + repr(done.exception)


@pytest.mark.parametrize(
    ("design", "says"),
    [
        ({"water_flow_kg_s": M_W0, "pressure_kPa": "x"}, "design.pressure_kPa is 'x', which is not a number"),
        (
            {"water_flow_kg_s": 0},
            "design.water_flow_kg_s, the design water flow of a cell, is needed as a number above 0",
        ),
        ({}, "design.water_flow_kg_s, the design water flow of a cell, is needed as a number above 0"),
    ],
)
def test_a_datasheet_that_cannot_commission_is_refused_by_its_key(
    plant: Path, tmp_path: Path, design: dict[str, Any], says: str
) -> None:
    (tmp_path / "sheet.json").write_text(json.dumps({**SHEET, "design": design}))
    words = ("--datasheet", tmp_path / "sheet.json", "--points", plant / "points.csv", "--out", tmp_path / "cell.toml")
    assert f"sheet.json: {says}" in refused(run("commission", plant / "record", "--cell", 1, *words))


def test_points_whose_outlet_tells_nothing_are_refused(plant: Path, tmp_path: Path) -> None:
    write_points(tmp_path / "points.csv", water_flow_kg_s=15.0 * M_W0)
    words = ("--datasheet", plant / "datasheet.json", "--points", tmp_path / "points.csv", "--out", tmp_path / "c.toml")
    said = refused(run("commission", plant / "record", "--cell", 1, *words))
    assert "points.csv: water_flow_kg_s of cell 1 is" in said and "check the unit" in said


def test_commissioning_of_a_cell_that_is_not_there_is_refused(plant: Path, tmp_path: Path) -> None:
    done = run("commission", plant / "record", "--cell", 3, *files(plant), "--out", tmp_path / "cell.toml")
    assert "has no cell 3" in refused(done)
    write_points(tmp_path / "points.csv", cell=2)
    done = commissioned(plant, tmp_path / "cell.toml", tmp_path / "points.csv")
    assert "has no test point of cell 1" in refused(done)


def test_a_commissioned_twin_is_never_overwritten(plant: Path) -> None:
    done = run("commission", plant / "record", "--cell", 1, *files(plant), "--out", plant / "cell1.toml")
    assert "exists already" in refused(done)
