"""Panel of a folder in a thread of this process, its clients, and a control socket that answers as a live run."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from hil.panel import ServeOptions
from hil.panel import connection as connection_module
from hil.panel.access import Access
from hil.panel.app import Panel
from hil.panel.server import _listener as listening
from hil.run.engine.control_socket import _short
from tests.hil.alarmed_run import AlarmedRun

httpx = pytest.importorskip("httpx", reason="the panel's tests need httpx")
pytest.importorskip("starlette", reason="the panel needs starlette")
uvicorn = pytest.importorskip("uvicorn", reason="the panel needs uvicorn")

JSON = {"content-type": "application/json"}


class Steered:
    """Control socket of a run that answers as a live one, and keeps what it was asked."""

    def __init__(self, path: Path) -> None:
        self.asked: list[dict[str, str]] = []
        self.refuses = ""
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        with _short(path) as address:
            self._listener.bind(address)
        self._listener.listen()
        self._thread = threading.Thread(target=self._answer, daemon=True)
        self._thread.start()

    def _answer(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            with client, client.makefile("rwb") as lines:
                self.asked.append(json.loads(lines.readline()))
                answer = {"ok": not self.refuses, "text": self.refuses or "done", "status": {}}
                lines.write(json.dumps(answer).encode() + b"\n")

    def close(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join(5)


class Served:
    """Panel of a folder in a thread of this process, and a client with a session."""

    def __init__(self, folder: Path) -> None:
        self.listener = listening(ServeOptions(port=0))
        self.port = self.listener.getsockname()[1]
        self.access = Access(["127.0.0.1", "localhost"], self.port, secure=False)
        config = uvicorn.Config(
            Panel(folder, self.access).application(),
            log_level="critical",
            ws="none",
            timeout_graceful_shutdown=1,
            http=connection_module.Connection,
            limit_concurrency=20,
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run, kwargs={"sockets": [self.listener]}, daemon=True)
        self._thread.start()
        self.url = f"http://127.0.0.1:{self.port}"
        self.client = httpx.Client(base_url=self.url, timeout=20.0, trust_env=False)

    def enter(self) -> None:
        answer = self.client.get("/", params={"token": self.access.token})
        assert answer.status_code == 303

    def post(self, path: str, body: object, **headers: str) -> httpx.Response:
        content = body if isinstance(body, bytes) else json.dumps(body).encode()
        return self.client.post(path, content=content, headers={"origin": self.url, **JSON, **headers})

    def close(self) -> None:
        self.client.close()
        self._server.should_exit = True
        self._thread.join(15)
        assert not self._thread.is_alive()


@contextmanager
def stream(served: Served, run: AlarmedRun) -> Iterator[Iterator[tuple[str, dict[str, object]]]]:
    """Yield the events of a run's stream."""
    with served.client.stream("GET", f"/api/runs/{run.path.name}/stream") as answer:
        assert answer.headers["content-type"].startswith("text/event-stream")

        def events() -> Iterator[tuple[str, dict[str, object]]]:
            name = "message"
            for line in answer.iter_lines():
                if line.startswith("event: "):
                    name = line[7:]
                elif line.startswith("data: "):
                    yield name, json.loads(line[6:])

        yield events()
