"""Folder of a calibration: one calibration, one process, and chains of records that are whole up to their ends."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hil.errors import exit_code
from hil.files import held
from tests.hil.reference_pages import page
from tests.hil.tower.made_plant import SHEET, files, iso, refused, run, write_points, write_record
from tests.twin.tower.made_cell import made_cell

FILES = {"calibrated.parquet", "calibration.json", "events.json", "records.jsonl", "review_queue.json"}


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a record, one that goes on beyond it, labels, a twin, and an advisory calibration `out`."""
    root = tmp_path_factory.mktemp("plant")
    write_record(root / "longer", days=4)
    table = pq.read_table(root / "longer" / "cell1.parquet")
    (root / "record").mkdir()
    shutil.copy(root / "longer" / "station.json", root / "record")
    pq.write_table(table.slice(0, 3 * 1440), root / "record" / "cell1.parquet")
    (root / "datasheet.json").write_text(json.dumps(SHEET))
    write_points(root / "points.csv")
    at = iso(made_cell(0.5).time_s[0] + 86400)
    (root / "labels.csv").write_text(f"time,cell,parameter,kind,value,sd,lo,hi\n{at},1,bias,point,0.3,0.05,,\n")
    done = run("commission", root / "record", "--cell", 1, *files(root), "--out", root / "cell1.toml")
    assert done.exit_code == 0, done.output
    done = calibrate(root, root / "out")
    assert done.exit_code == 0, done.output + repr(done.exception)
    return root


def calibrate(root: Path, out: Path, *more: Any, record: str = "record", twin: str = "cell1.toml") -> Any:
    words = ("--twin", root / twin, "--labels", root / "labels.csv", "--mode", "advisory", *more)
    return run("calibrate", root / record, "--out", out, *words)


@pytest.fixture
def out(plant: Path, tmp_path: Path) -> Path:
    """A copy of the calibration."""
    return Path(shutil.copytree(plant / "out", tmp_path / "out"))


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_second_run_of_one_calibration_changes_no_record(plant: Path, out: Path) -> None:
    before = content(out)
    assert set(before) == FILES
    assert calibrate(plant, out).exit_code == 0
    after = content(out)
    assert after["records.jsonl"] == before["records.jsonl"] and after["calibration.json"] == before["calibration.json"]


def test_a_record_that_goes_on_appends_its_new_times(plant: Path, out: Path) -> None:
    before = (out / "records.jsonl").read_text()
    assert calibrate(plant, out, record="longer").exit_code == 0
    after = (out / "records.jsonl").read_text()
    assert after.startswith(before) and len(after.splitlines()) == 4 * 288
    assert run("report", out).exit_code == 0
    assert "its record of cell 1 is another one, from 20" in refused(calibrate(plant, out))


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (("--mode", "shadow"), "its mode is advisory, not shadow"),
        (("--labels", "other.csv"), "its labels are other ones"),
        (("--events", "events.csv"), "it has no events"),
        (("--twin", "other.toml"), "its twin of cell 1 is another one, cell1.toml"),
    ],
)
def test_another_calibration_is_refused_with_what_differs(
    plant: Path, out: Path, tmp_path: Path, more: tuple[str, str], says: str
) -> None:
    before = content(out)
    (tmp_path / "other.csv").write_text((plant / "labels.csv").read_text().replace("0.3", "0.4"))
    (tmp_path / "events.csv").write_text("time,event,cell\n2022-09-12,inspection,1\n")
    write_points(tmp_path / "points.csv", water_outlet_C=0.05)
    words = ("--datasheet", plant / "datasheet.json", "--points", tmp_path / "points.csv")
    run("commission", plant / "record", "--cell", 1, *words, "--out", tmp_path / "other.toml")
    value: Any = tmp_path / more[1] if "." in more[1] else more[1]
    if more[0] == "--twin":
        done = run(
            "calibrate",
            plant / "record",
            "--labels",
            plant / "labels.csv",
            "--mode",
            "advisory",
            "--out",
            out,
            "--twin",
            value,
        )
    else:
        done = calibrate(plant, out, more[0], value)
    assert f"{out}: holds another calibration: {says}; give another --out, or --replace to remove it" in refused(done)
    assert content(out) == before


def test_replace_leaves_nothing_of_the_other_calibration(plant: Path, out: Path) -> None:
    (out / "network.parquet").write_bytes(b"of another one")
    (out / "mine.txt").write_text("kept")
    done = calibrate(plant, out, "--mode", "shadow", "--replace")
    assert done.exit_code == 0, done.output + repr(done.exception)
    assert set(content(out)) == FILES - {"review_queue.json"} | {"mine.txt"}
    assert {json.loads(line)["m"] for line in (out / "records.jsonl").read_text().splitlines()} == {"shadow"}
    assert "there is no review queue" in run("report", out).output


def test_files_that_nothing_tells_of_are_refused(plant: Path, out: Path) -> None:
    (out / "calibration.json").unlink()
    for done in (calibrate(plant, out), run("report", out)):
        assert "calibration.json: is missing, so that nothing tells of what the folder is" in refused(done)
    (out / "calibration.json").write_text('{"format": 1}')
    assert "calibration.json: mode is missing" in refused(run("report", out))


def test_a_folder_that_another_process_works_on_is_refused(plant: Path, out: Path) -> None:
    before = content(out)
    with held(out, RuntimeError):
        for done in (calibrate(plant, out), run("report", out)):
            assert f"{out}: another process works on this folder; wait until it has ended" in str(done.exception)
            assert done.exception is not None and exit_code(done.exception) == 1
    assert content(out) == before


def test_an_error_while_it_is_written_leaves_the_old_calibration(
    plant: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = content(out)
    from hil.tower.governance import service

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(service, "write_queue", full)
    done = calibrate(plant, out, record="longer")
    assert "No space left on device; make room" in str(done.exception)
    assert content(out) == before


def _without_last_line(path: Path) -> None:
    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[:-1]))


def _with_last_line_changed(path: Path) -> None:
    *lines, last = path.read_text().splitlines()
    path.write_text("\n".join([*lines, last.replace('"c":1', '"c":1 ')]) + "\n")


def _with_a_line_more(path: Path) -> None:
    import hashlib

    last = path.read_text().splitlines()[-1]
    line = json.loads(last) | {"p": hashlib.sha256(last.encode()).hexdigest()[:12]}
    with path.open("a") as handle:
        handle.write(json.dumps(line) + "\n")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (_without_last_line, "has 863 records and 864 were written: lines were removed from its end"),
        (_with_a_line_more, "has 865 records and 864 were written: lines were added to its end"),
        (_with_last_line_changed, ":864: is not the last line that was written"),
        (lambda path: path.write_text(""), "has 0 records and 864 were written"),
        (lambda path: path.unlink(), "is missing, and 864 records were written"),
        (lambda path: path.write_bytes(path.read_bytes().replace(b'"c"', b'"\xff"', 1)), ":1: is no record of a cal"),
        (lambda path: path.write_text("[" * 100_000 + "\n"), ":1: is no record of a calibration"),
        (lambda path: path.write_text('{"t": "2022-01-01", "c": 1, "p": ""}\n'), "f is missing"),
        (lambda path: path.write_text('{"t": "soon", "c": 1, "p": "", "f": []}\n'), ":1: is no record of a cal"),
        (lambda path: path.write_bytes(path.read_bytes().rstrip(b"\n")), ":864: does not follow"),
    ],
)
def test_a_chain_that_was_changed_anywhere_is_reported(
    plant: Path, out: Path, change: Callable[[Path], object], says: str
) -> None:
    change(out / "records.jsonl")
    for done in (run("report", out), calibrate(plant, out)):
        assert says in refused(done) and "restore the file, or calibrate into another folder" in refused(done)


def test_records_that_the_calibration_never_wrote_are_reported(out: Path) -> None:
    (out / "network_records.jsonl").write_text("")
    assert "network_records.jsonl: is no file of this calibration" in refused(run("report", out))


@pytest.mark.parametrize(
    ("document", "says"),
    [
        ([], "is not a JSON object"),
        ({}, "proposals is missing"),
        ({"proposals": [{"time": 1}]}, "proposals[0].time is 1, which is not a text"),
        ({"proposals": [{"time": "x", "cell": 1}]}, "a proposal's event is missing"),
        ({"proposals": [{"time": "x", "cell": 1, "parameter": "fill"}]}, "a proposal's value is missing"),
    ],
)
def test_a_queue_of_another_shape_is_reported(out: Path, document: Any, says: str) -> None:
    (out / "review_queue.json").write_text(json.dumps(document))
    said = refused(run("report", out))
    assert "review_queue.json: " in said and says in said and said.endswith("calibrate again")


def test_an_infinite_condition_is_said_in_words(out: Path) -> None:
    path = out / "review_queue.json"
    queue = json.loads(path.read_text())
    for entry in queue["proposals"]:
        if "parameter" in entry:
            entry |= {"accepted": False, "codes": ["LOW_SENSITIVITY:fill"], "condition": 1e9, "combined": "0.97 fill"}
    path.write_text(json.dumps(queue))
    assert "condition infinite, the combination shown least: 0.97 fill" in " ".join(run("report", out).output.split())


def test_a_truth_of_other_months_is_refused(out: Path, tmp_path: Path) -> None:
    n = 1440
    time = pa.array((np.arange(n) * 60_000).astype("datetime64[ms]"))
    columns = {"time": time, "cell": np.ones(n, dtype=np.int8), "running": np.ones(n, dtype=bool)}
    values = dict.fromkeys(("t_out", "fill", "air", "uniformity", "bias"), np.ones(n))
    pq.write_table(pa.table(columns | values), tmp_path / "truth.parquet")
    assert "no running minute of the calibrated cells 1" in refused(
        run("report", out, "--truth", tmp_path / "truth.parquet")
    )
    pq.write_table(pa.table(columns | values | {"fill": ["high"] * n}), tmp_path / "truth.parquet")
    said = refused(run("report", out, "--truth", tmp_path / "truth.parquet"))
    assert "column fill holds string and no numbers; use truth.parquet of hil tower simulate --score" in said


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("fan_power = { value = ", "fan_power = { value = 1", "was edited after it was saved"),
        (
            "fill = { value = 1.0, lower = 0.75, upper = 1.25",
            "fill = { value = 1.0, lower = 1.0, upper = 1.0",
            "no room",
        ),
    ],
)
def test_a_twin_that_was_edited_or_has_no_room_is_refused(
    plant: Path, tmp_path: Path, old: str, new: str, says: str
) -> None:
    text = (plant / "cell1.toml").read_text()
    assert old in text
    text = text.replace(old, new)
    if says == "no room":
        text = "\n".join(line for line in text.splitlines() if not line.startswith("checksum")) + "\n"
    (tmp_path / "cell1.toml").write_text(text)
    done = run("calibrate", plant / "record", "--twin", tmp_path / "cell1.toml", "--out", tmp_path / "out")
    assert says in refused(done) and "cell1.toml" in refused(done) and not (tmp_path / "out").exists()


def test_the_keys_of_the_folder_are_those_of_its_reference_page(out: Path) -> None:
    described = {key for row in page("tower-record").rows["Keys of calibration.json"] for key in _names(row["Key"])}
    assert set(json.loads((out / "calibration.json").read_text())) == described
    named = {name for row in page("tower-record").rows["Folder of a calibration"] for name in _names(row["File"])}
    assert named == FILES | {"network.parquet", "network_records.jsonl"}


def _names(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda table: table.drop_columns(["time"]), "it has no column of times"),
        (lambda table: table.set_column(0, "time", pa.array(["soon"] * table.num_rows)), "it has no column of times"),
        (lambda table: table.replace_schema_metadata({"hil.tower": "[]"}), "its metadata are no object"),
        (lambda table: table.slice(0, 0), "has no minute"),
    ],
)
def test_a_record_of_another_shape_is_refused(
    plant: Path, tmp_path: Path, change: Callable[[pa.Table], pa.Table], says: str
) -> None:
    shutil.copytree(plant / "record", tmp_path / "record")
    path = tmp_path / "record" / "cell1.parquet"
    pq.write_table(change(pq.read_table(path)), path)
    done = run("calibrate", tmp_path / "record", "--twin", plant / "cell1.toml", "--out", tmp_path / "out")
    assert says in refused(done) and f"{path}: " in refused(done) and "align the store again" in refused(done)
    assert not (tmp_path / "out").exists()


def test_a_record_whose_replacement_was_cut_is_refused(plant: Path, tmp_path: Path) -> None:
    shutil.copytree(plant / "record", tmp_path / "record")
    (tmp_path / "record" / ".ready").mkdir()
    done = run("calibrate", tmp_path / "record", "--twin", plant / "cell1.toml", "--out", tmp_path / "out")
    assert "was cut while it replaced the files; run that command again" in refused(done)
