"""Layouts of record files: lines above the rows, blanks between columns, and one reading a row."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hil.record.csv_file.dialect import find_dialect
from hil.record.reader import Record, RecordError, read_record
from tests.hil.command_line import hil

WARM = [18.0 + k / 4 for k in range(24)]
"""Readings in degC that every layout below holds, one every ten seconds, beside 55 W."""


def _read(tmp_path: Path, text: str) -> Record:
    path = tmp_path / "layout.csv"
    path.write_text(text, encoding="utf-8")
    return read_record(path)


def _rows(row: str, between: str = "\n") -> str:
    return (
        between.join(
            row.format(
                k=k,
                t=10 * k,
                clock=f"2026-05-06 07:{10 * k // 60:02}:{10 * k % 60:02}",
                T=f"{warm:.2f}",
                comma=f"{warm:.2f}".replace(".", ","),
            )
            for k, warm in enumerate(WARM)
        )
        + "\n"
    )


FLUX = "#group,false,false,false,false,true,true\n#datatype,string,long,dateTime:RFC3339,double,string,string\n"
FLUX += "#default,mean,,,,,\n,result,table,_time,_value,_field,host\n"


@pytest.mark.parametrize(
    "text",
    [
        "sep=;\ntime_s;T_in_C;fan_W\n" + _rows("{t};{comma};55"),
        '"sep=,"\r\ntime_s,T_in_C,fan_W\r\n' + _rows("{t},{T},55", "\r\n"),
        '"TOA5","lab","CR6","77","OS.1","CPU:a","1","T10"\n"TIMESTAMP","RECORD","T_in","fan"\n"TS","RN","Deg C","W"\n'
        '"","","Smp","Avg"\n' + _rows('"{clock}",{k},{T},55'),
        "Rig;7\nOperator;N. N.;\n\nTime;T_in;fan\ns;°C;W\n" + _rows("{t};{comma};55"),
        "Time [s],T_in_C,fan_W\n" + _rows("{t},{T},55"),
        "# made by a logger\n# time_s,T_in_C,fan_W\n" + _rows("{t},{T},55"),
        "  time_s     T_in_C   fan_W\n" + _rows("  {t}    {T}     55"),
        "time_s|T_in_C|fan_W\n" + _rows("{t}|{T}|55"),
        "time,name,value\n" + _rows("{t},T_in_C,{T}\n{t},fan_W,55"),
        "entity_id,state,last_changed\n" + _rows("T_in_C,{T},{clock}Z\nfan_W,55,{clock}Z"),
        "time;point;value;unit;quality\n" + _rows("{t};T_in;{comma};°C;Good\n{t};fan;55;W;Good"),
        FLUX + _rows(",,0,{clock}Z,{T},T_in_C,a") + "\n" + FLUX + _rows(",,1,{clock}Z,55,fan_W,a"),
        FLUX.replace("_value,_field,host", "T_in_C,fan_W,host") + _rows(",,0,{clock}Z,{T},55,a"),
    ],
)
def test_every_layout_gives_the_same_record(tmp_path: Path, text: str) -> None:
    record = _read(tmp_path, text)
    assert record.time_s.tolist() == [10.0 * k for k in range(len(WARM))]
    assert record.columns["T_in_C"] == pytest.approx(WARM)
    assert record.columns["fan_W"].tolist() == [55.0] * len(WARM)


def test_lines_that_are_left_out_are_named(tmp_path: Path) -> None:
    record = _read(tmp_path, "Rig;7\n\nTime;T_in;fan\ns;°C;W\n" + _rows("{t};{comma};55"))
    said = "line 3 is taken for the heading, and line 4 gives units; line 1 left out"
    assert record.messages[0] == said


def test_a_row_of_words_below_the_heading_is_a_row(tmp_path: Path) -> None:
    record = _read(tmp_path, "time_s,T_in_C\n0,OVER\n" + "".join(f"{k},20\n" for k in range(1, 30)))
    assert len(record.time_s) == 30 and np.isnan(record.columns["T_in_C"][0])


def test_minutes_in_a_line_of_units_are_minutes(tmp_path: Path) -> None:
    record = _read(tmp_path, "Time,T_in\nmin,degC\n0,20\n1,21\n2,22\n")
    assert record.time_s.tolist() == [0, 60, 120]


def test_a_value_of_bad_quality_is_missing(tmp_path: Path) -> None:
    record = _read(tmp_path, "time,tag,value,quality\n" + _rows("{t},T_in_C,{T},Good") + "999,T_in_C,77,Bad\n")
    assert np.isnan(record.columns["T_in_C"][-1])
    assert "1 reading is not of good quality (the first is line 26): missing" in record.messages


def test_series_of_a_parquet_file_become_columns(tmp_path: Path) -> None:
    path = tmp_path / "long.parquet"
    pq.write_table(pa.table({"time": [0, 0, 1, 1], "signal": ["a_W", "b_W"] * 2, "value": [1.0, 2.0, 3.0, 4.0]}), path)
    record = read_record(path)
    assert record.columns["a_W"].tolist() == [1, 3] and record.columns["b_W"].tolist() == [2, 4]


def test_readings_of_a_series_at_the_same_time_are_refused_where_they_differ(tmp_path: Path) -> None:
    text = "time,tag,value\n" + "".join(f"{k // 4},T_in_C,{20 + k}\n" for k in range(40))
    with pytest.raises(RecordError, match="30 readings of a series at a time that it has already; write times"):
        _read(tmp_path, text)


def test_a_column_called_value_beside_a_phase_stays_a_column(tmp_path: Path) -> None:
    rows = (f"{k},{k},{'heat' if k < 9 else 'cool'}\n" for k in range(20))
    record = _read(tmp_path, "time_s,value,phase\n" + "".join(rows))
    assert record.columns["value"].tolist() == list(range(20))


def test_a_parquet_file_that_repeats_a_name_is_read(tmp_path: Path) -> None:
    path = tmp_path / "twice.parquet"
    pq.write_table(
        pa.Table.from_arrays(
            [pa.array([0.0, 1.0]), pa.array([5.0, 6.0]), pa.array([7.0, 8.0])], names=["time_s", "a_W", "a_W"]
        ),
        path,
    )
    record = read_record(path)
    assert record.columns["a_W"].tolist() == [5, 6] and record.columns["a_W_2"].tolist() == [7, 8]


def test_lines_that_do_not_fit_are_refused_above_a_twentieth(tmp_path: Path) -> None:
    def text(odd: int) -> str:
        more = [",5" if k % 10 == 5 and k < 10 * odd else "" for k in range(100)]
        return "time_s,T_in_C\n" + "".join(f"{k},20{field}\n" for k, field in enumerate(more))

    assert len(_read(tmp_path, text(5)).time_s) == 95
    with pytest.raises(RecordError, match="line 7 does not have the 2 fields of the header, like 6 lines in all"):
        _read(tmp_path, text(6))


def test_the_widest_table_that_a_line_can_name_is_the_dialect() -> None:
    dialect = find_dialect("time_s;T_in_C;fan_W\n0;20,5;1,0\n1;20,6;1,5\n2;20,7;1,5\n")
    assert dialect.delimiter == ";" and dialect.names == ("time_s", "T_in_C", "fan_W") and dialect.rows_from == 1


@pytest.mark.parametrize(
    "text",
    [
        "sep=;\ntime_s;T_in_C;fan_W\n" + _rows("{t};{comma};55"),
        "entity_id,state,last_changed\n" + _rows("T_in_C,{T},{clock}Z"),
        FLUX + _rows(",,0,{clock}Z,{T},T_in_C,a"),
        "Date,Time,fan_W\n" + "".join(f"2026-05-06,07:00:{k:02},{k}\n" for k in range(9)),
    ],
)
def test_check_takes_a_record_for_one_in_every_layout(tmp_path: Path, text: str) -> None:
    path = tmp_path / "record.csv"
    path.write_text(text, encoding="utf-8")
    code, printed = hil("check", path)
    assert code == 0 and f"{path}: " in printed and " samples over " in printed


def test_a_column_of_structures_is_refused_or_left_out(tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table({"time": ["a", "b"] * 3, "series": [{"a": 1}] * 6, "value": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]})
    pq.write_table(table, tmp_path / "nested.parquet")
    with pytest.raises(RecordError, match=r"nested\.parquet"):
        read_record(tmp_path / "nested.parquet")


@pytest.mark.parametrize(
    ("above", "columns"),
    [
        ('Tag,"",Tank,Room\nUnit,"",C,W\nDate,Time,"",""', ["Tank_C", "Room_W"]),
        ('Ch,"",CH1,CH2\nTag,"",Tank,Room\nDate,Time,,', ["Tank", "Room"]),
        (",,tank,tank\n,,mean,max\nDate,Time,,", ["tank_mean", "tank_max"]),
        ("Date,Time,Tank,\n,,T [°C],p [bar]", ["Tank T_C", "Tank p_bar"]),
        ("Date,Time,Tank,\n,,°C,bar", ["Tank_C", "Tank_bar"]),
    ],
)
def test_names_in_other_lines_complete_the_heading(tmp_path: Path, above: str, columns: list[str]) -> None:
    rows = "".join(f"2026-03-04,10:00:{k:02d},{20 + k}.5,{k}.25\n" for k in range(20))
    record = _read(tmp_path, f"{above}\n{rows}")
    assert list(record.columns) == columns
    assert record.columns[columns[1]].tolist() == [k + 0.25 for k in range(20)]


def test_names_that_no_line_completes_are_reported(tmp_path: Path) -> None:
    rows = "".join(f"{k},{20 + k}.5,{k}.25\n" for k in range(20))
    record = _read(tmp_path, f"x,Tank,Tank\ntime_s,,\n{rows}")
    assert any("names no column 2, 3: write the names into that line" in said for said in record.messages)


def test_japanese_text_is_read_as_such(tmp_path: Path) -> None:
    path = tmp_path / "logger.csv"
    path.write_bytes(("time_s,温度 [℃]\n" + "".join(f"{k},20.5\n" for k in range(9))).encode("cp932"))
    record = read_record(path)
    assert list(record.columns) == ["温度_C"]
    assert "line 1 is not UTF-8; read as Shift-JIS" in record.messages
