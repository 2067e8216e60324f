"""Frames of a simulated rig: cantools decodes from them what was put in."""

from __future__ import annotations

from pathlib import Path

import cantools
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.can.encoding import FrameEncoder
from drivers.rig_file.bus_sections import CanBus, CanMessage
from drivers.rig_file.model import Point

LAYOUT = """VERSION ""

NS_ :

BS_:

BU_: N

BO_ 256 MIXED: 8 N
 SG_ big : 7|13@0- (0.1,5) [0|0] "degC" N
 SG_ little : 21|11@1+ (0.25,-40) [0|0] "degC" N
 SG_ whole : 39|32@0- (1,0) [0|0] "degC" N

BO_ 2566844926 ENGINE: 8 N
 SG_ coolant : 0|8@1+ (1,-40) [-40|210] "degC" N

SIG_VALTYPE_ 256 whole : 1;
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_ "VFrameFormat" BO_ 2566844926 3;
"""


def point(signal: str, message: str = "MIXED", **more: object) -> Point:
    return Point(name=signal, bus="can", message=message, signal=signal, unit="degC", **more)


@pytest.fixture(scope="module")
def dbc(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("dbc") / "layout.dbc"
    path.write_text(LAYOUT)
    return path


@given(
    big=st.floats(-400.0, 410.0),
    little=st.floats(-40.0, 470.0),
    whole=st.floats(-1e6, 1e6, width=32),
)
def test_a_foreign_decoder_reads_every_layout(dbc: Path, big: float, little: float, whole: float) -> None:
    points = [point("big"), point("little"), point("whole")]
    bus = CanBus(transport="socketcand", dbc=dbc)
    (frame,) = FrameEncoder("can", bus, points).frames({"big": big, "little": little, "whole": whole})
    assert (frame.identifier, frame.extended) == (256, False)
    found = cantools.database.load_file(dbc).decode_message(frame.identifier, frame.data)
    assert found["big"] == pytest.approx(big, abs=0.0501)
    assert found["little"] == pytest.approx(little, abs=0.1251)
    assert found["whole"] == pytest.approx(whole)


def test_values_beyond_a_signal_become_its_ends_and_bounds_leave_indicators_out(dbc: Path) -> None:
    coolant = point("coolant", "ENGINE", scale=2.0)
    encoder = FrameEncoder("can", CanBus(transport="socketcand", dbc=dbc), [coolant])
    assert encoder.bounds("coolant") == (-80.0, 420.0)  # 0xFB to 0xFF mean that there is no value
    (frame,) = encoder.frames({"coolant": 1e4})
    assert frame.data[0] == 0xFF


def test_a_parameter_group_gets_priority_and_source(dbc: Path) -> None:
    coolant = point("coolant", "ENGINE")
    anybody = FrameEncoder("can", CanBus(transport="socketcand", dbc=dbc), [coolant])
    assert anybody.frames({"coolant": 20.0})[0].identifier == 0x18FEF100
    entry = CanMessage(name="ENGINE", pgn=0xFEF2, source=0x27)
    with pytest.raises(Exception, match="has PGN"):
        FrameEncoder("can", CanBus(transport="socketcand", dbc=dbc, message=(entry,)), [coolant])


def test_the_frame_with_the_clock_comes_last(dbc: Path) -> None:
    """Whoever waits for the time of a step then has all of its values; a read call may end between two frames."""
    bus = CanBus(transport="socketcand", dbc=dbc, uptime="whole")
    points = [point("whole"), point("coolant", "ENGINE")]
    frames = FrameEncoder("can", bus, points).frames({"whole": 7.0, "coolant": 20.0})
    assert [frame.extended for frame in frames] == [True, False]
