"""Bad input at the command line: one plain sentence with place and remedy, exit 2 or 1, nothing moved, nothing lost."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from hil.cli import group
from hil.record.reader import Record, read_record, write_record
from hil.rig.element_kinds import parameters_of
from tests.hil.command_line import typed
from twin.elements import KINDS
from twin.twinfile import load as read_twin

PROJECT = Path(__file__).resolve().parents[2]
RIG = PROJECT / "profiles" / "rigs" / "virtual.toml"
TWIN = PROJECT / "profiles" / "twins" / "virtual.toml"
GOOD_LOAD = "time_s,heater_power_W,pump_speed_pct,fan_speed_pct\n0,700,100,70\n900,700,100,70\n"


def hil(*arguments: object) -> tuple[int, str]:
    """Exit code and everything printed."""
    done = typed(*arguments)
    return done.returncode, done.stdout + done.stderr


def load(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "load.csv"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            GOOD_LOAD.replace("heater_power_W", "heatre_power_W"),
            ["load.csv", "heatre_power", "did you mean heater_power"],
        ),
        (GOOD_LOAD.replace("heater_power_W", "heater_power"), ["load.csv", "line 1", "heater_power", "unit"]),
        (GOOD_LOAD.replace("heater_power_W", "heater_power_kW"), ["heater_power", "kW", "W"]),
        (GOOD_LOAD.replace("0,700", "0,1700"), ["load.csv", "line 2", "1700", "1000"]),
        (GOOD_LOAD.replace("900,700", "300,700"), ["load.csv", "300", "600"]),
        (GOOD_LOAD.replace("900,700", "900,x"), ["load.csv", "line 3", "x"]),
        (GOOD_LOAD.replace("0,700", "5,700"), ["load.csv", "line 2", "0"]),
        (GOOD_LOAD.replace(",", ";"), ["load.csv", "line 1"]),
        ("", ["load.csv", "empty"]),
    ],
)
def test_a_bad_profile_is_refused_before_anything_moves(tmp_path, text, words):
    runs = tmp_path / "runs"
    code, printed = hil("run", load(tmp_path, text), "--virtual", "--lockstep", "--runs", runs)
    assert code == 2
    for word in words:
        assert word in printed
    assert "Traceback" not in printed
    assert not runs.exists()


def test_a_rig_that_cannot_be_reached_is_one_sentence_a_bus_and_nothing_else(tmp_path):
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        port = holder.getsockname()[1]
    text = (
        RIG.read_text(encoding="utf-8")
        .replace("port = 5020", f"port = {port}")
        .replace("port = 29536", f"port = {port}")
    )
    rig = tmp_path / "rig.toml"
    rig.write_text(text.replace('"thermocouples.dbc"', f'"{RIG.parent / "thermocouples.dbc"}"'), encoding="utf-8")
    code, printed = hil("run", load(tmp_path, GOOD_LOAD), "--rig", rig, "--no-twin", "--runs", tmp_path / "runs")
    assert code == 1
    assert f"plc (Modbus/TCP 127.0.0.1:{port}, device 1) cannot be reached" in printed
    assert f"thermocouples (socketcand 127.0.0.1:{port}/vcan0) cannot be opened" in printed
    assert "Traceback" not in printed


@pytest.mark.parametrize("option", ["--modbus-port", "--can-port", "--control-port"])
def test_a_port_in_use_is_named(option):
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        holder.listen()
        port = holder.getsockname()[1]
        ports = {"--modbus-port": 0, "--can-port": 0, "--control-port": 0} | {option: port}
        arguments = [str(item) for pair in ports.items() for item in pair]
        done = subprocess.run(
            [sys.executable, "-m", "hil", "rig", *arguments], capture_output=True, text=True, timeout=60, cwd=PROJECT
        )
    assert done.returncode == 1
    assert str(port) in done.stderr
    assert "in use" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run", "none.csv"], ["none.csv: there is no such file"]),
        (["run", "{load}", "--lockstep"], ["lockstep time needs a rig whose time can be set; add --virtual"]),
        (["run", "{load}", "--lockstep", "--speed", "3"], ["exclude each other"]),
        (["run", "{load}", "--virtual", "--speed", "0"], ["--speed 0 is not between 0 and 100"]),
        (["run", "{load}", "--virtual", "--speed", "300"], ["use --lockstep to go faster"]),
        (["run", "{load}", "--virtual", "--calibrator", "psso"], ["no calibrator psso; there are pso"]),
        (["run", "{load}", "--with", "profiles/effects/pump_heat.toml"], ["give --virtual too"]),
        (["run", "{load}", "--virtual", "--twin", "{rig}"], ["virtual.toml"]),
        (["check", "{load}.x"], ["there is no such file"]),
        (["review", "{here}"], ["is not a run folder"]),
        (["cheque"], ["did you mean check?"]),
        (["commission", "{load}", "--out", "x.toml"], ["give --twin, --datasheet or both"]),
    ],
)
def test_wrong_use_is_explained(tmp_path, arguments, words):
    places = {"load": load(tmp_path, GOOD_LOAD), "rig": RIG, "here": tmp_path}
    code, printed = hil(*(argument.format(**places) for argument in arguments))
    assert code == 2
    for word in words:
        assert word in printed
    assert "Traceback" not in printed


EFFECT = '[[effect]]\nkind = "heat_source"\nwhere = "tank"\ndriver = "constant"\npower_W = 5.0\n'


@pytest.mark.parametrize("more", [["--check-only"], ["--no-viewer"]])
def test_a_bad_effects_file_is_refused_before_anything_is_written(tmp_path, more):
    effects, runs = tmp_path / "effects.toml", tmp_path / "runs"
    effects.write_text(EFFECT.replace("tank", "T_tank_C"), encoding="utf-8")
    command = ["run", load(tmp_path, GOOD_LOAD), "--virtual", "--lockstep", "--no-twin", "--with", effects]
    code, printed = hil(*command, "--runs", runs, *more)
    assert code == 2 and printed.startswith(f"hil: {effects}, line 3: effect 1: key 'where' is 'T_tank_C'; use one of")
    assert len(printed.splitlines()) == 1 and not runs.exists()


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


def test_a_run_on_a_wire_that_the_virtual_rig_does_not_serve_is_refused(tmp_path):
    rig = tmp_path / "rig.toml"
    text = RIG.read_text(encoding="utf-8")
    text = text.replace('transport = "modbus_tcp"\nhost', 'transport = "modbus_rtu_tcp"\nhost')
    text = text.replace('"thermocouples.dbc"', f'"{RIG.parent / "thermocouples.dbc"}"')
    text = text.replace('twin = "../twins/virtual.toml"\n', "")
    rig.write_text(text, encoding="utf-8")
    code, printed = hil("run", load(tmp_path, GOOD_LOAD), "--virtual", "--rig", rig, "--runs", tmp_path / "runs")
    assert code == 2
    assert "bus plc is Modbus RTU over TCP 127.0.0.1:5020, which --virtual does not start" in printed


def healthy_record(tmp_path: Path, **changes: np.ndarray | None) -> Path:
    time_s = np.arange(0.0, 3000.0)
    columns: dict[str, np.ndarray] = {
        "heater_power_W": np.full(3000, 700.0),
        "pump_speed_pct": np.full(3000, 100.0),
        "fan_speed_pct": np.full(3000, 70.0),
        "T_ambient_C": np.full(3000, 21.0),
    }
    for name in ("heater", *(f"pm{i}" for i in range(1, 7)), "radiator", "tank"):
        columns[f"T_{name}_C"] = 30.0 + time_s / 1000
    for name, values in changes.items():
        if values is None:
            del columns[name]
        else:
            columns[name] = values
    path = tmp_path / "record.parquet"
    write_record(Record(time_s, columns), path)
    return path


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


@pytest.mark.parametrize("kind", ["ambient_loss", "conduction", "flow"])
def test_what_an_element_says_of_its_parameters_is_of_no_single_rig(kind):
    assert not [spec for spec, _ in parameters_of(KINDS[kind]) if "Table" in spec.source]


def test_a_twin_is_never_overwritten(tmp_path):
    out = tmp_path / "new.toml"
    out.write_text("mine", encoding="utf-8")
    code, printed = hil("commission", healthy_record(tmp_path), "--twin", TWIN, "--out", out)
    assert code == 2
    assert "exists already" in printed
    assert out.read_text(encoding="utf-8") == "mine"


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
    assert code == 2 and "no twin is written: the record identifies none of the 13 tunables" in printed
    assert not list(tmp_path.glob("new*"))


def test_a_record_with_tabs_between_columns_is_checked_as_a_record(tmp_path):
    path = load(tmp_path, "time_s\tT_tank_C\n0\t20\n1\t21\n")
    code, printed = hil("check", path)
    assert code == 0 and "2 samples" in printed


@pytest.mark.parametrize("verb", ["check", "commission", "profile", "review", "rig", "run", "track", "twin"])
def test_every_verb_has_help_with_an_example(verb):
    result: Result = CliRunner().invoke(group, [verb, "--help"])
    assert result.exit_code == 0
    assert "Example" in result.output
    assert f"hil {verb}" in result.output


def test_help_says_which_steady_states_are_held_out():
    printed = " ".join(CliRunner().invoke(group, ["diagnose", "--help"]).output.split())
    assert "every fourth is held out of every fit" in printed


def test_help_loads_no_heavy_library():
    heavy = "{'torch', 'rerun', 'scipy', 'numba', 'pymodbus', 'can', 'cantools', 'pyarrow', 'matplotlib', 'numpy'}"
    program = (
        "import sys\nfrom click.testing import CliRunner\nfrom hil.cli import group\n"
        "assert CliRunner().invoke(group, ['--help']).exit_code == 0\n"
        f"found = {heavy} & set(sys.modules)\nassert not found, found"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=PROJECT, timeout=60)
    assert done.returncode == 0, done.stderr


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


ANY_RIG = '[rig]\nname = "r"\n[bus.b]\ntransport = "{}"\n{}\n[[point]]\nname = "t"\nbus = "b"\nunit = "1"\n{}\n'
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


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("run", "a.toml"), "is no load profile; give a CSV, a rig file with --rig"),
        (("track", "a.toml"), "is no record; give a run folder or a record first, and a twin with --twin"),
        (("init", "--from", "a.toml", "--out", "b.toml"), "is a rig file already"),
        (("run", "load.csv", "--rig", "twin.toml"), "is a twin file and no rig file; give it with --twin"),
    ],
)
def test_a_file_in_the_place_of_another_is_named_as_what_it_is(tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.toml").write_text(ANY_RIG.format("modbus_tcp", "", 'table = "input"\naddress = 1'), encoding="utf-8")
    (tmp_path / "twin.toml").write_text('[inputs]\n[elements.tank]\nkind = "tank"\n', encoding="utf-8")
    (tmp_path / "load.csv").write_text("time_s,heater_power_W\n0,0\n600,0\n", encoding="utf-8")
    code, printed = hil(*arguments)
    assert code == 2
    assert said in printed
