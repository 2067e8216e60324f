"""`hil explain` as a user types it, on a virtual rig of separate processes over real Modbus and CAN."""

from __future__ import annotations

import io
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from hil.diagnosis.experiment_file import write_experiment
from hil.diagnosis.session import Written
from hil.explain import session
from hil.explain.explanation import DOCUMENT, PAGE, HashedFile
from hil.run.session.interrupted_run import request_of as request_of_run
from hil.run_folder.folder import RunFolder, new_manifest
from tests.hil.command_line import typed
from tests.hil.made_explanation import PLAN, RIG, Scripted, diagnosis, made_files, request_of
from tests.hil.slow_period import slow_period_rig
from twin.discovery.diagnosis import Diagnosis

PROJECT = Path(__file__).resolve().parents[2]
HOURS = 2.5
STEADY = "time_s,heater_power_W,pump_speed_pct,fan_speed_pct\n0,700,85,70\n{end:g},700,85,70\n"
GAIN = '[[effect]]\nkind = "actuator"\nwhere = "heater_power"\ndriver = "constant"\ngain = 1.08\nonset_s = 3600\n'


def test_a_run_with_two_causes_alike_is_settled_by_an_experiment_on_the_virtual_rig(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Heat at the heater and a heater that gives more than it says are one at a constant load; the former is likelier
    beforehand, and the experiment shows the latter."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "steady.csv").write_text(STEADY.format(end=3600.0 * HOURS), encoding="utf-8")
    (tmp_path / "gain.toml").write_text(GAIN, encoding="utf-8")
    for name in ("virtual.toml", "virtual.healthy.parquet"):
        shutil.copy(PROJECT / "profiles/twins" / name, tmp_path)
    options = ("--rig", slow_period_rig(tmp_path, 5.0), "--virtual", "--lockstep", "--no-viewer")
    made = typed(
        "run", "steady.csv", "--no-twin", "--with", "gain.toml", "--seed", 4, "--json", "--no-report", *options
    )
    assert made.returncode == 0, made.stderr
    first = Path(json.loads(made.stdout)["folder"])
    asked = ("explain", first, "--twin", "virtual.toml", *options)
    # Nobody answers the question: the plan is kept, and nothing has run.
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    declined = typed(*asked)
    assert declined.returncode == 1, declined.stderr
    assert "Run it on a virtual rig now?" in declined.stderr and "--yes" in declined.stderr
    assert list((tmp_path / "runs").glob("*-experiment")) == []
    done = typed(*asked, "--yes")
    assert done.returncode == 1, done.stderr
    assert "1 round; it is continued" in done.stderr and "round 1: effect found" in done.stderr
    folder = tmp_path / first / "explanation"
    document = json.loads((folder / DOCUMENT).read_text(encoding="utf-8"))
    before, after = document["rounds"]
    assert (before["verdict"], after["verdict"], document["end"]) == ("ambiguous", "effect found", "settled")
    shares = {belief["label"]: belief["share"] for belief in before["beliefs"]}
    assert shares["heat source at heater"] > shares["actuator at heater power"] > 0.005
    assert [belief["label"] for belief in after["beliefs"]] == ["actuator at heater power"]
    assert all(e["after"] < 0.5 * e["baseline"] for e in after["errors"].values())
    assert all(e["after"] < 0.5 * e["baseline"] for one in after["further"].values() for e in one.values())
    # The virtual rig goes on with the effects of the run, which are as old as it left them.
    (path,) = (tmp_path / "runs").glob("*-experiment")
    manifest = RunFolder(path).read_manifest()
    assert manifest["settings"]["start_s"] == pytest.approx(3600.0 * HOURS, abs=2.0)
    assert manifest["settings"]["seed"] == 4 and manifest["safe"] is True
    assert Path(manifest["files"]["effects"]["path"]).name == "gain.toml"
    assert Path(after["revision"]).is_file()
    page = (folder / PAGE).read_text(encoding="utf-8")
    assert "heater power changes between" in page and "heat source at heater" in page and str(path) in page
    # Asked again there is nothing left to do.
    again = typed(*asked, "--yes", "--json")
    assert again.returncode == 1 and json.loads(again.stdout) == document
    assert len(list((tmp_path / "runs").iterdir())) == 2 and len(list(tmp_path.glob("virtual.r*.toml"))) == 1


def diagnosed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, found: Diagnosis) -> dict[str, Path]:
    """Files of a record with one round in the folder `out`, whose diagnosis is `found`."""

    def brief(ready, found, folder, *, empirical, began):  # type: ignore[no-untyped-def]
        folder.mkdir(parents=True, exist_ok=True)
        return Written(experiment=write_experiment(found, folder, ready.request.rig)), {}

    files = made_files(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(session, "write_results", brief)
        session.explain(request_of(tmp_path, files), Scripted(found, approves=False))
    return files


@pytest.fixture
def open_case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Path]:
    """A record whose first diagnosis left two causes open, with a plan for the virtual rig."""
    return diagnosed_once(tmp_path, monkeypatch, diagnosis("ambiguous", PLAN))


def asked_of(place: Path, files: dict[str, Path], *options: object) -> tuple[object, ...]:
    return (
        "explain",
        files["record"],
        "--twin",
        files["twin"],
        "--no-healthy",
        "--out",
        place / "out",
        "--runs",
        place / "runs",
        "--no-viewer",
        *options,
    )


@pytest.mark.parametrize(("verdict", "code"), [("adequate", 0), ("effect found", 1), ("unexplained", 1)])
def test_a_settled_verdict_has_the_exit_code_of_a_diagnosis(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verdict: str, code: int
) -> None:
    files = diagnosed_once(tmp_path, monkeypatch, diagnosis(verdict))
    done = typed(*asked_of(tmp_path, files, "--virtual", "--lockstep", "--yes"))
    assert done.returncode == code, done.stderr
    assert f"{verdict}: " in done.stdout and str(tmp_path / "out" / PAGE) in done.stdout
    assert not (tmp_path / "runs").exists()


def test_ctrl_c_in_a_diagnosis_says_how_to_go_on(
    tmp_path: Path, open_case: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("hil.diagnosis.session.diagnose_files", interrupted)
    done = typed(*asked_of(tmp_path / "new", open_case))
    assert done.returncode == 1 and "To go on: " in done.stderr and "Traceback" not in done.stderr


def test_ctrl_c_in_an_experiment_leaves_the_heater_safe_and_the_finished_rounds(
    tmp_path: Path, open_case: dict[str, Path]
) -> None:
    asked = asked_of(tmp_path, open_case, "--virtual", "--speed", 20, "--yes")
    process = subprocess.Popen(
        [sys.executable, "-m", "hil", *map(str, asked)],
        cwd=PROJECT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        process_group=0,
    )
    assert process.stdout is not None
    before = []
    for line in process.stdout:
        before.append(line)
        if line.startswith("replaying"):
            os.killpg(process.pid, signal.SIGINT)
            break
    said, _ = process.communicate(timeout=180)
    assert process.returncode == 1, "".join(before) + said
    assert "Traceback" not in said and "to go on" in said and "hil resume" in said
    (path,) = (tmp_path / "runs").iterdir()
    manifest = RunFolder(path).read_manifest()
    assert (manifest["exit_status"], manifest["safe"]) == ("aborted", True)
    # `hil resume` completes it on a virtual rig of the same age.
    assert request_of_run(RunFolder(path), manifest, {}).start_s == manifest["settings"]["start_s"] > 1000.0
    document = json.loads((tmp_path / "out" / DOCUMENT).read_text(encoding="utf-8"))
    assert document["end"] == "stopped" and len(document["rounds"]) == 1


def test_a_trip_in_an_experiment_ends_it_safe_and_is_named(tmp_path: Path, open_case: dict[str, Path]) -> None:
    text = RIG.read_text(encoding="utf-8").replace("alarm = [-5.0, 75.0]", "alarm = [-5.0, 26.0]")
    text = text.replace('dbc = "', f'dbc = "{RIG.parent}/').replace('twin = "', f'twin = "{RIG.parent}/')
    (tmp_path / "cool.toml").write_text(text, encoding="utf-8")
    path = tmp_path / "out" / DOCUMENT
    document = json.loads(path.read_text(encoding="utf-8"))
    # The plan counts as made for this rig, so that it is run as it is.
    document["rounds"][0]["next"]["rig"] = HashedFile.of(tmp_path / "cool.toml").model_dump()
    path.write_text(json.dumps(document), encoding="utf-8")
    done = typed(*asked_of(tmp_path, open_case, "--virtual", "--lockstep", "--yes", "--rig", tmp_path / "cool.toml"))
    assert done.returncode == 1, done.stderr
    (run,) = (tmp_path / "runs").iterdir()
    manifest = RunFolder(run).read_manifest()
    assert (manifest["exit_status"], manifest["safe"]) == ("faulted", True)
    left = json.loads(path.read_text(encoding="utf-8"))
    assert left["end"] == "stopped" and "26" in left["reason"] and len(left["rounds"]) == 1
    assert "to go on" in done.stdout


def test_a_rig_that_does_not_answer_is_named(tmp_path: Path, open_case: dict[str, Path]) -> None:
    done = typed(*asked_of(tmp_path, open_case, "--rig", RIG, "--yes"))
    assert done.returncode == 1 and "cannot be reached" in done.stdout and "Traceback" not in done.stderr
    assert json.loads((tmp_path / "out" / DOCUMENT).read_text(encoding="utf-8"))["end"] == "stopped"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--lockstep",), "add --virtual"),
        (("--effects", "profiles/effects/modules_heat.toml"), "add --virtual"),
        (("--virtual", "--lockstep", "--speed", "2"), "exclude each other"),
        (("--virtual", "--json"), "add --yes"),
        (("--healthy", "profiles/twins/virtual.healthy.parquet"), "exclude each other"),
        (("--rounds", "0"), "--rounds"),
    ],
)
def test_options_that_contradict_each_other_are_refused(
    tmp_path: Path, open_case: dict[str, Path], options: tuple[str, ...], said: str
) -> None:
    done = typed(*asked_of(tmp_path, open_case, *options))
    assert done.returncode == 2 and said in done.stderr


def a_run(folder: Path, files: dict[str, Path], **settings: object) -> RunFolder:
    """A run folder with the record of `files`, and the settings of its run."""
    folder.mkdir()
    run = RunFolder(folder)
    shutil.copy(files["record"], run.record)
    shutil.copy(files["twin"], run.twin)
    effects = folder.parent / "effects.toml"
    effects.write_text(GAIN, encoding="utf-8")
    run.write_manifest(new_manifest({"effects": effects}, **settings) | {"exit_status": "done"})
    return run


def test_a_virtual_run_is_explained_on_a_virtual_rig_alone_and_a_real_one_on_a_rig(
    tmp_path: Path, open_case: dict[str, Path]
) -> None:
    virtual = a_run(tmp_path / "virtual", open_case, virtual=True)
    done = typed("explain", virtual.path, "--rig", RIG)
    assert done.returncode == 2 and "add --virtual" in done.stderr
    real = a_run(tmp_path / "real", open_case, virtual=False)
    done = typed("explain", real.path, "--virtual")
    assert done.returncode == 2 and "--rig" in done.stderr


def test_effects_that_were_changed_or_moved_since_the_run_are_named(tmp_path: Path, open_case: dict[str, Path]) -> None:
    run = a_run(tmp_path / "run", open_case, virtual=True)
    effects = tmp_path / "effects.toml"
    effects.write_text(GAIN + "# changed\n", encoding="utf-8")
    done = typed("explain", run.path, "--virtual", "--no-healthy")
    assert done.returncode == 2 and "effects.toml" in done.stderr and "--effects" in done.stderr
    effects.unlink()
    done = typed("explain", run.path, "--virtual", "--no-healthy")
    assert done.returncode == 2 and "is not there" in done.stderr and "--effects" in done.stderr
