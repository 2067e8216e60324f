"""`hil init --from x.dbc`: messages become points, or one sentence."""

from __future__ import annotations

from pathlib import Path

from click.testing import CliRunner

from drivers.points import ConfigurationError
from drivers.rigfile import load_rig
from hil.commands.check import command as check
from hil.commands.init import command as init
from tests.drivers.import_files import table
from tests.drivers.j1939 import dbc_in

DBC = Path(__file__).resolve().parents[2] / "profiles" / "rigs" / "thermocouples.dbc"


def test_a_dbc_becomes_points_with_plausible_ranges_and_time_outs(tmp_path):
    copy, out = tmp_path / "tc.dbc", tmp_path / "rig.toml"
    copy.write_bytes(DBC.read_bytes())
    done = CliRunner().invoke(init, ["--from", str(copy), "--channel", "vcan0", "--out", str(out)])
    assert done.exit_code == 0, (done.output, done.exception)
    rig = load_rig(out)
    tank = rig.get("T_tank")
    assert (tank.message, tank.plausible, tank.stale_after_s, tank.unit) == ("TC_C", (-40.0, 150.0), 3.0, "degC")
    assert rig.bus["can"].dbc == copy
    assert CliRunner().invoke(check, [str(out)]).exit_code == 0


def test_a_dbc_that_is_none_is_said_plainly(tmp_path):
    done = CliRunner().invoke(
        init, ["--from", str(table(tmp_path, "BO_ x", "x.dbc")), "--out", str(tmp_path / "r.toml")]
    )
    assert isinstance(done.exception, ConfigurationError)
    assert "x.dbc: is not a DBC file" in str(done.exception)
    assert not (tmp_path / "r.toml").exists()


def test_j1939_messages_are_imported_by_their_pgn_and_that_is_said(tmp_path):
    out = tmp_path / "rig.toml"
    done = CliRunner().invoke(init, ["--from", str(dbc_in(tmp_path)), "--out", str(out)])
    assert done.exit_code == 0, (done.output, done.exception)
    text = out.read_text(encoding="utf-8")
    assert "ET1 is read by its PGN 0xFEEE, source any, at any priority; where several send it, give" in text
    assert "EEC1 is read by its PGN 0xF004, source 0x00, at any priority\n" in text
    assert "PLAIN is read" not in text
    done = CliRunner().invoke(check, [str(out)])
    assert done.exit_code == 0
    assert "can: ET1 is PGN 0xFEEE, source any" in done.output
