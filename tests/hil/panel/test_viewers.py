"""Panel over HTTP: what viewers see of a run, and what a run or a viewer in trouble does to them."""

from __future__ import annotations

import contextlib
import json
import shutil
import socket
import sqlite3
import threading
import time

import pytest

from hil.journal import ACKNOWLEDGED
from hil.panel import app as app_module
from hil.run_folder import RunFolder, new_manifest
from tests.hil.panel.served import Served, stream


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


def test_a_viewer_sees_the_verdict_of_a_test_and_what_did_not_pass(served, run):
    limits = [
        {
            "id": name,
            "limit": "T_tank_C < 50",
            "requirement": "R1",
            "severity": "major",
            "step": None,
            "verdict": verdict,
            "value": 55.0,
            "unit": "degC",
            "at_s": 3.0,
            "text": "55 °C at 3 s",
        }
        for name, verdict in (("hot", "fail"), ("flow", "pass"))
    ]
    test = {"id": "a", "title": "<Heat>", "sha256": "0", "verdict": "fail", "judged": "", "limits": limits}
    (run.path / "verdict.json").write_text(json.dumps({"verdict": "fail", "tests": [test]}), encoding="utf-8")
    with stream(served, run) as events:
        _, now = next(events)
    limit = "hot: T_tank_C < 50: 55 °C at 3 s"
    assert now["tests"] == [{"verdict": "fail", "title": "<Heat>", "text": "1 of 2 limits passed", "limits": [limit]}]


def test_a_viewer_sees_that_a_trip_is_acknowledged_before_the_run_goes_on(served, run):
    writer = run.run.writer
    writer.state(20, 20.0, 20.0, "running", "trip", "paused", "tripped: too hot")
    writer.commit()
    with stream(served, run) as events:
        _, now = next(events)
        assert now["tripped"] and now["reason"] == "tripped: too hot"
        writer.event(25, 25.0, "INFO", f"{ACKNOWLEDGED} (panel, Ada): too hot")
        run.step(25.0)
        now = _next(events, lambda state: not state["tripped"])
        assert now["state"] == "paused" and now["reason"] == f"{ACKNOWLEDGED} (panel, Ada): too hot"
        writer.state(50, 50.0, 20.0, "paused", "trip", "paused", "tripped: again")
        run.step(25.0)
        assert _next(events, lambda state: state["tripped"])["reason"] == "tripped: again"


def _next(events, wanted):
    for _, state in events:
        if wanted(state):
            return state
    raise AssertionError("the stream ended")


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
