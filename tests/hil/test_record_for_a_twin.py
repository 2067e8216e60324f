"""Records that a twin cannot use as they are: missing columns, gaps, other units, inputs that hardly move."""

from __future__ import annotations

import numpy as np
import pytest

from hil.record.reader import Record, read_record, write_record
from tests.hil.command_line import hil
from tests.hil.input_files import TWIN, healthy_record


@pytest.mark.parametrize("verb", ["track", "commission"])
def test_a_record_without_a_sensor_is_taken_and_says_so(tmp_path, verb):
    arguments = [verb, healthy_record(tmp_path, T_tank_C=None), "--twin", TWIN]
    if verb == "commission":
        arguments += ["--out", tmp_path / "new.toml"]
    code, printed = hil(*arguments)
    assert code == 0 and "T_tank_C" in printed and "Traceback" not in printed


@pytest.mark.parametrize("verb", ["track", "commission"])
@pytest.mark.parametrize("column", ["heater_power_W", "T_tank_C"])
def test_a_record_without_a_column_is_refused(tmp_path, verb, column):
    others = ("T_heater_C", "T_radiator_C") if column == "T_tank_C" else ()  # more than half of the sensors
    arguments = [verb, healthy_record(tmp_path, **dict.fromkeys((column, *others))), "--twin", TWIN]
    if verb == "commission":
        arguments += ["--out", tmp_path / "new.toml"]
    code, printed = hil(*arguments)
    assert code == 2
    assert column in printed
    assert "Traceback" not in printed
    assert not (tmp_path / "new.toml").exists()


def test_a_record_with_gaps_and_holes_is_tracked_and_says_so(tmp_path):
    path = healthy_record(tmp_path)
    import pyarrow.parquet as parquet

    table = parquet.read_table(path)
    keep = np.r_[0:1000, 1300:3000]
    columns = {name: table[name].to_numpy()[keep].copy() for name in table.schema.names if name != "time_s"}
    columns["T_radiator_C"][500:900] = np.nan
    write_record(Record(table["time_s"].to_numpy()[keep], columns), path)
    code, printed = hil("track", path, "--twin", TWIN)
    assert code == 0
    assert "gap" in printed
    assert "T_radiator_C" in printed


def test_commissioning_tells_times_as_they_are_read_and_leaves_out_what_has_no_reading(tmp_path):
    path = healthy_record(tmp_path)
    import pyarrow.parquet as parquet

    table = parquet.read_table(path)
    columns = {name: table[name].to_numpy()[:1200].copy() for name in table.schema.names if name != "time_s"}
    columns["T_radiator_C"][:] = np.nan
    write_record(Record(table["time_s"].to_numpy()[:1200], columns), path)
    code, printed = hil("commission", path, "--twin", TWIN, "--out", tmp_path / "new.toml")
    assert code == 0 and "nan" not in printed
    assert "free run from 16 min to 19 min 59 s" in printed
    assert "not in the table: T_radiator_C" in printed


def test_a_twin_is_never_overwritten(tmp_path):
    out = tmp_path / "new.toml"
    out.write_text("mine", encoding="utf-8")
    code, printed = hil("commission", healthy_record(tmp_path), "--twin", TWIN, "--out", out)
    assert code == 2
    assert "exists already" in printed
    assert out.read_text(encoding="utf-8") == "mine"


def test_fahrenheit_and_kelvin_are_to_be_converted_not_renamed(tmp_path):
    path = healthy_record(tmp_path, **{f"T_{name}_C": None for name in ("heater", "radiator", "tank")})
    record = read_record(path)
    hot = {f"T_{name}_F": np.full(len(record.time_s), 86.0) for name in ("heater", "radiator", "tank")}
    write_record(Record(record.time_s, {**record.columns, **hot}), path)
    code, printed = hil("diagnose", path, "--twin", TWIN, "--dry")
    assert code == 2 and "T_tank_F is in degrees Fahrenheit by its name: subtract 32" in printed
    assert "rename" not in printed


def test_an_input_that_uses_next_to_nothing_of_its_range_is_asked_about(tmp_path):
    path = healthy_record(tmp_path, heater_power_W=np.full(3000, 0.7))
    code, printed = hil("commission", path, "--twin", TWIN, "--out", tmp_path / "new.toml")
    assert "heater_power_W is 0.7 to 0.7 in this record, where the twin declares" in printed
    assert code == 2 and "no twin is written" in printed and "is it in another unit?" in printed
    code, printed = hil("commission", path, "--twin", TWIN, "--out", tmp_path / "new.toml", "--units-checked")
    assert code == 2 and "no twin is written: the record identifies none of the 13 tunables" in printed
    assert not list(tmp_path.glob("new*"))
