"""`hil tower commission`, `calibrate`, `plan` and `report` on a made record: results, gates, revisions, and bad
input."""

from __future__ import annotations

import csv
import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from hil.cli.verbs import group
from hil.errors import exit_code
from tests.twin.tower.made_cell import M_A0, M_W0, made_cell, made_points

SHEET = {
    "station": "Z",
    "cells_in_station": 1,
    "cells_recorded": [1],
    "design": {
        "water_flow_kg_s": M_W0,
        "water_to_air": M_W0 / M_A0,
        "water_inlet_C": 34.0,
        "wet_bulb_C": 24.0,
        "range_K": 6.0,
        "pressure_kPa": 99.0,
    },
    "basin": {"volume_m3": 120, "compartments": 1},
}


def write_record(folder: Path, cell: int = 1, days: float = 6, **options: Any) -> None:
    """Write a record of a made cell as the alignment does."""
    made = made_cell(days, seed=21, **options)
    folder.mkdir(exist_ok=True)
    arrays = {"time": pa.array((made.time_s * 1e3).astype("datetime64[ms]"), pa.timestamp("ms", tz="UTC"))}
    for name, values in made.columns.items():
        whole = name in ("regime", "check")
        arrays[name] = pa.array(values.astype(np.uint8) if whole else values)
        if not whole:
            arrays[f"{name}_how"] = pa.array(made.origin[name])
    table = pa.table(arrays).replace_schema_metadata(
        {"hil.tower": json.dumps({"format": 1, "cell": cell, "station": "Z"})}
    )
    pq.write_table(table, folder / f"cell{cell}.parquet")
    events = [
        {
            "time": iso(made.time_s[1440]),
            "by_day": False,
            "cell": cell,
            "kind": "inspection",
            "source": "CMMS",
            "text": "",
            "from": iso(made.time_s[1440]),
            "to": iso(made.time_s[1500]),
            "parameters": [],
        }
    ]
    (folder / "station.json").write_text(json.dumps({"datasheet": SHEET, "events": events}))


def iso(seconds: float) -> str:
    return str(np.datetime64(int(seconds), "s")) + "Z"


def write_points(path: Path, cell: int = 1, **changed: float) -> None:
    points = made_points()
    with path.open("w", newline="") as handle:
        out = csv.writer(handle)
        out.writerow(["cell", "test", *points])
        for k in range(14):
            out.writerow([cell, f"T{k:02d}", *(f"{changed.get(n, 0.0) + v[k]:.4f}" for n, v in points.items())])


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with record, datasheet, test points, labels and the commissioned twin."""
    root = tmp_path_factory.mktemp("plant")
    write_record(root / "record")
    (root / "datasheet.json").write_text(json.dumps(SHEET))
    write_points(root / "points.csv")
    at = iso(made_cell(0.5).time_s[0] + 3 * 86400)
    (root / "labels.csv").write_text(
        "time,cell,parameter,kind,value,sd,lo,hi,source\n"
        f"{at},1,fill,interval,,,0.83,0.91,inspection\n{at},1,bias,point,0.3,0.05,,,certificate\n{at},1,air,point,0.93,0.02,,,traverse\n"
    )
    done = run("commission", root / "record", "--cell", 1, *files(root), "--out", root / "cell1.toml")
    assert done.exit_code == 0, done.output
    return root


def files(root: Path) -> tuple[Any, ...]:
    return "--datasheet", root / "datasheet.json", "--points", root / "points.csv"


def run(*words: Any) -> Any:
    return CliRunner().invoke(group, ["tower", *(str(word) for word in words)])


def refused(done: Any) -> str:
    """Return the sentence of a refusal that a user can mend."""
    assert done.exit_code != 0 and done.exception is not None
    if isinstance(done.exception, SystemExit):
        return str(done.output)
    assert exit_code(done.exception) == 2, repr(done.exception)
    return str(done.exception)


@pytest.fixture(scope="module")
def calibrated(plant: Path) -> Path:
    out = plant / "out"
    done = run(
        "calibrate",
        plant / "record",
        "--twin",
        plant / "cell1.toml",
        "--labels",
        plant / "labels.csv",
        "--out",
        out,
        "--mode",
        "controlled",
    )
    assert done.exit_code == 0, done.output + repr(done.exception)
    assert "written" in done.output
    return out


def test_calibrated_table_has_outlet_and_deviations_with_intervals(calibrated: Path) -> None:
    table = pq.read_table(calibrated / "calibrated.parquet")
    names = ["time", "cell", "t_out", "t_out_lo", "t_out_hi", "t_out_commissioned", "t_out_measured"]
    assert table.schema.names == names + [
        f"{n}{s}" for n in ("fill", "air", "uniformity", "bias") for s in ("", "_lo", "_hi")
    ]
    got = {n: table[n].to_numpy() for n in table.schema.names}
    truth = made_cell(6, seed=21).truth
    known = np.isfinite(got["t_out"])
    assert known.mean() > 0.95
    after, before = (np.abs(got[n] - truth["t_out"])[known].mean() for n in ("t_out", "t_out_commissioned"))
    assert after < 0.5 * before
    assert ((got["t_out_lo"] <= got["t_out"]) & (got["t_out"] <= got["t_out_hi"]))[known].all()
    assert np.nanmean(np.abs(got["fill"] - truth["fill"])) < 0.05


def test_records_form_a_chain_of_five_minutes_that_a_change_breaks(
    calibrated: Path, plant: Path, tmp_path: Path
) -> None:
    lines = (calibrated / "records.jsonl").read_text().splitlines()
    assert len(lines) == 6 * 288 and 200 < np.mean([len(line) for line in lines]) < 500
    first = json.loads(lines[0])
    assert set(first) == {"t", "c", "m", "d", "s", "y", "w", "r", "k", "h", "f", "src", "tw", "p"}
    assert run("report", calibrated).exit_code == 0
    copy = tmp_path / "out"
    shutil.copytree(calibrated, copy)
    lines[100] = lines[100].replace('"c":1', '"c":1 ')
    (copy / "records.jsonl").write_text("\n".join(lines) + "\n")
    assert "records.jsonl:102" in refused(run("report", copy)) and "changed or removed" in refused(run("report", copy))


def test_a_second_run_appends_nothing_that_is_there(calibrated: Path, plant: Path) -> None:
    before = (calibrated / "records.jsonl").read_text()
    assert run("calibrate", plant / "record", "--twin", plant / "cell1.toml", "--out", calibrated).exit_code == 0
    assert (calibrated / "records.jsonl").read_text() == before


def test_the_controlled_mode_saves_a_revision_that_can_be_reverted(calibrated: Path, plant: Path) -> None:
    revision = plant / "cell1.r1.toml"
    assert revision.is_file()
    log = CliRunner().invoke(group, ["twin", "log", str(revision)])
    assert log.exit_code == 0 and "hil tower calibrate" in log.output
    diff = CliRunner().invoke(group, ["twin", "diff", str(revision)])
    assert "bias_K" in diff.output
    assert CliRunner().invoke(group, ["twin", "revert", str(revision)]).exit_code == 0
    from twin.twinfile import load

    assert list(load(plant / "cell1.r2.toml").values) == list(load(plant / "cell1.toml").values)


def test_review_queue_states_each_proposal_with_its_codes(calibrated: Path) -> None:
    entries = json.loads((calibrated / "review_queue.json").read_text())["proposals"]
    proposals = {e["parameter"]: e for e in entries if "parameter" in e}
    assert set(proposals) == {"fill", "air", "uniformity", "bias"}
    assert proposals["bias"]["accepted"] and all(e["accepted"] == (not e["codes"]) for e in proposals.values())


def test_shadow_mode_changes_no_twin(plant: Path, tmp_path: Path) -> None:
    shutil.copy(plant / "cell1.toml", tmp_path / "cell1.toml")
    assert (
        run("calibrate", plant / "record", "--twin", tmp_path / "cell1.toml", "--out", tmp_path / "out").exit_code == 0
    )
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cell1.toml", "out"]
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["calibrated.parquet", "records.jsonl"]


def test_without_certificate_and_inspection_bias_and_fill_are_held_back(plant: Path, tmp_path: Path) -> None:
    record = tmp_path / "record"
    write_record(record)
    notes = json.loads((record / "station.json").read_text())
    (record / "station.json").write_text(
        json.dumps({"datasheet": {k: v for k, v in notes["datasheet"].items() if k != "basin"}, "events": []})
    )
    shutil.copy(plant / "cell1.toml", tmp_path / "cell1.toml")
    run("calibrate", record, "--twin", tmp_path / "cell1.toml", "--out", tmp_path / "out", "--mode", "advisory")
    entries = json.loads((tmp_path / "out" / "review_queue.json").read_text())["proposals"]
    codes = {e["parameter"]: e["codes"] for e in entries if "parameter" in e}
    assert "NO_SECOND_THERMOMETER" in codes["bias"] and "NO_INSPECTION" in codes["fill"]


def test_without_a_step_test_the_combined_direction_is_named_and_the_weaker_deviation_held_back(
    plant: Path, tmp_path: Path
) -> None:
    record = tmp_path / "record"
    write_record(record, test_days=())
    notes = json.loads((record / "station.json").read_text())
    (record / "station.json").write_text(json.dumps({**notes, "datasheet": {**SHEET, "basin": {}}}))
    table = pq.read_table(record / "cell1.parquet")
    lost = pa.array(np.full(table.num_rows, np.nan))
    pq.write_table(
        table.set_column(table.schema.get_field_index("fan_power_kW"), "fan_power_kW", lost), record / "cell1.parquet"
    )
    shutil.copy(plant / "cell1.toml", tmp_path / "cell1.toml")
    done = run("calibrate", record, "--twin", tmp_path / "cell1.toml", "--out", tmp_path / "out", "--mode", "advisory")
    shown = " ".join(done.output.split())
    assert "cell 1: the last day does not identify all deviations (condition " in shown and "limit 80)" in shown
    named = re.search(r"known least: (.*?); (\w+).*? is held back", shown)
    assert named and named[2] in named[1]
    entries = json.loads((tmp_path / "out" / "review_queue.json").read_text())["proposals"]
    held = next(e for e in entries if e.get("parameter") == named[2])
    assert f"LOW_SENSITIVITY:{named[2]}" in held["codes"] and held["condition"] > 80.0
    assert f"known least: {held['combined']}" in " ".join(run("report", tmp_path / "out").output.split())


def test_hidden_channels_refuse_the_window_and_a_makeup_of_zero_is_not_weighed(plant: Path, tmp_path: Path) -> None:
    record = tmp_path / "record"
    write_record(record)
    table = pq.read_table(record / "cell1.parquet")
    for name in ("fan_power_kW", "pressure_kPa"):
        lost = np.where(np.arange(table.num_rows) > table.num_rows - 1440, np.nan, table[name].to_numpy())
        table = table.set_column(table.schema.get_field_index(name), name, pa.array(lost))
    pq.write_table(table, record / "cell1.parquet")
    shutil.copy(plant / "cell1.toml", tmp_path / "cell1.toml")
    done = run("calibrate", record, "--twin", tmp_path / "cell1.toml", "--out", tmp_path / "out", "--mode", "advisory")
    assert "cell 1: the last window is refused: 29 % of its channels are hidden" in done.output.replace("\n", " ")
    assert "the water balance is not used: NOT_CLOSED" in done.output
    entries = json.loads((tmp_path / "out" / "review_queue.json").read_text())["proposals"]
    assert all("MISSING_REQUIRED" in e["codes"] for e in entries if "parameter" in e)


def test_a_step_of_the_thermometer_becomes_a_bias_and_no_fouling(plant: Path, tmp_path: Path) -> None:
    record = tmp_path / "record"
    write_record(record, step=(3.5, 0.6), fill=(0.88, 0.88))
    shutil.copy(plant / "cell1.toml", tmp_path / "cell1.toml")
    done = run("calibrate", record, "--twin", tmp_path / "cell1.toml", "--out", tmp_path / "out", "--mode", "advisory")
    assert "the outlet thermometer stepped by +0" in done.output
    table = pq.read_table(tmp_path / "out" / "calibrated.parquet")
    bias, fill = table["bias"].to_numpy(), table["fill"].to_numpy()
    assert np.nanmedian(bias[-1440:]) - np.nanmedian(bias[:1440]) == pytest.approx(0.6, abs=0.2)
    assert abs(np.nanmedian(fill[-1440:]) - np.nanmedian(fill[:1440])) < 0.03


def test_plan_proposes_a_step_test_with_its_steps(plant: Path) -> None:
    done = run("plan", plant / "record", "--twin", plant / "cell1.toml")
    assert done.exit_code == 0 and "condition number was" in done.output and "kg/s" in done.output


def test_a_twin_of_another_cell_is_refused_by_name(plant: Path, tmp_path: Path) -> None:
    write_record(tmp_path / "record", cell=2)
    says = refused(run("calibrate", tmp_path / "record", "--twin", plant / "cell1.toml", "--out", tmp_path / "out"))
    assert "is of cell 1" in says and "cell 2" in says
    assert not (tmp_path / "out").exists()


def test_a_twin_of_another_station_is_refused_unless_its_title_names_none(plant: Path, tmp_path: Path) -> None:
    text = (plant / "cell1.toml").read_text()
    (tmp_path / "other.toml").write_text(text.replace("of station Z", "of station Y"))
    done = run("calibrate", plant / "record", "--twin", tmp_path / "other.toml", "--out", tmp_path / "out")
    assert "is of station 'Y'" in refused(done) and "of station 'Z'" in refused(done)
    assert not (tmp_path / "out").exists()


def test_a_result_that_cannot_be_written_is_one_sentence(calibrated: Path, plant: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    done = run("calibrate", plant / "record", "--twin", plant / "cell1.toml", "--out", tmp_path / "file" / "out")
    assert exit_code(done.exception) == 1 and "cannot be written: Not a directory; make room" in str(done.exception)
    done = run("report", calibrated, "--picture", tmp_path / "file" / "cell1.png")
    assert exit_code(done.exception) == 2 and "is no folder that is there" in str(done.exception)


def test_a_twin_of_no_tower_is_refused(plant: Path, tmp_path: Path) -> None:
    loop = Path(__file__).resolve().parents[3] / "profiles" / "twins" / "loop.toml"
    says = refused(run("calibrate", plant / "record", "--twin", loop, "--out", tmp_path / "out"))
    assert "no twin of a tower cell" in says


@pytest.mark.parametrize(
    ("column", "value", "says"),
    [
        ("t_out_C", np.nan, "t_out_C is missing throughout"),
        ("m_w_kg_s", 0.0, "no minute has water"),
        ("m_w_kg_s", 3000.0, "design flow"),
    ],
)
def test_a_record_that_cannot_calibrate_is_refused(
    plant: Path, tmp_path: Path, column: str, value: float, says: str
) -> None:
    record = tmp_path / "record"
    write_record(record)
    table = pq.read_table(record / "cell1.parquet")
    at = table.schema.get_field_index(column)
    pq.write_table(table.set_column(at, column, pa.array(np.full(table.num_rows, value))), record / "cell1.parquet")
    assert says in refused(run("calibrate", record, "--twin", plant / "cell1.toml", "--out", tmp_path / "out"))


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("2022-09-10,1,fill,interval,,,0.9,0.8,", "labels.csv:2: lo 0.9 is not below hi 0.8"),
        ("2022-09-10,1,scale,point,0.9,0.1,,,", "labels.csv:2: parameter 'scale' is unknown"),
        ("someday,1,fill,point,0.9,0.1,,,", "labels.csv:2: time or cell cannot be read"),
        ("2022-09-10,1,air,point,0.9,0,,,", "labels.csv:2: sd 0 is not above 0"),
    ],
)
def test_bad_labels_are_refused_with_their_line(plant: Path, tmp_path: Path, line: str, says: str) -> None:
    labels = tmp_path / "labels.csv"
    labels.write_text(f"time,cell,parameter,kind,value,sd,lo,hi,source\n{line}\n")
    done = run(
        "calibrate", plant / "record", "--twin", plant / "cell1.toml", "--labels", labels, "--out", tmp_path / "out"
    )
    assert says in refused(done)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"water_inlet_C": 60.0}, "outside 0 to 70; it looks like degF"),
        ({"pressure_kPa": 900.0}, "it looks like hPa"),
        ({"water_outlet_C": 15.0}, "is not below the inlet"),
        ({"entering_wet_bulb_C": 9.0}, "below the entering wet bulb"),
        ({"fan_speed_pct": -99.5}, "fan_speed_pct"),
    ],
)
def test_bad_test_points_are_refused_with_their_line(
    plant: Path, tmp_path: Path, changed: dict[str, float], says: str
) -> None:
    write_points(tmp_path / "points.csv", **changed)
    done = run(
        "commission",
        plant / "record",
        "--cell",
        1,
        "--datasheet",
        plant / "datasheet.json",
        "--points",
        tmp_path / "points.csv",
        "--out",
        tmp_path / "cell.toml",
    )
    assert says in refused(done) and "points.csv:" in refused(done)
    assert not (tmp_path / "cell.toml").exists()


def test_commissioning_of_a_cell_that_is_not_there_is_refused(plant: Path, tmp_path: Path) -> None:
    done = run("commission", plant / "record", "--cell", 3, *files(plant), "--out", tmp_path / "cell.toml")
    assert "has no cell 3" in refused(done)
    write_points(tmp_path / "points.csv", cell=2)
    done = run(
        "commission",
        plant / "record",
        "--cell",
        1,
        "--datasheet",
        plant / "datasheet.json",
        "--points",
        tmp_path / "points.csv",
        "--out",
        tmp_path / "cell.toml",
    )
    assert "has no test point of cell 1" in refused(done)


def test_a_commissioned_twin_is_never_overwritten(plant: Path) -> None:
    done = run("commission", plant / "record", "--cell", 1, *files(plant), "--out", plant / "cell1.toml")
    assert "exists already" in refused(done)
