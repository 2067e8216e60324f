"""Panel over HTTP: who gets in, from where, and what of a run folder is served."""

from __future__ import annotations

import contextlib
import re
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from hil.bench.faults.tls import make_certificates
from hil.panel import PanelError, ServeOptions, serve
from hil.panel import connection as connection_module
from hil.run_folder import RunFolder, read_notes
from tests.hil.command_line import typed
from tests.hil.panel.served import Served

httpx = pytest.importorskip("httpx", reason="the panel's tests need httpx")
uvicorn = pytest.importorskip("uvicorn", reason="the panel needs uvicorn")


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
