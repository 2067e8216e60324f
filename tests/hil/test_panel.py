"""Panel over HTTP: who gets in, what may change anything, what a viewer sees, and what is refused."""

from __future__ import annotations

import contextlib
import json
import re
import shutil
import socket
import sqlite3
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.bench.faults.tls import make_certificates
from hil.panel import PanelError, ServeOptions, serve
from hil.panel import app as app_module
from hil.panel import connection as connection_module
from hil.panel.access import Access
from hil.panel.app import Panel
from hil.panel.server import _listener as listening
from hil.panel.trends import Trends
from hil.run.engine.control_socket import _short
from hil.run_folder import RunFolder, new_manifest, read_notes
from tests.hil.alarmed_run import AlarmedRun, alarmed_run
from tests.hil.command_line import typed

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


@pytest.fixture
def run(tmp_path: Path) -> Iterator[AlarmedRun]:
    made = alarmed_run(tmp_path)
    made.step(55.0)
    yield made
    if made.path.exists():
        made.finish()


@pytest.fixture
def served(run: AlarmedRun, tmp_path: Path) -> Iterator[Served]:
    made = Served(tmp_path)
    made.enter()
    yield made
    made.close()


@pytest.fixture
def steered(run: AlarmedRun) -> Iterator[Steered]:
    made = Steered(run.path / "control.sock")
    yield made
    made.close()


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


def test_the_token_of_the_first_address_begins_a_session_and_leaves_the_address(run, tmp_path):
    served = Served(tmp_path)
    try:
        for path in ("/", "/?token=wrong", "/api/runs", "/panel.js", f"/runs/{run.path.name}/report.html"):
            refused = served.client.get(path)
            assert refused.status_code == 403 and "open the address that `hil serve` printed" in refused.json()["text"]
            assert "set-cookie" not in refused.headers
        entered = served.client.get("/", params={"token": served.access.token})
        assert (entered.status_code, entered.headers["location"]) == (303, "/")
        assert re.fullmatch(
            rf"hil_session_{served.port}=[\w-]{{40,}}; Path=/; HttpOnly; SameSite=Strict", entered.headers["set-cookie"]
        )
        page = served.client.get("/")
        assert page.status_code == 200 and "<title>hil</title>" in page.text
        assert served.access.token not in page.text
    finally:
        served.close()


def test_every_answer_forbids_foreign_and_inline_script(served, run):
    for path in ("/", "/panel.js", "/api/runs", "/nowhere"):
        headers = served.client.get(path).headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy and "script-src 'self'" in policy and "unsafe" not in policy
        assert "frame-ancestors 'none'" in policy and headers["x-content-type-options"] == "nosniff"
        assert headers["cache-control"] == "no-store" and headers["referrer-policy"] == "no-referrer"
    page = served.client.get("/").text
    assert not re.search(r"<script>|<style|\son\w+=|style=", page)
    for script in ("/panel.js", "/trends.js"):
        assert not re.search(
            r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|eval\(", served.client.get(script).text
        )


@pytest.mark.parametrize("host", ["rebound.example.org", "127.0.0.1", "127.0.0.1:1", ""])
def test_a_name_that_is_pointed_at_this_machine_reads_nothing(served, run, host):
    answer = served.client.get("/api/runs", headers={"host": host})
    assert answer.status_code in (400, 421) and run.path.name not in answer.text


def test_nothing_changes_by_get_nor_from_another_origin(served, run, steered):
    for path, body in (
        ("verb", {"verb": "abort", "confirmed": True}),
        ("alarm", {"act": "acknowledge", "id": "T_tank.H"}),
        ("note", {"text": "x"}),
    ):
        url = f"/api/runs/{run.path.name}/{path}"
        assert served.client.get(url, params=body).status_code == 405
        for origin in (
            "http://evil.example.org",
            "null",
            f"http://127.0.0.1:{served.port + 1}",
            f"https://127.0.0.1:{served.port}",
        ):
            assert served.post(url, body, origin=origin).status_code == 403
        assert served.client.post(url, json=body).status_code == 403  # without an Origin
        form = {"content-type": "text/plain"}
        assert served.post(url, body, **form).status_code == 415
        served.client.cookies.clear()
        assert served.post(url, body).status_code == 403
        served.enter()
    assert steered.asked == [] and read_notes(RunFolder(run.path)) == [] and not (run.path / "alarms.jsonl").exists()
    assert served.client.put("/api/runs").status_code == 405


def test_a_viewer_sees_state_values_twins_and_alarms_and_a_late_one_the_past(served, run):
    with stream(served, run) as events:
        _, now = next(events)
        assert (now["state"], now["live"], now["status"], now["time_s"]) == ("running", False, "running", 29.0)
        values = {value["name"]: value for value in now["values"]}
        assert (values["T_tank"]["value"], values["T_tank"]["quality"], values["T_tank"]["unit"]) == (
            55.0,
            "good",
            "°C",
        )
        assert values["T_tank"]["age_s"] == pytest.approx(0.0) and "alarm_bits" not in values
        assert [(alarm["id"], alarm["state"]) for alarm in now["alarms"]["alarms"]] == [("T_tank.H", "unacknowledged")]
        assert {twin["sensor"] for twin in now["twins"]} == set(run.run.truth.header.twin_sensors)
        run.run.truth.quality[run.run.written :, 16] = 3  # T_tank
        run.step(55.0)
        assert _next(events, lambda state: state["time_s"] == 44.0)["values"][-1]["quality"] == "sensor fault"
    past = served.client.get(f"/api/runs/{run.path.name}/history").json()
    assert past["sensors"] and past["twins"] == ["static"]
    for course in (past["all"], past["recent"]):
        assert course["time_s"][0] < 1.0 and course["time_s"][-1] > 43.0
        assert course["series"]["T_tank"]["mean"][0] == 25.0 and course["series"]["T_tank"]["mean"][-1] is None
        assert course["series"]["T_tank_C static"]["mean"][-1] is not None


def _next(events, wanted):
    for _, state in events:
        if wanted(state):
            return state
    raise AssertionError("the stream ended")


def test_an_operator_steers_by_confirmed_requests_and_reads_the_answer(served, run, steered):
    url = f"/api/runs/{run.path.name}/verb"
    for body, said in (
        ({"verb": "pause"}, "confirm it"),
        ({"verb": "pause", "confirmed": "yes"}, "confirm it"),
        ({"verb": "reboot", "confirmed": True}, "give one of hold"),
        ({"verb": "resume", "confirmed": True, "seen": "paused"}, "the run is running now, and was 'paused'"),
        ({"verb": "pause", "confirmed": True, "reason": 5}, "reason must be text"),
        ([], "no JSON object"),
        (b"{", "no JSON"),
        ({"verb": "pause", "reason": "x" * app_module.MOST_BODY}, "at most 16384 bytes"),
    ):
        answer = served.post(url, body)
        assert answer.status_code == 400 and said in answer.json()["text"], body
    assert steered.asked == []
    done = served.post(url, {"verb": "pause", "confirmed": True, "reason": "topping up\n", "by": "Ada"})
    assert done.json() == {"ok": True, "text": "done"}
    assert steered.asked == [{"verb": "pause", "reason": "topping up (panel, Ada)"}]
    steered.refuses = "tripped: T_tank is 80 degC"
    answer = served.post(url, {"verb": "resume", "confirmed": True, "seen": "running"})
    assert (answer.status_code, answer.json()["text"]) == (409, "tripped: T_tank is 80 degC")


def test_a_run_that_does_not_listen_is_named_in_a_sentence(served, run):
    answer = served.post(f"/api/runs/{run.path.name}/verb", {"verb": "abort", "confirmed": True})
    assert answer.status_code == 409 and "is no live run" in answer.json()["text"]


def test_alarms_are_acknowledged_and_shelved_and_notes_added(served, run):
    url = f"/api/runs/{run.path.name}"
    for body, said in (
        ({"act": "delete", "id": "T_tank.H"}, "acknowledge, shelve or unshelve"),
        ({"act": "acknowledge", "id": "T_tnk.H", "count": 1}, "did you mean T_tank.H?"),
        ({"act": "shelve", "id": "T_tank.H", "reason": "x"}, "needs an end"),
        ({"act": "shelve", "id": "T_tank.H", "reason": "x", "for_s": True}, "needs an end"),
        ({"act": "shelve", "id": "T_tank.H", "for_s": 60}, "needs a reason"),
    ):
        answer = served.post(f"{url}/alarm", body)
        assert answer.status_code == 400 and said in answer.json()["text"]
    done = served.post(f"{url}/alarm", {"act": "acknowledge", "id": "T_tank.H", "by": "Ada", "count": 1})
    assert done.json()["text"] == "T_tank.H: acknowledged; it came at 2023-11-14T22:13:35Z"
    with stream(served, run) as events:
        alarm = next(events)[1]["alarms"]["alarms"][0]
    assert (alarm["state"], alarm["by"]) == ("acknowledged", "Ada")
    assert served.post(f"{url}/note", {"text": "topped up", "by": "Ada"}).json()["ok"]
    assert served.post(f"{url}/note", {"text": " "}).status_code == 400
    assert [(note.by, note.text) for note in read_notes(RunFolder(run.path))] == [("Ada", "topped up")]


def test_pages_of_a_run_folder_get_an_origin_of_their_own_and_nothing_else_of_it_is_served(served, run):
    (run.path / "report.html").write_text("<script>alert(1)</script>", encoding="utf-8")
    report = served.client.get(f"/runs/{run.path.name}/report.html")
    policy = report.headers["content-security-policy"]
    assert report.status_code == 200 and policy.startswith("sandbox allow-scripts;") and "default-src 'none'" in policy
    (run.path / "report.html").unlink()
    for path in ("report.html", "journal.sqlite", "run.json", "..%2f..%2fetc%2fpasswd", "control.sock"):
        assert served.client.get(f"/runs/{run.path.name}/{path}").status_code == 404
    assert served.client.get("/runs/..%2f/report.html").status_code == 404
    assert served.client.get("/api/runs/%2e%2e/stream").status_code == 404


def test_a_run_whose_folder_goes_is_said_to_viewers_and_the_panel_goes_on(served, run):
    with stream(served, run) as events:
        next(events)
        run.run._held.close()
        run.run.writer.close()
        shutil.rmtree(run.path)
        name, said = next((name, state) for name, state in events if name == "gone")
    assert name == "gone" and "is gone; it was deleted or moved" in said["text"]
    deadline = time.monotonic() + 10
    while served.client.get("/api/runs").json() != {"runs": []}:
        assert time.monotonic() < deadline
        time.sleep(0.2)
    answer = served.post(f"/api/runs/{run.path.name}/note", {"text": "x"})
    assert answer.status_code == 400 and "there is no run" in answer.json()["text"]


def test_a_viewer_that_stalls_is_dropped_and_delays_nobody(served, run, monkeypatch):
    monkeypatch.setattr(app_module, "STALLED_S", 0.3)
    monkeypatch.setattr("hil.panel.feeds.POLL_S", 0.02)
    cookie = "; ".join(f"{name}={value}" for name, value in served.client.cookies.items())
    head = f"GET /api/runs/{run.path.name}/stream HTTP/1.1\r\nHost: 127.0.0.1:{served.port}"
    request = f"{head}\r\nCookie: {cookie}\r\n\r\n"
    with socket.socket() as stalls:
        stalls.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        stalls.connect(("127.0.0.1", served.port))
        stalls.sendall(request.encode())
        with stream(served, run) as events:
            began, gone = time.monotonic(), False
            while not gone and time.monotonic() - began < 20.0:
                next(events)
                gone = _streams(served) == 1
        assert gone, "the stalled viewer is still served"


def _streams(served: Served) -> int:
    """Return the number of viewers that the panel serves now."""
    guarded = served._server.config.app
    return guarded._stream.__self__._streams


def test_more_viewers_than_allowed_are_refused(served, run, monkeypatch):
    monkeypatch.setattr(app_module, "MOST_STREAMS", 1)
    with stream(served, run) as events:
        next(events)
        answer = served.client.get(f"/api/runs/{run.path.name}/stream")
        assert answer.status_code == 503 and "1 viewers look on already" in answer.json()["text"]


def test_a_run_without_alarms_is_shown_with_a_sentence_in_their_place(served, run):
    run.run.writer.put_meta("alarms", None)
    run.run.writer.commit()
    with stream(served, run) as events:
        alarms = next(events)[1]["alarms"]
    assert alarms["known"] is False and "holds no alarm definitions" in alarms["text"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--host", "0.0.0.0"), "can be reached from other machines, and that needs TLS; add --cert and --key"),
        (("--host", "192.0.2.1", "--cert", "none.pem"), "needs TLS"),
        (("--host", "rig.example.org"), "is no address of this machine"),
        (("--cert", "none.pem"), "give both --cert and --key"),
        (("--name", "https://rig.example.org"), "is no name of a machine; give it alone"),
        (("--cert", "none.pem", "--key", "none.key"), "there is no certificate none.pem"),
        (("--host", "0.0.0.0", "--cert", "none.pem", "--key", "none.key"), "add --name"),
    ],
)
def test_an_open_or_unusable_address_is_refused_in_one_sentence(run, arguments, said):
    refused = typed("serve", run.path, *arguments)
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1) and said in refused.stderr


def test_a_port_in_use_and_what_is_no_folder_are_refused(run, tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as other:
        refused = typed("serve", run.path, "--port", other.getsockname()[1])
    assert refused.returncode == 2 and "cannot be had (Address already in use)" in refused.stderr
    assert "is no folder" in typed("serve", tmp_path / "none").stderr


@contextmanager
def served_by_tls(folder: Path, certificate: Path, key: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Serve a panel with a certificate in a thread, and yield its address."""
    said: list[str] = []
    servers: list[uvicorn.Server] = []
    original = uvicorn.Server.__init__

    def kept(self, config):
        original(self, config)
        servers.append(self)

    monkeypatch.setattr(uvicorn.Server, "__init__", kept)
    options = ServeOptions("0.0.0.0", 0, certificate, key, ("127.0.0.1",))
    thread = threading.Thread(target=serve, args=(folder, options, said.append), daemon=True)
    thread.start()
    deadline = time.monotonic() + 15
    while not (said and servers and servers[0].started):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    try:
        yield said[0]
    finally:
        servers[0].should_exit = True
        thread.join(15)


@pytest.mark.skipif(shutil.which("openssl") is None, reason="certificates are made by openssl")
def test_other_machines_get_in_by_tls_with_the_token_alone(run, tmp_path, monkeypatch):
    certificate, key, _ = make_certificates(tmp_path).rig
    with pytest.raises(PanelError, match="are no certificate and its key"):
        serve(run.path, ServeOptions(certificate=certificate, key=certificate), print)
    locked = tmp_path / "locked.key"
    command = ["openssl", "pkey", "-in", str(key), "-aes256", "-passout", "pass:x", "-out", str(locked)]
    subprocess.run(command, check=True, capture_output=True)
    with pytest.raises(PanelError, match=r"locked.key has a passphrase"):
        serve(run.path, ServeOptions(certificate=certificate, key=locked), print)
    with (
        served_by_tls(run.path, certificate, key, monkeypatch) as address,
        httpx.Client(verify=False, trust_env=False) as client,
    ):
        base, _, token = address.partition("/?token=")
        assert base.startswith("https://127.0.0.1:") and len(token) > 40
        assert client.get(f"{base}/api/runs").status_code == 403
        entered = client.get(address)
        assert entered.status_code == 303 and entered.headers["set-cookie"].endswith("; Secure")
        assert client.get(f"{base}/api/runs").json()["runs"][0]["name"] == run.path.name


@pytest.mark.skipif(shutil.which("openssl") is None, reason="certificates are made by openssl")
@pytest.mark.parametrize("sent", [b"", b"\x16\x03\x01"], ids=["nothing", "a begin"])
def test_a_tls_handshake_that_does_not_end_is_closed(run, tmp_path, monkeypatch, sent):
    certificate, key, _ = make_certificates(tmp_path).rig
    monkeypatch.setattr("hil.panel.server.HANDSHAKE_S", 0.5)
    with served_by_tls(run.path, certificate, key, monkeypatch) as address, contextlib.ExitStack() as stack:
        port = int(re.search(r":(\d+)/", address)[1])
        began = time.monotonic()
        silent = [stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=10)) for _ in range(20)]
        for one in silent:
            one.sendall(sent)
        for one in silent:
            with contextlib.suppress(ConnectionResetError):
                assert one.recv(100) == b""
        assert 0.4 < time.monotonic() - began < 8.0
        with httpx.Client(verify=False, trust_env=False) as client:
            assert client.get(address).status_code == 303


def test_a_killed_run_is_interrupted_and_takes_no_request(served, run, steered):
    with stream(served, run) as events:
        assert next(events)[1]["live"] is True
        run.run._held.close()  # as after kill -9: the socket stays
        now = _next(events, lambda state: not state["live"])
    assert now["status"] == "interrupted"
    deadline = time.monotonic() + 10
    while served.client.get("/api/runs").json()["runs"][0]["status"] != "interrupted":
        assert time.monotonic() < deadline
        time.sleep(0.1)


def test_readers_that_ask_whether_a_run_is_held_do_not_keep_it_from_going_on(run):
    folder = RunFolder(run.path)
    assert folder.is_held is True and not folder.was_cut
    run.run._held.close()
    stop = threading.Event()
    threads = [threading.Thread(target=lambda: [folder.was_cut for _ in iter(stop.is_set, True)]) for _ in range(2)]
    for thread in threads:
        thread.start()
    try:
        assert all(folder.was_cut for _ in range(50))
        for _ in range(20):
            with folder.owned():
                pass
    finally:
        stop.set()
        for thread in threads:
            thread.join(10)


def test_an_alarm_that_came_again_is_not_acknowledged_by_who_saw_the_first(served, run):
    url, seen = f"/api/runs/{run.path.name}/alarm", {"act": "acknowledge", "id": "T_tank.H", "count": 1}
    answer = served.post(url, {"act": "acknowledge", "id": "T_tank.H"})
    assert answer.status_code == 400 and "give count" in answer.json()["text"]
    run.step(25.0)
    run.step(55.0)
    answer = served.post(url, seen)
    assert answer.status_code == 400 and "came again since you looked" in answer.json()["text"]
    assert served.post(url, seen | {"count": 2}).status_code == 200


@pytest.mark.parametrize("text", ["1" * 400, "1e999", "-1", "null"])
def test_a_duration_that_is_none_is_refused(served, run, text):
    body = f'{{"act": "shelve", "id": "T_tank.H", "reason": "x", "for_s": {text}}}'.encode()
    answer = served.post(f"/api/runs/{run.path.name}/alarm", body)
    assert answer.status_code == 400 and "needs an end" in answer.json()["text"]


@pytest.mark.parametrize("name", ["x" * 300, "a%00b"])
def test_a_name_that_no_file_can_have_is_no_run(served, name):
    assert served.client.get(f"/api/runs/{name}/stream").status_code == 404
    assert served.client.get(f"/runs/{name}/report.html").status_code == 404


def test_a_defect_in_one_feed_is_a_sentence_and_touches_no_other_run(served, run, monkeypatch):
    from hil.panel.feeds import RunFeed

    poll = RunFeed.poll
    monkeypatch.setattr(RunFeed, "poll", lambda self: {}["no such key"])
    with stream(served, run) as events:
        name, said = next(events)
    assert name == "gone" and "and cannot be shown" in said["text"]
    monkeypatch.setattr(RunFeed, "poll", poll)
    with stream(served, run) as events:
        assert next(events)[0] == "message"


def test_a_forged_time_is_said_to_viewers(served, run):
    with contextlib.closing(sqlite3.connect(run.path / "journal.sqlite")) as database, database:
        database.execute("UPDATE states SET wall_s = 1e30")
    with stream(served, run) as events:
        name, said = next(events)
    assert name == "gone" and "1e+30 s is no time" in said["text"]


def test_a_malformed_cookie_of_another_service_locks_nobody_out(served):
    (mine,) = (f"{name}={value}" for name, value in served.client.cookies.items())
    served.client.cookies.clear()
    old = f"hil_session_{served.port}=old; {mine}"
    for cookies in (f"a=b c; {mine}", f'x="1;2"; {mine}; y', f"{{}}=1; ;{mine}", old):
        assert served.client.get("/api/runs", headers={"cookie": cookies}).status_code == 200
    assert served.client.get("/api/runs", headers={"cookie": f"x{mine}"}).status_code == 403


def test_connections_without_a_request_lock_nobody_out_and_end(served, monkeypatch):
    monkeypatch.setattr(connection_module, "UNFINISHED_S", 0.5)
    head = f"POST /api/runs/x/note HTTP/1.1\r\nHost: 127.0.0.1:{served.port}\r\n"
    idle = [socket.create_connection(("127.0.0.1", served.port)) for _ in range(25)]
    try:
        idle[-1].sendall(head.encode())
        idle[-2].sendall(f"{head}Content-Length: 10\r\n\r\n12".encode())
        assert served.client.get("/api/runs").status_code == 200
        for one in idle:
            one.settimeout(10)
            with contextlib.suppress(ConnectionResetError):
                while one.recv(4096):
                    pass
    finally:
        for one in idle:
            one.close()
    with served.client.stream("GET", "/panel.js") as answer:
        assert answer.status_code == 200


def test_an_empty_folder_is_an_empty_list_and_runs_come_newest_first(tmp_path):
    served = Served(tmp_path)
    try:
        served.enter()
        assert served.client.get("/api/runs").json() == {"runs": []}
        for name, started in (("b", "2026-01-01"), ("a", "2026-03-01"), ("c", "2026-02-01")):
            (tmp_path / name).mkdir()
            folder = RunFolder(tmp_path / name)
            folder.write_manifest(new_manifest({}) | {"started": f"{started}T00:00:00+00:00", "exit_status": "done"})
        deadline = time.monotonic() + 10
        while [run["name"] for run in served.client.get("/api/runs").json()["runs"]] != ["a", "c", "b"]:
            assert time.monotonic() < deadline
            time.sleep(0.2)
    finally:
        served.close()


@settings(max_examples=60)
@given(
    st.lists(st.tuples(st.integers(0, 400), st.one_of(st.none(), st.integers(-50, 50))), min_size=1, max_size=60),
    st.lists(st.integers(1, 20), max_size=6),
)
def test_a_course_keeps_mean_least_and_greatest_of_each_bin_however_it_comes(points, sizes):
    points = sorted(points, key=lambda point: point[0])
    time_s = np.array([at for at, _ in points], dtype=float)
    values = np.array([[np.nan if value is None else value] for _, value in points], dtype=float)
    course, first = Trends(["x"], 1.0, bins=8), 0
    for size in [*sizes, len(points)]:
        course.add(time_s[first : first + size], [0], values[first : first + size])
        first += size
    document = course.document()
    assert len(document["time_s"]) <= 8 and document["bin_s"] * 8 > time_s[-1]
    bins: dict[int, list[float]] = {}
    for at, value in points:
        if value is not None:
            bins.setdefault(int(at // document["bin_s"]), []).append(value)
    assert document["time_s"] == [(k + 0.5) * document["bin_s"] for k in sorted(bins)]
    series = document["series"]["x"]
    for k, members in enumerate(bins[key] for key in sorted(bins)):
        assert series["mean"][k] == pytest.approx(np.mean(members), rel=1e-4, abs=1e-9)
        assert (series["low"][k], series["high"][k]) == (min(members), max(members))
