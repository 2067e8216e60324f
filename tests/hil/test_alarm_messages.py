"""Messages about alarms: to a web server, an SMTP server and a broker of this machine, limited in rate, each once."""

from __future__ import annotations

import contextlib
import email
import email.header
import email.message
import http.server
import json
import logging
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.alarms import AlarmError, NotifyOptions, notify_run, read_addresses
from hil.alarms import notify as notify_module
from hil.alarms.alarm_list import Change, fold
from hil.alarms.notify import shown
from hil.alarms.outbox import Outbox, line_of, message
from tests.hil.alarmed_run import TANK, alarmed_run
from tests.hil.command_line import typed
from tests.hil.mosquitto_broker import BINARY, Broker, free_port

pytest.importorskip("apprise", reason="messages need apprise")
SECRET = "s3cr3t-token"


class WebHook:
    """Web server that keeps what it is sent, and refuses on request."""

    def __init__(self) -> None:
        self.bodies: list[dict[str, str]] = []
        self.refuses = False
        hook = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                self.send_response(500 if hook.refuses else 200)
                self.end_headers()
                if not hook.refuses:
                    hook.bodies.append(json.loads(body) | {"path": self.path})

            def log_message(self, format: str, *arguments: object) -> None:
                pass

        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()
        self.url = f"json://ada:{SECRET}@127.0.0.1:{self._server.server_port}/{SECRET}"

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join(5)


@pytest.fixture
def hook() -> Iterator[WebHook]:
    made = WebHook()
    yield made
    made.close()


@contextlib.contextmanager
def following(run, addresses, per_hour=10):
    """Follow the run in a thread, as the command does in a process; yields its lines."""
    lines: list[str] = []
    failures: list[BaseException] = []

    def follow() -> None:
        try:
            notify_run(run.path, addresses, NotifyOptions(per_hour), lines.append)
        except BaseException as error:
            failures.append(error)

    thread = threading.Thread(target=follow, daemon=True)
    thread.start()
    yield lines
    thread.join(20)
    assert not thread.is_alive() and failures == []


def until(condition, seconds=10.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(notify_module, "POLL_S", 0.05)
    monkeypatch.setattr(notify_module, "RETRY_S", (0.1,))


def test_a_web_hook_gets_each_alarm_and_its_end_once_and_secrets_are_nowhere(tmp_path, hook, caplog, capfd):
    run = alarmed_run(tmp_path)
    with caplog.at_level(logging.INFO), following(run, (hook.url,)) as lines:
        until(lambda: run.path.joinpath("alarms-notified.json").exists())
        run.step(55.0)
        until(lambda: len(hook.bodies) == 1)
        run.step(25.0)
        until(lambda: len(hook.bodies) == 2)
        run.finish()
    first, second = hook.bodies
    assert "ALARM high T_tank.H = 55 °C: T_tank above 50 °C" in first["message"]
    assert "over  high T_tank.H" in second["message"]
    assert run.path.name in first["title"] and first["path"] == f"/{SECRET}"
    kept = "".join(path.read_text() for path in run.path.glob("*.json*"))
    out = capfd.readouterr()
    assert SECRET not in "".join([*lines, caplog.text, kept, out.out, out.err])


def test_a_second_start_repeats_nothing_and_sends_what_came_meanwhile(tmp_path, hook):
    run = alarmed_run(tmp_path)
    run.step(55.0)
    command = [sys.executable, "-m", "hil", "alarms", str(run.path), "--follow", "--notify", hook.url]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        until(lambda: len(hook.bodies) == 1 and run.path.joinpath("alarms-notified.json").exists(), 30)
        busy = typed("alarms", run.path, "--follow", "--notify", hook.url)
        assert busy.returncode == 2 and "another process sends the alarms" in busy.stderr
    finally:
        process.kill()
        process.wait(10)
    run.step(55.0, flow=0.2)
    run.finish()
    done = typed("alarms", run.path, "--follow", "--notify", hook.url)
    assert (done.returncode, done.stdout.splitlines()[-1]) == (0, "1 messages sent")
    assert [("T_tank.H" in body["message"], "flow.L" in body["message"]) for body in hook.bodies] == [
        (True, False),
        (False, True),
    ]


def test_an_address_that_takes_nothing_is_said_once_and_tried_again(tmp_path, hook):
    run = alarmed_run(tmp_path)
    hook.refuses = True
    with following(run, (hook.url,)) as lines:
        until(lambda: run.path.joinpath("alarms-notified.json").exists())
        run.step(55.0)
        until(lambda: any("did not take a message" in line for line in lines))
        time.sleep(0.3)
        hook.refuses = False
        until(lambda: len(hook.bodies) == 1)
        run.finish()
    said = [line for line in lines if "127.0.0.1" in line]
    assert said == [
        "json://127.0.0.1/... did not take a message; it is tried again",
        "json://127.0.0.1/... takes messages again",
    ]


def test_mail_goes_through_an_smtp_server(tmp_path):
    controller = pytest.importorskip("aiosmtpd.controller")

    class Handler:
        def __init__(self) -> None:
            self.mails: list[email.message.Message] = []

        async def handle_DATA(self, server, session, envelope) -> str:
            self.mails.append(email.message_from_bytes(envelope.content))
            return "250 taken"

    handler = Handler()
    server = controller.Controller(handler, hostname="127.0.0.1", port=free_port())
    server.start()
    try:
        run = alarmed_run(tmp_path)
        run.step(55.0)
        run.finish()
        address = f"mailto://127.0.0.1:{server.port}?from=rig@example.org&to=ada@example.org"
        assert notify_run(run.path, (address,), NotifyOptions(), lambda line: None) == 1
    finally:
        server.stop()
    (mail,) = handler.mails
    subject = str(email.header.make_header(email.header.decode_header(mail["Subject"])))
    assert mail["To"] == "ada@example.org" and run.path.name in subject
    text = next(part for part in mail.walk() if not part.is_multipart()).get_payload(decode=True).decode()
    assert "T_tank.H" in text and "\n" not in text.strip()
    assert {part.get_content_type() for part in mail.walk() if not part.is_multipart()} == {"text/plain"}


@pytest.mark.skipif(BINARY is None, reason="no mosquitto here; .ci/run installs it")
def test_a_broker_gets_a_message_over_mqtt(tmp_path):
    from paho.mqtt.client import CallbackAPIVersion, Client

    got: list[str] = []
    broker = Broker(tmp_path)
    broker.start()
    client = Client(CallbackAPIVersion.VERSION2)
    try:
        client.on_message = lambda _client, _data, found: got.append(found.payload.decode())
        client.connect("127.0.0.1", broker.port)
        client.subscribe("rigs/alarms")
        client.loop_start()
        run = alarmed_run(tmp_path)
        run.step(55.0)
        run.finish()
        address = f"mqtt://127.0.0.1:{broker.port}/rigs/alarms"
        assert notify_run(run.path, (address,), NotifyOptions(), lambda line: None) == 1
        until(lambda: got)
    finally:
        client.loop_stop()
        client.disconnect()
        broker.stop()
    assert "T_tank.H" in got[0]


@settings(max_examples=60)
@given(st.lists(st.tuples(st.floats(0, 900), st.integers(0, 5)), max_size=40), st.integers(1, 20))
def test_no_more_messages_than_allowed_leave_in_any_hour_and_no_line_is_lost(course, per_hour):
    outbox, now, left, given_lines, got = Outbox(per_hour), 0.0, [], 0, []
    for passed, count in course:
        now += passed
        outbox.add([f"line {given_lines + k}" for k in range(count)])
        given_lines += count
        if lines := outbox.due(now):
            outbox.sent(len(lines))
            left.append(now)
            got += lines
    got += outbox.due(now, last=True)
    assert got == [f"line {k}" for k in range(given_lines)]
    for first in left:  # a full bucket, and what comes back into it in the hour
        assert sum(first <= at < first + 3600.0 for at in left) <= 2 * per_hour


def test_a_flood_is_put_together_and_counted():
    text = message([f"line {k}" for k in range(70)])
    assert text.count("\n") == 50 and text.endswith("and 20 more, see `hil alarms`")


def test_addresses_are_read_from_a_file_that_others_cannot_read(tmp_path):
    file = tmp_path / "notify"
    file.write_text("# who is told\n\njson://127.0.0.1/x\nmailto://127.0.0.1\n")
    os.chmod(file, 0o644)
    with pytest.raises(AlarmError, match=r"may be read by others.*chmod 600"):
        read_addresses(file)
    os.chmod(file, 0o600)
    assert read_addresses(file) == ("json://127.0.0.1/x", "mailto://127.0.0.1")
    file.write_text("\n")
    with pytest.raises(AlarmError, match="holds no address"):
        read_addresses(file)
    with pytest.raises(AlarmError, match="cannot be read"):
        read_addresses(tmp_path / "none")


@pytest.mark.parametrize("address", ["carrier-pigeon://x/s3cr3t-token", "s3cr3t-token", "json://[s3cr3t-token"])
def test_an_address_that_is_none_is_refused_without_being_repeated(tmp_path, address):
    run = alarmed_run(tmp_path)
    refused = typed("alarms", run.path, "--follow", "--notify", address)
    assert refused.returncode == 2 and "is no address that Apprise knows" in refused.stderr
    assert SECRET not in refused.stderr and "Traceback" not in refused.stderr
    run.finish()


def test_an_address_is_shown_by_its_kind_and_host_alone():
    assert shown(f"mailtos://ada:{SECRET}@mail.example.org?to=x") == "mailtos://mail.example.org/..."


def test_a_critical_alarm_waits_for_nothing_and_the_urgent_ones_come_first():
    outbox = Outbox(1)
    outbox.add(["first"])
    assert outbox.due(0.0) == ("first",)
    outbox.sent(1)
    outbox.add(["low"])
    outbox.add(["high"], 1)
    assert outbox.due(1.0) == ()
    outbox.add(["critical"], 0)
    assert outbox.due(2.0) == ("critical",)
    outbox.sent(1)
    assert (outbox.due(3.0), outbox.due(4000.0)) == ((), ("high", "low"))


def test_a_line_has_no_control_characters():
    item = TANK.model_copy(update={"doc": "a\x1b[31m\nb\x00"})
    run = [Change(1, 1.0, 1.7e9, item.id, True, 55.0)]
    kept = fold([item], run, [], 1.7e9)
    assert line_of(kept.records[0], kept).endswith("T_tank above 50 °C (a [31m b )")
