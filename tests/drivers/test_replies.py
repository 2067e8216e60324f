"""Replies that a device may not give: none of them is ever a value, and nothing foreign is raised."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.modbus.protocol.frames import TcpFrames
from drivers.modbus.protocol.replies import FrameGuard
from drivers.signals.points import ProtocolError
from hil.bench.fuzz.can_frames import mutate_can
from hil.bench.fuzz.j1939_frames import HARMLESS as J1939_HARMLESS
from hil.bench.fuzz.j1939_frames import mutate_j1939
from hil.bench.fuzz.rtu_replies import HARMLESS as RTU_HARMLESS
from hil.bench.fuzz.rtu_replies import mutate_rtu
from hil.bench.fuzz.wire import HARMLESS, Mutator, mutate_modbus

GOOD = struct.pack(">HHHBBB2H", 7, 0, 7, 1, 4, 4, 555, 100)


def test_whole_frames_of_the_request_are_passed_on_however_they_are_cut():
    for cut in range(1, len(GOOD)):
        guard = FrameGuard()
        assert guard.feed(GOOD[:cut], 7, 1) + guard.feed(GOOD[cut:], 7, 1) == [GOOD]
        assert guard.dropped == 0


@pytest.mark.parametrize(
    "frame",
    [GOOD.replace(b"\0\x07", b"\0\x06", 1), b"\0\0" + GOOD[2:], GOOD[:6] + b"\x02" + GOOD[7:]],
    ids=["another transaction", "transaction 0", "another unit"],
)
def test_frames_of_others_are_dropped_and_counted(frame):
    guard = FrameGuard()
    assert guard.feed(frame + GOOD, 7, 1) == [GOOD]
    assert guard.dropped == 1


ASKED = GOOD[7:8] + b"\0\0\0\2"


def test_transaction_0_is_a_reply_where_the_rig_file_says_so_and_nothing_else_is():
    zero = b"\0\0" + GOOD[2:]

    def fed(data: bytes, pdu: bytes = ASKED) -> bytes | None:
        frames = TcpFrames(numbered=False)
        frames.frame(1, pdu)
        return frames.feed(data, 1, pdu)

    assert fed(zero) == GOOD[7:]
    assert fed(b"\0\x01" + GOOD[2:]) == GOOD[7:], "its own number is as good"
    assert fed(b"\0\x02" + GOOD[2:]) is None
    assert fed(zero[:6] + b"\x02" + zero[7:]) is None
    for data, pdu in (
        (zero + zero, ASKED),
        (zero + b"\0", ASKED),
        (zero, b"\3" + ASKED[1:]),
        (zero, ASKED[:4] + b"\3"),
    ):
        with pytest.raises(ProtocolError):
            fed(data, pdu)


@pytest.mark.parametrize(
    ("came", "remedy"),
    [
        ([1], "raise timeout_s where the device is slow"),
        ([4], "does not repeat the number of the request"),
        ([1, 1], "does not repeat the number of the request"),
        ([1, 2], "raise timeout_s where the device is slow"),
    ],
    ids=["late", "ahead", "the same twice", "two late ones"],
)
def test_a_late_reply_is_told_from_a_device_that_numbers_its_replies_itself(came, remedy):
    frames = TcpFrames()
    for _ in range(3):
        frames.frame(1, ASKED)
    for transaction in came:
        assert frames.feed(transaction.to_bytes(2, "big") + GOOD[2:], 1, ASKED) is None
    assert remedy in (frames.unused or "")


def test_what_answers_with_transaction_0_is_told_from_what_answers_something_else():
    frames = TcpFrames()
    frames.frame(1, ASKED)
    assert frames.feed(b"\0\x09" + GOOD[2:], 1, ASKED) is None
    assert "the last has transaction 9 where 1 was asked" in (frames.unused or "")
    assert frames.feed(b"\0\0" + GOOD[2:], 1, ASKED) is None
    assert "give transaction = 'zero' where it always does" in (frames.unused or "")


@pytest.mark.parametrize(
    ("frame", "said"),
    [
        (GOOD[:2] + b"\0\x01" + GOOD[4:], "of protocol 1"),
        (b"\0\x08" + GOOD[2:4] + b"\x01\x00" + GOOD[6:], "length 256"),
        (GOOD[:4] + b"\0\x02" + GOOD[6:], "announces 2 bytes and has 7; give frame_length = 'ignored'"),
        (GOOD[:4] + b"\x01\x00" + GOOD[6:], "announces 256 bytes and has 7; give frame_length = 'ignored'"),
        (GOOD[:8] + b"\x02" + GOOD[9:], "byte count is 2 and that has 4 bytes of values"),
        (GOOD[:4] + b"\0\x08" + GOOD[6:] + b"\0", "announces 8 bytes and its content has 7"),
        (GOOD[:4] + b"\0\x06" + GOOD[6:], "announces 6 bytes and its content has 7; give frame_length"),
        (GOOD[:7] + b"\x2b" + GOOD[8:], "function 43, which was not asked for"),
        (GOOD[:4] + b"\0\x04\x01\x83\x02\x00", "function 131 announces 4 bytes and its content has 3"),
    ],
)
def test_what_makes_no_sense_is_refused(frame, said):
    with pytest.raises(ProtocolError, match=said):
        FrameGuard().feed(frame, 7, 1, ASKED)


@pytest.mark.parametrize("length", [0, 1, 2, 4, 5, 9, 250, 300, 65535])
def test_an_exception_reply_counts_whatever_its_header_announces(length):
    refused = b"\0\x07\0\0" + struct.pack(">H", length) + b"\x01\x84\x02"
    guard = FrameGuard()
    assert guard.feed(refused, 7, 1, ASKED) == [refused]
    following = b"\0\x08" + GOOD[2:]
    assert guard.feed(following[:3], 8, 1, ASKED) + guard.feed(following[3:], 8, 1, ASKED) == [following]


@pytest.mark.parametrize("more", [1, 2, 6])
@pytest.mark.parametrize("later", [False, True], ids=["at once", "later"])
def test_bytes_behind_an_exception_reply_are_no_part_of_the_next_reply(more, later):
    refused, rest = b"\0\x07\0\0" + struct.pack(">H", 3 + more) + b"\x01\x84\x02", bytes(more)
    guard = FrameGuard()
    frames = guard.feed(refused if later else refused + rest, 7, 1, ASKED)
    assert [frame[7:] for frame in frames] == [b"\x84\x02"]
    following = b"\0\x08" + GOOD[2:]
    assert guard.feed((rest if later else b"") + following, 8, 1, ASKED) == [following]


def test_an_exception_to_another_function_or_of_an_unknown_code_is_none():
    for pdu in (b"\x83\x02", b"\x84\x63"):
        guard = FrameGuard()
        assert guard.feed(b"\0\x07\0\0\0\x04\x01" + pdu, 7, 1, ASKED) == []
        assert "announces 4 bytes and has 3" in (guard.unfinished(7, 1) or "")


@pytest.mark.parametrize("length", [0, 2, 6, 8, 13, 65535])
@pytest.mark.parametrize("behind", [b"", b"\0\0"])
def test_a_reply_is_as_long_as_its_content_where_the_rig_file_says_so(length, behind):
    frames = TcpFrames(by_content=True)
    for number in (1, 2, 3):
        frames.frame(1, ASKED)
        reply = struct.pack(">HHHB", number, 0, length, 1) + GOOD[7:]
        assert frames.feed(reply[:9], 1, ASKED) is None
        assert frames.feed(reply[9:] + behind, 1, ASKED) == GOOD[7:]


def test_bytes_behind_a_reply_are_named_when_the_next_one_cannot_be_read():
    guard = FrameGuard()
    assert guard.feed(GOOD + b"\1\2\3", 7, 1, ASKED) == [GOOD]
    with pytest.raises(ProtocolError, match=r"3 bytes came behind a reply.*give frame_length = 'ignored'"):
        guard.feed(b"\0\x08" + GOOD[2:], 8, 1, ASKED)


@given(data=st.lists(st.binary(max_size=40), max_size=8))
def test_any_bytes_are_frames_of_the_request_or_our_own_error(data):
    guard = FrameGuard()
    try:
        for segment in data:
            for frame in guard.feed(segment, 7, 1, ASKED):
                assert frame[:2] == b"\0\x07" and frame[6] == 1
    except ProtocolError:
        pass


async def test_no_mutated_reply_is_ever_a_wrong_value_that_counts_as_good():
    found = await mutate_modbus(2040, 1)
    assert {kind: wrong for kind, (*_, wrong) in found.items() if wrong} == {}
    assert all(reads == 2040 // len(Mutator.KINDS) for reads, *_ in found.values())
    for kind in HARMLESS:
        reads, right, unused, _ = found[kind]
        assert (right, unused) == (24 * reads, 0), kind
    for kind in ("transaction 0", "the reply before as transaction 0", "unit", "trailing bytes", "silence"):
        assert found[kind][1] == 0, kind


class Naive(FrameGuard):
    """Passes everything on, as pymodbus by itself would take it."""

    def feed(self, data: bytes, transaction: int, unit: int, request: bytes = b"") -> list[bytes]:
        return [data]


async def test_without_the_guard_a_late_reply_of_transaction_0_is_taken_for_the_answer(monkeypatch):
    monkeypatch.setattr("drivers.modbus.protocol.frames.FrameGuard", Naive)
    found = await mutate_modbus(170, 1)
    assert found["the reply before as transaction 0"][3] > 0
    assert found["trailing bytes"][1] > 0


def test_no_mutated_rtu_reply_is_passed_on_with_other_registers():
    found = mutate_rtu(2600, 1)
    assert {kind: wrong for kind, (*_, wrong) in found.items() if wrong} == {}
    for kind, (replies, used, unused, _) in found.items():
        assert (used, unused) == ((replies, 0) if kind in RTU_HARMLESS else (0, replies)), kind


async def test_no_mutated_can_frame_is_ever_a_wrong_value_that_counts_as_good():
    found = await mutate_can(2200, 1)
    assert {kind: wrong for kind, (*_, wrong) in found.items() if wrong} == {}
    assert found["none"][1] > 0 and found["none"][2] == 0
    assert {kind for kind, (_, good, *_) in found.items() if good} == {"none", "any data"}


async def test_no_mutated_frame_of_a_pgn_is_ever_a_wrong_value_that_counts_as_good():
    found = await mutate_j1939(2800, 1)
    assert {kind: wrong for kind, (*_, wrong) in found.items() if wrong} == {}
    assert {kind for kind, (_, good, *_) in found.items() if good} == {*J1939_HARMLESS, "any data"}
    assert all(found[kind][2] == 0 for kind in J1939_HARMLESS)
