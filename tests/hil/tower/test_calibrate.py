"""`hil tower calibrate`, `plan` and `report` on a made record: results, gates, revisions, and bad input."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from hil.cli.verbs import group
from hil.errors import exit_code
from hil.tower.calibration import priors_of
from hil.tower.calibration.remarks import gap_sentences
from hil.tower.station import read_notes
from tests.hil.tower.made_plant import SHEET, refused, run, write_record
from tests.twin.tower.made_cell import made_cell
from twin.tower import ANY_DRAUGHT, FAN_DENSITY, FORCED, INDUCED, NAMES
from twin.twinfile import load


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


@pytest.mark.parametrize(
    ("kind", "prior"),
    [("Induced-draft counterflow", INDUCED), ("forced draught, crossflow", FORCED), ("cooling tower", ANY_DRAUGHT)],
)
def test_the_kind_of_tower_in_a_datasheet_names_where_the_fan_stands(
    plant: Path, kind: str, prior: tuple[float, float]
) -> None:
    notes = replace(read_notes(plant / "record"), datasheet={"kind": kind})
    means, sds = priors_of(load(plant / "cell1.toml"), notes).constant()
    at = NAMES.index(FAN_DENSITY)
    assert (means[at], sds[at]) == prior


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


def controlled(plant: Path, folder: Path, out: str, *words: str) -> str:
    """Calibrate the plant's twin in `folder` again and return the sentences without the table."""
    twin = folder / "cell1.toml"
    if not twin.exists():
        shutil.copy(plant / "cell1.toml", twin)
        for healthy in plant.glob("*.healthy.json"):
            shutil.copy(healthy, folder)
    labels = folder / "labels.csv"
    if not labels.exists():
        shutil.copy(plant / "labels.csv", labels)
    done = run(
        *("calibrate", plant / "record", "--twin", twin, "--labels", labels),
        *("--out", folder / out, "--mode", "controlled", *words),
    )
    assert done.exit_code == 0, done.output + repr(done.exception)
    return str(done.output)


def test_a_reverted_value_waits_for_new_evidence_or_the_option(plant: Path, tmp_path: Path) -> None:
    assert "written: " + str(tmp_path / "cell1.r1.toml") in controlled(plant, tmp_path, "o1")
    assert "cell1.r1.toml holds the accepted values already" in controlled(plant, tmp_path, "o2")
    assert CliRunner().invoke(group, ["twin", "revert", str(tmp_path / "cell1.r1.toml")]).exit_code == 0
    says = controlled(plant, tmp_path, "o3")
    assert "cell1.r2.toml undid" in says and "REVERTED:bias" in says and ".r3.toml" not in says
    entries = json.loads((tmp_path / "o3" / "review_queue.json").read_text())["proposals"]
    assert all(f"REVERTED:{e['parameter']}" in e["codes"] for e in entries if "parameter" in e)
    assert str(tmp_path / "cell1.r3.toml") in controlled(plant, tmp_path, "o4", "--propose-reverted")


def test_a_label_that_a_reverted_revision_did_not_know_is_new_evidence_of_its_deviation_alone(
    plant: Path, tmp_path: Path
) -> None:
    controlled(plant, tmp_path, "o1")
    assert CliRunner().invoke(group, ["twin", "revert", str(tmp_path / "cell1.r1.toml")]).exit_code == 0
    labels = tmp_path / "labels.csv"
    last = labels.read_text().strip().splitlines()[-1]
    labels.write_text(labels.read_text() + last + "\n")
    says = controlled(plant, tmp_path, "o2")
    assert "REVERTED:fill" in says and "REVERTED:air" not in says
    from twin.twinfile import load

    clean, new = (load(tmp_path / name) for name in ("cell1.toml", "cell1.r3.toml"))
    moved = {n for n, p in new.parameters.items() if p.value != clean.parameters[n].value}
    assert moved == {"cell.air"}


def test_the_log_of_a_cell_s_revision_has_dates(plant: Path, tmp_path: Path) -> None:
    controlled(plant, tmp_path, "o1")
    log = CliRunner().invoke(group, ["twin", "log", str(tmp_path / "cell1.r1.toml")])
    assert re.search(r"fitted over \d{4}-\d\d-\d\d \d\d:\d\d to \d{4}-.* UTC", log.output)
    assert "± " in log.output and "(90 %)" in log.output


def test_an_inlet_in_another_unit_for_a_day_is_named_and_nothing_is_adopted(plant: Path, tmp_path: Path) -> None:
    bad = tmp_path / "bad"
    shutil.copytree(plant / "record", bad / "record")
    shutil.copy(plant / "cell1.toml", bad / "cell1.toml")
    path = bad / "record" / "cell1.parquet"
    table = pq.read_table(path)
    inlet = table["t_in_C"].to_numpy().copy()
    inlet[3 * 1440 : 4 * 1440] = 32.0 + 1.8 * inlet[3 * 1440 : 4 * 1440]
    index = table.schema.get_field_index("t_in_C")
    pq.write_table(table.set_column(index, "t_in_C", pa.array(inlet)), path)
    shutil.copy(plant / "labels.csv", bad / "labels.csv")
    says = controlled(bad, bad, "out")
    assert "the inlet temperature (t_in_C) jumps there" in says and "CONTRADICTORY_RECORD" in says
    assert "r1.toml" not in says and not (bad / "cell1.r1.toml").exists()
    assert "the inlet temperature (t_in_C) jumps there" in run("report", bad / "out").output.replace("\n", " ")
    got = pq.read_table(bad / "out" / "calibrated.parquet")
    inside = slice(3 * 1440 + 120, 4 * 1440 - 120)
    assert np.isnan(got["t_out"].to_numpy()[inside]).all()
    bias = got["bias"].to_numpy()
    assert np.nanmax(np.abs(bias)) < 1.0 and abs(bias[-1] - 0.3) < 0.15


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ("fill,interval,,,1.12,1.20,inspection", "the inspection of the fill of .* contradicts the record by"),
        ("bias,point,0.9,0.05,,,certificate", "the labels of the bias of .* contradict each other"),
    ],
)
def test_a_label_that_contradicts_is_said_everywhere_and_widens_the_interval(
    rows: str, says: str, plant: Path, tmp_path: Path, calibrated: Path
) -> None:
    name = rows.split(",")[0]
    lines = (plant / "labels.csv").read_text().strip().splitlines()
    at = lines[1].split(",")[0]
    kept = [one for one in lines if name != "fill" or ",fill," not in one]
    (tmp_path / "labels.csv").write_text("\n".join([*kept, f"{at},1,{rows}"]) + "\n")
    found = controlled(plant, tmp_path, "out")
    assert re.search(says, found) and f"CONTRADICTORY_LABEL:{name}" in found
    picture = tmp_path / "c.svg"
    report = run("report", tmp_path / "out", "--picture", picture, "--labels", tmp_path / "labels.csv").output
    assert re.search(says, report.replace("\n", " ")) and picture.exists()
    entries = json.loads((tmp_path / "out" / "review_queue.json").read_text())["proposals"]
    assert any(e.get("event") == "contradictory_label" for e in entries)
    (held,) = [e for e in entries if e.get("parameter") == name]
    (usual,) = [
        e for e in json.loads((calibrated / "review_queue.json").read_text())["proposals"] if e.get("parameter") == name
    ]
    assert not held["accepted"] and held["sd"] > 1.5 * usual["sd"]


def test_labels_that_agree_are_no_contradiction(calibrated: Path) -> None:
    assert "contradict" not in run("report", calibrated).output


def test_swapped_tags_of_inlet_and_outlet_are_named(plant: Path, tmp_path: Path) -> None:
    shutil.copytree(plant / "record", tmp_path / "record")
    path = tmp_path / "record" / "cell1.parquet"
    table = pq.read_table(path)
    names = {"t_in_C": "t_out_C", "t_out_C": "t_in_C"}
    about = table.schema.metadata
    table = table.rename_columns([names.get(name, name) for name in table.schema.names])
    check = np.full(table.num_rows, 8, dtype=np.uint8)
    table = table.set_column(table.schema.get_field_index("check"), "check", pa.array(check))
    pq.write_table(table.replace_schema_metadata(about), path)
    done = run("calibrate", tmp_path / "record", "--twin", plant / "cell1.toml", "--out", tmp_path / "out")
    assert "are the tags of inlet and outlet swapped?" in refused(done)


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
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        "calibrated.parquet",
        "calibration.json",
        "events.json",
        "records.jsonl",
    ]


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
    assert "NO_SECOND_THERMOMETER" in codes["bias"] and "NO_INSPECTION:fill" in codes["fill"]


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
    named = re.search(r"shows least is (.*?); (\w+).*? is held back", shown)
    assert named and named[2] in named[1]
    entries = json.loads((tmp_path / "out" / "review_queue.json").read_text())["proposals"]
    held = next(e for e in entries if e.get("parameter") == named[2])
    assert f"LOW_SENSITIVITY:{named[2]}" in held["codes"] and held["condition"] > 80.0
    assert f"combination shown least: {held['combined']}" in " ".join(run("report", tmp_path / "out").output.split())


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
    assert "water balance is not used, since most of its sums contradict the cells (NOT_CLOSED)" in done.output
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


def test_plan_and_calibration_have_one_condition_and_plan_says_where_no_test_suffices(
    plant: Path, tmp_path: Path
) -> None:
    common = (plant / "record", "--twin", plant / "cell1.toml")
    run("calibrate", *common, "--out", tmp_path / "out", "--mode", "advisory")
    entries = json.loads((tmp_path / "out" / "review_queue.json").read_text())["proposals"]
    calibrated = next(e["condition"] for e in entries if "condition" in e)
    shown = run("plan", *common, "--warmer", 0.3).output.replace("\n", " ")
    planned = float(re.search(r"condition number was ([0-9]+)", shown)[1])
    assert planned == pytest.approx(calibrated, rel=0.35)
    best = [float(word) for word in re.findall(r"│ ([0-9]+) +│", shown)]
    assert ("no test that keeps the outlet within 0.3 K" in shown) == (not best or min(best) > 80.0)


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
    assert exit_code(done.exception) == 1 and "cannot be written: Not a directory; choose another path" in str(
        done.exception
    )
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
        ("someday,1,fill,point,0.9,0.1,,,", "labels.csv:2: 'someday' is no time"),
        ("2022-09-10,1,air,point,0.9,0,,,", "labels.csv:2: sd 0 is not above 0"),
        (
            "2022-09-10,1,air,point,-0.05,0.02,,,",
            "labels.csv:2: air is -0.05, outside 0.82 to 1.18; a label of air is a",
        ),
        ("2022-09-10,1,air,point,95.5,2,,,", "a multiplier of the clean cell, about 1, not in %"),
        ("2022-09-10,1,air,point,0.955,2,,,", "labels.csv:2: sd 2 is above the bound of air"),
        ("2022-09-10,1,fill,interval,,,90,96,", "labels.csv:2: fill is 90 to 96, outside 0.75 to 1.25"),
        ("2022-09-10,1,bias,point,72.5,0.05,,,", "outside -1 to 1; a label of bias is the reading less the true"),
    ],
)
def test_bad_labels_are_refused_with_their_line(plant: Path, tmp_path: Path, line: str, says: str) -> None:
    labels = tmp_path / "labels.csv"
    labels.write_text(f"time,cell,parameter,kind,value,sd,lo,hi,source\n{line}\n")
    done = run(
        "calibrate", plant / "record", "--twin", plant / "cell1.toml", "--labels", labels, "--out", tmp_path / "out"
    )
    assert says in refused(done)


def test_labels_of_other_cells_and_times_are_named(plant: Path, tmp_path: Path) -> None:
    labels = tmp_path / "labels.csv"
    good = (plant / "labels.csv").read_text()
    labels.write_text(good + "2022-09-10,9,air,point,0.95,0.02,,,\n2019-09-10,1,air,point,0.95,0.02,,,\n")
    done = run(
        "calibrate", plant / "record", "--twin", plant / "cell1.toml", "--labels", labels, "--out", tmp_path / "o"
    )
    assert done.exit_code == 0
    shown = done.output
    assert f"{labels}:5: cell 9 is none of the record's (1); the label is not used" in shown
    assert f"{labels}:6: 2019-09-10 is outside the record" in shown and f"{labels}:2" not in shown


def test_the_console_shows_the_interval_of_the_table(calibrated: Path, plant: Path, tmp_path: Path) -> None:
    done = run(
        "calibrate",
        plant / "record",
        "--twin",
        plant / "cell1.toml",
        "--labels",
        plant / "labels.csv",
        "--out",
        tmp_path,
    )
    table = pq.read_table(tmp_path / "calibrated.parquet")
    low, high = (table[f"air_{end}"].to_numpy() for end in ("lo", "hi"))
    half = (0.5 * (high - low))[np.isfinite(low)][-1]
    shown = [float(word) for word in re.findall(r"± ([0-9.]+)", done.output)]
    assert abs(shown[1] - half) < 2e-3


def test_a_gap_of_months_is_told_with_its_days_and_a_week_of_standby_is_not() -> None:
    day = np.concatenate([np.arange(0.0, 20.0, 0.1), np.arange(27.0, 40.0, 0.1), np.arange(185.0, 200.0, 0.1)])
    (told,) = gap_sentences(86400.0 * (19000.0 + day))
    assert re.search(r"from 2022-02-16 to 2022-07-12, 145 days", told) and "events" in told
