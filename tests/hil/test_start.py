"""`hil start`: the whole course by questions, its script, what it goes on with, and what it never writes unasked."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from hil.start import StartError, StartRequest, StopRequest, read_answers, start
from hil.start.questions import Answering, Question, anything, limits, number, whole
from tests.docs.fences import PROJECT
from tests.hil.command_line import hil

TABLE = """\
name,address,type,scale,unit,access
heater_set,40001,uint16,0.1,W,rw
pump_speed_set,40002,uint16,0.1,%,rw
fan_speed_set,40003,uint16,0.1,%,rw
beat,40004,uint16,1,1,rw
arm,40005,uint16,1,1,rw
heater_power,30001,uint16,0.1,W,r
pump_speed,30002,uint16,0.1,%,r
fan_speed,30003,uint16,0.1,%,r
counter,30004,uint16,1,1,r
T_heater,30021,int16,0.01,degC,r
module_1,30022,int16,0.01,degC,r
T_pm2,30023,int16,0.01,degC,r
T_pm3,30024,int16,0.01,degC,r
T_pm4,30025,int16,0.01,degC,r
T_pm5,30026,int16,0.01,degC,r
T_pm6,30027,int16,0.01,degC,r
T_radiator,30028,int16,0.01,degC,r
T_tank,30029,int16,0.01,degC,r
T_ambient,30030,int16,0.01,degC,r
"""
SHORT = """\
time_s,heater_power_W,pump_speed_pct,fan_speed_pct
0,600,100,70
1200,600,70,70
1500,850,70,70
2100,850,70,40
2700,650,70,40
3300,900,100,80
"""
SHIM = """#!/bin/sh
case "$*" in
  *"--runs runs/trial"|*"--runs runs/load"|"diagnose "*) mkdir -p runs/load/made; echo "$*" >> asked ;;
  *"--runs runs/healthy") exec "{python}" -m hil "$@" --no-report ;;
  *) exec "{python}" -m hil "$@" ;;
esac
"""
ANSWERS = "addressing = 'modicon'\nhealthy = 'short.csv'\n[role]\nmodule_1 = 'T_pm1'\n"


def prepared(folder: Path) -> Path:
    """Return a folder with a register table, a short load and answers."""
    folder.mkdir()
    for name, text in (("registers.csv", TABLE), ("short.csv", SHORT), ("answers.toml", ANSWERS)):
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": str(PROJECT)}


def called(folder: Path, *words: str, typed: str = "") -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "hil", "start", *words],
        cwd=folder,
        input=typed,
        text=True,
        capture_output=True,
        timeout=300,
        env=environment(),
    )


def begun(folder: Path, *words: str) -> subprocess.Popen[bytes]:
    """Return a course under way in a process group of its own, whose run of the healthy rig has begun."""
    with (folder / "log.txt").open("wb") as log:
        child = subprocess.Popen(
            [sys.executable, "-m", "hil", "start", *words],
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            env=environment(),
        )
    end = time.monotonic() + 120
    while b"running: running" not in (folder / "log.txt").read_bytes().partition(b"--runs runs/healthy")[2]:
        assert child.poll() is None and time.monotonic() < end, (folder / "log.txt").read_text()
        time.sleep(0.1)
    return child


@pytest.fixture(scope="module")
def course(tmp_path_factory):
    """Folder of a course that was killed in its healthy run and finished by a second call with piped answers."""
    folder = prepared(tmp_path_factory.mktemp("course") / "course")
    child = begun(folder, "--virtual", "--from", "registers.csv", "--answers", "answers.toml", "--yes")
    os.killpg(child.pid, signal.SIGKILL)
    child.wait()
    done = called(folder)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder, done


def test_a_second_call_after_a_kill_goes_on_with_the_step_that_was_not_done(course):
    folder, done = course
    assert done.stdout.count("done before") == 4
    rest = done.stdout.partition("Record the healthy rig")[2]
    assert "hil run short.csv" in rest.partition("Commission the twin")[0]
    assert "$ hil init" not in done.stdout and "$ hil rig" not in done.stdout
    assert "adequate" in done.stdout and "Done." in done.stdout
    assert (folder / "twin.toml").exists() and list((folder / "runs/load").glob("*/diagnosis/diagnosis.json"))


def test_every_answer_is_kept_and_can_be_given_again(course):
    folder, _ = course
    kept = read_answers(folder / "start.answers.toml")
    assert kept["addressing"] == "modicon" and kept["role.module_1"] == "T_pm1" and kept["heartbeat.point"] == "beat"
    assert kept["limits.heater_set"] == "0, 1000" and kept["healthy"] == "short.csv"
    document = tomllib.loads((folder / "rig.toml").read_text(encoding="utf-8"))
    points = {point["name"]: point for point in document["point"]}
    assert points["heater_set"]["readback"] == "heater_power" and points["heater_set"]["safe_value"] == 0.0
    assert points["T_pm1"]["role"] == "T_pm1" and points["T_pm1"]["address"] == 21 and "module_1" not in points
    assert document["heartbeat"] == {"point": "beat", "counter": "counter", "arm": "arm"}


def test_the_script_gives_the_same_files(course, tmp_path):
    """Up to the twin, but for the report of the healthy run; of the trial, the run and its diagnosis, which the course
    has carried out, the same commands."""
    folder, course_done = course
    again = tmp_path / "again"
    again.mkdir()
    for name in ("registers.csv", "short.csv", "start.sh"):
        shutil.copy(folder / name, again)
    shim = tmp_path / "bin" / "hil"
    shim.parent.mkdir()
    shim.write_text(SHIM.format(python=sys.executable), encoding="utf-8")
    shim.chmod(0o755)
    path = {"PATH": f"{shim.parent}:{os.environ['PATH']}"}
    done = subprocess.run(
        ["bash", "start.sh"], cwd=again, capture_output=True, text=True, timeout=300, env=environment() | path
    )
    assert done.returncode == 0, done.stdout + done.stderr
    for name in ("draft.toml", "rig.toml", "load.csv"):
        assert (again / name).read_bytes() == (folder / name).read_bytes()
    values = []
    for place in (folder, again):
        twin = tomllib.loads((place / "twin.toml").read_text(encoding="utf-8"))
        record = pq.read_table(sorted((place / "runs/healthy").iterdir())[-1] / "record.parquet")
        values.append((twin["elements"], np.asarray(record["T_tank_C"])))
    assert values[0][0] == values[1][0] and np.array_equal(values[0][1], values[1][1])
    trial, run, diagnosis = (again / "asked").read_text(encoding="utf-8").splitlines()
    assert trial.endswith("--virtual --lockstep --no-twin --no-report --runs runs/trial")
    assert f"$ hil {trial}\n" in (folder / "log.txt").read_text(encoding="utf-8")
    assert run.endswith("--runs runs/load") and f"$ hil {run}\n" in course_done.stdout
    assert diagnosis == "diagnose runs/load/made" and '$ hil diagnose "runs/load/' in course_done.stdout


def test_a_signal_ends_the_run_and_the_course_after_it(tmp_path):
    child = begun(tmp_path, "--virtual", "--yes")
    child.send_signal(signal.SIGINT)
    assert child.wait(60) == 1
    said = (tmp_path / "log.txt").read_text(encoding="utf-8")
    assert "`hil start` in this folder goes on there" in said and "Commission the twin" not in said
    assert "stopped by the operator" in said  # by the run, which makes its heaters safe before it says so
    assert 0 < pq.read_table(next((tmp_path / "runs/healthy").iterdir()) / "record.parquet").num_rows < 36000
    done = tomllib.loads((tmp_path / "start.answers.toml").read_text(encoding="utf-8"))["done"]
    assert "healthy" not in done and "trial" in done


def test_a_second_course_in_a_folder_is_refused_while_the_first_lasts(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = []

    def second(prompt: str) -> str:
        code, printed = hil("start", "--virtual", "--yes")
        said.append(printed)
        assert code == 2 and sorted(path.name for path in tmp_path.iterdir()) == ["start.answers.toml"]
        raise EOFError

    with pytest.raises(StopRequest):
        start(StartRequest(tmp_path), lambda line: None, second)
    (printed,) = said
    assert printed == (
        f"hil: {tmp_path}: another process works on this folder; wait until it has ended, or give another folder\n"
    )
    with pytest.raises(StopRequest):  # the first has ended: its folder is free
        start(StartRequest(tmp_path), lambda line: None, lambda prompt: (_ for _ in ()).throw(EOFError))


def test_a_wrong_answer_is_refused_with_its_reason_and_asked_again(tmp_path):
    folder = prepared(tmp_path / "course")
    (folder / "notes.pdf").write_text("x", encoding="utf-8")
    typed = "nothing.csv\nnotes.pdf\nregisters.csv\n40001\nmodicon\n\n70000\n502\n\nT_heater\nbeat\n"
    done = called(folder, typed=typed)
    assert done.returncode == 2
    for sentence in (
        "nothing.csv: there is no such file",
        "notes.pdf is none of .csv",
        "'40001' is none of zero, one, modicon",
        "'70000' is no whole number from 1 to 65535",
        "'T_heater' is none of",
    ):
        assert f"refused: {sentence}" in done.stdout
    assert "input ended at the question 'heartbeat.counter'" in done.stderr and "Traceback" not in done.stderr
    assert "hil init --from registers.csv --addressing modicon" in (folder / "start.sh").read_text(encoding="utf-8")
    assert read_answers(folder / "start.answers.toml")["port"] == "502"


def test_answers_that_a_command_refuses_are_asked_again(tmp_path):
    folder = prepared(tmp_path / "course")
    (folder / "registers.csv").write_text("name,address\nT_tank,5\n", encoding="utf-8")
    given = ("--virtual", "--from", "registers.csv", "--answer", "addressing=modicon", "--yes")
    done = called(folder, *given, typed="registers.csv\n")
    assert done.returncode == 2 and "These answers are refused; give them again." in done.stdout
    assert "input ended at the question 'addressing'" in done.stderr
    assert not (folder / "draft.toml").exists()


class RecordedRig:
    """Course on a rig whose commands are recorded in the place of being run."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder = folder
        self.ran: list[str] = []
        shutil.copy(PROJECT / "tests/hil/start_rig.toml", folder / "tank.toml")
        monkeypatch.setattr("hil.start.actions.Command.run", lambda *words: self._run(*words))

    def _run(self, command, base, say):
        self.ran.append(command.in_shell().splitlines()[-1])
        return 0

    def runs(self, name: str) -> int:
        """Return the number of runs on the rig into a folder."""
        return sum(line.endswith(f"--runs runs/{name}") for line in self.ran)

    def start(self, *typed: str, **given: str) -> str:
        lines, said = list(typed), []

        def read(prompt: str) -> str:
            said.append(prompt)
            if not lines:
                raise EOFError
            return lines.pop(0)

        answers = {"source": "tank.toml", "protection": "yes", **given}
        try:
            start(StartRequest(self.folder, given=answers, takes_defaults=True), said.append, read)
        except StopRequest as stop:
            said.append(str(stop))
        return "\n".join(said)


def test_nothing_is_written_to_a_rig_without_a_yes_that_names_it(tmp_path, monkeypatch):
    rig = RecordedRig(tmp_path, monkeypatch)
    for typed in ((), ("",), ("no",), ("y", "YES")):
        said = rig.start(*typed)
        assert "This run writes to the rig: heater_power_set" in said and "limits 0 to 500, safe value 0" in said
        assert "heartbeat, arm, watchdog_timeout every tick; for 10 h" in said
        assert "input ended at the question 'writes.healthy'" in said
    said = rig.start(**{"writes.healthy": "yes"})
    assert "only yes at the terminal, or exactly this text" in said
    assert rig.runs("healthy") == rig.runs("load") == 0


def test_a_yes_allows_this_run_and_no_other(tmp_path, monkeypatch):
    rig = RecordedRig(tmp_path, monkeypatch)
    said = rig.start("yes")
    assert rig.runs("healthy") == 1 and "input ended at the question 'writes.load'" in said
    assert rig.runs("load") == 0
    script = (tmp_path / "start.sh").read_text(encoding="utf-8")
    assert "read -r -p 'The next command writes to the rig: heater_power_set" in script
    said = rig.start("yes")
    assert rig.runs("healthy") == rig.runs("load") == 1 and "Done." in said, said


def test_a_text_that_names_all_that_is_written_agrees_beforehand(tmp_path, monkeypatch):
    rig = RecordedRig(tmp_path, monkeypatch)
    text = rig.start().rpartition("This run writes to the rig: ")[2].partition(". Type yes")[0]
    rig.start(**{"writes.healthy": text})
    assert rig.runs("healthy") == 1
    other = tmp_path / "other"
    other.mkdir()
    rig = RecordedRig(other, monkeypatch)
    rig.start(**{"writes.healthy": text.replace("limits 0 to 500", "limits 0 to 400")})
    assert rig.runs("healthy") == 0


def test_files_of_others_are_not_overwritten(tmp_path):
    (tmp_path / "rig.toml").write_text("mine", encoding="utf-8")
    with pytest.raises(StartError, match=r"rig\.toml is there already"):
        start(StartRequest(tmp_path, virtual=True), print, lambda _: "")
    assert [path.name for path in tmp_path.iterdir()] == ["rig.toml"]
    run = tmp_path / "run"
    run.mkdir()
    (run / "run.json").write_text("{}", encoding="utf-8")
    with pytest.raises(StartError, match="is a file of the run"):
        start(StartRequest(run, virtual=True), print, lambda _: "")


def test_a_course_on_a_rig_becomes_no_virtual_one(tmp_path, monkeypatch):
    RecordedRig(tmp_path, monkeypatch).start()
    with pytest.raises(StartError, match="has a course on a rig"):
        start(StartRequest(tmp_path, virtual=True), print, lambda _: "")


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--answer", "host"), "is no KEY=VALUE"),
        (("--answers", "missing.toml"), "there is no such file"),
        (("--answers", "broken.toml"), "is no TOML file"),
    ],
)
def test_a_wrong_option_is_one_sentence(tmp_path, monkeypatch, words, sentence):
    monkeypatch.chdir(tmp_path)
    Path("broken.toml").write_text("a b", encoding="utf-8")
    code, said = hil("start", *words)
    assert code == 2 and sentence in said and "Traceback" not in said


@pytest.mark.parametrize(
    ("check", "good", "kept", "bad"),
    [
        (limits, "0,100", "0, 100", ("100, 0", "5", "a, b", "0, nan", "0, 1e99")),
        (whole(1, 10), "07", "7", ("0", "11", "1.5", "", "\u0663")),
        (number(0, 5), "5", "5", ("-1", "6", "x", "nan")),
    ],
)
def test_a_check_keeps_good_answers_in_one_form(check, good, kept, bad):
    assert check(good) == kept
    for text in bad:
        with pytest.raises(ValueError):
            check(text)


def test_a_given_answer_comes_before_a_saved_one_and_a_default():
    def answer(given, saved, defaults):
        question = Question("port", "Port", "3", whole(1, 9))
        return Answering(given, saved, defaults, lambda _: None, lambda _: "4").answer(question)

    assert answer({"port": "1"}, {"port": "2"}, True) == "1"
    assert answer({}, {"port": "2"}, True) == "2"
    assert answer({}, {"port": "20"}, True) == "3"
    assert answer({}, {}, False) == "4"
    assert Answering({}, {}, True, lambda _: None, lambda _: "x").answer(Question("a", "A", None, anything)) == "x"


def test_an_agreement_does_not_outlast_a_change_of_what_is_run(tmp_path, monkeypatch):
    rig = RecordedRig(tmp_path, monkeypatch)
    rig.start("yes")
    said = rig.start(twin="profiles/twins/tclab.toml")
    assert said.count("This run writes to the rig") == 1 and "question 'writes.healthy'" in said
    assert rig.runs("healthy") == 1


def test_a_rig_file_of_the_same_name_is_the_source_and_is_kept(tmp_path, monkeypatch):
    rig = RecordedRig(tmp_path, monkeypatch)
    (tmp_path / "tank.toml").rename(tmp_path / "rig.toml")
    before = (tmp_path / "rig.toml").read_bytes()
    said = rig.start(source="rig.toml")
    assert "question 'writes.healthy'" in said and (tmp_path / "rig.toml").read_bytes() == before


@pytest.mark.parametrize("name", ["served.toml", "twin.toml", "load.csv", "healthy.csv", "draft.toml"])
def test_a_source_that_the_course_would_overwrite_is_refused_and_kept(tmp_path, name):
    (tmp_path / name).write_text("mine", encoding="utf-8")
    said: list[str] = []
    with pytest.raises(StopRequest):
        start(StartRequest(tmp_path, source=name), said.append, lambda _: (_ for _ in ()).throw(EOFError))
    assert any("yours would be lost; give it another name" in line for line in said), said
    assert (tmp_path / name).read_text(encoding="utf-8") == "mine"


def test_a_load_that_is_none_is_refused_before_anything_is_agreed_to(tmp_path, monkeypatch):
    rig = RecordedRig(tmp_path, monkeypatch)
    (tmp_path / "bad.csv").write_text("time_s,heater_power_W\n0,1\n0,2\n", encoding="utf-8")
    said = rig.start("bad.csv", load="bad.csv")
    assert said.count("refused: ") == 2 and "bad.csv" in said
    assert "question 'load'" in said and "writes.healthy" not in said  # no default takes its place


def test_a_given_answer_that_is_refused_is_replaced_by_no_older_one_and_no_default():
    question = Question("port", "Port", "502", whole(1, 65535))
    said: list[str] = []

    def ends(_prompt: str) -> str:
        raise EOFError

    answering = Answering({"port": "abc"}, {"port": "5020"}, True, said.append, ends)
    with pytest.raises(StopRequest, match="question 'port'"):
        answering.answer(question)
    assert "port = 'abc' is refused" in said[0]
    assert Answering({}, {"port": "5020"}, False, said.append, ends).answer(question) == "5020"
    assert Answering({"port": "503"}, {"port": "5020"}, False, said.append, ends).answer(question) == "503"


def test_a_rig_without_a_point_to_drive_ends_the_course_with_the_remedy(tmp_path, monkeypatch):
    rig = RecordedRig(tmp_path, monkeypatch)
    text = (tmp_path / "tank.toml").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith(("limits", "max_rate", "safe", "readback"))]
    (tmp_path / "tank.toml").write_text("\n".join(lines), encoding="utf-8")
    assert "has no point with limits" in rig.start()
    assert rig.runs("healthy") == 0
