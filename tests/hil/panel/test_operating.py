"""Panel over HTTP: requests to a run, alarms and notes of an operator, and what of them is refused."""

from __future__ import annotations

import pytest

from hil.panel import app as app_module
from hil.run_folder import RunFolder, read_notes
from tests.hil.panel.served import stream


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
