"""RTU replies that a line may not give, and the question that shows whether a device is in step."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.modbus.protocol.pdu import Read
from drivers.modbus.protocol.pymodbus_codec import rtu_frame
from drivers.modbus.protocol.reply_offset import OpenRequests
from drivers.modbus.protocol.rtu import RtuGuard
from drivers.modbus.read_plan import plan_reads
from drivers.rig_file.model import Point
from drivers.signals.points import ProtocolError
from drivers.virtual.devices.rtu_protocol import crc

REQUEST = struct.pack(">BHH", 4, 8, 2)
REPLY = rtu_frame(3, b"\4\4\0\1\0\2")


def test_the_crc_is_that_of_the_specification():
    # Modbus over serial line V1.02, 6.2.2: address 02, function 07 give 0x1241, low byte first
    assert rtu_frame(2, b"\7") == bytes.fromhex("02074112")
    assert rtu_frame(3, REQUEST)[-2:] == crc(b"\3" + REQUEST)


def test_a_reply_is_found_however_it_is_cut_and_after_what_a_line_gives_as_it_turns():
    for cut in range(len(REPLY)):
        guard = RtuGuard()
        assert guard.feed(b"\0\xff" + REPLY[:cut], 3, REQUEST) + guard.feed(REPLY[cut:], 3, REQUEST) == [REPLY[1:-2]]


@pytest.mark.parametrize(
    "frame",
    [
        rtu_frame(4, REPLY[1:-2]),
        rtu_frame(3, b"\3" + REPLY[2:-2]),
        rtu_frame(3, b"\4\2\0\1"),
        rtu_frame(3, b"\6\0\1\0\2"),
    ],
    ids=["another device", "another function", "another length", "a write"],
)
def test_frames_that_answer_something_else_are_dropped_and_counted(frame):
    guard = RtuGuard()
    assert guard.feed(frame, 3, REQUEST) == []
    assert guard.feed(REPLY, 3, REQUEST) == [REPLY[1:-2]]
    assert guard.dropped == 1


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (REPLY[:-1] + bytes((REPLY[-1] ^ 1,)), "wrong CRC"),
        (REPLY + REPLY, "more than one reply"),
        (REPLY + b"\3", "more than one reply"),
        (b"\3\x2b\1\2\3", "bytes that are no reply: 03 2b"),
    ],
)
def test_what_makes_no_sense_is_refused(data, said):
    with pytest.raises(ProtocolError, match=said):
        RtuGuard().feed(data, 3, REQUEST)


@settings(max_examples=300)
@given(segments=st.lists(st.one_of(st.binary(max_size=20), st.just(REPLY)), max_size=6))
def test_any_bytes_are_the_reply_or_our_own_error(segments):
    guard = RtuGuard()
    try:
        for segment in segments:
            for pdu in guard.feed(segment, 3, REQUEST):
                assert pdu == REPLY[1:-2] or pdu[0] == 0x84 or pdu[:2] == b"\4\4"
    except ProtocolError:
        pass


@given(
    addresses=st.lists(st.integers(0, 300), min_size=1, max_size=20, unique=True),
    misses=st.integers(1, 6),
)
def test_the_question_that_shows_the_step_has_a_length_that_nothing_open_has(addresses, misses):
    planned = plan_reads(
        [Point(name=f"p{a}", bus="b", unit="1", table="holding", address=2 * a, type="int32") for a in addresses]
    )
    open_requests, seen = OpenRequests(numbered=False), []
    for number in range(misses):
        request = Read(planned[number % len(planned)]).request
        open_requests.asked(request)
        seen.append(request[3:5])
    probe = open_requests.probe(planned)
    if probe is None:
        ends = {(p.address or 0) + p.width - b.address for b in planned for p in b.points}
        assert ends <= {int.from_bytes(count, "big") for count in seen}
        return
    assert struct.pack(">H", probe.count) not in seen
    assert probe.count % 2 == 0 and any(b.address == probe.address and probe.count <= b.count for b in planned)
    open_requests.asked(Read(probe).request)
    open_requests.answered()
    assert open_requests.open
    open_requests.found()
    assert not open_requests.open


def test_replies_that_carry_a_number_need_no_such_question():
    open_requests = OpenRequests(numbered=True)
    open_requests.asked(REQUEST)
    assert not open_requests.open
