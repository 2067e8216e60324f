"""Wire with one request at a time, each answered by its own reply within its deadline or not at all.

Deadlines count on a clock that goes on while this process is stopped or the machine suspended: a reply that is read
after such a gap was measured before it, and is no answer.

Over TCP a reply is identified by its transaction. RTU frames have none, and some devices answer with 0. After a request
without a valid answer the line must then fall silent before the next one goes out. `unanswered` reports to the bus that
its device may be a reply behind; the bus then sends a probe (`drivers.modbus.protocol.reply_offset`).
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import ssl
from collections.abc import Awaitable, Callable

from drivers.bus import steady_s
from drivers.modbus.protocol import frames_of
from drivers.modbus.serial_line import BITS_PER_BYTE, silence_s
from drivers.modbus.tls import client_context, why_refused
from drivers.modbus.wire import Lost, Received, Wire, open_wire
from drivers.rig_file import ModbusBusSection, ModbusRtuBus, ModbusTlsBus, is_numbered, is_rtu
from drivers.signals import DeadlineError, LateReplyError, LinkError, ProtocolError

RECONNECT_EVERY_S = 1.0
EXHAUSTED = (errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.ENOBUFS)
AT_ONCE_S = 1e-3
"""A reply within this time comes at once: the next is waited for without the event loop, which costs more than that."""
_PATIENCE_S = 10e-3
"""Time, s, before the loop takes over. A shorter time-out makes the kernel set a timer, which costs more."""
_LATE_AT_MOST = 3
"""Replies in a row that did not come at once, after which the loop waits for them until one comes at once again."""
LATE_S = 0.25
"""Time, s, after its deadline at which a reply may still be read: a busy machine wakes this process late."""
_YIELD_EVERY_S = 5e-3
_QUIET_S = 0.05
_QUIET_AT_MOST_S = 0.5

Opener = Callable[[ModbusBusSection, ssl.SSLContext | None, Received, Lost], Awaitable[Wire]]


class ModbusLink:
    """Only user of a wire. Devices that share it take turns; a wire that is lost is opened again automatically.

    `unanswered` counts the requests without a valid answer since the last one that had one. `patience_s` is the time
    that a connection without any answer is kept, for a device that is deaf after connecting.
    """

    def __init__(self, config: ModbusBusSection, *, opener: Opener = open_wire) -> None:
        self.config = config
        self.devices = 0
        self.reconnects = 0
        self.unanswered = 0
        self.patience_s = 0.0
        self.has_answered = False
        """True once anything was answered on this connection."""
        self.heard_nothing = False
        """True where not a byte came after the last unanswered request."""
        self.deaf_s = 0.0
        """Silence, s, of this connection before its first answer, where requests were lost meanwhile."""
        self.on_reopened: list[Callable[[], None]] = []
        self.exhausted: str | None = None
        """Sentence where this machine, not the device, prevents opening the wire: no descriptor or memory is left."""
        self.is_rtu = is_rtu(config)
        self.is_numbered = is_numbered(config)
        self._opener = opener
        self._tls = client_context(config) if isinstance(config, ModbusTlsBus) else None
        self._frames = frames_of(config)
        self._gap_s = config.gap_s
        if self.is_rtu and config.serial_baud is not None:
            self._gap_s = max(config.gap_s, silence_s(config.serial_baud))
        self._byte_s = BITS_PER_BYTE / config.serial_baud if config.serial_baud is not None else 0.0
        self._lock = asyncio.Lock()
        self._opening = asyncio.Lock()
        self._wire: Wire | None = None
        self._supervisor: asyncio.Task[None] | None = None
        self._waiting: tuple[int, bytes] | None = None
        self._reply: bytes | None = None
        self._refused: str | None = None
        self._cause: str | None = None
        """Cause of the end of the last connection."""
        self._closed_by_device = False
        self._opened_s = self._answered_s = 0.0
        self._waiter: asyncio.Future[None] | None = None
        self._quiet_since = 0.0
        self._unquiet = False
        self._late = 0
        self._yielded = 0.0

    @property
    def connected(self) -> bool:
        """True while the wire is open, as far as has been noticed."""
        return self._wire is not None

    async def open(self, where: str) -> None:
        """Open the wire, unless it is open; raise LinkError that names `where`."""
        async with self._opening:
            if self._wire is None:
                await self._open(where)

    async def _open(self, where: str) -> None:
        self._frames = frames_of(self.config)
        timeout_s = self.config.timeout_s + 1.0
        try:
            async with asyncio.timeout(timeout_s):
                wire = await self._opener(self.config, self._tls, self._received, self._lost)
        except (OSError, ValueError) as error:  # pyserial gives ValueError for a speed that a port has not
            if isinstance(error, OSError) and error.errno in EXHAUSTED:
                self.exhausted = f"{where} cannot be reached from here: {error.strerror}"
                raise LinkError(self.exhausted) from error
            await self.explain(where)
            why = f"no answer within {timeout_s:g} s" if isinstance(error, TimeoutError) else str(error)
            what = "serial_port" if isinstance(self.config, ModbusRtuBus) else "host and port"
            raise LinkError(f"{where} cannot be reached: {why}; is the rig on, and {what} right?") from error
        self._cause, self._closed_by_device, self.has_answered = None, False, False
        if self.config.connect_delay_s > 0.0:
            await asyncio.sleep(self.config.connect_delay_s)
        self._wire = wire
        self.exhausted = None
        self._opened_s = self._quiet_since = steady_s()
        self._unquiet = not self.is_numbered  # adapters give noise when they are opened, and converters late replies
        self._late = 0

    async def explain(self, where: str) -> None:
        """Raise LinkError with the cause where TLS was refused; return where TLS is not the cause."""
        if self._tls is None or not isinstance(self.config, ModbusTlsBus):
            return
        why = await why_refused(self.config, self._tls)
        if why is not None:
            raise LinkError(f"{where}: {why}")

    def drop(self) -> None:
        """Close the wire; it stays closed until someone opens it."""
        wire, self._wire = self._wire, None
        if wire is not None:
            wire.close()

    async def close(self) -> None:
        """Stop reconnecting and close the wire."""
        if self._supervisor is not None:
            self._supervisor.cancel()
            await asyncio.gather(self._supervisor, return_exceptions=True)
            self._supervisor = None
        self.drop()
        await asyncio.sleep(0)

    async def ask(self, device: int, pdu: bytes, timeout_s: float, where: str) -> bytes:
        """Return the PDU of the reply to a request; raise DeadlineError, LinkError, or ProtocolError of a garbled line.

        A device that closes the connection after each reply is reconnected at once. The request is repeated where the
        device closed before it answered.
        """
        async with self._lock:
            reply = await self._asked(device, pdu, timeout_s, where)
            if reply is None and self._may_ask_again:
                reply = await self._asked(device, pdu, timeout_s, where)
            if reply is None:
                raise self._failure(where, timeout_s)
            if self._answered_s - self._yielded > _YIELD_EVERY_S:
                await asyncio.sleep(0)  # replies that come at once would otherwise never let another task run
                self._yielded = steady_s()
            return reply

    async def _asked(self, device: int, pdu: bytes, timeout_s: float, where: str) -> bytes | None:
        """Send a request once and return its reply; None where no valid one came."""
        wire = await self._ready_wire(timeout_s, where)
        now = steady_s
        if self._gap_s > 0.0:
            wait_s = self._quiet_since + self._gap_s - now()
            if wait_s > 0.0:
                await asyncio.sleep(wait_s)
        if not self.is_numbered:
            await self._fall_silent(wire)
        self._reply = self._refused = None
        self._waiting = (device, pdu)
        self._unquiet = not self.is_numbered  # until the reply is here, whatever ends this
        frame = self._frames.frame(device, pdu)
        deadline_s = timeout_s + self._line_s(frame, pdu)
        began = now()
        try:
            wire.send(frame)
            if self._late < _LATE_AT_MOST:
                data = wire.take(_PATIENCE_S)
                if data:
                    self._received(data)
            if self._reply is None and self._refused is None:
                await self._wait(deadline_s)
            ended = now()
            self._late = 0 if ended - began < AT_ONCE_S else self._late + 1
        except OSError as error:
            self._closed_by_device = True
            self._broken(str(error))
            ended = now()
        finally:
            self._waiting = None
            self._quiet_since = now()
        if self._reply is None:
            self.unanswered += 1
            return None
        if ended - began > deadline_s + LATE_S:
            raise self._too_late(where, ended - began)
        if not self.has_answered:
            self.has_answered, self.deaf_s = True, ended - self._opened_s if self.unanswered else 0.0
        self.unanswered, self._answered_s = 0, ended
        return self._reply

    async def _ready_wire(self, timeout_s: float, where: str) -> Wire:
        """Return the open wire; raise LinkError where there is none, and begin to reconnect."""
        if self._wire is None and self._closes_itself:
            was, self._closed_by_device = self._answered_s, False
            with contextlib.suppress(LinkError, TimeoutError):
                # Python 3.11's wait_for loses a cancellation that comes when the connection stands.
                async with asyncio.timeout(timeout_s + self.config.connect_delay_s):
                    await self.open(where)
                if steady_s() - was > RECONNECT_EVERY_S:
                    self._tell_reopened()
        if self._wire is None and self.devices > 1:
            await self._reopened(timeout_s)
        if self._wire is None:
            why = "" if self._cause is None else f" ({self._cause})"
            self._reconnect()
            raise LinkError(f"{where}: the connection is lost{why}; reconnecting every {RECONNECT_EVERY_S:g} s")
        return self._wire

    @property
    def _closes_itself(self) -> bool:
        """True where the device has answered on the last connection and then closed it."""
        return self._closed_by_device and self.has_answered and not isinstance(self.config, ModbusRtuBus)

    @property
    def _may_ask_again(self) -> bool:
        """True where the device closed the connection instead of answering a request, after it had answered others."""
        return self._wire is None and self._closes_itself

    def _too_late(self, where: str, after_s: float) -> LateReplyError:
        """Return the error of a reply that was read too late: it is no answer, though the connection may stay."""
        self.unanswered += 1
        if not self.is_numbered:
            self._unquiet = True
            if not self.is_rtu:
                self.drop()
                self._reconnect()
        return LateReplyError(
            f"{where}: a reply was read {after_s:.1f} s after its request, too late to be used; was this process "
            "stopped or the machine suspended?"
        )

    def _line_s(self, frame: bytes, pdu: bytes) -> float:
        """Return the time, s, that request and reply take on the line itself."""
        if self._byte_s == 0.0:
            return 0.0
        count = int.from_bytes(pdu[3:5], "big") if pdu[0] in (1, 2, 3, 4, 23) else 0
        size = 5 + (-(-count // 8) if pdu[0] <= 2 else 2 * count)
        return (len(frame) + max(size, 8)) * self._byte_s

    async def _wait(self, seconds: float) -> None:
        loop = asyncio.get_running_loop()
        self._waiter = waiter = loop.create_future()
        timer = loop.call_later(seconds, self._wake)
        try:
            await waiter
        finally:
            timer.cancel()
            self._waiter = None
        self._yielded = steady_s()

    def _wake(self) -> None:
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_result(None)

    def _failure(self, where: str, timeout_s: float) -> Exception:
        """Return the error of a request without a valid reply, after closing or keeping the wire."""
        why = self._refused
        if why is None:
            why = self._frames.unused
        self.heard_nothing = why is None
        silence = f"{where}: " + (f"{why}; " if why is not None else "") + f"no answer within {timeout_s:g} s"
        lost = self._wire is None
        if self.is_rtu and not lost:
            if self._refused is not None:
                return ProtocolError(f"{where}: {self._refused}; the reply is not used")
            if self.unanswered >= 2 and not isinstance(self.config, ModbusRtuBus) and not self._may_be_deaf:
                self.drop()  # nobody on it answers: the connection itself may be dead
                self._reconnect()
            return DeadlineError(silence)
        if lost or self._refused is not None:
            self._cause = why or self._cause
            self.drop()
            self._reconnect()
            return LinkError(f"{where}: {self._cause or 'the connection is lost'}; reconnecting")
        if (self.devices < 2 or self.unanswered >= 2 or not self.is_numbered) and not self._may_be_deaf:
            self._cause = why
            self.drop()
            self._reconnect()
            silence += "; reconnecting"
        return DeadlineError(silence)

    @property
    def _may_be_deaf(self) -> bool:
        """True while this connection is so young that its device may not listen yet."""
        is_young = steady_s() - self._opened_s < self.patience_s
        return is_young and self.heard_nothing and not self.has_answered

    async def _fall_silent(self, wire: Wire) -> None:
        """Wait until nothing has arrived for a while, where something did: it belongs to an earlier request."""
        if wire.take(0.0):
            self._quiet_since, self._unquiet = steady_s(), True
        if not self._unquiet:
            return
        end = steady_s() + _QUIET_AT_MOST_S
        quiet_s = max(_QUIET_S, self._gap_s)
        left_s = self._quiet_since + quiet_s - steady_s()
        while left_s > 0.0 and steady_s() < end:
            await asyncio.sleep(left_s)
            left_s = self._quiet_since + quiet_s - steady_s()

    def _received(self, data: bytes) -> None:
        if self._waiting is None:
            self._quiet_since = steady_s()
            if not self.is_numbered:
                self._unquiet = True  # bytes without a request
                return
            device, pdu = 0, b"\0"
        else:
            device, pdu = self._waiting
        if self._reply is not None and self._waiting is not None:
            self._unquiet = not self.is_numbered
            return
        try:
            self._reply = self._frames.feed(data, device, pdu)
        except ProtocolError as error:
            self._refused = self._cause = str(error)
            if not self.is_rtu:
                self.drop()  # the beginning of the stream's next frame is not known any more
        if self._reply is not None:
            self._unquiet = False
        if self._reply is not None or self._refused is not None:
            self._wake()

    def _lost(self, why: str) -> None:
        self._closed_by_device = True
        if self._waiting is not None and not self.has_answered:
            why += " instead of answering; end its other clients, and see that it has this device_id"
        self._broken(why)
        self._wake()

    def _broken(self, why: str) -> None:
        if self._waiting is not None:
            why = self._frames.unused or why
        self._refused = self._cause = self._refused or why
        self.drop()

    async def _reopened(self, timeout_s: float) -> Wire | None:
        """Return the wire if the reconnection under way succeeds soon: another device's silence has closed it."""
        if self._supervisor is not None:
            await asyncio.wait((self._supervisor,), timeout=min(timeout_s, 0.2))
        return self._wire

    def _reconnect(self) -> None:
        if self._supervisor is None or self._supervisor.done():
            self._supervisor = asyncio.create_task(self._keep_trying(), name=f"reconnect {self.config.place}")

    async def _keep_trying(self) -> None:
        while True:
            with contextlib.suppress(LinkError):
                await self.open(self.config.place)
                self.reconnects += 1
                self._tell_reopened()
                return
            await asyncio.sleep(RECONNECT_EVERY_S)

    def _tell_reopened(self) -> None:
        for told in self.on_reopened:
            told()
