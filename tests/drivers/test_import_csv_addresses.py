"""Addresses of register tables: a bit behind a register, ranges, Modicon's 4x, and what is no address."""

from __future__ import annotations

import pytest

from drivers.importers.vendor_table.table import import_csv
from tests.drivers.import_files import BUS, table

HEAD = "name;address;table;type\n"
BIT_10 = "it is bit 10"


def imported(tmp_path, rows, addressing="zero", head=HEAD):
    draft = import_csv(
        table(tmp_path, head + rows + "last;900;holding;int16\n" * (addressing == "zero")), addressing, dict(BUS)
    )
    return {point.name: point.keys for bus in draft.buses for point in bus.points}, draft.notes


@pytest.mark.parametrize("text", ["10.3", "10,3", "10:3", "10/3", "10 bit 3", "10.bit3", "10.03", "0x0A.3", "0Ah.3"])
def test_a_bit_behind_a_register_is_its_bit(tmp_path, text):
    points, notes = imported(tmp_path, f"run;{text};holding;bool\n")
    assert (points["run"]["address"], points["run"]["bits"]) == (10, [3, 3])
    assert notes == []


def test_a_bit_behind_a_modicon_address_is_its_bit(tmp_path):
    rows = "run;40011.15;;bool\nstop;4x0011.2;;bool\nt;4x0012;;int16\n"
    points, _ = imported(tmp_path, rows, "modicon")
    assert (points["run"]["address"], points["run"]["bits"]) == (10, [15, 15])
    assert (points["stop"]["address"], points["stop"]["bits"]) == (10, [2, 2])
    assert (points["t"]["table"], points["t"]["address"]) == ("holding", 11)


@pytest.mark.parametrize("text", ["10-11", "10..11", "10 to 11", "10/11", "0x0A-0x0B"])
def test_a_range_is_the_registers_of_one_value(tmp_path, text):
    points, notes = imported(tmp_path, f"t;{text};holding;float32\n")
    assert points["t"]["address"] == 10 and "bits" not in points["t"] and notes == []


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("t;10-12;holding;float32", "addresses '10-12' are 3 registers and its type takes 2"),
        ("t;10.3;holding;int16", "has bit 3 and type int16 takes whole registers; write the type bool"),
        ("t;10.3;coil;bool", "has bit 3, and a coil is one bit; write its number alone"),
        ("t;10.16;holding;bool", "do not count from 0 to 15; give the bits in a column bits"),
        ("t;%MW100;holding;int16", "is the place in the memory of a PLC; write the Modbus address"),
        ("t;HR100;holding;int16", "is a number behind letters; write the number alone"),
        ("t;ten;holding;int16", "is no address; write it as 100 or 0x64, a bit as 100.3"),
    ],
)
def test_what_is_not_certain_is_left_out_with_the_remedy(tmp_path, row, said):
    points, notes = imported(tmp_path, row + "\n")
    assert list(points) == ["last"]
    (note,) = notes
    assert said in note and note.startswith("line 2: ")


def test_bits_that_count_from_one_are_left_out(tmp_path):
    points, notes = imported(tmp_path, "a;10.1;holding;bool\nb;10.16;holding;bool\n")
    assert list(points) == ["last"] and len(notes) == 2


def test_a_bit_that_a_spreadsheet_may_have_cut_is_noted_and_refused_where_it_stands_twice(tmp_path):
    points, notes = imported(tmp_path, "a;10.1;holding;bool\nb;11.1;holding;bool\nc;11.1;holding;bool\n")
    assert list(points) == ["a", "last"] and points["a"]["bits"] == [1, 1]
    assert BIT_10 in notes[0] and "stands twice" in notes[1]
    points, notes = imported(tmp_path, "a;10.1;holding;bool\nb;10.10;holding;bool\n")
    assert (points["a"]["bits"], points["b"]["bits"], notes) == ([1, 1], [10, 10], [])


def test_whole_numbers_that_a_spreadsheet_wrote_as_fractions_are_addresses(tmp_path):
    points, notes = imported(tmp_path, "a;40001.0;;int16\nb;40002.0;;int16\n", "modicon")
    assert [points[name]["address"] for name in "ab"] == [0, 1]
    assert "end in .0" in notes[0]


def test_a_bit_is_read_only_and_says_so(tmp_path):
    head = "name;address;table;type;access\n"
    points, notes = imported(tmp_path, "a;10.3;holding;bool;rw\n", head=head)
    assert "access" not in points["a"]
    assert notes == ["line 2: a: a bit of a register is read only here; its access was not used"]
