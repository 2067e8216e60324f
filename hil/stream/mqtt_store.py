"""Stream to an MQTT broker: a JSON topic a signal, retained state with a last will, events."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import socket
import ssl
import threading
from collections.abc import Callable, Iterable
from typing import Any

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

from drivers.signals import Quality
from hil.files import printable
from hil.stream.address import Address
from hil.stream.errors import StoreDownError, StreamError
from hil.stream.position_file import PositionFile
from hil.stream.store import Block, Position, RunIdentity, RunState, iso_time

ANSWER_WITHIN_S = 15.0
"""Longest time for an answer of the broker, s."""
KEEPALIVE_S = 15
"""Period of the protocol's own pings, s: a dead wire is noticed after one and a half."""
OWN_TOPICS = ("state", "events")
_REFUSED = {4, 5, 134, 135}
"""Return codes of MQTT 3.1.1 and 5 for a wrong user or password, and a client that may not connect."""
_QUICK_ACK: int | None = getattr(socket, "TCP_QUICKACK", None)
"""Option of Linux; it lasts until the next packet."""
_QUALITY = {int(member): member.name.lower() for member in Quality}

Message = tuple[str, str, bool]
"""Topic, payload, retained."""


class MqttStore:
    """Connection to a broker for one run: QoS 1, one tick under way at a time.

    The position is stored when the broker has acknowledged a tick or an event. After a crash only the last one that
    was not stored is sent again.

    Parameters
    ----------
    address
        Address of the broker.
    run
        Identity of the run.
    positions
        File for the confirmed position.
    start
        Position of a run of which nothing was sent yet.
    stride
        Ticks from a message of a signal to the next.

    Raises
    ------
    StreamError
        The broker refuses user or password, or its certificate is wrong.
    StoreDownError
        The broker does not answer.
    """

    longest_block = 1000
    stays = False

    def __init__(
        self, address: Address, run: RunIdentity, positions: PositionFile, *, start: Position, stride: int
    ) -> None:
        self._address, self._run, self._stride = address, run, stride
        self._positions, self._start = positions, start
        self._base = f"{address.prefix}/{_topic_part(run.name)}"
        self._topics = [f"{self._base}/{_signal_topic(signal.column)}" for signal in run.signals]
        self._state: RunState | None = None
        self._changed = threading.Condition()
        self._acknowledged: set[int] = set()
        self._answer: int | None = None
        self._lost = False
        self._client = self._connected()

    def position(self) -> Position:
        found = self._positions.read()
        if found is None:
            self._positions.write(self._start)  # so that a run that ends meanwhile is continued from here
        return found or self._start

    def send(self, block: Block) -> Position:
        at = block.before
        for i, tick in enumerate(block.tick.tolist()):
            if tick // self._stride != at.tick // self._stride:
                self._publish(self._samples(block, i))
                at = Position(tick, at.event)
                self._positions.write(at)
            else:
                at = Position(tick, at.event)
        for event in block.events:
            document = {"time": iso_time(event.time_us), "level": event.level, "text": printable(event.text)}
            self._publish([(f"{self._base}/events", json.dumps(document), False)])
            at = Position(at.tick, event.id)
            self._positions.write(at)
        if at.tick != block.before.tick:
            self._positions.write(at)
        if block.state != self._state:
            self._publish([self._state_message(block.state.name, block.state.reason, block.state.time_us)])
            self._state = block.state
        return at

    def close(self, *, ended: bool) -> None:
        if not ended and not self._lost:
            with contextlib.suppress(StoreDownError):  # the broker publishes the last will then
                self._publish([self._offline()])
        self._client.disconnect()
        self._client.loop_stop()

    def _samples(self, block: Block, i: int) -> Iterable[Message]:
        when = iso_time(int(block.time_us[i]))
        for topic, signal, value, quality in zip(
            self._topics, self._run.signals, block.values[i].tolist(), block.quality[i].tolist(), strict=True
        ):
            number = value if math.isfinite(value) else None
            name = _QUALITY.get(quality, str(quality))
            document = {"time": when, "value": number, "unit": signal.unit, "quality": name}
            yield topic, json.dumps(document), False

    def _state_message(self, state: str, reason: str, time_us: int | None) -> Message:
        when = None if time_us is None else iso_time(time_us)
        document = {"time": when, "state": state, "reason": printable(reason)}
        return f"{self._base}/state", json.dumps(document), True

    def _offline(self) -> Message:
        return self._state_message("offline", "the stream of the run is not connected", None)

    def _publish(self, messages: Iterable[Message]) -> None:
        """Publish and wait for all acknowledgements; raises StoreDownError."""
        sent: set[int] = set()
        for topic, payload, retained in messages:
            sent.add(self._client.publish(topic, payload, qos=1, retain=retained).mid)
        with self._changed:
            done = self._changed.wait_for(lambda: self._lost or sent <= self._acknowledged, ANSWER_WITHIN_S)
            if self._lost or not done:
                raise self._down("the connection was lost" if self._lost else "it does not answer")
            self._acknowledged -= sent

    def _connected(self) -> mqtt.Client:
        named = f"{self._run.uid} {self._address.shown}".encode("utf-8", "replace")
        client = mqtt.Client(
            CallbackAPIVersion.VERSION2,
            # The same after a crash: the broker then drops the former connection. Every broker takes 23 characters.
            client_id=f"hil-{hashlib.sha256(named).hexdigest()[:18]}",
            reconnect_on_failure=False,
        )
        if self._address.user is not None:
            client.username_pw_set(self._address.user, self._address.password)
        client.will_set(*self._offline()[:2], qos=1, retain=True)
        client.on_connect = lambda _client, _data, _flags, code, _properties: self._note_answer(code)
        client.on_publish = lambda _client, _data, mid, _code, _properties: self._note_acknowledgement(mid)
        client.on_disconnect = lambda *_arguments: self._note_loss()
        client.on_socket_open = lambda _client, _data, wire: _send_at_once(wire, socket.TCP_NODELAY)
        client.connect_timeout = ANSWER_WITHIN_S
        try:
            if self._address.scheme == "mqtts":
                client.tls_set_context(self._checked_context())
            client.connect(self._address.host, self._address.port, KEEPALIVE_S)
        except ssl.SSLEOFError:
            raise self._down("the connection was lost") from None
        except ssl.SSLError as error:
            why = error.verify_message if isinstance(error, ssl.SSLCertVerificationError) else error.reason
            raise StreamError(
                f"{self._address.shown}: TLS failed ({why}); check host and port, and name your authority's file in "
                "SSL_CERT_FILE"
            ) from None
        except (OSError, ValueError) as error:
            raise self._down(getattr(error, "strerror", None) or "no answer") from None
        client.loop_start()
        with self._changed:
            self._changed.wait_for(lambda: self._answer is not None or self._lost, ANSWER_WITHIN_S)
            answer = self._answer
        if answer == 0:
            return client
        client.disconnect()
        client.loop_stop()
        if answer in _REFUSED:
            raise StreamError(
                f"{self._address.shown}: the broker refused user or password; check them, or set HIL_MQTT_PASSWORD"
            )
        raise self._down("no answer of a broker" if answer is None else f"the broker refused with code {answer}")

    def _checked_context(self) -> ssl.SSLContext:
        """Return the TLS context after a handshake of its own: paho-mqtt leaves the socket of a failed one open."""
        context, place = ssl.create_default_context(), (self._address.host, self._address.port)
        with (
            socket.create_connection(place, ANSWER_WITHIN_S) as wire,
            context.wrap_socket(wire, server_hostname=self._address.host),
        ):
            return context

    def _down(self, why: str) -> StoreDownError:
        return StoreDownError(f"{self._address.shown} cannot be reached: {why}")

    def _note(self, change: Callable[[], Any]) -> None:
        with self._changed:
            change()
            self._changed.notify_all()

    def _note_answer(self, code: Any) -> None:
        self._note(lambda: setattr(self, "_answer", int(code.value)))

    def _note_acknowledgement(self, mid: int) -> None:
        # A broker that collects small packets (Nagle, RFC 896) waits for our delayed acknowledgement: 40 ms a tick.
        if _QUICK_ACK is not None and (wire := self._client.socket()) is not None:
            _send_at_once(wire, _QUICK_ACK)
        self._note(lambda: self._acknowledged.add(mid))

    def _note_loss(self) -> None:
        self._note(lambda: setattr(self, "_lost", True))


def _send_at_once(wire: Any, option: int) -> None:
    """Set an option of TCP that keeps small packets from waiting."""
    with contextlib.suppress(OSError):  # the wire was closed meanwhile
        wire.setsockopt(socket.IPPROTO_TCP, option, 1)


def _topic_part(name: str) -> str:
    """Return a name as one level of a topic: `/`, wildcards and control characters become `_`."""
    return "".join("_" if c in "/+#" or not c.isprintable() else c for c in printable(name))


def _signal_topic(column: str) -> str:
    part = _topic_part(column)
    return f"{part}_signal" if part in OWN_TOPICS else part
