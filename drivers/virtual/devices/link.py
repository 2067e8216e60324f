"""Link between plant and thermocouple module: one fixed-size record per period over a local socket."""

import asyncio
import struct
from collections.abc import Callable, Sequence

RECORD = struct.Struct("<d9d")


def pack(time_s: float, junctions_C: Sequence[float]) -> bytes:
    """Return the record of rig time in s and the nine true junction temperatures in degC."""
    return RECORD.pack(time_s, *junctions_C)


class LinkSender(asyncio.Protocol):
    """PLC's end of the link. While the module cannot keep up, `ready` is False."""

    def __init__(self, on_ready: Callable[[], None], on_lost: Callable[[], None]) -> None:
        self.ready = True
        self._on_ready, self._on_lost = on_ready, on_lost
        self.transport: asyncio.WriteTransport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Start with an empty buffer."""
        assert isinstance(transport, asyncio.WriteTransport)
        self.transport = transport

    def connection_lost(self, exc: Exception | None) -> None:
        """Report that the module died."""
        self._on_lost()

    def pause_writing(self) -> None:
        """Note that the module lags behind."""
        self.ready = False

    def resume_writing(self) -> None:
        """Report that the module caught up."""
        self.ready = True
        self._on_ready()


class LinkReceiver(asyncio.Protocol):
    """Module's end of the link: it hands over one record at a time."""

    def __init__(self, on_record: Callable[[float, list[float]], None], on_lost: Callable[[], None]) -> None:
        self._on_record, self._on_lost = on_record, on_lost
        self._rest = b""

    def data_received(self, data: bytes) -> None:
        """Split the stream into records."""
        if self._rest:
            data = self._rest + data
        whole = len(data) - len(data) % RECORD.size
        for at in range(0, whole, RECORD.size):
            time_s, *junctions = RECORD.unpack_from(data, at)
            self._on_record(time_s, junctions)
        self._rest = data[whole:]

    def connection_lost(self, exc: Exception | None) -> None:
        """Report that the PLC is gone."""
        self._on_lost()
