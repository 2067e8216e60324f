"""`hil alarms` on runs that go on, were killed, and have ended: lists, acts of operators, and what is refused."""

from __future__ import annotations

import contextlib
import json
import math
import sqlite3
import time

import pytest

from drivers.rig_file import AlarmSpec, load_rig
from drivers.rig_file.reader import RigFileError
from hil.alarms import AlarmError, AlarmWatch, definitions_of
from hil.alarms.definitions import META_KEY, as_document, from_document
from hil.alarms.states import AlarmState
from hil.report import write_report
from hil.run_folder import RunFolder
from tests.hil.alarmed_run import TANK, alarmed_run
from tests.hil.command_line import typed
from tests.hil.reference_pages import page

RIG = page("rig-file").code["toml"][0]


def listed(run, **options):
    with AlarmWatch(run.path) as watch:
        return {item.definition.id: item.state.value for item in watch.poll(**options).standing()}


def test_an_alarm_comes_is_acknowledged_and_is_over(tmp_path):
    run = alarmed_run(tmp_path)
    assert listed(run) == {}
    assert "no alarm stands, and none has been" in typed("alarms", run.path).stdout
    run.step(55.0)
    shown = typed("alarms", run.path).stdout
    assert "UNACKNOWLEDGED  high  T_tank.H  55 °C  since 2023-11-14T22:13:35Z" in shown
    assert "T_tank above 50 °C" in shown
    done = typed("alarms", run.path, "--ack", "T_tank.H", "--by", "Ada", "--reason", "fan is off")
    assert (done.returncode, done.stdout) == (0, "T_tank.H: acknowledged; it came at 2023-11-14T22:13:35Z\n")
    assert "ACKNOWLEDGED" in (shown := typed("alarms", run.path).stdout) and "Ada: fan is off" in shown
    run.step(25.0)
    assert listed(run) == {}
    document = json.loads(typed("alarms", run.path, "--json").stdout)
    assert [(entry["event"], entry["by"]) for entry in document["history"]] == [
        ("raise", ""),
        ("acknowledge", "Ada"),
        ("clear", ""),
    ]
    assert "1 have come and gone" in typed("alarms", run.path).stdout
    run.finish()


def test_a_watch_that_follows_sees_the_same_as_one_that_starts_late(tmp_path):
    run = alarmed_run(tmp_path)
    with AlarmWatch(run.path) as follows:
        for tank_C, flow in ((25, 8), (60, 8), (60, 0.5), (25, 0.5), (25, 8), (70, 8)):
            run.step(tank_C, flow)
            kept = follows.poll()
            if flow < 1 and tank_C == 60:
                follows.act("acknowledge", "flow.L", "op")
        with AlarmWatch(run.path) as late:
            anew = late.poll()
    kept = follows_list(kept)
    assert follows_list(anew)[:-1] == kept[:-1] or follows_list(anew) == kept
    assert listed(run) == {"T_tank.H": "unacknowledged", "flow.L": "latched"}
    run.finish()


def follows_list(kept):
    return [(record.id, record.event, record.target, record.tick) for record in kept.records]


def test_acts_and_alarms_outlive_a_killed_run_and_its_resumption(tmp_path):
    run = alarmed_run(tmp_path)
    run.step(55.0)
    with AlarmWatch(run.path) as watch:
        watch.act("acknowledge", "all", "op")
    run.run._held.close()  # as after kill -9: nobody holds the folder, and the manifest still says running
    assert listed(run) == {"run.interrupted": "unacknowledged", "T_tank.H": "acknowledged"}
    assert typed("alarms", run.path, "--ack", "run.interrupted").returncode == 0
    with run.path.joinpath("alarms.jsonl").open("a") as file:
        file.write('{"act": "acknowl')  # a crash in the middle of a line
    run.run._held.enter_context(RunFolder(run.path).owned())
    writer = run.run.writer
    writer.state(29, 29.0, 0.0, "running", "cut", "idle", "the run was cut while running")
    writer.state(30, 30.0, 0.0, "restoring", "start", "running", "the rig is back")
    run.step(55.0)
    assert listed(run) == {"T_tank.H": "acknowledged"}
    with AlarmWatch(run.path) as watch:
        watch.act("shelve", "T_tank.H", "op", "after the torn line", 60.0)
    assert listed(run) == {"T_tank.H": "shelved, active"}
    run.finish()


def test_a_trip_is_an_alarm_with_the_reason_of_the_run_until_it_goes_on(tmp_path):
    run = alarmed_run(tmp_path)
    run.run.writer.state(15, 15.0, 0.0, "running", "trip", "paused", "tripped: T_tank is 80.00 degC")
    run.step(25.0)
    assert "tripped: T_tank is 80.00 degC" in typed("alarms", run.path).stdout
    run.run.writer.state(31, 31.0, 0.0, "paused", "resume", "running", "by an operator")
    run.step(25.0)
    assert listed(run) == {"run.trip": "returned unacknowledged"}
    run.finish()


def test_a_shelving_has_an_end_and_a_reason_and_ends_by_itself(tmp_path):
    run = alarmed_run(tmp_path)
    run.step(55.0)
    for arguments, said in (
        (("--shelve", "T_tank.H", "--reason", "x"), "a shelving needs an end"),
        (("--shelve", "T_tank.H", "--for", "30min"), "a shelving needs a reason"),
        (("--shelve", "T_tank.H", "--for", "30", "--reason", "x"), "'30' is no duration"),
        (("--shelve", "T_tank.H", "--for", "8d", "--reason", "x"), "at most 7 days"),
        (("--shelve", "T_tnk.H", "--for", "8h", "--reason", "x"), "did you mean T_tank.H?"),
        (("--for", "8h"), "give --shelve ID"),
        (("--ack", "T_tank.H", "--unshelve", "T_tank.H"), "at a time"),
        (("--ack", "flow.L"), "flow.L is normal, so there is nothing to acknowledge"),
        (("--notify", "json://127.0.0.1:1"), "add --follow"),
    ):
        refused = typed("alarms", run.path, *arguments)
        assert refused.returncode == 2 and said in refused.stderr, arguments
        assert "Traceback" not in refused.stderr
    assert not run.path.joinpath("alarms.jsonl").exists()
    done = typed("alarms", run.path, "--shelve", "T_tank.H", "--for", "30min", "--reason", "cleaning").stdout
    assert done.startswith("T_tank.H: shelved until 20")
    assert "its condition is there" in typed("alarms", run.path).stdout
    assert listed(run, now_s=time.time() + 1799) == {"T_tank.H": "shelved, active"}
    assert listed(run, now_s=time.time() + 1801) == {"T_tank.H": "unacknowledged"}
    run.finish()


def test_a_journal_without_definitions_or_with_damaged_ones_is_refused_in_one_sentence(tmp_path):
    run = alarmed_run(tmp_path)
    for document, said in ((None, "holds no alarm definitions"), ({"definitions": [{"id": "x"}]}, "damaged")):
        run.run.writer.put_meta(META_KEY, document)
        run.run.writer.commit()
        refused = typed("alarms", run.path)
        assert (refused.returncode, refused.stderr.count("\n")) == (2, 1) and said in refused.stderr
    run.finish()


def test_a_damaged_line_of_acts_is_named(tmp_path):
    run = alarmed_run(tmp_path)
    run.path.joinpath("alarms.jsonl").write_text('{"act": "delete", "id": "x", "tick": 1, "wall_s": 1.0}\n')
    refused = typed("alarms", run.path)
    assert refused.returncode == 2 and "alarms.jsonl, line 1 is no act on an alarm" in refused.stderr
    run.finish()


def test_the_report_lists_alarms_with_what_was_done(tmp_path):
    run = alarmed_run(tmp_path)
    run.step(55.0)
    with AlarmWatch(run.path) as watch:
        watch.act("acknowledge", "T_tank.H", "Ada <script>", "seen")
    run.finish()
    folder = RunFolder(run.path)
    folder.write_manifest(folder.read_manifest() | {"settings": {}, "reason": "", "safe": True})
    write_report(folder)
    text = folder.report.read_text(encoding="utf-8")
    assert "<h2>Alarms</h2>" in text and "T_tank above 50 °C" in text
    assert "Ada &lt;script&gt;" in text and "Ada <script>" not in text


@pytest.fixture
def rig(tmp_path):
    def made(*sections: str):
        path = tmp_path / "rig.toml"
        path.write_text(RIG + "\n".join(sections), encoding="utf-8")
        return load_rig(path)

    return made


ALARM = '\n[[alarm]]\npoint = "T_tank"\nhigh = 60.0\nlow = 5.0\ndeadband = 1.0\non_delay_s = 5.0\npriority = "low"\n'


def test_the_alarms_of_a_rig_file_are_those_of_its_limits_interlocks_links_and_alarm_sections(rig):
    found = {item.id: item for item in definitions_of(rig(ALARM, ALARM))}
    assert found["T_tank.HH"].limit == 75.0 and found["T_tank.LL"].limit == -5.0
    assert (found["T_tank.H"].limit, found["T_tank.H"].priority) == (65.0, "medium")  # the page's own interlock
    assert (found["T_tank.H-2"].limit, found["T_tank.H-2"].on_delay_s) == (60.0, 5.0)
    assert found["T_tank.L-2"].priority == "low"
    assert found["link.plc"].on_delay_s == 4.0  # a tick before the interlock
    assert {"run.trip", "heater_power_set.deviation", "rig.counter"} <= set(found)
    assert from_document(as_document(found.values()), "x") == tuple(found.values())


def test_an_interlock_may_have_a_priority_of_its_own(rig):
    text = RIG.replace('kind = "limit"\n', 'kind = "limit"\npriority = "critical"\n')
    assert text != RIG
    found = {
        item.id: item for item in definitions_of(rig("").model_copy(update={"interlock": _rig_of(text).interlock}))
    }
    assert found["T_tank.H"].priority == "critical"


def _rig_of(text: str):
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.toml"
        path.write_text(text, encoding="utf-8")
        return load_rig(path)


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ('\n[[alarm]]\npoint = "T_tnk"\nhigh = 1.0\n', "no point 'T_tnk'; declare it or correct point"),
        ('\n[[alarm]]\npoint = "heater_power_set"\nhigh = 1.0\n', "is not read on every tick"),
        ('\n[[alarm]]\npoint = "T_tank"\n', "an alarm needs low, high or both"),
        (f'\n[[alarm]]\npoint = "T_tank"\nhigh = 5.0\ndoc = "{"x" * 201}"\n', "doc"),
        ('\n[[alarm]]\npoint = "T_tank"\nhigh = 5.0\nlow = 1.0\ndeadband = 3.0\n', "no room for the deadband"),
        ('\n[[alarm]]\npoint = "T_tank"\nhigh = 5.0\npriority = "urgent"\n', "priority"),
        ('\n[[alarm]]\npoint = "T_tank"\nhigh = 5.0\non_delay_s = -1.0\n', "on_delay_s"),
        ('\n[alarm]\npoint = "T_tank"\nhigh = 5.0\n', r"alarm must be sections with two brackets, \[\[alarm\]\]"),
    ],
)
def test_a_mistake_in_an_alarm_is_named_with_its_line(rig, section, said):
    with pytest.raises(RigFileError, match=said) as refused:
        rig(section)
    assert "line " in str(refused.value)


def test_an_act_without_an_end_is_refused_by_the_interface_too(tmp_path):
    run = alarmed_run(tmp_path)
    with AlarmWatch(run.path) as watch:
        for for_s in (math.nan, math.inf, 0.0, -1.0):
            with pytest.raises(AlarmError, match=r"needs an end"):
                watch.act("shelve", TANK.id, "op", "why", for_s)
        assert watch.poll().statuses[TANK.id].state is AlarmState.NORMAL
    run.finish()


def test_an_alarm_section_trips_nothing():
    assert "level" not in AlarmSpec.model_fields


def guardian_says(run, *entries):
    """Append lines of the guardian, each `what`, seconds after the last row, and more keys."""
    with run.path.joinpath("guardian.log").open("a", encoding="utf-8") as file:
        for what, after_s, more in entries:
            wall_s = 1.7e9 + run.run.written - 1 + after_s
            file.write(json.dumps({"time": "", "wall_s": wall_s, "what": what, **more}) + "\n")


def guardian_of(run):
    with AlarmWatch(run.path) as watch:
        found = watch.poll().statuses["run.guardian"]
        return found.state.value, found.text


def test_what_the_guardian_of_a_killed_run_did_is_an_alarm_until_the_rig_is_safe(tmp_path):
    run = alarmed_run(tmp_path)
    guardian_says(run, ("watching", -5, {"pid": 1}))
    assert guardian_of(run) == ("normal", "")
    run.run._held.close()
    guardian_says(run, ("acting", 1, {"reason": "the engine is gone"}))
    guardian_says(run, ("not safe", 1.1, {"problem": "heater still reads 900.0 W", "after_s": 0.1, "meters": {}}))
    assert guardian_of(run) == ("unacknowledged", "the engine is gone; not safe: heater still reads 900.0 W")
    assert "CRITICAL" in typed("alarms", run.path).stdout.upper()
    guardian_says(run, ("gave up", 3601, {"problem": "heater still reads 900.0 W", "after_s": 3600}))
    state, text = guardian_of(run)
    assert state == "unacknowledged" and "it gave up after 3.6e+03 s, not safe: heater still" in text
    guardian_says(run, ("ended", 3601, {}), ("watching", 3700, {"pid": 2}))
    guardian_says(run, ("acting", 3800, {"reason": "no beat"}), ("safe", 3805, {"problem": "", "after_s": 5.0}))
    assert guardian_of(run) == ("returned unacknowledged", "no beat; safe after 5 s")
    with AlarmWatch(run.path) as watch:
        raised = [r for r in watch.poll().records if r.id == "run.guardian" and r.event == "raise"]
    assert next((r.wall_s, r.time_s) for r in raised) == (1.7e9 + 15, 14.0)


@pytest.mark.parametrize(
    "line", [b"{", b"[]\n", b'{"wall_s": 1e400, "what": "acting"}\n', b'{"wall_s": "x"}\n', b"\xff\n"]
)
def test_a_damaged_line_of_the_guardian_is_left_out(tmp_path, line):
    run = alarmed_run(tmp_path)
    run.path.joinpath("guardian.log").write_bytes(line)
    assert guardian_of(run) == ("normal", "")
    run.finish()


def test_who_follows_a_killed_run_waits_for_its_guardian_but_not_for_ever(tmp_path, monkeypatch):
    run = alarmed_run(tmp_path)
    guardian_says(run, ("watching", -5, {"pid": 1}))
    run.run._held.close()
    with AlarmWatch(run.path) as watch:
        watch.poll()
        assert not watch.has_ended()  # a guardian that watches will act
        now_s = time.time()
        acting = {"wall_s": now_s, "what": "acting", "reason": "the engine is gone"}
        with run.path.joinpath("guardian.log").open("a") as file:
            file.write(json.dumps(acting) + "\n")
        assert not watch.has_ended()
        with run.path.joinpath("guardian.log").open("a") as file:
            file.write(json.dumps({"wall_s": now_s + 5, "what": "safe", "after_s": 5.0}) + "\n")
        assert watch.has_ended()
    with AlarmWatch(run.path) as watch:
        watch.poll()
        run.path.joinpath("guardian.log").write_text(json.dumps(acting | {"wall_s": now_s - 4000}) + "\n")
        assert watch.has_ended()  # it was killed, too
    monkeypatch.setattr("hil.alarms.guardian_log.WAKES_WITHIN_S", 0.0)
    run.path.joinpath("guardian.log").write_text(json.dumps({"wall_s": now_s, "what": "watching"}) + "\n")
    with AlarmWatch(run.path) as watch:
        watch.poll()
        assert watch.has_ended()


def test_an_act_counts_for_what_was_written_when_it_was_made(tmp_path):
    run = alarmed_run(tmp_path)
    run.step(25.0)
    run.run.writer.calibration("static", 1, 5.0, {"disturbed": 0.3, "disturbed_W": 40.0, "disturbed_sd_W": 1.0})
    run.run.writer.commit()
    before = listed(run)
    assert before == {"twin.disturbance": "unacknowledged"}
    with AlarmWatch(run.path) as watch:
        assert watch.act("acknowledge", "all", "op").startswith("twin.disturbance: acknowledged; it came at 2023-")
        with pytest.raises(AlarmError, match=r"admits it"):
            watch.act("acknowledge", "all", "op")
    for document in ({"disturbed": None}, {"disturbed": 0.3, "disturbed_W": 40.0, "disturbed_sd_W": 1.0}):
        run.run.writer.calibration("static", 1, 6.0, document)  # of a window that ended long ago
    run.run.writer.commit()
    assert listed(run) == {"twin.disturbance": "unacknowledged"}
    run.finish()


def test_an_alarm_that_came_again_is_not_acknowledged_by_who_saw_the_first(tmp_path):
    run = alarmed_run(tmp_path)
    for tank_C in (55.0, 25.0, 55.0):
        run.step(tank_C)
    with AlarmWatch(run.path) as watch:
        with pytest.raises(AlarmError, match=r"T_tank.H came again since you looked, at 2023-11-14T22:14:05Z"):
            watch.act("acknowledge", "T_tank.H", "op", count=1)
        watch.act("acknowledge", "T_tank.H", "op", count=2)
    run.finish()


def test_an_interruption_keeps_its_time_after_a_resumption(tmp_path):
    run = alarmed_run(tmp_path)
    run.run._held.close()

    def came():
        with AlarmWatch(run.path) as watch:
            return watch.poll().statuses["run.interrupted"].wall_s

    assert (before := came()) == 1.7e9 + 14
    with AlarmWatch(run.path) as watch:
        watch.act("acknowledge", "run.interrupted", "op")
    run.run._held.enter_context(RunFolder(run.path).owned())
    run.run.writer.state(14, 14.0, 0.0, "running", "cut", "idle", "the run was cut while running")
    run.run.writer.commit()
    assert came() == before
    with AlarmWatch(run.path) as watch:
        found = [r.event.value for r in watch.poll().records if r.id == "run.interrupted"]
    assert found == ["raise", "acknowledge"]
    run.finish()


@pytest.mark.parametrize(
    ("statement", "said"),
    [
        ("UPDATE samples SET wall_s = 1e30", "is no time"),
        ("UPDATE states SET wall_s = 1e30", "is no time"),
        ("UPDATE samples SET time_s = 9e999", "is no time"),
        ("""UPDATE meta SET value = '{"definitions": [{"id": "a", "kind": "high", "priority": "low",
            "points": ["T_tank"], "limit": 1e999}]}' WHERE key = 'alarms'""", "damaged"),
        ("""UPDATE meta SET value = '{"definitions": [{"id": "a", "kind": "sensor", "priority": "low"}]}'
            WHERE key = 'alarms'""", "damaged"),
    ],
)  # fmt: skip
def test_a_forged_time_or_limit_is_refused_in_one_sentence(tmp_path, statement, said):
    run = alarmed_run(tmp_path)
    run.step(55.0)
    run.finish()
    with contextlib.closing(sqlite3.connect(run.path / "journal.sqlite")) as database, database:
        database.execute(statement)
    refused = typed("alarms", run.path)
    assert refused.returncode in (1, 2) and refused.stderr.count("\n") == 1 and said in refused.stderr


def test_a_shelving_of_more_than_a_week_or_with_an_invisible_reason_is_none(tmp_path):
    run = alarmed_run(tmp_path)
    run.step(55.0)
    with AlarmWatch(run.path) as watch, pytest.raises(AlarmError, match=r"needs a reason"):
        watch.act("shelve", "T_tank.H", "op", "\u200b\u2800\u3164 ", 60.0)
    line = {"act": "shelve", "id": "T_tank.H", "tick": 30, "wall_s": 1.7e9, "until_s": 1.8e9, "reason": "x"}
    run.path.joinpath("alarms.jsonl").write_text(json.dumps(line) + "\n")
    refused = typed("alarms", run.path)
    assert refused.returncode == 2 and "for more than 7 days" in refused.stderr
    run.finish()


def test_an_act_may_answer_in_json(tmp_path):
    run = alarmed_run(tmp_path)
    run.step(55.0)
    document = json.loads(typed("alarms", run.path, "--ack", "all", "--json").stdout)
    assert document["done"] == ["T_tank.H: acknowledged; it came at 2023-11-14T22:13:35Z"]
    assert document["alarms"][0]["state"] == "acknowledged"
    run.finish()
