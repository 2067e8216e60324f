"""Fleets: one result a job, resumed by what is there, whatever ends in between."""

from __future__ import annotations

import dataclasses
import errno
import json
import os

import pyarrow.parquet as pq
import pytest

from hil.executor import ExecutorError, ExecutorOptionError, ExecutorOptions, check_options, opened
from hil.executor.code_identity import code_identity
from hil.executor.task import OtherVersionError, perform
from hil.fleet import FleetFolder, FleetFolderError, session
from hil.fleet.kinds import GivenJob, MadeJob
from tests.hil.command_line import typed
from tests.hil.made_fleet import made_fleet


def run(file, out, *more):
    return typed("fleet", file, "--on", "here", "--out", out, *more)


@pytest.fixture
def counted(monkeypatch):
    """Replace the work by a count of its calls; a record in `broken` fails, and so does the first call for `flaky`."""
    calls: list[str] = []
    broken: set[str] = set()

    def perform_job(given: GivenJob, say):
        name = next(place for place, role in given.roles.items() if role == "record")
        calls.append(name)
        say(f"at /tmp/hil-job-x1/{name}")
        if name in broken:
            raise RuntimeError(f"/tmp/hil-job-x1/{name} is broken")
        return MadeJob({"value": float(len(calls))}, "fine", {"sub/out.txt": b"made"})

    monkeypatch.setattr(session, "perform_job", perform_job)
    calls.clear()
    return calls, broken


def test_each_job_has_one_result_with_files_log_and_row_and_is_not_run_again(tmp_path, counted):
    calls, _ = counted
    file, out = made_fleet(tmp_path / "in", records=3, hours=0.2), tmp_path / "out"
    assert run(file, out).returncode == 0 and len(calls) == 3
    rows = pq.read_table(out / "results.parquet").to_pylist()
    assert [row["status"] for row in rows] == ["done"] * 3 and {row["value"] for row in rows} == {1.0, 2.0, 3.0}
    for row in rows:
        assert (out / "files" / row["job"] / "sub/out.txt").read_bytes() == b"made"
        log = (out / "logs" / f"{row['job']}.log").read_text(encoding="utf-8")
        assert "attempt 1 begins" in log and f"at {file.parent / row['record']}" in log and "hil-job" not in log
    next((out / "jobs").iterdir()).unlink()
    again = run(file, out, "--json")
    assert again.returncode == 0 and len(calls) == 4 and len(json.loads(again.stdout)) == 3
    assert run(file, out).returncode == 0 and len(calls) == 4


def test_a_failure_is_tried_again_up_to_the_limit_then_kept_until_asked(tmp_path, counted):
    calls, broken = counted
    file, out = made_fleet(tmp_path / "in", records=2, hours=0.2), tmp_path / "out"
    file.write_text("attempts = 2\n" + file.read_text(encoding="utf-8"), encoding="utf-8")
    broken.add("record/r1.parquet")
    done = run(file, out)
    assert done.returncode == 1 and calls.count("record/r1.parquet") == 2 and calls.count("record/r0.parquet") == 1
    (failed,) = [row for row in pq.read_table(out / "results.parquet").to_pylist() if row["status"] == "failed"]
    assert failed["attempts"] == 2 and f"{file.parent}/records/r1.parquet is broken" in failed["error"]
    assert "Traceback" in (out / "logs" / f"{failed['job']}.log").read_text(encoding="utf-8")
    broken.clear()
    assert run(file, out).returncode == 1 and len(calls) == 3
    assert run(file, out, "--retry").returncode == 0 and len(calls) == 4


def test_a_mistake_in_a_record_is_not_tried_again_and_names_the_record(tmp_path):
    file, out = made_fleet(tmp_path / "in", records=1, hours=0.2), tmp_path / "out"
    record = file.parent / "records/r0.parquet"
    record.write_bytes(b"PAR1 and no more")
    done = run(file, out, "--json")
    (row,) = json.loads(done.stdout)
    assert done.returncode == 1 and row["status"] == "failed" and row["attempts"] == 1
    assert str(record) in row["error"] and "hil-job" not in row["error"]


def test_a_full_disk_is_one_sentence_and_the_same_command_goes_on(tmp_path, counted, monkeypatch):
    calls, _ = counted
    file, out = made_fleet(tmp_path / "in", records=2, hours=0.2), tmp_path / "out"
    link, linked = os.link, []

    def full(*arguments):
        linked.append(arguments)
        if len(linked) == 2:
            raise OSError(errno.ENOSPC, "No space left on device")
        link(*arguments)

    monkeypatch.setattr("os.link", full)
    done = run(file, out)
    assert done.returncode == 1 and done.stderr.count("hil: ") == 1
    assert "No space left on device); make room, and give the same command again" in done.stderr
    assert run(file, out).returncode == 0 and len(calls) == 3


def test_a_folder_of_another_fleet_or_of_other_files_or_in_use_is_refused(tmp_path, counted):
    file, out = made_fleet(tmp_path / "in", records=1, hours=0.2), tmp_path / "out"
    assert run(file, out).returncode == 0
    other = file.with_name("other.toml")
    other.write_text(file.read_text(encoding="utf-8").replace('"night"', '"day"'), encoding="utf-8")
    done = run(other, out)
    assert done.returncode == 2 and "is the folder of the fleet 'night'" in done.stderr
    done = run(file, file.parent)
    assert done.returncode == 2 and "has files and is no folder of a fleet" in done.stderr
    done = run(file, out, "--cancel")
    assert done.returncode == 2 and "there is nothing to cancel" in done.stderr
    done = run(file, tmp_path / "new", "--status")
    assert done.returncode == 2 and "is no folder of a fleet" in done.stderr


def test_a_second_result_never_replaces_the_first(tmp_path):
    folder = FleetFolder(tmp_path)
    for name in ("jobs", "files", "logs"):
        (tmp_path / name).mkdir()
    first, second = ({"status": "done", "row": {}, "n": n} for n in (1, 2))
    assert folder.write_result("a", first, {"x": b"1"}) and not folder.write_result("a", second, {"x": b"2"})
    assert folder.result("a") == first and (tmp_path / "files/a/x").read_bytes() == b"1"
    with pytest.raises(FleetFolderError, match="outside of its folder"):
        folder.write_result("b", second, {"../../x": b"2"})
    assert folder.result("b") is None and not (tmp_path / "x").exists()


def test_a_worker_of_another_version_takes_no_job():
    ours, called = code_identity(), []
    for change, said in (
        ({"hil": "0.0.1"}, f"hil {ours.hil}, here it is 0.0.1"),
        ({"python": "3.9"}, f"Python {ours.python}, here it is 3.9"),
        ({"sources": "x"}, f"other sources of hil {ours.hil}"),
    ):
        with pytest.raises(OtherVersionError, match=said) as found:
            perform(lambda *_: called.append(1), None, print, "tcp://w:1", dataclasses.replace(ours, **change))
        assert not called and "install the same version there" in str(found.value)


@pytest.mark.parametrize("address", ["there", "tcp://host", "tcp://host:99999", "udp://host:1", "tcp://:1"])
def test_an_address_that_is_none_is_refused(address):
    with pytest.raises(ExecutorOptionError, match="is no address of a scheduler"):
        check_options(ExecutorOptions(address))


def test_certificates_are_complete_and_for_tls_alone(tmp_path):
    with pytest.raises(ExecutorOptionError, match="give all three"):
        check_options(ExecutorOptions("tls://h:1", tls_ca=tmp_path))
    with pytest.raises(ExecutorOptionError, match="are for --on tls"):
        check_options(ExecutorOptions("tcp://h:1", tls_ca=tmp_path))


def test_without_dask_the_extra_is_named(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ExecutorError, match=r"pip install 'hil-rig\[fleet\]'"):
        check_options(ExecutorOptions())
    check_options(ExecutorOptions("here"))


def test_a_scheduler_that_does_not_answer_is_one_sentence(monkeypatch):
    monkeypatch.setattr("hil.executor.dask_cluster.CONNECT_S", 0.5)
    with (
        pytest.raises(ExecutorError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9") as found,
        opened(ExecutorOptions("tcp://127.0.0.1:9"), print),
    ):
        pass
    assert "\n" not in str(found.value) and "start one with `dask scheduler`" in str(found.value)
