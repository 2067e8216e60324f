"""Bad input at the command line: one plain sentence with place and remedy, exit 2 or 1, nothing moved, nothing lost."""

from __future__ import annotations

import socket
import subprocess
import sys

import click
import pytest
from click.testing import CliRunner

from hil.cli.verbs import group
from tests.hil.command_line import hil
from tests.hil.input_files import ANY_RIG, EFFECT, GOOD_LOAD, PROJECT, RIG, load


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


@pytest.mark.parametrize("more", [["--check-only"], ["--no-viewer"]])
def test_a_bad_effects_file_is_refused_before_anything_is_written(tmp_path, more):
    effects, runs = tmp_path / "effects.toml", tmp_path / "runs"
    effects.write_text(EFFECT.replace("tank", "T_tank_C"), encoding="utf-8")
    command = ["run", load(tmp_path, GOOD_LOAD), "--virtual", "--lockstep", "--no-twin", "--with", effects]
    code, printed = hil(*command, "--runs", runs, *more)
    assert code == 2 and printed.startswith(f"hil: {effects}, line 3: effect 1: key 'where' is 'T_tank_C'; use one of")
    assert len(printed.splitlines()) == 1 and not runs.exists()


def test_effects_of_the_virtual_rig_are_refused_for_a_rig_that_is_served_by_its_file(tmp_path):
    rig = tmp_path / "rig.toml"
    text = RIG.read_text(encoding="utf-8")
    text = text.replace('transport = "modbus_tcp"\nhost', 'transport = "modbus_rtu_tcp"\nhost')
    text = text.replace('"thermocouples.dbc"', f'"{RIG.parent / "thermocouples.dbc"}"')
    text = text.replace('twin = "../twins/virtual.toml"\n', "")
    rig.write_text(text, encoding="utf-8")
    effects = tmp_path / "effects.toml"
    effects.write_text(EFFECT, encoding="utf-8")
    command = ["run", load(tmp_path, GOOD_LOAD), "--virtual", "--lockstep", "--rig", rig, "--with", effects]
    code, printed = hil(*command, "--runs", tmp_path / "runs")
    assert code == 2
    assert f"--with changes the built-in virtual rig, and {rig} describes another; take --with out" in printed
    assert not (tmp_path / "runs").exists()


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


@pytest.mark.parametrize(
    ("raised", "code", "said"),
    [(KeyboardInterrupt, 130, "hil: interrupted"), (click.Abort, 130, "hil: interrupted before all questions")],
)
def test_ctrl_c_is_told_from_a_fault_that_was_found(tmp_path, monkeypatch, raised, code, said):
    def stopped(*_: object, **__: object) -> None:
        raise raised

    monkeypatch.setattr("hil.cli.run_commands.ls.command.callback", stopped)
    done = CliRunner().invoke(group, ["ls", str(tmp_path)])
    assert (done.exit_code, done.output.startswith(said)) == (code, True)


def test_an_input_that_ends_before_all_questions_asks_for_options(tmp_path, monkeypatch):
    monkeypatch.setattr("hil.cli.run_commands.ls.command.callback", lambda *_, **__: click.prompt("name"))
    done = CliRunner().invoke(group, ["ls", str(tmp_path)], input="")
    assert done.exit_code == 2 and "the input ended before all questions were answered" in done.output
