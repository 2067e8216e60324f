"""CAN bus over TCP in the socketcand protocol (raw mode), with any number of clients.

Server greets `< hi >`; client sends `< open BUS >` and `< rawmode >`, each answered `< ok >`; then frames flow as
`< frame ID SEC.USEC DATA >` to the client and `< send ID LEN B0 B1 .. >` from it. A client's frames reach the others,
not itself. Protocol: github.com/linux-can/socketcand, doc/protocol.md.
"""

import asyncio
from collections.abc import Callable

BUS = "vcan0"
"""Name of the virtual rig's bus."""
LARGEST_BACKLOG = 1 << 20
"""Bytes kept for a client that reads slowly; frames beyond are dropped and counted."""
SETTLE_S = 0.1
"""Frames wait this long after the `< ok >` to raw mode: clients match that answer against a whole segment."""
_LONGEST_LINE = 256


class CanHub:
    """Bus on which every connected client in raw mode receives every frame; clients open it as `bus`."""

    def __init__(self, clock: Callable[[], float], bus: str = BUS) -> None:
        self._clock = clock
        self.bus = bus
        self.clients: set[CanConnection] = set()
        self.listeners: tuple[CanConnection, ...] = ()
        self.dropped = 0

    def publish(self, text: bytes, frames: int, sender: "CanConnection | None" = None) -> None:
        """Send one or more frames, already written out, to everyone but the sender."""
        for client in self.listeners:
            if client is not sender and not client.deliver(text):
                self.dropped += frames

    def relay(self, identifier: str, data: bytes, sender: "CanConnection") -> None:
        """Send a client's frame to all others."""
        self.publish(frame_text(identifier, self._clock(), data), 1, sender)

    def update_listeners(self) -> None:
        """Keep the tuple that the hot path walks over."""
        self.listeners = tuple(client for client in self.clients if client.raw)


def frame_text(identifier: str, time_s: float, data: bytes) -> bytes:
    """Return `< frame ... >` as sent to clients; standard ids have three hexadecimal digits, extended ones eight."""
    return f"< frame {identifier} {time_s:.6f} {data.hex().upper()} >".encode("ascii")


class CanConnection(asyncio.Protocol):
    """Connection of one client of the hub."""

    def __init__(self, hub: CanHub) -> None:
        self._hub = hub
        self._rest = b""
        self._opened = False
        self._settling: bytearray | None = None
        self._timer: asyncio.TimerHandle | None = None
        self.raw = False
        self.dropped = 0
        self._transport: asyncio.Transport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Greet the client."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._hub.clients.add(self)
        transport.write(b"< hi >")

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the client."""
        if self._timer:
            self._timer.cancel()
        self.raw = False
        self._hub.clients.discard(self)
        self._hub.update_listeners()

    def close(self) -> None:
        """Drop the client."""
        self._transport.abort()

    def deliver(self, text: bytes) -> bool:
        """Queue frames for this client; False when its backlog is full and they are dropped."""
        if self._settling is not None:
            if len(self._settling) > LARGEST_BACKLOG:
                return False
            self._settling += text
            return True
        if self._transport.get_write_buffer_size() > LARGEST_BACKLOG:
            self.dropped += 1
            return False
        self._transport.write(text)
        return True

    def data_received(self, data: bytes) -> None:
        """Split the stream into `< ... >` commands."""
        data = self._rest + data
        while (end := data.find(b">")) >= 0:
            command, data = data[:end], data[end + 1 :]
            self._obey(command)
        if len(data) > _LONGEST_LINE:
            self._refuse("command too long")
            data = b""
        self._rest = data

    def _obey(self, command: bytes) -> None:
        start = command.rfind(b"<")
        words = command[start + 1 :].decode("ascii", "replace").split()
        if start < 0 or not words:
            self._refuse("expected < command >")
        elif words[0] == "send" and self.raw:
            self._send(words[1:])
        elif words[0] == "open" and len(words) == 2:
            if words[1] == self._hub.bus:
                self._opened = True
                self._transport.write(b"< ok >")
            else:
                self._refuse(f"no bus {words[1]}, open {self._hub.bus}")
        elif words[0] == "rawmode" and self._opened:
            self._transport.write(b"< ok >")
            if not self.raw:
                self.raw = True
                self._settling = bytearray()
                self._timer = asyncio.get_running_loop().call_later(SETTLE_S, self._settled)
                self._hub.update_listeners()
        elif words[0] == "echo":
            self._transport.write(b"< echo >")
        else:
            self._refuse("unknown command")

    def _settled(self) -> None:
        waiting, self._settling = self._settling, None
        if waiting:
            self._transport.write(bytes(waiting))

    def _send(self, words: list[str]) -> None:
        try:
            identifier, length = words[0].upper(), int(words[1], 16)
            data = bytes(int(word, 16) for word in words[2:])
            highest = 0x7FF if len(identifier) == 3 else 0x1FFFFFFF
            if len(identifier) not in (3, 8) or not 0 <= int(identifier, 16) <= highest:
                raise ValueError
            if len(data) != length or length > 8:
                raise ValueError
        except (ValueError, IndexError):
            self._refuse("could not parse send")
            return
        self._hub.relay(identifier, data, self)

    def _refuse(self, reason: str) -> None:
        self._transport.write(f"< error {reason} >".encode("ascii", "replace"))
