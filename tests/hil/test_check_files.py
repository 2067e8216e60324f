"""`hil check` of files: the kind that it finds, what is in a file, and what is refused with a remedy."""

from __future__ import annotations

import os
import re

import pytest

from hil.rig.element_kinds import parameters_of
from tests.hil.command_line import hil, typed
from tests.hil.input_files import ANY_RIG, EFFECT, PROJECT, TWIN, load
from twin.elements import KINDS
from twin.twinfile import load as read_twin


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "holds no key; a rig file has [rig]"),
        (
            EFFECT.replace("[[effect]]\n", "").encode(),
            "line 1: key 'kind' belongs to no effect; write [[effect]] above it",
        ),
        (
            EFFECT.replace("effect", "effects").encode(),
            "line 1: key 'effects' is unknown; write only [[effect]] tables",
        ),
        (b"\xef\xbb\xbf" + EFFECT.encode(), "begins with a byte order mark (line 1); save it as UTF-8 without one"),
        (EFFECT.replace("tank", "t\u00e4nk").encode("latin-1"), "is not UTF-8 text (line 3); save it as UTF-8"),
        (EFFECT.replace('"tank"', "tank").encode(), '(at line 3, column 9); put text in quotes, as in name = "rig"'),
    ],
)
def test_check_refuses_what_is_no_effects_file_in_one_sentence(tmp_path, content, words):
    effects = tmp_path / "effects.toml"
    effects.write_bytes(content)
    code, printed = hil("check", effects)
    assert code == 2 and words in printed and len(printed.splitlines()) == 1
    assert printed.startswith(f"hil: {effects}")


def test_check_tells_effects_in_plain_words(tmp_path):
    effects = tmp_path / "effects.toml"
    effects.write_text(EFFECT + "onset_s = 60\nramp_s = 30\nend_s = 600\n", encoding="utf-8")
    code, printed = hil("check", effects)
    said = "effect 1: heat_source at tank, constant: power_W = 5; from 60 s to 600 s, growing for 30 s"
    assert code == 0 and printed.splitlines()[0] == said


@pytest.mark.parametrize("kind", ["ambient_loss", "conduction", "flow"])
def test_what_an_element_says_of_its_parameters_is_of_no_single_rig(kind):
    assert not [spec for spec, _ in parameters_of(KINDS[kind]) if "Table" in spec.source]


def test_check_takes_a_file_or_kinds(tmp_path):
    code, printed = hil("check")
    assert code == 2 and "give a file to check, or --kinds" in printed
    code, printed = hil("check", "--kinds", TWIN)
    assert code == 2 and "leave" in printed


def test_every_kind_is_listed_with_keys_parameters_units_and_bounds():
    code, printed = hil("check", "--kinds")
    assert code == 0
    for kind, cls in KINDS.items():
        assert f" {kind} " in printed
        for key in cls.places():
            assert f" {key} " in printed
    for network in map(read_twin, sorted(TWIN.parent.glob("*.toml"))):
        for parameter in network.parameters.values():
            name = re.sub(r"^effectiveness_.*", "effectiveness_<node>", parameter.name)
            assert f" {name} " in printed, parameter.id
    rows = [line.split() for line in printed.splitlines()]
    assert any(row[:5] == ["capacitance", "J/K", "1", "to", "1e+09"] for row in rows)
    only = {spec.name: only for spec, only in parameters_of(KINDS["heat_source"])}
    assert only["night"] == "with driver, law = daylight" and only["power"] == "without driver"
    assert parameters_of(KINDS["sensor"])[-1][1] == "with other"


@pytest.mark.parametrize(
    ("name", "header"),
    [
        ("a.csv", "Time [s],heater_1_pct,T1_C"),
        ("a.csv", "time_s,heater_1_pct,T1_C"),
        ("a.csv", "time_s,heater_1_pct,T1_F"),
        ("a.tsv", "time_s\theater_1_pct\tT1_C"),
        ("a.txt", "Time (min);heater_1_pct;T1 [°C]"),
    ],
)
def test_a_table_with_temperatures_is_checked_as_a_record(tmp_path, name, header):
    path = tmp_path / name
    between = next(mark for mark in ",;\t" if mark in header)
    path.write_text(header + "".join(f"\n{row},50,20".replace(",", between) for row in range(3)), encoding="utf-8")
    code, printed = hil("check", path)
    assert code == 0 and "3 samples" in printed


def test_a_table_whose_first_column_has_no_name_says_so(tmp_path):
    code, printed = hil("check", load(tmp_path, ",heater_1_pct,T1_C\n0,50,20\n1,50,21\n"))
    assert code == 2 and "the first column has no name" in printed and "time_s" in printed


def test_a_record_with_tabs_between_columns_is_checked_as_a_record(tmp_path):
    path = load(tmp_path, "time_s\tT_tank_C\n0\t20\n1\t21\n")
    code, printed = hil("check", path)
    assert code == 0 and "2 samples" in printed


@pytest.mark.parametrize(
    ("name", "content", "kind"),
    [
        ("a.toml", "[pump]\nspeed = 3\n", "checked as a rig file, since it has no [elements]"),
        ("a.csv", "time_s,tank\n0,20\n900,21\n", "checked as a load profile, since no column is a temperature"),
        ("a.csv", "T_tank_C\nwarm\nwarmer\n", "checked as a record, since it is Parquet or has a column"),
    ],
)
def test_check_names_the_kind_of_file_that_it_guessed_before_it_complains(tmp_path, name, content, kind):
    path = tmp_path / name
    path.write_text(content, encoding="utf-8")
    code, printed = hil("check", path)
    assert code != 0
    assert printed.splitlines()[0].startswith(f"{path}: {kind}")


def test_check_names_no_kind_where_a_key_says_it(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text('[rig]\nname = "r"\n', encoding="utf-8")
    assert "checked as" not in hil("check", path)[1]


@pytest.mark.parametrize("name", ["load.csv", "rig.toml", "record.parquet"])
def test_a_pipe_in_the_place_of_a_file_holds_up_no_check(tmp_path, name):
    os.mkfifo(tmp_path / name)
    code, said = hil("check", tmp_path / name)
    assert (code, "it is a pipe, no regular file" in said) == (2, True)


def test_a_profile_of_more_than_ten_years_is_refused_with_its_line(tmp_path):
    (tmp_path / "load.csv").write_text("time_s,heater_power_W\n0,100\n1e30,100\n")
    code, said = hil("check", tmp_path / "load.csv")
    assert code == 2 and "load.csv line 3 is at 1e+30 s, more than ten years" in said


def test_a_name_with_control_characters_is_refused_and_reaches_no_terminal(tmp_path):
    text = (PROJECT / "profiles/rigs/virtual.toml").read_text(encoding="utf-8")
    first = next(line for line in text.splitlines() if line.startswith("name = "))
    rig = load(tmp_path, text.replace(first, 'name = "a\\u001b[2Jb"', 1))
    rig = rig.rename(tmp_path / "rig.toml")
    done = typed("check", rig)
    assert done.returncode == 2 and "control character" in done.stderr and "\x1b" not in done.stderr


TELEGRAF = '[[inputs.modbus]]\nname = "d"\n'


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.toml", TELEGRAF, "is a Telegraf configuration; `hil init --from {path}` makes a rig file of it"),
        ("a.yaml", "modbus:\n", "is no rig file; `hil init --from {path}` makes one of it"),
        ("a.csv", "name,address,type\nt,1,int16\n", "is a register table; `hil init --from {path}`"),
        ("a.csv", "0,20.5,700\n30,20.6,700\n", "holds numbers where column names should stand; add a header line"),
        ("a.csv", "time_s,0,30,60\nT_in_C,20,21,22\n", "the table lies on its side; transpose it"),
        ("a.xls", b"\xd0\xcf\x11\xe0\xa1\xb1", "is a spreadsheet of old Excel; save the sheet as CSV"),
        ("a.mat", b"MATLAB 5.0 MAT-file", "is a MATLAB file; save its table as CSV (writetable)"),
        ("a.mf4", b"MDF     4.10", "is an MDF file; export its channels as CSV or Parquet"),
        (
            "a.toml",
            ANY_RIG.format(
                "modbus_rtu", 'serial_port = "/dev/ttyS0"\nhost = "10.0.0.5"', 'table = "input"\naddress = 1'
            ),
            "host: is no key of transport 'modbus_rtu', but of modbus_tcp",
        ),
        (
            "a.toml",
            ANY_RIG.format("modbus_tcp", "", 'table = "input"\naddres = 1'),
            "addres of point t: is not a key of this section; did you mean address?",
        ),
    ],
)
def test_check_names_what_a_file_is_and_what_to_do_with_it(tmp_path, name, content, said):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    code, printed = hil("check", path)
    assert code == 2
    assert said.format(path=path) in printed
    assert "checked as" not in printed


@pytest.mark.parametrize(
    ("names", "rows", "is_record"),
    [
        ("timestamp;A1;A2", "2026-03-04 10:{k:02}:00;20.5;7{k}", True),
        ("Time\tFlow\tPressure", "{k}\t3.{k}\t1.2", True),
        ("time_s,T1,T2", "{k},20.{k},21", True),
        ("Time [s],Heater power [W]", "{k},700", False),
        ("time,heater_power_W", "{k},700", False),
    ],
)
def test_a_table_without_a_set_point_of_the_rig_is_a_record(tmp_path, names, rows, is_record):
    path = tmp_path / "a.csv"
    path.write_text(names + "\n" + "".join(rows.format(k=k) + "\n" for k in range(20)), encoding="utf-8")
    code, printed = hil("check", path)
    assert (code == 0 and "20 samples" in printed) if is_record else "checked as a load profile" in printed


def test_lines_that_stand_in_quotes_as_a_whole_are_read_without_them(tmp_path):
    path = tmp_path / "a.csv"
    rows = "".join(f'"{k},20.{k},""ok"""\n' for k in range(20))
    path.write_text('"time_s,T_tank_C,remark"\n' + rows, encoding="utf-8")
    code, printed = hil("check", path)
    assert code == 0
    assert "each line stands in quotes: read without them" in printed and "T_tank_C: 20 to 20.9" in printed
