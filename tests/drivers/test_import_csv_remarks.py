"""Remarks of a register table that change how a register is read, and remarks that change nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.importers.draft import Draft
from drivers.importers.vendor_table.table import import_csv
from tests.drivers.import_files import BUS, table


def _imported(tmp_path: Path, remark: str, kind: str = "int16", more: tuple[str, str] = ("", "")) -> Draft:
    heading, cell = more
    quoted = remark.replace('"', '""')
    lines = [
        f"name;address;table;type;unit;remark;{heading or 'colour'}",
        f'A;10;holding;{kind};;"{quoted}";{cell}',
        "B;20;holding;int16;;;",
    ]
    return import_csv(table(tmp_path, "\n".join(lines)), "zero", BUS)


def _names(draft: Draft) -> list[str]:
    return [point.name for point in draft.buses[0].points]


@pytest.mark.parametrize(
    "remark",
    [
        *("value/100", "2 decimals", "÷10", "raw / 10", "two decimal places", "235 = 23.5 °C", "LSB 0.1"),
        *("steps of 0.1", "1000 = 100 %", "0-1000 = 0-100 %", "0..32767 = 0..150", "4-20 mA = 0-10 bar", "unit 0.1"),
        *("mal 10", "geteilt durch 10", "Wert*10", "1 Nachkommastelle", "10ths of a degree", "0.01 per count", "0,01"),
        *("SF in next register", "count/16", "decidegrees", "10 x", "times 100", "1 dp", "scaled value", "counts/256"),
    ],
)
def test_a_factor_in_a_remark_leaves_the_point_out_unless_a_column_gives_it(tmp_path: Path, remark: str) -> None:
    draft = _imported(tmp_path, remark)
    assert _names(draft) == ["B"]
    assert any("put the factor in a column scale, 1 where there is none" in note for note in draft.notes)
    assert _names(_imported(tmp_path, remark, more=("scale", "0.1"))) == ["A", "B"]
    assert _names(_imported(tmp_path, remark, kind="float32")) == ["A", "B"]


@pytest.mark.parametrize(
    ("remark", "kind", "column", "cell"),
    [
        ("offset -40", "int16", "offset", "-40"),
        ("raw - 40", "float32", "offset", "-40"),
        ("Nullpunkt bei 4000", "uint16", "offset", "0"),
        ("word order swapped", "int32", "order", "CDAB"),
        ("low word first", "float32", "order", "CDAB"),
        ("LSW first", "uint32", "order", "ABCD"),
        ("little endian", "float32", "order", "DCBA"),
        ("invalid = 32767", "int16", "invalid", "32767"),
        ("0x8000 = sensor fault", "int16", "invalid", "0x8000"),
        ("bei Drahtbruch -9999", "int16", "invalid", "-9999"),
        ("9999 means no sensor", "int16", "invalid", "9999"),
    ],
)
def test_an_offset_an_order_or_a_code_in_a_remark_needs_its_column(
    tmp_path: Path, remark: str, kind: str, column: str, cell: str
) -> None:
    draft = _imported(tmp_path, remark, kind)
    assert _names(draft) == ["B"]
    assert any(f"in a column {column}" in note for note in draft.notes)
    assert _names(_imported(tmp_path, remark, kind, (column, cell))) == ["A", "B"]


@pytest.mark.parametrize("remark", ["BCD", "fixed point 8.8", "Q8", "Q7.8 format"])
def test_a_format_in_a_remark_that_is_not_read_leaves_the_point_out(tmp_path: Path, remark: str) -> None:
    draft = _imported(tmp_path, remark, more=("scale", "1"))
    assert _names(draft) == ["B"]
    assert any("a format that is not read here" in note for note in draft.notes)


@pytest.mark.parametrize("remark", ["range 0..1000", "up to 12.5", "4-20 mA input", "full range is 100"])
def test_a_number_in_a_remark_that_may_be_a_factor_is_noted(tmp_path: Path, remark: str) -> None:
    draft = _imported(tmp_path, remark)
    assert _names(draft) == ["A", "B"]
    assert any("which no column explains: see if that is a factor" in note for note in draft.notes)


@pytest.mark.parametrize(
    "remark",
    [
        *(
            "signed",
            "water to the rig",
            "see chapter 3.4.1",
            "since firmware 1.2",
            "added 2024-03-01",
            "04.03.2026",
            "PT100",
        ),
        *("0 = off, 1 = on", "sensor 2 of 6", "IEC 60751", "hexadecimal", "accuracy 0.1 %", "±0.1 K", "T1 in the tank"),
        *("m3/h, W/m2", "pump and/or fan", "page 12", "on/off", "high word first", "error: see page 300"),
    ],
)
def test_a_remark_without_such_content_is_harmless(tmp_path: Path, remark: str) -> None:
    draft = _imported(tmp_path, remark)
    assert _names(draft) == ["A", "B"]
    assert not [note for note in draft.notes if "A:" in note]
