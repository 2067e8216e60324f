"""Lines among the rows of a CSV that are no rows: second headings, second lines of units, comments."""

from __future__ import annotations

import numpy as np
import pytest

from hil.record.raw import RecordError
from hil.record.reader import read_record

HEAD = "Time;heater;T_tank\ns;W;°C\n"
FIRST = "0;500;20.0\n10;510;20.5\n20;520;21.0\n"
NEXT_SI = "30;0.530;71.6\n40;0.540;73.4\n"
POWER = [500.0, 510.0, 520.0, 530.0, 540.0]
TANK = [20.0, 20.5, 21.0, 22.0, 23.0]


def read(tmp_path, text):
    path = tmp_path / "record.csv"
    path.write_text(text, encoding="utf-8")
    return read_record(path)


@pytest.mark.parametrize("between", ["Time;heater;T_tank\ns;kW;°F\n", "s;kW;°F\n"])
def test_numbers_below_a_second_line_of_units_are_converted(tmp_path, between):
    record = read(tmp_path, HEAD + FIRST + between + NEXT_SI)
    assert np.allclose(record.columns["heater_W"], POWER)
    assert np.allclose(record.columns["T_tank_C"], TANK)
    assert any("gives the unit kW: 2 values below it are converted" in said for said in record.messages)


def test_units_that_come_back_end_the_conversion(tmp_path):
    text = HEAD + FIRST + "s;kW;°F\n" + NEXT_SI + "s;W;°C\n50;550;23.5\n"
    record = read(tmp_path, text)
    assert np.allclose(record.columns["heater_W"], [*POWER, 550.0])
    assert np.allclose(record.columns["T_tank_C"], [*TANK, 23.5])


def test_only_the_columns_whose_unit_changes_are_converted(tmp_path):
    record = read(tmp_path, HEAD + FIRST + "Time;heater;T_tank\ns;W;°F\n30;530;71.6\n40;540;73.4\n")
    assert np.allclose(record.columns["heater_W"], POWER)
    assert np.allclose(record.columns["T_tank_C"], TANK)


def test_a_heading_with_units_in_its_names_takes_a_line_of_other_units(tmp_path):
    record = read(tmp_path, "time_s,heater_W,T_tank_C\n0,500,20\n10,510,21\ns,kW,°C\n20,0.52,22\n30,0.53,23\n")
    assert np.allclose(record.columns["heater_W"], [500.0, 510.0, 520.0, 530.0])


def test_a_second_heading_with_equal_units_is_one_quiet_note(tmp_path):
    record = read(tmp_path, HEAD + FIRST + HEAD + "30;530;22.0\n40;540;23.0\n")
    assert np.allclose(record.columns["heater_W"], POWER)
    assert "a second heading at line 6" in record.messages
    assert not any("no readable time" in said or "no number" in said for said in record.messages)


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("s;bar;°C\n", r"line 6 gives 'bar' for column 'heater' where the top of the file has 'W'"),
        ("ms;W;°C\n", r"line 6 gives 'ms' for the times 'Time' where the top of the file has 's'"),
        ("s;W;furlongs\n", r"line 6 gives 'furlongs' for column 'T_tank'"),
    ],
)
def test_units_that_cannot_be_converted_are_refused_with_their_line(tmp_path, line, why):
    with pytest.raises(RecordError, match=why):
        read(tmp_path, HEAD + FIRST + line + "30;530;22.0\n40;540;23.0\n")


def test_a_unit_below_rows_without_one_is_refused(tmp_path):
    with pytest.raises(RecordError, match=r"line 4 gives 'kW' for column 'heater' .* 'no unit'"):
        read(tmp_path, "time_s,heater,T_tank_C\n0,500,20\n10,510,21\ns,kW,°C\n20,0.52,22\n30,0.53,23\n")


@pytest.mark.parametrize("comment", ["# pump cleaned\n", "# pump cleaned;;\n"])
def test_a_comment_among_the_rows_is_shown_with_its_line(tmp_path, comment):
    record = read(tmp_path, HEAD + FIRST + comment + "30;530;22.0\n40;540;23.0\n")
    assert "line 6 is a comment among the rows: '# pump cleaned'" in record.messages
    assert len(record.time_s) == 5


def test_rows_below_a_left_out_line_keep_their_line_numbers(tmp_path):
    record = read(tmp_path, HEAD + FIRST + HEAD + "30;530;22.0\n40;x;23.0\n50;550;23.5\n")
    assert any("line 9, is 'x'" in said for said in record.messages)


def test_a_row_that_was_cut_before_a_second_heading_is_counted_and_a_preamble_is_not(tmp_path):
    cut = read(tmp_path, HEAD + FIRST + "30;5\n" + HEAD + "40;540;23.0\n50;550;23.5\n")
    assert any("1 line has not the 3 fields" in said and "line 6" in said for said in cut.messages)
    own = read(tmp_path, HEAD + FIRST + "Logger;7\n" + HEAD + "40;540;23.0\n50;550;23.5\n")
    assert "a second heading at line 7" in own.messages
    assert not any("fields" in said for said in own.messages)
