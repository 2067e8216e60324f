"""Detection of a device on a serial line that is one reply behind: open requests and a probe. Pure.

Replies on a serial line carry no number. The reply to an unanswered request may come in the place of the next one's,
and every reply is one behind from then on. A quiet line is no proof, since the delay of a device has no bound. The
probe is a read of a part of the polled points with a reply length that no open request has. A device answers in the
order of the requests: after the answer to the probe no earlier reply can come.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from drivers.modbus.read_plan import BIT_TABLES, Block

_Shape = tuple[int, int]


class OpenRequests:
    """Requests whose replies may still come, as (function code, data bytes) in `open`.

    While any is open, a probe must come first. Replies that are `numbered` are identified by that: none is ever open.
    """

    def __init__(self, *, numbered: bool) -> None:
        self._numbered = numbered
        self.open: list[_Shape] = []

    def asked(self, request: bytes) -> None:
        """Add a request that goes out."""
        if not self._numbered:
            self.open.append(_shape(request))

    def answered(self) -> None:
        """Remove the only open request: it was answered by a device that was not behind."""
        if len(self.open) == 1:
            self.open.clear()

    def doubt(self, request: bytes) -> None:
        """Keep a request open whose answer was not its own: a gateway's exception for a silence, or another length."""
        if not self.open:
            self.asked(request)

    def found(self) -> None:
        """Remove all: the probe was answered."""
        self.open.clear()

    def probe(self, planned: Sequence[Block]) -> Block | None:
        """Return the beginning of a planned block, whole points, with a reply length that no open request has.

        Return None, and forget all open requests, where every length is used up, as for a device with a single point:
        a quiet line must suffice then.
        """
        for block in planned:
            end = 0
            for number, point in enumerate(block.points, 1):
                end = max(end, (point.address or 0) + point.width - block.address)
                part = replace(block, count=end, points=block.points[:number])
                if (block.read_code, _size(block.table in BIT_TABLES, end)) not in self.open:
                    return part
        self.open.clear()
        return None


def _shape(request: bytes) -> _Shape:
    """Return function code and data bytes of the reply to a request."""
    code, count = request[0], int.from_bytes(request[3:5], "big")
    return code, _size(code <= 2, count) if code in (1, 2, 3, 4, 23) else 0


def _size(is_bits: bool, count: int) -> int:
    return -(-count // 8) if is_bits else 2 * count
