"""A mosquitto broker of its own for tests, on a free port of this machine, and a subscriber that keeps all messages."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

BINARY = shutil.which("mosquitto") or next((p for p in ("/usr/sbin/mosquitto",) if Path(p).is_file()), None)


class NoBroker(Exception):
    """There is no mosquitto here; the message says what is missing."""


def free_port() -> int:
    """Return a port that nobody listens on at present."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


class Broker:
    """Broker that `start` begins; with a password only `plant` gets in. `tls` is certificate and key."""

    def __init__(
        self,
        folder: Path,
        password: str | None = None,
        *,
        host: str = "127.0.0.1",
        tls: tuple[Path, Path] | None = None,
    ) -> None:
        if BINARY is None:
            raise NoBroker("mosquitto is not installed (Debian: mosquitto)")
        self.host, self.port = host, free_port()
        self._process: subprocess.Popen[bytes] | None = None
        lines = [f"listener {self.port} {host}", "persistence false", "user root", "max_queued_messages 0"]
        if tls is not None:
            lines += [f"certfile {tls[0]}", f"keyfile {tls[1]}"]
        if password is None:
            lines.append("allow_anonymous true")
        else:
            made = folder / "passwords"
            subprocess.run(["mosquitto_passwd", "-b", "-c", made, "plant", password], check=True, timeout=20)
            lines += ["allow_anonymous false", f"password_file {made}"]
        self._config = folder / "mosquitto.conf"
        self._config.write_text("\n".join(lines) + "\n")

    def start(self) -> None:
        """Start the broker and wait until it listens."""
        assert BINARY is not None
        self._process = subprocess.Popen(
            [BINARY, "-c", self._config], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        until(lambda: _listens(self.host, self.port), "the broker listens")

    def stop(self) -> None:
        """Kill the broker."""
        if self._process is not None:
            self._process.kill()
            self._process.wait(timeout=10)
            self._process = None


class Subscriber:
    """Client that keeps topic, document and retained flag of each message."""

    def __init__(self, port: int, topics: str = "#") -> None:
        import paho.mqtt.client as mqtt
        from paho.mqtt.enums import CallbackAPIVersion

        self.messages: list[tuple[str, Any, bool]] = []
        subscribed = threading.Event()
        self._client = mqtt.Client(CallbackAPIVersion.VERSION2)
        self._client.on_message = lambda _c, _d, message: self.messages.append(
            (message.topic, json.loads(message.payload), message.retain)
        )
        self._client.on_subscribe = lambda *_arguments: subscribed.set()
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()
        self._client.subscribe(topics, qos=1)
        assert subscribed.wait(10)

    def of(self, ending: str) -> list[Any]:
        """Return the documents of the topics that end so, in order."""
        return [document for topic, document, _ in self.messages if topic.endswith(ending)]

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


def until(condition: Callable[[], object], what: str, within_s: float = 30.0) -> None:
    """Wait until a condition holds."""
    end = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < end, f"not within {within_s:g} s: {what}"
        time.sleep(0.02)


def _listens(host: str, port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((host, port)) == 0
