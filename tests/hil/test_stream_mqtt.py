"""Streams to MQTT: every message as a broker that is not ours delivers it, kills, lost connections, refusals."""

from __future__ import annotations

import datetime
import json
import shutil
import threading
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from hil.bench.faults.tls import authority, signed
from hil.run_folder import RunFolder
from hil.stream import StreamOptions
from hil.stream.address import parse_address
from tests.hil.command_line import typed
from tests.hil.mosquitto_broker import Broker, NoBroker, Subscriber, free_port, until
from tests.hil.streamed_run import NAME, InThread, StreamedRun, finished_run, killed_at_the_end, live_run

pytest.importorskip("paho.mqtt.client", reason="paho-mqtt is not installed")


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    try:
        made = Broker(tmp_path)
    except NoBroker as error:
        pytest.skip(str(error))
    made.start()
    yield made
    made.stop()


@pytest.fixture
def heard(broker: Broker) -> Iterator[Subscriber]:
    subscriber = Subscriber(broker.port)
    yield subscriber
    subscriber.close()


def _to(broker: Broker) -> str:
    return f"mqtt://127.0.0.1:{broker.port}/lab/loop"


def _samples(heard: Subscriber) -> list[tuple[str, int, float | None, str]]:
    """Return column, time in µs, value and quality of each message of a signal."""
    found = []
    for topic, document, _ in heard.messages:
        assert topic.startswith(f"lab/loop/{NAME}/")
        column = topic.rpartition("/")[2]
        if column not in ("state", "events"):
            when = datetime.datetime.fromisoformat(document["time"])
            found.append((column, round(when.timestamp() * 1e6), document["value"], document["quality"]))
    return found


def _expected(run: StreamedRun) -> Counter[Any]:
    names = ("good", "stale", "out_of_range", "sensor_fault", "link_fault")
    return Counter((*key, value, names[quality]) for key, (value, quality) in run.samples().items())


def test_a_finished_run_in_full_has_each_sample_once_with_unit_and_quality(
    broker: Broker, heard: Subscriber, tmp_path: Path
) -> None:
    run = finished_run(tmp_path, 60)
    done = typed("stream", run.path, "--to", _to(broker), "--all")
    assert (done.returncode, done.stderr) == (0, "")
    assert "60 ticks" in done.stdout and "run done" in done.stdout
    until(lambda: heard.of("/state"), "the state came")
    assert Counter(_samples(heard)) == _expected(run)
    assert {d["unit"] for t, d, _ in heard.messages if t.endswith("T_tank_C")} == {"degC"}
    assert [(e["level"], e["text"]) for e in heard.of("/events")] == [("INFO", "run started"), ("WARN", "tick 60")]
    assert heard.of("/state")[-1]["state"] == "done"

    heard.messages.clear()
    again = typed("stream", run.path, "--to", _to(broker), "--all")
    assert "0 ticks and 0 events" in again.stdout
    assert _samples(heard) == [], "what was confirmed is not sent again"
    assert "nothing was new" in again.stderr and "stream-mqtt-" in again.stderr


def test_all_samples_are_sent_after_the_last_values_alone(broker: Broker, heard: Subscriber, tmp_path: Path) -> None:
    run = finished_run(tmp_path, 60)
    typed("stream", run.path, "--to", _to(broker))
    until(lambda: heard.of("/state"), "the state came")
    heard.messages.clear()
    done = typed("stream", run.path, "--to", _to(broker), "--all")
    assert (done.returncode, done.stderr) == (0, "") and "60 ticks" in done.stdout
    until(lambda: heard.of("/state"), "the state came")
    assert Counter(_samples(heard)) == _expected(run)
    assert "nothing was new" in typed("stream", run.path, "--to", _to(broker)).stderr


def test_a_finished_run_that_nobody_followed_is_sent_with_its_last_values(
    broker: Broker, heard: Subscriber, tmp_path: Path
) -> None:
    run = finished_run(tmp_path, 60)
    assert typed("stream", run.path, "--to", _to(broker)).returncode == 0
    until(lambda: heard.of("/state"), "the state came")
    assert len(_samples(heard)) == len(run.truth.header.signals)
    assert {row[1] for row in _samples(heard)} == {round((run.started_s + 59) * 1e6)}
    assert heard.of("/events") == []
    late = Subscriber(broker.port)
    until(lambda: late.messages, "the retained state came")
    late.close()
    assert [(topic.rpartition("/")[2], d["state"], kept) for topic, d, kept in late.messages] == [
        ("state", "done", True)
    ]


@pytest.mark.parametrize(("every_s", "stride"), [(None, 4), (2.0, 7)])
def test_a_live_run_is_thinned_to_a_message_a_signal_and_period(
    broker: Broker, heard: Subscriber, tmp_path: Path, every_s: float | None, stride: int
) -> None:
    run = live_run(tmp_path, 40, period_s=0.3)
    run.write(5)
    stream = InThread(run, _to(broker), StreamOptions(every_s=every_s))
    until(lambda: heard.of("/T_tank_C"), "the stream follows")
    run.write(18)
    run.finish()
    assert stream.result().state == "done"
    until(lambda: heard.of("/state")[-1]["state"] == "done", "the last state came")
    times = [row[1] for row in _samples(heard) if row[0] == "T_tank_C"]
    assert times == [round((run.started_s + tick * 0.3) * 1e6) for tick in range(0, 40, stride)]
    assert [d["state"] for d in heard.of("/state")] == ["running", "done"]


def test_a_killed_stream_goes_on_and_repeats_one_tick_at_most(
    broker: Broker, heard: Subscriber, tmp_path: Path
) -> None:
    run = live_run(tmp_path, 400)
    run.write(300)
    with killed_at_the_end(run, "--to", _to(broker), "--all"):
        until(lambda: len(_samples(heard)) > 100, "messages came")
    until(lambda: heard.of("/state")[-1:] and heard.of("/state")[-1]["state"] == "offline", "the last will came")
    assert len(_samples(heard)) < 300 * 19, "it was killed in the middle"
    run.finish()
    done = typed("stream", run.path, "--to", _to(broker), "--all")
    assert done.returncode == 0, done.stderr
    until(lambda: heard.of("/state")[-1]["state"] == "done", "the last state came")
    counted, expected = Counter(_samples(heard)), _expected(run)
    assert set(counted) == set(expected)
    doubled = [row for row, count in counted.items() if count > 1]
    assert len({row[1] for row in doubled}) <= 1 and max(counted.values()) <= 2


def test_a_broker_that_is_down_at_the_start_and_goes_away_later_gets_everything(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    try:
        broker = Broker(tmp_path)
    except NoBroker as error:
        pytest.skip(str(error))
    may_call = threading.Event()  # the stream calls the broker again only after the subscriber is there
    paced = SimpleNamespace(monotonic=time.monotonic, sleep=lambda _s: (time.sleep(0.05), may_call.wait(30)))
    monkeypatch.setattr("hil.stream.session.time", paced)
    run = live_run(tmp_path, 30)
    run.write(10)
    stream = InThread(run, _to(broker))
    until(lambda: stream.said, "it says that the broker is down")
    assert stream.said[0].startswith(f"{_to(broker)} cannot be reached: ")
    broker.start()
    try:
        heard = Subscriber(broker.port)
        may_call.set()
        until(lambda: stream.said[-1].endswith("catches up"), "the backlog was sent")
        until(lambda: len(_samples(heard)) >= 10 * 19, "the backlog came")
        seen = _samples(heard)
        heard.close()
        may_call.clear()
        broker.stop()
        run.write(10)
        may_call.set()
        until(lambda: len(stream.said) == 3, "it says that the broker went away")
        may_call.clear()
        broker.start()
        heard = Subscriber(broker.port)
        may_call.set()
        run.finish()
        assert stream.result().ticks == 30
        until(lambda: heard.of("/state")[-1:] and heard.of("/state")[-1]["state"] == "done", "the end came")
        seen += _samples(heard)
        heard.close()
    finally:
        may_call.set()
        broker.stop()
    assert set(seen) == set(_expected(run)), "nothing is missing"
    assert len(stream.said) == 4, "one sentence each: down, back, lost, back"


def test_a_password_is_asked_and_in_no_message_and_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    try:
        broker = Broker(tmp_path, password="s3cret/@word")
    except NoBroker as error:
        pytest.skip(str(error))
    run = finished_run(tmp_path, 5)
    broker.start()
    try:
        address = f"mqtt://plant@127.0.0.1:{broker.port}/lab/loop"
        wrong = typed("stream", run.path, "--to", address.replace("plant@", "plant:n0t%40it@"))
        assert wrong.returncode == 2
        assert wrong.stderr == (
            f"hil: {address}: the broker refused user or password; check them, or set HIL_MQTT_PASSWORD\n"
        )
        monkeypatch.setenv("HIL_MQTT_PASSWORD", "s3cret/@word")
        right = typed("stream", run.path, "--to", address, "--all")
        assert right.returncode == 0, right.stderr
    finally:
        broker.stop()
    stored = list(run.path.glob("stream-*.json"))
    assert len(stored) == 1
    assert json.loads(stored[0].read_text()) == {"to": address, "tick": 4, "event": 2, "all": True}
    for text in (wrong.stderr, right.stdout, *(path.read_text() for path in run.path.glob("stream-*"))):
        assert "s3cret" not in text and "n0t" not in text


@pytest.mark.skipif(shutil.which("openssl") is None, reason="certificates are made by openssl")
@pytest.mark.parametrize(
    ("host", "is_known", "said"),
    [
        ("127.0.0.1", True, ""),
        ("127.0.0.1", False, "TLS failed (unable to get local issuer certificate)"),
        ("127.0.0.2", True, "TLS failed (IP address mismatch"),
    ],
)
def test_tls_takes_no_certificate_of_a_stranger_or_another_host(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, host: str, is_known: bool, said: str
) -> None:
    ours, strange = authority(tmp_path, "ours"), authority(tmp_path, "strange")
    try:
        broker = Broker(tmp_path, host=host, tls=signed(tmp_path, "broker", ours))
    except NoBroker as error:
        pytest.skip(str(error))
    monkeypatch.setenv("SSL_CERT_FILE", str(ours[0] if is_known else strange[0]))
    run = finished_run(tmp_path, 3)
    broker.start()
    try:
        done = typed("stream", run.path, "--to", f"mqtts://{host}:{broker.port}/lab")
    finally:
        broker.stop()
    assert done.returncode == (2 if said else 0)
    assert said in done.stderr and len(done.stderr.splitlines()) == bool(said)


def test_a_second_stream_to_the_same_broker_is_refused(broker: Broker, heard: Subscriber, tmp_path: Path) -> None:
    run = live_run(tmp_path, 10)
    run.write(5)
    stream = InThread(run, _to(broker))
    until(lambda: heard.of("/state"), "the first stream goes on")
    second = typed("stream", run.path, "--to", _to(broker))
    assert second.returncode == 2
    assert "another process streams" in second.stderr
    run.finish()
    assert stream.result().ticks == 10


@pytest.mark.parametrize("status", ["running", "done"], ids=["killed", "journal copied before the end"])
def test_a_run_that_was_killed_is_streamed_as_interrupted(
    broker: Broker, heard: Subscriber, tmp_path: Path, status: str
) -> None:
    run = live_run(tmp_path, 10)
    run.write(5)
    folder = RunFolder(run.path)
    folder.write_manifest(folder.read_manifest() | {"exit_status": status})
    run._held.close()  # as the kernel does for a process that is gone
    done = typed("stream", run.path, "--to", _to(broker), "--all")
    assert done.returncode == 0, done.stderr
    assert "5 ticks" in done.stdout and "run interrupted" in done.stdout
    until(lambda: heard.of("/state"), "the state came")
    assert heard.of("/state")[-1]["state"] == "interrupted"
    samples = [message["time"] for message in heard.of("/T_tank_C")]
    assert heard.of("/state")[-1]["time"] == max(samples)
    assert run.writer is not None
    run.writer.close()


def test_an_operator_who_stops_the_stream_leaves_the_state_offline(
    broker: Broker, heard: Subscriber, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(_seconds: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("hil.stream.session.time", SimpleNamespace(sleep=interrupted, monotonic=time.monotonic))
    run = live_run(tmp_path, 10)
    run.write(5)
    done = typed("stream", run.path, "--to", _to(broker))
    assert done.returncode == 130
    assert "was stopped; start it again to go on" in done.stderr
    until(lambda: len(heard.of("/state")) == 2, "both states came")
    assert [document["state"] for document in heard.of("/state")] == ["running", "offline"]
    run.finish()


def test_giving_up_is_a_sentence_with_exit_code_1(tmp_path: Path) -> None:
    run = finished_run(tmp_path, 5)
    done = typed("stream", run.path, "--to", f"mqtt://127.0.0.1:{free_port()}/lab", "--give-up", "0")
    assert done.returncode == 1
    assert "cannot be reached" in done.stderr and "given up after 0 s" in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("http://broker/lab", "http:// is no store that is known; use mqtt://HOST/PREFIX"),
        ("broker.example.org", "an address begins with the kind of its store"),
        ("mqtt://broker:wide/lab", "the address of the broker cannot be read"),
        ("mqtt:///lab", "the address of the broker cannot be read"),
        ("mqtt://broker:0/lab", "the address of the broker cannot be read"),
        ("mqtt://broker/" + "é" * 33_000, "the prefix of topics has more than 64511 bytes; shorten it"),
        ("mqtt://broker/lab/#", "the address of the broker cannot be read"),
        ("mqtt://broker/lab/+/x", "the prefix of topics may not begin with $ nor hold"),
        ("mqtt://broker/$SYS/x", "the prefix of topics may not begin with $ nor hold"),
        ("mqtt://plant:s3cret@lost.example.org/lab", "there is no host 'lost.example.org'; check the address"),
    ],
)
def test_a_wrong_address_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, address: str, said: str
) -> None:
    import socket

    def lost(*_arguments: object) -> None:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", lost)
    run = finished_run(tmp_path, 3)
    done = typed("stream", run.path, "--to", address)
    assert done.returncode == 2
    assert said in done.stderr and len(done.stderr.splitlines()) == 1
    assert "s3cret" not in done.stderr


def test_folders_that_hold_no_run_and_a_missing_library_are_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import sys

    run = finished_run(tmp_path, 3)
    (tmp_path / "empty").mkdir()
    for folder in (tmp_path / "empty", tmp_path / "absent"):
        done = typed("stream", folder, "--to", "mqtt://localhost/lab")
        assert done.returncode == 2 and "is not a run folder" in done.stderr
    monkeypatch.setitem(sys.modules, "paho.mqtt.client", None)
    done = typed("stream", run.path, "--to", "mqtt://localhost/lab")
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert "needs the package paho-mqtt, which is not installed; pip install 'hil-rig[stream]'" in done.stderr
    (run.path / "journal.sqlite").unlink()
    done = typed("stream", run.path, "--to", "mqtt://localhost/lab")
    assert done.returncode == 2 and "holds no journal.sqlite" in done.stderr


def test_a_damaged_position_is_one_sentence(broker: Broker, tmp_path: Path) -> None:
    run = finished_run(tmp_path, 3)
    assert typed("stream", run.path, "--to", _to(broker)).returncode == 0
    next(run.path.glob("stream-*.json")).write_text("")
    done = typed("stream", run.path, "--to", _to(broker))
    assert done.returncode == 2 and "is damaged; remove it" in done.stderr


def test_addresses_have_files_of_their_own() -> None:
    names = [
        parse_address(text).file_name
        for text in ("mqtt://h/a/b", "mqtt://h/a_b", "mqtt://h:1884/a/b", "mqtts://h/a/b", f"mqtt://h/{'a' * 300}")
    ]
    assert len(set(names)) == len(names)
    assert all(len(name) < 150 and "/" not in name for name in names)
