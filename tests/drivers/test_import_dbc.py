"""`hil init --from x.dbc`: messages become points, or one sentence."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from drivers.can.dbc import bind
from drivers.rig_file.reader import load_rig
from drivers.signals.points import ConfigurationError
from hil.cli.rig_commands.check import command as check
from hil.cli.rig_commands.init import command as init
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
    assert "x.dbc, line 1: is not a DBC file" in str(done.exception)
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


HEAD = """\
VERSION ""

BS_:

BU_: PLC PC

"""
GOOD = """\
BO_ 300 Tank: 2 PLC
 SG_ T_wall : 0|16@1- (0.01,0) [-40|200] "degC" PC

"""


def imported(tmp_path: Path, text: str, encoding: str = "utf-8") -> tuple[list[str], list[str]]:
    """Return the points and the notes of a DBC file whose rig file `hil check` accepts."""
    source, out = tmp_path / "bus.dbc", tmp_path / "rig.toml"
    source.write_bytes((HEAD + text).encode(encoding))
    done = CliRunner().invoke(init, ["--from", str(source), "--out", str(out)])
    assert done.exit_code == 0, (done.output, done.exception)
    assert CliRunner().invoke(check, [str(out)]).exit_code == 0
    notes = [line.removeprefix("note: bus.dbc, ") for line in done.output.splitlines() if line.startswith("note: ")]
    return [point.name for point in load_rig(out).point], notes


def test_signals_that_share_bits_are_each_read_by_themselves(tmp_path):
    text = """\
BO_ 301 Pump: 2 PLC
 SG_ Status : 0|8@1+ (1,0) [0|255] "" PC
 SG_ Blocked : 7|1@1+ (1,0) [0|1] "" PC
 SG_ Speed : 8|8@1+ (10,0) [0|2550] "rpm" PC
"""
    points, notes = imported(tmp_path, text)
    assert points == ["Status", "Blocked", "Speed"]
    assert [note.split(";")[0] for note in notes] == [
        "line 8: Status shares bits with Blocked",
        "line 9: Blocked shares bits with Status",
    ]
    rig = load_rig(tmp_path / "rig.toml")
    (bound,) = bind("can", rig.bus["can"], rig.point)
    assert bound.decode(bytes([0x81, 12])) == {"Status": 129.0, "Blocked": 1.0, "Speed": 120.0}


def test_a_message_longer_than_a_frame_is_left_out_alone(tmp_path):
    text = 'BO_ 302 Cells: 24 PLC\n SG_ U_1 : 0|16@1+ (0.001,0) [0|5] "V" PC\n\n' + GOOD
    points, notes = imported(tmp_path, text)
    assert points == ["T_wall"]
    assert len(notes) == 1
    assert notes[0].startswith("line 7: message Cells: has 24 bytes and a frame carries 8")


def test_an_encoding_that_is_not_utf8_is_tried_named_and_kept(tmp_path):
    text = GOOD.replace('"degC"', '"°C"') + 'CM_ SG_ 300 T_wall "Wärme";\n'
    points, notes = imported(tmp_path, text, "cp1252")
    assert points == ["T_wall"]
    assert notes == ["it is no UTF-8 text and was read as cp1252; look at its names and units"]
    rig = load_rig(tmp_path / "rig.toml")
    assert (rig.bus["can"].dbc_encoding, rig.get("T_wall").unit, rig.get("T_wall").doc) == ("cp1252", "degC", "Wärme")


@pytest.mark.parametrize(
    ("bad", "said"),
    [
        (' SG_ T_air : 16|16@1- (0.01,0) [-40|200] "degC"', "line 9: T_air: names no receiver after its unit"),
        (' SG_ T_air : 16|16@1- (0.01,0) [-40|200 "degC" PC', "line 9: T_air: is no signal as DBC files have them"),
        (' SG_ T_air : 16|80@1- (0.01,0) [-40|200] "degC" PC', "line 9: T_air: has 80 bits"),
        (' SG_ T_air : 60|16@1- (0.01,0) [-40|200] "degC" PC', "line 9: T_air: does not fit in the 4 bytes of Tank"),
        (' SG_ T_air : 16|16@1- (0,0) [-40|200] "degC" PC', "line 9: T_air: has a factor that loses the value"),
        (' SG_ T_wall : 16|16@1- (0.01,0) [-40|200] "degC" PC', "line 9: T_wall: a second signal of this name"),
        (' SG_ T_air : 16|16@1- (0.01,0) [-40|200] "furlong" PC', "line 9: T_air: unit 'furlong' is not known"),
        ('BO_ 9000 Wide: 2 PLC\n SG_ w : 0|8@1+ (1,0) [0|9] "" PC', "line 9: Wide: id 9000 has more than 11 bits"),
        ('BO_ 310 Tank: 2 PLC\n SG_ w : 0|8@1+ (1,0) [0|9] "" PC', "line 9: Tank: a second message of this name"),
    ],
)
def test_a_bad_line_of_a_dbc_does_not_take_its_neighbours(tmp_path, bad, said):
    points, notes = imported(tmp_path, GOOD.replace("Tank: 2", "Tank: 4").rstrip("\n") + f"\n{bad}\n")
    assert points == ["T_wall"]
    assert len(notes) == 1
    assert notes[0].startswith(said)
    assert notes[0].endswith("(left out)")


def test_messages_that_one_frame_could_be_are_left_out_both(tmp_path):
    text = (
        GOOD
        + GOOD.replace("Tank", "Twin").replace("T_wall", "T_twin")
        + GOOD.replace("300 Tank", "305 Air").replace("T_wall", "T_air")
    )
    points, notes = imported(tmp_path, text)
    assert points == ["T_air"]
    assert [note.split("; ")[0] for note in notes] == [
        "line 7: message Tank: a frame could be it and Twin",
        "line 10: message Twin: a frame could be it and Tank",
    ]


def test_a_dbc_whose_only_signal_is_bad_is_refused_with_its_line(tmp_path):
    source = table(tmp_path, HEAD + GOOD.replace(" PC", ""), "bus.dbc")
    done = CliRunner().invoke(init, ["--from", str(source), "--out", str(tmp_path / "r.toml")])
    assert "bus.dbc, line 8: T_wall: names no receiver after its unit" in str(done.exception)


def test_a_point_on_a_line_that_cannot_be_used_names_that_line(tmp_path):
    imported(tmp_path, GOOD)
    text = (tmp_path / "bus.dbc").read_text(encoding="utf-8")
    (tmp_path / "bus.dbc").write_text(text.replace('"degC" PC', '"degC"'), encoding="utf-8")
    done = CliRunner().invoke(check, [str(tmp_path / "rig.toml")])
    assert "bus.dbc, line 8: T_wall: names no receiver after its unit" in (done.output + str(done.exception))


def test_signals_that_no_message_carries_are_noted(tmp_path):
    orphans = "BO_ 3221225472 VECTOR__INDEPENDENT_SIG_MSG: 0 Vector__XXX\n"
    points, notes = imported(tmp_path, GOOD + orphans + ' SG_ lost : 0|8@1+ (1,0) [0|0] "" Vector__XXX\n')
    assert points == ["T_wall"]
    assert notes == ["line 11: lost: no message carries it; move it into one (left out)"]


ODD_NAMES = """VERSION ""

NS_ :

BS_:

BU_: Gerät HMI

BO_ 1008 Kühler: 4 Gerät
 SG_ T_Rücklauf : 0|16@1- (0.1,0) [-40|200] "degC" HMI
 SG_ flow : 16|16@1+ (0.1,0) [0|200] "L/min" HMI

CM_ SG_ 1008 T_Rücklauf "Fühler im Rücklauf";
"""


def test_names_of_a_dbc_beyond_a_to_z_are_read_and_noted(tmp_path):
    out = tmp_path / "rig.toml"
    done = CliRunner().invoke(init, ["--from", str(table(tmp_path, ODD_NAMES, "x.dbc")), "--out", str(out)])
    assert done.exit_code == 0, (done.output, done.exception)
    assert "line 10: T_Ruecklauf is called 'T_Rücklauf'" in done.output
    rig = load_rig(out)
    assert [point.name for point in rig.point] == ["T_Ruecklauf", "flow"]
    assert rig.get("T_Ruecklauf").doc == "Fühler im Rücklauf"
    assert CliRunner().invoke(check, [str(out)]).exit_code == 0


def test_a_comment_that_cannot_be_read_costs_no_signal(tmp_path):
    out = tmp_path / "rig.toml"
    text = ODD_NAMES.replace("im Rücklauf", 'im "kalten" Rücklauf')
    done = CliRunner().invoke(init, ["--from", str(table(tmp_path, text, "x.dbc")), "--out", str(out)])
    assert done.exit_code == 0, (done.output, done.exception)
    assert "line 13: a comment: is none as DBC files have them; correct the line (left out)" in done.output
    assert [point.name for point in load_rig(out).point] == ["T_Ruecklauf", "flow"]
