"""Guard of RTU frames on a serial line: pure.

An RTU frame carries no transaction, so a reply that comes late looks like the answer to the next request; pymodbus's
own client serves it as such, and goes on so. A frame is passed on only if it is whole, has the right CRC, is of the
device, function and length that the request admits, and came alone. `drivers.modbus.link` ensures a quiet line, and
`drivers.modbus.bus` a device that is not a reply behind.
"""

from __future__ import annotations

from drivers.modbus.protocol.pdu import NO_VALUES
from drivers.modbus.protocol.pymodbus_codec import has_right_crc, rtu_frame, rtu_size
from drivers.modbus.protocol.replies import answers
from drivers.modbus.protocol.reply_defects import ECHO, reply_size
from drivers.signals import ProtocolError

_LONGEST = 256  # Modbus over serial line V1.02, 2.5.1


def size_of(start: bytes) -> int | None:
    """Return the length of the reply that begins with `start`, or None while too few bytes are here.

    Raises
    ------
    ProtocolError
        No reply begins so.
    """
    if len(start) < 2:
        return None
    try:
        return rtu_size(start)
    except KeyError:
        raise ProtocolError(f"bytes that are no reply: {start[:8].hex(' ')}") from None


class RtuGuard:
    """Splitter of a line's bytes into frames. `dropped` counts whole frames that answer another request."""

    def __init__(self) -> None:
        self.dropped = 0
        self.others: str | None = None
        """Sentence about the last frame that was dropped."""
        self._buffer = b""

    def clear(self) -> None:
        """Forget what has arrived: a new request goes out on a quiet line."""
        self._buffer = b""

    def feed(self, data: bytes, device: int, request: bytes) -> list[bytes]:
        """Return PDUs that may answer `request` of `device`; raise ProtocolError where the line carries something else.

        A frame that is right in itself and answers another request, or another device's, is dropped and counted.
        """
        self._buffer = (self._buffer + data).lstrip(b"\0\xff")  # no reply begins so: noise of a line as it turns around
        passed: list[bytes] = []
        while self._buffer:
            size = size_of(self._buffer)
            if size is None or len(self._buffer) < size:
                break
            if size > _LONGEST:
                raise ProtocolError(f"a reply of {size} bytes, which is more than a frame may have")
            frame = self._buffer[:size]
            if not has_right_crc(frame):
                if self._may_be_echo(device, request):
                    break
                raise ProtocolError(
                    f"a reply with a wrong CRC: {frame[:8].hex(' ')}; look for noise, termination and the line's speed"
                )
            self._buffer = self._buffer[size:]
            if frame[0] == device and answers(frame[1:-2], request):
                passed.append(frame[1:-2])
            else:
                self.dropped += 1
                self.others = _why_unused(frame, device, request)
        if passed and (self._buffer or len(passed) > 1):
            raise ProtocolError("more than one reply to one request: none of them is used")
        return passed

    def _may_be_echo(self, device: int, request: bytes) -> bool:
        """Return True while the bytes that came are the beginning of the request; raise ProtocolError where all are.

        A write of one value is confirmed by its echo and has the right CRC.
        """
        asked = rtu_frame(device, request)
        if self._buffer.startswith(asked):
            raise ProtocolError(ECHO)
        return asked.startswith(self._buffer)


def _why_unused(frame: bytes, device: int, request: bytes) -> str:
    """Return a sentence about a sound frame that does not answer `request` of `device`."""
    if frame[0] != device:
        return f"it came from device {frame[0]} where device_id {device} was asked; correct device_id"
    asked, pdu = reply_size(request), frame[1:-2]
    if asked is not None and pdu[0] == request[0]:
        if pdu[1] == 0:
            return f"it has byte count 0 where {asked} bytes were asked; {NO_VALUES}"
        if pdu[1] % 2 and pdu[0] not in (1, 2):
            return f"it has {pdu[1]} bytes of values, which are no whole registers; the device is faulty"
        return (
            f"it has {pdu[1]} bytes of values where {asked} were asked; raise timeout_s of a device that answers late, "
            "or give the bus max_read where it reads no more at once"
        )
    return f"it was of function {pdu[0]} where {request[0]} was asked; raise timeout_s of a slow device"
