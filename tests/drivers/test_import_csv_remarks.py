"""Remarks of a register table that change how a register is read, and remarks that change nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.bus.contract import judge
from drivers.importers.draft import Draft
from drivers.importers.vendor_table.table import import_csv
from drivers.signals import Quality
from tests.drivers.import_files import BUS, table, written


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


CODES = [
    *(
        "999.9 = sensor break",
        "999,9 = Fühlerbruch",
        "-3276.8 = Fuehlerbruch",
        "−3276,8 °C: Drahtbruch",
        "+999.9 means fault",
    ),
    *(
        "sensor break: 999.9",
        "bei Fühlerbruch 850,5",
        "Fühlerbruch = -3276,8 °C",
        "sensor broken -> 999.9",
        "850.1 °C (no sensor)",
    ),
    *(
        "reads 999.9 °C if the sensor is broken",
        "Vorlauf, 999,9 = Messfehler, sonst °C",
        "999.9C on sensor failure",
        "-1 = error",
    ),
    *(
        "Tank; 85.0 stands for open circuit; see chapter 3.2",
        "no signal = 1e30",
        "-99 = kein Messwert",
        "850,0 = rupture de sonde",
    ),
    *("±0.1 K, 327.67 sensor fault", "99.9 = n/a", "missing: −40.0", "32.767 = sensor fault", "Kurzschluß ≙ 0,0"),
    *(
        "999.9 = N.C.",
        "Fühler ab = 999,9",
        "sensor fault value 850.0",
        "returns -127.0 when no probe",
        "-999.9 °C = pas de sonde",
    ),
]


@pytest.mark.parametrize("kind", ["int16", "float32"])
@pytest.mark.parametrize("remark", CODES)
def test_a_code_with_a_decimal_or_a_sign_needs_its_column_as_a_whole_one_does(
    tmp_path: Path, remark: str, kind: str
) -> None:
    draft = _imported(tmp_path, remark, kind, ("scale", "0.1"))
    assert _names(draft) == ["B"]
    assert any(
        "put the code in a column invalid (raw or in the unit), - where there is none (left out)" in note
        for note in draft.notes
    )
    assert not any("code" in note for note in _imported(tmp_path, remark, kind, ("invalid", "-")).notes)


@pytest.mark.parametrize("cell", ["999.9", "999,9", "9999"])
def test_the_code_in_its_column_makes_the_reading_a_sensor_fault(tmp_path: Path, cell: str) -> None:
    text = (
        f"name;address;table;type;unit;scale;remark;invalid\nT;1;holding;int16;degC;0.1;999.9 = sensor break;{cell}\n"
    )
    (point,) = written(tmp_path, import_csv(table(tmp_path, text), "zero", BUS)).point
    assert (judge(point, 9999)[1], judge(point, 215)) == (Quality.SENSOR_FAULT, (21.5, Quality.GOOD))


@pytest.mark.parametrize(("kind", "cell"), [("int16", "99.95"), ("uint16", "-99.9"), ("int16", "9999.9")])
def test_a_code_that_no_raw_number_gives_leaves_the_point_out(tmp_path: Path, kind: str, cell: str) -> None:
    lines = [
        "name;address;table;type;unit;scale;invalid",
        f"T;1;holding;{kind};degC;0.1;{cell}",
        "B;2;holding;int16;degC;0.1;",
    ]
    draft = import_csv(table(tmp_path, "\n".join(lines)), "zero", BUS)
    assert _names(draft) == ["B"]
    assert any(f"invalid {cell} never comes out of a {kind}" in note for note in draft.notes)


def test_a_small_number_is_a_code_of_a_quantity_and_may_be_a_state_without_a_unit(tmp_path: Path) -> None:
    lines = [
        "name;address;table;type;unit;scale;remark",
        "T;1;holding;int16;degC;0.1;99 = sensor break",
        'S;2;holding;int16;;;"0 = off, 1 = on, 2 = fault"',
    ]
    draft = import_csv(table(tmp_path, "\n".join(lines)), "zero", BUS)
    assert _names(draft) == ["S"]


@pytest.mark.parametrize(
    "remark",
    [
        *(
            "max. error: 0.5 K",
            "Messfehler: 0,3 K",
            "measurement error = 0.2",
            "fault: see chapter 3.2",
            "breaker: 12.5 A",
        ),
        *(
            "bit 0 = ok, bit 1 = error",
            "error < 0.5 K",
            "20.5 = set point at start",
            "accuracy 0.1 %, no fault known",
            "999.9 = maximum",
            "99.99 = full scale",
        ),
    ],
)
def test_a_decimal_that_no_words_link_to_a_fault_is_no_code(tmp_path: Path, remark: str) -> None:
    assert _names(_imported(tmp_path, remark, more=("scale", "0.1"))) == ["A", "B"]
