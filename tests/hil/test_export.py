"""Exports of a run: each file is read back by the software of its format, values, units, qualities and events."""

from __future__ import annotations

import csv
import datetime
import json
import resource
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from drivers.rig_file import load_rig
from drivers.signals import Quality
from hil.export import SUFFIX, ExportError, export_run
from hil.journal import Header, JournalWriter
from hil.record import read_record
from hil.run_folder import RunFolder, new_manifest
from tests.docs.fences import PROJECT
from tests.hil.command_line import typed

RIG = """
[rig]
name = "bench"

[bus.plc]
transport = "modbus_tcp"
host = "127.0.0.1"
port = 15020
device_id = 1

[[point]]
name = "T_tank"
bus = "plc"
table = "input"
address = 0
type = "int16"
scale = 0.01
offset = -20.0
unit = "degC"
doc = "Tank, half height"

[[point]]
name = "flow"
bus = "plc"
table = "input"
address = 1
type = "float32"
unit = "L/min"

[[point]]
name = "counter"
bus = "plc"
table = "input"
address = 3
unit = "1"
kind = "status"
"""
TICKS = 120
EVENTS = (
    (3, "INFO", "preparing → running: start"),
    (40, "WARN", 'T_tank: sensor fault, "masked"'),
    (90, "ERROR", "línk, lost\n2"),
)


@dataclass(frozen=True)
class MadeRun:
    """Folder of a run, and by column what its journal holds: received values, qualities, values that are good."""

    path: Path
    received: dict[str, np.ndarray]
    quality: dict[str, np.ndarray]
    counts: np.ndarray

    def good(self, column: str) -> np.ndarray:
        """Return the values (n,) of a column, NaN where missing or not GOOD."""
        return np.where(self.quality[column] == Quality.GOOD, self.received[column], np.nan)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> MadeRun:
    """A run of a rig of three points, with gaps, a fault, a stale value and events."""
    path = tmp_path_factory.mktemp("runs") / "20260520T120000Z-steps"
    path.mkdir()
    rig_file = path.parent / "rig.toml"
    rig_file.write_text(RIG, encoding="utf-8")
    signals = tuple(point.as_signal() for point in load_rig(rig_file).point)
    rng = np.random.default_rng(7)
    counts = np.round(4000.0 + 100.0 * rng.random(TICKS))
    values = np.column_stack([counts * 0.01 - 20.0, 3.0 + rng.random(TICKS), np.arange(TICKS) % 7.0])
    quality = np.zeros(values.shape, dtype=np.uint8)
    values[40:50, 0], quality[40:50, 0] = np.nan, Quality.SENSOR_FAULT
    quality[60:62, 0] = Quality.STALE
    quality[70, 1] = Quality.OUT_OF_RANGE
    values[90:93], quality[90:93] = np.nan, Quality.LINK_FAULT
    writer = JournalWriter(path / "journal.sqlite", Header(signals, {}, (), "steps", float(TICKS), 1.0, {}))
    for tick in range(TICKS):
        time_s = float(tick) + 0.1 * (tick % 3)
        writer.sample(tick, time_s, 1.7e9 + tick, 0.001, values[tick].tolist(), quality[tick].tolist(), [time_s] * 3)
    for tick, level, text in EVENTS:
        writer.event(tick, float(tick), level, text)
    writer.close()
    labels = {"serial_number": "0042", "tags": ["night"]}
    RunFolder(path).write_manifest(new_manifest({"rig": rig_file}) | {"exit_status": "done", "labels": labels})
    columns = [signal.column for signal in signals]
    return MadeRun(
        path,
        {column: values[:, k] for k, column in enumerate(columns)},
        {column: quality[:, k] for k, column in enumerate(columns)},
        counts,
    )


@pytest.mark.parametrize("to", ["csv", "parquet"])
def test_our_reader_gets_the_same_values_from_a_table(run: MadeRun, tmp_path: Path, to: str) -> None:
    export_run(run.path, to, tmp_path / f"out.{to}")
    record = read_record(tmp_path / f"out.{to}")
    assert list(record.columns) == list(run.received)
    for column in run.received:
        assert np.array_equal(record.columns[column], run.good(column), equal_nan=True), column
        assert np.array_equal(record.quality[column], run.quality[column]), column
    assert np.array_equal(record.time_s, np.arange(TICKS) + 0.1 * (np.arange(TICKS) % 3))


def test_a_csv_has_a_line_of_units_and_its_events_beside_it(run: MadeRun, tmp_path: Path) -> None:
    files = export_run(run.path, "csv", tmp_path / "out.csv")
    assert files == (tmp_path / "out.csv", tmp_path / "out.events.csv")
    with files[0].open(newline="") as file:
        names, units = list(csv.reader(file))[:2]
    assert dict(zip(names[:4], units[:4], strict=True)) == {
        "time_s": "s",
        "T_tank_C": "degC",
        "flow_L_per_min": "L/min",
        "counter": "1",
    }
    with files[1].open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))[2:]
    assert rows == [[repr(float(tick)), level, text] for tick, level, text in EVENTS]


def test_parquet_has_units_and_events_in_its_metadata(run: MadeRun, tmp_path: Path) -> None:
    export_run(run.path, "parquet", tmp_path / "out.parquet")
    schema = pq.read_schema(tmp_path / "out.parquet")
    assert schema.field("flow_L_per_min").metadata[b"unit"] == b"L/min"
    assert schema.field("T_tank_C").metadata[b"doc"] == b"Tank, half height"
    about = json.loads(schema.metadata[b"hil"])
    assert [(e["time_s"], e["level"], e["text"]) for e in about["events"]] == list(EVENTS)
    assert (about["profile"], about["serial_number"], about["tags"]) == ("steps", "0042", "night")


@pytest.mark.parametrize(
    ("to", "query"),
    [
        ("parquet", "SELECT T_tank_C, T_tank_C_quality FROM 'out.parquet'"),
        ("csv", "SELECT T_tank_C, T_tank_C_quality FROM read_csv('out.csv', header = true, skip = 0, delim = ',')"),
    ],
)
def test_duckdb_reads_a_table(
    run: MadeRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, to: str, query: str
) -> None:
    duckdb = pytest.importorskip("duckdb")
    monkeypatch.chdir(tmp_path)
    export_run(run.path, to, Path(f"out.{to}"))
    rows = duckdb.sql(query).fetchall()[1 if to == "csv" else 0 :]
    assert [np.nan if value in (None, "") else float(value) for value, _ in rows] == pytest.approx(
        run.good("T_tank_C").tolist(), rel=0, abs=0, nan_ok=True
    )
    assert [int(code) for _, code in rows] == run.quality["T_tank_C"].tolist()


def test_asammdf_reads_an_mf4_with_units_comments_and_raw_counts(run: MadeRun, tmp_path: Path) -> None:
    asammdf = pytest.importorskip("asammdf")
    export_run(run.path, "mf4", tmp_path / "out.mf4")
    with asammdf.MDF(tmp_path / "out.mf4") as read:
        tank = read.get("T_tank_C", ignore_invalidation_bits=True)
        assert (tank.unit, tank.comment) == ("degC", "measured; bus plc; Tank, half height")
        assert np.array_equal(tank.samples, run.good("T_tank_C"), equal_nan=True)
        bad = run.quality["T_tank_C"] != Quality.GOOD
        # A reader that obeys the bits gets good values only.
        assert len(read.get("T_tank_C").samples) == TICKS - bad.sum(), (
            "a reader that obeys the bits gets good values only"
        )
        raw = read.get("T_tank_C_raw", raw=True, ignore_invalidation_bits=True)
        assert raw.samples.dtype == np.uint16
        assert np.array_equal(raw.samples[~bad], run.counts[~bad])
        assert (raw.conversion.a, raw.conversion.b) == (0.01, -20.0)
        assert np.allclose(read.get("T_tank_C_raw").samples, run.good("T_tank_C")[~bad], rtol=0, atol=1e-12)
        assert "flow_L_per_min_raw" not in read, "a float has no counts"
        assert np.array_equal(read.get("T_tank_C_quality").samples, run.quality["T_tank_C"])
        assert [text.decode() for text in read.get("event_text").samples] == [text for _, _, text in EVENTS]
        assert "profile: steps" in read.header.comment


def test_h5py_reads_an_hdf5_with_units_and_time_as_a_scale(run: MadeRun, tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    export_run(run.path, "hdf5", tmp_path / "out.h5")
    with h5py.File(tmp_path / "out.h5") as read:
        for column in run.received:
            signal = read["signals"][column]
            assert np.array_equal(signal[:], run.good(column), equal_nan=True)
            assert np.array_equal(read["quality"][column][:], run.quality[column])
            assert signal.dims[0]["time_s"] == read["time_s"]
        assert read["signals/T_tank_C"].attrs["units"] == "degC"
        raw = read["raw/T_tank_C"]
        good = run.quality["T_tank_C"] == Quality.GOOD
        physical = raw[:] * raw.attrs["scale_factor"] + raw.attrs["add_offset"]
        assert np.array_equal(physical[good], run.received["T_tank_C"][good])
        assert list(read["events/text"].asstr()) == [text for _, _, text in EVENTS]
        assert read.attrs["profile"] == "steps"


def test_nptdms_reads_a_tdms_with_units_and_events(run: MadeRun, tmp_path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    export_run(run.path, "tdms", tmp_path / "out.tdms")
    read = nptdms.TdmsFile.read(tmp_path / "out.tdms")
    for column in run.received:
        assert np.array_equal(read["signals"][column][:], run.good(column), equal_nan=True)
        assert np.array_equal(read["quality"][column][:], run.quality[column])
    assert read["signals"]["T_tank_C"].properties["unit_string"] == "degC"
    assert list(read["events"]["text"][:]) == [text for _, _, text in EVENTS]
    good = run.quality["T_tank_C"] == Quality.GOOD
    assert np.array_equal(read["raw"]["T_tank_C"][:][good], run.counts[good])


def test_raw_counts_are_left_out_where_the_rig_file_was_changed(run: MadeRun, tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    rig_file = run.path.parent / "rig.toml"
    rig_file.write_text(RIG.replace("scale = 0.01", "scale = 0.02"), encoding="utf-8")
    try:
        export_run(run.path, "hdf5", tmp_path / "out.h5")
    finally:
        rig_file.write_text(RIG, encoding="utf-8")
    with h5py.File(tmp_path / "out.h5") as read:
        assert "raw" not in read
        assert "T_tank_C" in read["signals"]


@pytest.mark.parametrize("names", ["T_*", "T_tank", "T_tank_C"])
def test_signals_are_chosen_by_column_name_or_pattern(run: MadeRun, tmp_path: Path, names: str) -> None:
    export_run(run.path, "parquet", tmp_path / "out.parquet", signals=[names])
    assert list(read_record(tmp_path / "out.parquet").columns) == ["T_tank_C"]


def test_an_unknown_signal_is_refused_with_the_nearest_name(run: MadeRun, tmp_path: Path) -> None:
    result = typed("export", run.path, "--to", "csv", "--signals", "T_tnk", "--out", tmp_path / "out.csv")
    assert (result.returncode, result.stderr) == (2, "hil: the run has no signal 'T_tnk'; did you mean 'T_tank'?\n")
    assert not list(tmp_path.iterdir())


def test_a_file_that_exists_is_replaced_on_request_only(run: MadeRun, tmp_path: Path) -> None:
    (tmp_path / "out.csv").write_text("mine")
    refused = typed("export", run.path, "--to", "csv", "--out", tmp_path / "out.csv")
    assert refused.returncode == 2
    assert "--force" in refused.stderr
    assert (tmp_path / "out.csv").read_text() == "mine"
    made = typed("export", run.path, "--to", "csv", "--out", tmp_path / "out.csv", "--force", "--json")
    assert made.returncode == 0
    assert json.loads(made.stdout)["files"][0]["bytes"] == (tmp_path / "out.csv").stat().st_size


def test_an_events_file_that_exists_is_not_replaced_either(run: MadeRun, tmp_path: Path) -> None:
    (tmp_path / "out.events.csv").write_text("mine")
    with pytest.raises(ExportError, match=r"out\.events\.csv exists"):
        export_run(run.path, "csv", tmp_path / "out.csv")
    assert [path.name for path in tmp_path.iterdir()] == ["out.events.csv"]


@pytest.mark.parametrize("name", ["journal.sqlite", "run.json", "notes.jsonl", "verdict.json", "twin.before-1.toml"])
def test_a_file_of_the_run_itself_is_never_replaced(run: MadeRun, name: str) -> None:
    is_there = (run.path / name).exists()
    before = (run.path / name).read_bytes() if is_there else b"{}\n"
    (run.path / name).write_bytes(before)
    result = typed("export", run.path, "--to", "csv", "--out", run.path / "." / name, "--force")
    assert (result.returncode, "is a file of the run" in result.stderr) == (2, True)
    assert (run.path / name).read_bytes() == before


def test_a_folder_without_a_journal_is_refused(run: MadeRun, tmp_path: Path) -> None:
    (tmp_path / "run.json").write_bytes((run.path / "run.json").read_bytes())
    result = typed("export", tmp_path, "--to", "csv", "--out", tmp_path / "out.csv")
    assert (result.returncode, result.stderr.count("\n")) == (2, 1)
    assert "holds no journal.sqlite" in result.stderr


def test_a_journal_without_samples_is_refused(run: MadeRun, tmp_path: Path) -> None:
    (tmp_path / "run.json").write_bytes((run.path / "run.json").read_bytes())
    signals = tuple(point.as_signal() for point in load_rig(run.path.parent / "rig.toml").point)
    JournalWriter(tmp_path / "journal.sqlite", Header(signals, {}, (), "steps", 60.0, 1.0, {})).close()
    with pytest.raises(ExportError, match="no samples yet"):
        export_run(tmp_path, "csv", tmp_path / "out.csv")


def test_a_record_is_no_run(tmp_path: Path) -> None:
    (tmp_path / "record.csv").write_text("time_s,T_tank_C\n0,20\n1,21\n")
    result = typed("export", tmp_path / "record.csv", "--to", "mf4")
    assert result.returncode == 2
    assert "takes the folder of a run" in result.stderr


@pytest.mark.parametrize(
    ("to", "library"), [("csv", ""), ("parquet", ""), ("mf4", "asammdf"), ("hdf5", "h5py"), ("tdms", "nptdms")]
)
def test_a_full_disk_leaves_nothing_half_written(run: MadeRun, tmp_path: Path, to: str, library: str) -> None:
    if library:
        pytest.importorskip(library)
    (tmp_path / "out").write_bytes(b"old")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))  # the system refuses what is written beyond
    try:
        with pytest.raises(ExportError, match="out cannot be written"):
            export_run(run.path, to, tmp_path / "out", force=True)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert (tmp_path / "out").read_bytes() == b"old"


def _without(library: str) -> Callable[[str], Any]:
    def load(name: str) -> Any:
        if name == library:
            raise ImportError(name)
        return sys.modules[name]

    return load


@pytest.mark.parametrize(("to", "library"), [("mf4", "asammdf"), ("hdf5", "h5py"), ("tdms", "nptdms")])
def test_a_format_without_its_library_names_the_extra(
    run: MadeRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, to: str, library: str
) -> None:
    monkeypatch.setattr("hil.export.target.importlib.import_module", _without(library))
    with pytest.raises(ExportError, match=rf"needs {library}, .* pip install 'hil-rig\[export\]'"):
        export_run(run.path, to, tmp_path / f"out{SUFFIX[to]}")
    assert not list(tmp_path.iterdir())


def test_absolute_time_is_that_of_the_first_tick(run: MadeRun, tmp_path: Path) -> None:
    pytest.importorskip("asammdf")
    pytest.importorskip("nptdms")
    pytest.importorskip("h5py")
    import asammdf
    import h5py
    import nptdms

    first = datetime.datetime.fromtimestamp(1.7e9, datetime.UTC)
    assert RunFolder(run.path).read_manifest()["started"] != first.isoformat()
    made = {to: export_run(run.path, to, tmp_path / f"a{SUFFIX[to]}")[0] for to in ("mf4", "tdms", "hdf5", "parquet")}
    with asammdf.MDF(made["mf4"]) as found:
        assert found.header.start_time == first
    assert nptdms.TdmsFile.read(made["tdms"]).properties["datetime"] == np.datetime64(first.replace(tzinfo=None))
    with h5py.File(made["hdf5"]) as found:
        assert datetime.datetime.fromisoformat(found.attrs["started"]) == first
    about = json.loads(pq.read_schema(made["parquet"]).metadata[b"hil"])
    assert datetime.datetime.fromisoformat(about["started"]) == first


@pytest.mark.parametrize(
    ("to", "name", "right"), [("mf4", "foo.csv", "foo.mf4"), ("csv", "foo.MF4", "foo.csv"), ("hdf5", "x.fmu", "x.h5")]
)
def test_a_name_with_the_ending_of_another_format_is_refused(
    run: MadeRun, tmp_path: Path, to: str, name: str, right: str
) -> None:
    done = typed("export", run.path, "--to", to, "--out", tmp_path / name)
    assert done.returncode == 2 and f"name it {right}" in done.stderr and not (tmp_path / name).exists()
    other = tmp_path / "foo.dat"
    assert typed("export", run.path, "--to", "csv", "--out", other).returncode == 0 and other.is_file()


def test_a_folder_is_no_file_to_write(run: MadeRun, tmp_path: Path) -> None:
    for out, said in ((tmp_path, "is a folder"), (tmp_path / "none" / "a.csv", "is no folder that is there")):
        done = typed("export", run.path, "--to", "csv", "--out", out)
        assert done.returncode == 2 and said in done.stderr and len(done.stderr.splitlines()) == 1


def test_a_twin_never_replaces_a_file_of_a_run(run: MadeRun) -> None:
    before = (run.path / "journal.sqlite").read_bytes()
    twin = PROJECT / "profiles/twins/virtual.toml"
    done = typed("export", twin, "--to", "fmu", "--out", run.path / "journal.sqlite", "--force")
    assert done.returncode == 2 and "is a file of the run" in done.stderr
    assert (run.path / "journal.sqlite").read_bytes() == before
