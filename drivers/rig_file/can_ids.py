"""Identification of CAN messages: identifiers with masks, and parameter groups of J1939. Pure.

A J1939 identifier of 29 bits is priority (3), extended data page and data page, PDU format, PDU specific and source
address (8 each). In messages with a PDU format below 240 (PDU1), PDU specific is the destination and no part of the
PGN (SAE J1939-21, 5.2 and 5.3).
"""

from __future__ import annotations

from dataclasses import dataclass

STANDARD_BITS, EXTENDED_BITS = 0x7FF, 0x1FFFFFFF
HIGHEST_PGN = 0x3FFFF
NO_SOURCE = 0xFE
"""Null address: in a DBC it stands for a source that is not known (J1939-81)."""
CONFLICT_S = 10.0
"""Time, s, for which a message is not used after a frame of it came from a second sender."""
_PRIORITY = 0x1C000000
_DESTINATION, _SOURCE = 0xFF00, 0x00FF


@dataclass(frozen=True, slots=True)
class IdMatch:
    """Frames of one kind (29 or 11 bits) whose identifier is `value` in the bits of `mask`.

    `senders` are the bits outside the mask that identify the sender. `pgn` is None but for J1939.
    """

    value: int
    mask: int
    extended: bool
    senders: int = 0
    pgn: int | None = None

    @property
    def is_exact(self) -> bool:
        """True where only one identifier matches."""
        return self.mask == (EXTENDED_BITS if self.extended else STANDARD_BITS)

    @property
    def looks_like_j1939(self) -> bool:
        """True for an identifier from the null address, from which no device sends in J1939."""
        return self.is_exact and self.extended and self.value & _SOURCE == NO_SOURCE

    def matches(self, identifier: int, extended: bool) -> bool:
        """Return True where a frame is of this message."""
        return extended == self.extended and (identifier ^ self.value) & self.mask == 0

    def overlaps(self, other: IdMatch) -> bool:
        """Return True where one frame could be of both."""
        return self.extended == other.extended and (self.value ^ other.value) & self.mask & other.mask == 0

    def sender(self, identifier: int) -> str:
        """Return the sender of a frame as keys of a rig file."""
        if self.pgn is None:
            return f"id = 0x{identifier:X}"
        to = f", destination = 0x{(identifier & _DESTINATION) >> 8:02X}" if self.senders & _DESTINATION else ""
        return f"source = 0x{identifier & _SOURCE:02X}{to}"

    def __str__(self) -> str:
        if self.pgn is None:
            masked = "" if self.is_exact else f", mask 0x{self.mask:X}"
            return f"id 0x{self.value:X}{masked} of {29 if self.extended else 11} bits"
        said = f"0x{self.value & _SOURCE:02X}" if self.mask & _SOURCE else "any"
        if is_pdu1(self.pgn):
            to = f"0x{(self.value & _DESTINATION) >> 8:02X}" if self.mask & _DESTINATION else "any"
            said += f", destination {to}"
        return f"PGN 0x{self.pgn:04X}, source {said}"


def is_pdu1(pgn: int) -> bool:
    """Return True where frames of a PGN are sent to a destination."""
    return pgn >> 8 & 0xFF < 240


def by_id(value: int, extended: bool, mask: int | None = None) -> IdMatch:
    """Return the match of an identifier, exactly or in the bits of `mask`."""
    bits = EXTENDED_BITS if extended else STANDARD_BITS
    kept = bits if mask is None else mask & bits
    return IdMatch(value & kept, kept, extended, bits & ~kept)


def by_pgn(pgn: int, source: int | None = None, destination: int | None = None) -> IdMatch:
    """Return the match of a PGN at any priority, from `source` and to `destination` where these are given."""
    who = _SOURCE | _DESTINATION if is_pdu1(pgn) else _SOURCE
    mask, value = EXTENDED_BITS & ~_PRIORITY & ~who, pgn << 8
    if source is not None:
        mask, value = mask | _SOURCE, value | source
    if destination is not None:
        mask, value = mask | _DESTINATION, value | destination << 8
    return IdMatch(value & mask, mask, True, who & ~mask, pgn)


def pgn_of(identifier: int) -> int:
    """Return the PGN of a J1939 identifier."""
    pgn = identifier >> 8 & HIGHEST_PGN
    return pgn & ~0xFF if is_pdu1(pgn) else pgn


def by_j1939(identifier: int) -> IdMatch:
    """Return the match of a DBC's J1939 message: its PGN, from its source address unless that is the null address."""
    source = identifier & _SOURCE
    return by_pgn(pgn_of(identifier), None if source == NO_SOURCE else source)


class Senders:
    """Senders of a message whose match leaves them open: only the first sender is read.

    While a second one sends the message too, it is not known which one is meant, and no frame is used.
    """

    def __init__(self, match: IdMatch) -> None:
        self._match = match
        self._first: int | None = None
        self._other = 0
        self._until_s = float("-inf")

    def admits(self, identifier: int, now_s: float) -> bool:
        """Return True where a frame that came at `now_s` (rig time, s) may be used."""
        if self._first is None:
            self._first = identifier
        elif (identifier ^ self._first) & self._match.senders:
            self._other, self._until_s = identifier, now_s + CONFLICT_S
        return now_s >= self._until_s

    def conflict(self, now_s: float) -> str | None:
        """Return both senders as keys of a rig file; None where there is one."""
        if self._first is None or now_s >= self._until_s:
            return None
        return f"{self._match.sender(self._first)} and {self._match.sender(self._other)}"
