"""Whether a device on a serial line may be a reply behind, and the question that tells: pure.

Replies of a serial line carry no number. After a request that was not answered, its reply may come in the place of the
next one's, and everything is one behind from then on. A quiet line is no proof, for nobody knows how late a device
can be. So it is asked for a part of what is polled, of a length that none of the open requests has: a device answers in
the order in which it was asked, so once this answer is here, those before it are either gone or were dropped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from drivers.modbus.read_plan import BIT_TABLES, Block

_Shape = tuple[int, int]


class Steps:
    """Requests that are still `open`; none ever is where the replies are `numbered`, and known by that.

    While any is open, a probe must come first.
    """

    def __init__(self, *, numbered: bool) -> None:
        self._numbered = numbered
        self.open: list[_Shape] = []

    def asked(self, request: bytes) -> None:
        """A request goes out."""
        if not self._numbered:
            self.open.append(_shape(request))

    def answered(self) -> None:
        """It was answered, by a device that was in step."""
        if len(self.open) == 1:
            self.open.clear()

    def doubt(self, request: bytes) -> None:
        """What came was an answer in form, but not to this: a gateway's word for silence, or another length."""
        if not self.open:
            self.asked(request)

    def found(self) -> None:
        """The probe was answered."""
        self.open.clear()

    def probe(self, planned: Sequence[Block]) -> Block | None:
        """Whole points from the beginning of a planned block, of a reply that no open request has.

        None where all lengths are used up, as of a device with a single point: then a quiet line must do.
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
    """Function code and data bytes of the reply to a request."""
    code, count = request[0], int.from_bytes(request[3:5], "big")
    return code, _size(code <= 2, count) if code in (1, 2, 3, 4, 23) else 0


def _size(is_bits: bool, count: int) -> int:
    return -(-count // 8) if is_bits else 2 * count
