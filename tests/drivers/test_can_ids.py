"""Which frames are a message: identifiers with masks, PGNs of J1939, and messages that would take each other's."""

from __future__ import annotations

import asyncio
import errno
import gc
import math
from pathlib import Path

import can
import cantools.j1939
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from drivers.can.bus import CanReceiver
from drivers.can.wire import CanWire, failure_reason
from drivers.rig.watch import RigWatch
from drivers.rig_file.bus_sections import CanMessage
from drivers.rig_file.can_ids import EXTENDED_BITS, STANDARD_BITS, IdMatch, by_id, by_j1939, by_pgn, is_pdu1, pgn_of
from drivers.rig_file.model import Point
from drivers.rig_file.reader import load_rig
from drivers.signals.points import ConfigurationError, LinkError, Quality
from hil.cli.rig_commands.check import command as check
from tests.drivers.j1939 import EEC1, ET1, POINTS, dbc_in, et1, section

identifiers = st.integers(0, EXTENDED_BITS)
masks = st.none() | identifiers | st.sampled_from([0, 1, 0x7F0, 0x03FFFF00])
matches = st.builds(by_id, identifiers, st.booleans(), masks) | st.builds(
    by_pgn, st.integers(0, 0x3FFFF).map(lambda p: pgn_of(p << 8)), st.none() | st.integers(0, 253)
)


def fields(identifier: int) -> cantools.j1939.FrameId:
    return cantools.j1939.frame_id_unpack(identifier)


@given(identifier=identifiers)
def test_the_pgn_is_that_of_cantools(identifier):
    assert pgn_of(identifier) == cantools.j1939.pgn_from_frame_id(identifier)


@given(
    identifier=identifiers,
    priority=st.integers(0, 7),
    source=st.integers(0, 253),
    destination=st.integers(0, 255),
)
def test_a_pgn_matches_any_priority_and_what_of_source_and_destination_is_open(
    identifier, priority, source, destination
):
    found = fields(identifier)
    pgn = pgn_of(identifier)
    sent = found._replace(priority=priority, source_address=source)
    if is_pdu1(pgn):
        sent = sent._replace(pdu_specific=destination)
    frame = cantools.j1939.frame_id_pack(*sent)
    assert by_pgn(pgn).matches(frame, True)
    assert not by_pgn(pgn).matches(frame, False)
    assert by_pgn(pgn, source).matches(frame, True)
    assert not by_pgn(pgn, (source + 1) % 254).matches(frame, True)
    if is_pdu1(pgn):
        assert by_pgn(pgn, source, destination).matches(frame, True)
        assert not by_pgn(pgn, None, destination ^ 1).matches(frame, True)


@given(pgn=identifiers.map(pgn_of), other=identifiers)
def test_a_pgn_matches_no_frame_of_another(pgn, other):
    assert by_pgn(pgn).matches(other, True) == (cantools.j1939.pgn_from_frame_id(other) == pgn)


@given(match=matches, identifier=identifiers, extended=st.booleans())
def test_a_mask_keeps_its_bits_and_the_kind_of_frame(match, identifier, extended):
    bits = EXTENDED_BITS if match.extended else STANDARD_BITS
    alike = all((identifier >> bit & 1) == (match.value >> bit & 1) for bit in range(29) if match.mask >> bit & 1)
    if extended or identifier <= STANDARD_BITS:
        assert match.matches(identifier, extended) == (alike and extended == match.extended)
    assert match.mask & ~bits == match.value & ~match.mask == match.senders & match.mask == 0


@given(one=matches, other=matches, open_bits=identifiers)
def test_two_messages_overlap_where_a_frame_could_be_of_both(one, other, open_bits):
    both = one.value | other.value | (open_bits & ~one.mask & ~other.mask)
    both &= EXTENDED_BITS if one.extended else STANDARD_BITS
    assert one.overlaps(other) == other.overlaps(one)
    if one.overlaps(other):
        assert one.matches(both, one.extended) and other.matches(both, other.extended)
    else:
        assert not (one.matches(both, one.extended) and other.matches(both, one.extended))


def test_a_match_says_what_it_is():
    assert str(by_j1939(ET1)) == "PGN 0xFEEE, source any"
    assert str(by_pgn(0xEF00, 3, 0x21)) == "PGN 0xEF00, source 0x03, destination 0x21"
    assert str(by_id(0x180, False, 0x7F0)) == "id 0x180, mask 0x7F0 of 11 bits"
    assert str(by_id(0x181, True)) == "id 0x181 of 29 bits"


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({}, "needs an id"),
        ({"id": 0x181}, "say extended = false or true"),
        ({"id": 0x800, "extended": False}, "beyond 0x7FF has 29 bits"),
        ({"id": 1, "mask": 0x800, "extended": False}, "beyond 0x7FF has 29 bits"),
        ({"id": 1, "extended": True, "source": 3}, "source and destination go with a pgn"),
        ({"pgn": 0xFEEE, "mask": 1}, "a pgn stands for id, mask and extended"),
        ({"pgn": 0xEF21}, "end it with 00 and give destination = 0x21"),
        ({"pgn": 0xFEEE, "destination": 3}, "is sent to all"),
        ({"pgn": 0x40000}, "less than or equal to 262143"),
        ({"pgn": 0xFEEE, "source": 254}, "less than or equal to 253"),
    ],
)
def test_what_an_entry_cannot_be_is_said(keys, said):
    with pytest.raises(ValidationError, match=said):
        CanMessage(name="M", **keys)


class Heard:
    """A receiver whose frames come by hand and whose clock stands until told otherwise."""

    def __init__(self, folder: Path, *messages: dict[str, object], points: tuple[Point, ...] = POINTS, **ids: int):
        self.now = 100.0
        self.bus = CanReceiver("c", section(dbc_in(folder, **ids), messages), points, lambda: self.now)

    def take(self, identifier: int, data: bytes, *, extended: bool = True) -> None:
        self.bus._take(can.Message(arbitration_id=identifier, data=data, is_extended_id=extended))

    def read(self) -> tuple[list[float], list[int], str | None]:
        readings = asyncio.run(self.bus.read())
        return readings.values, readings.quality, readings.fault


GOOD = int(Quality.GOOD)


@pytest.mark.parametrize("identifier", [0x18FEEE00, 0x0CFEEE00, 0x18FEEE17])
def test_a_j1939_message_is_read_from_any_source_at_any_priority(tmp_path, identifier):
    heard = Heard(tmp_path)
    heard.take(identifier, et1(85, 90))
    assert heard.read() == ([85.0, 90.0], [GOOD, GOOD], None)
    heard.now += 0.4
    _, quality, fault = heard.read()
    assert (quality, fault) == ([Quality.STALE] * 2, None)


@pytest.mark.parametrize(
    ("identifier", "extended", "length"),
    [(0x18FEEF00, True, 8), (0x19FEEE00, True, 8), (0x1AFEEE00, True, 8), (0x6EE, False, 8), (0x18FEEE00, True, 7)],
    ids=["another PGN", "data page 1", "extended data page", "11 bits", "another length"],
)
def test_what_is_not_quite_the_message_is_no_value(tmp_path, identifier, extended, length):
    heard = Heard(tmp_path)
    heard.take(identifier, et1(85, 90)[:length], extended=extended)
    assert GOOD not in heard.read()[1]
    assert heard.bus.unknown_frames + heard.bus.bad_frames == 1


def test_a_source_that_the_dbc_names_is_the_only_one(tmp_path):
    speed = (Point(name="speed", bus="c", unit="1", message="EEC1", signal="speed"),)
    text = dbc_in(tmp_path).read_text().replace('"1/min"', '""')
    (tmp_path / "j1939.dbc").write_text(text)
    bus = CanReceiver("c", section(tmp_path / "j1939.dbc"), speed, lambda: 0.0)
    assert str(bus.messages[0].match) == "PGN 0xF004, source 0x00"
    bus._take(can.Message(arbitration_id=EEC1 | 0x0F, data=bytes(8), is_extended_id=True))
    assert bus.unknown_frames == 1


def test_two_senders_of_one_message_are_never_mixed_and_both_named(tmp_path):
    heard = Heard(tmp_path)
    heard.take(0x18FEEE00, et1(85, 90))
    heard.now += 0.1
    heard.take(0x18FEEE21, et1(20, 25))
    values, quality, fault = heard.read()
    assert quality == [Quality.LINK_FAULT] * 2 and all(math.isnan(v) for v in values)
    assert "ET1 comes from source = 0x00 and source = 0x21, and is not used" in fault
    assert "[[bus.c.message]]" in fault
    heard.now += 9.9
    heard.take(0x18FEEE00, et1(86, 91))
    assert GOOD not in heard.read()[1]
    heard.now += 0.2
    assert heard.read()[2] is None
    heard.take(0x0CFEEE00, et1(87, 92))  # at another priority it is the same sender
    assert heard.read() == ([87.0, 92.0], [GOOD, GOOD], None)
    heard.now += 60.0
    heard.take(0x18FEEE21, et1(20, 25))
    values, quality, fault = heard.read()
    assert GOOD not in quality, "the other one is not taken for it when the first has long been silent"
    assert "source = 0x21" in fault


def test_a_source_in_the_rig_file_picks_one_sender(tmp_path):
    heard = Heard(tmp_path, {"name": "ET1", "pgn": 0xFEEE, "source": 0x21})
    heard.take(0x18FEEE00, et1(85, 90))
    heard.take(0x18FEEE21, et1(20, 25))
    heard.take(0x18FEEE00, et1(85, 90))
    assert heard.read() == ([20.0, 25.0], [GOOD, GOOD], None)


def test_one_layout_serves_two_sources_side_by_side(tmp_path):
    points = (POINTS[0], POINTS[0].model_copy(update={"name": "T_right", "message": "right"}))
    entries = (
        {"name": "ET1", "pgn": 0xFEEE, "source": 0},
        {"name": "right", "dbc_message": "ET1", "pgn": 0xFEEE, "source": 1},
    )
    heard = Heard(tmp_path, *entries, points=points)
    heard.take(0x18FEEE00, et1(85, 90))
    heard.take(0x18FEEE01, et1(20, 25))
    assert heard.read()[:2] == ([85.0, 20.0], [GOOD, GOOD])


def test_an_id_with_a_mask_is_read_and_its_sender_named(tmp_path):
    heard = Heard(tmp_path, {"name": "ET1", "id": 0x300, "mask": 0x7F0, "extended": False})
    heard.take(0x305, et1(85, 90), extended=False)
    assert heard.read()[0] == [85.0, 90.0]
    heard.take(0x315, et1(20, 25), extended=False)
    heard.take(0x305, et1(86, 91))
    assert (heard.read()[0], heard.bus.unknown_frames) == ([85.0, 90.0], 2)
    heard.take(0x306, et1(20, 25), extended=False)
    assert "id = 0x305 and id = 0x306" in heard.read()[2]


def test_what_a_j1939_device_sends_for_no_value_is_none(tmp_path):
    heard = Heard(tmp_path)
    for coolant, oil in ((0xFF, 0xFF00), (0xFE, 0xFEFF), (0xFB, 0xFB00)):
        heard.take(0x18FEEE00, bytes((coolant, 0)) + oil.to_bytes(2, "little") + bytes(4))
        values, quality, _ = heard.read()
        assert quality == [Quality.SENSOR_FAULT] * 2 and all(math.isnan(v) for v in values)
    heard.take(0x18FEEE00, bytes((0xFA, 0)) + 0xFAFF.to_bytes(2, "little") + bytes(4))
    assert heard.read()[:2] == ([210.0, pytest.approx(1734.96875)], [GOOD, GOOD])


@pytest.mark.parametrize(
    ("entries", "ids", "said"),
    [
        ((), {"plain": ET1 & ~0xFF}, "both ET1 (PGN 0xFEEE, source any) and PLAIN"),
        ((), {"tsc1": 0x0CFEEE11}, "both ET1 (PGN 0xFEEE, source any) and TSC1 (PGN 0xFEEE, source 0x11)"),
        (({"name": "ET1", "pgn": 0xFEEF},), {}, "ET1 has PGN 0xFEEE and the rig file gives ET1 0xFEEF"),
        (({"name": "ET1", "id": 0, "mask": 0, "extended": True},), {}, "both ET1 (id 0x0, mask 0x0 of 29 bits) and"),
    ],
)
def test_messages_that_would_take_each_others_frames_are_refused(tmp_path, entries, ids, said):
    with pytest.raises(ConfigurationError) as caught:
        Heard(tmp_path, *entries, **ids)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_source_keeps_two_messages_of_a_pgn_apart(tmp_path):
    torque = Point(name="torque", bus="c", unit="%", message="TSC1", signal="torque")
    heard = Heard(tmp_path, {"name": "ET1", "pgn": 0xFEEE, "source": 0}, points=(*POINTS, torque), tsc1=0x0CFEEE11)
    heard.take(0x18FEEE00, et1(85, 90))
    heard.take(0x0CFEEE11, bytes((145, *bytes(7))))
    assert heard.read() == ([85.0, 90.0, 20.0], [GOOD] * 3, None)


def test_a_message_of_several_packets_is_refused(tmp_path):
    text = dbc_in(tmp_path).read_text().replace("ET1: 8 ECU", "ET1: 39 ECU")
    (tmp_path / "j1939.dbc").write_text(text)
    with pytest.raises(ConfigurationError, match="has 39 bytes and a frame carries 8"):
        CanReceiver("c", section(tmp_path / "j1939.dbc"), POINTS, lambda: 0.0)


def test_the_kernel_is_told_what_to_filter(tmp_path, monkeypatch):
    made: dict[str, object] = {}
    monkeypatch.setattr("drivers.can.wire.can.Bus", lambda **keys: made.update(keys))
    monkeypatch.setattr("drivers.can.wire.socket.if_nameindex", lambda: [(3, "can0")])
    bus = CanReceiver("c", section(dbc_in(tmp_path), transport="socketcan"), POINTS, lambda: 0.0)
    bus._open()
    assert made["can_filters"] == [{"can_id": 0x00FEEE00, "can_mask": 0x03FFFF00, "extended": True}]
    match = bus.messages[0].match
    assert isinstance(match, IdMatch) and match.matches(0x18FEEE00, True)


RIG = """[rig]
name = "engine"

[bus.c]
transport = "socketcan"
channel = "nocan7"
dbc = "j1939.dbc"

[[bus.c.message]]
name = "ET1"
pgn = 0xFEEE

[[bus.c.message]]
name = "EEC1"
pgn = 0xF004
source = 0x00

[[point]]
name = "T_coolant"
bus = "c"
message = "ET1"
signal = "T_coolant"
unit = "degC"
plausible = [-40.0, 130.0]
stale_after_s = 3.0

[[point]]
name = "torque"
bus = "c"
message = "EEC1"
signal = "torque"
unit = "%"
"""


def checked(folder: Path, old: str = "", new: str = "") -> tuple[int, str]:
    text = (
        dbc_in(folder)
        .read_text()
        .replace(
            ' SG_ speed : 24|16@1+ (0.125,0) [0|8031.875] "1/min"', ' SG_ torque : 16|8@1+ (1,-125) [-125|125] "%"'
        )
    )
    (folder / "j1939.dbc").write_text(text)
    path = folder / "rig.toml"
    path.write_text(RIG.replace(old, new, 1) if old else RIG, encoding="utf-8")
    done = CliRunner().invoke(check, [str(path)])
    return done.exit_code, done.output + str(done.exception or "")


def test_the_check_says_which_frames_are_which(tmp_path):
    code, said = checked(tmp_path)
    assert code == 0, said
    assert "c: ET1 is PGN 0xFEEE, source any" in said
    assert "c: EEC1 is PGN 0xF004, source 0x00" in said


def test_a_j1939_message_that_the_dbc_does_not_call_so_is_noted(tmp_path):
    plain = RIG.replace('"ET1"', '"PLAIN"').replace('"T_coolant"', '"level"').replace('unit = "degC"', 'unit = "1"')
    path = tmp_path / "rig.toml"
    path.write_text(plain.split("[[bus.c.message]]")[0] + "[[point]]" + plain.split("[[point]]")[1], encoding="utf-8")
    dbc_in(tmp_path)
    assert "does not call it J1939" not in CliRunner().invoke(check, [str(path)]).output
    dbc_in(tmp_path, plain=0x18FF01FE)
    done = CliRunner().invoke(check, [str(path)])
    assert done.exit_code == 0
    assert "c: PLAIN has the null source address of J1939 and the DBC does not" in " ".join(done.output.split())
    assert "add a [[bus.c.message]]" in " ".join(done.output.split())


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("pgn = 0xF004", "pgn = 0xFEEE", 14, "bus c: a frame could be both ET1 (PGN 0xFEEE, source any) and EEC1 (PGN"),
        ('name = "EEC1"', 'name = "EEC2"', 14, "bus c: no point has message = 'EEC2'; correct name"),
        ('name = "EEC1"', 'name = "ET1"', 14, "bus c: message ET1 is there twice"),
        ("pgn = 0xF004", "pgn = 0xFF000", 15, "must be at most 262143, got 1044480"),
        ("pgn = 0xF004", "id = 0x181", 13, "message EEC1: source and destination go with a pgn"),
        ("pgn = 0xF004", "png = 0xF004", 15, "png: is not a key of this section"),
    ],
)
def test_the_check_refuses_what_overlaps_and_what_no_entry_can_be(tmp_path, old, new, line, words):
    code, said = checked(tmp_path, old, new)
    assert code != 0
    assert f"rig.toml, line {line}: " in said
    assert words in said


async def test_a_missing_interface_is_one_plain_sentence(tmp_path):
    checked(tmp_path)
    done = await asyncio.to_thread(CliRunner().invoke, check, [str(tmp_path / "rig.toml")])
    assert done.exit_code == 0
    async with RigWatch(load_rig(tmp_path / "rig.toml")) as watch:
        (said,) = watch.faults()["c"]
    assert said.startswith(
        "c (socketcan nocan7) cannot be opened: there is no CAN interface nocan7; plug the adapter in"
    )


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.ENODEV, "there is no CAN interface can0"),
        (errno.ENETDOWN, "can0 is down; bring it up: `ip link set can0 up type can bitrate 500000`"),
        (errno.EPERM, "this user may not open can0"),
        (errno.EAFNOSUPPORT, "the kernel has no CAN"),
        (errno.EIO, "`ip -details link show can0` shows its state"),
    ],
)
def test_what_is_wrong_with_an_interface_of_the_kernel_has_its_remedy(tmp_path, number, words):
    config = section(dbc_in(tmp_path), transport="socketcan")
    assert words in failure_reason(config, OSError(number, "no"))
    assert words in failure_reason(config, can.CanOperationError("Error receiving: no", number))
    assert "is the rig on?" in failure_reason(section(dbc_in(tmp_path)), OSError(number, "no"))


def test_a_kernel_without_can_is_said_and_leaves_nothing_open(tmp_path):
    config = section(dbc_in(tmp_path), transport="socketcan", channel="lo")
    with pytest.raises(LinkError) as caught:
        CanWire(config, "c", ())
    assert "the kernel has no CAN" in str(caught.value) or "there is no CAN interface lo" in str(caught.value)
    gc.collect()  # what was left open would warn here
