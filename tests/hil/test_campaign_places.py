"""What a campaign publishes, and whom it calls left over."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
from types import SimpleNamespace

import pytest

from hil.bench.faults.judge import tries_on
from hil.bench.faults.places import PROJECT, take_places_out, without_places
from hil.errors import exhausted_resource, explained
from hil.run.session.event_loop import session_result


def test_no_place_of_the_machine_is_left_in_the_texts_of_a_result():
    result = SimpleNamespace(
        failures=[f"left running: python -c sys.path.insert(0, '{PROJECT}'", 'File "/opt/py/lib/threading.py", line 9'],
        wrong=["tick 3: T_tank 20 recorded as good"],
        reason=f"{tempfile.gettempdir()}/hil-chaos-ab12/runs/x/journal.sqlite is gone | socket:[3] at /dev/pts/0 5 K/s",
    )
    take_places_out(result)
    assert result.failures == [
        "left running: python -c sys.path.insert(0, 'PROJECT'",
        'File ".../threading.py", line 9',
    ]
    assert result.wrong == ["tick 3: T_tank 20 recorded as good"]
    assert result.reason == "FOLDER/runs/x/journal.sqlite is gone | socket:[3] at /dev/pts/0 5 K/s"
    assert without_places("see http://example.org/a/b and runs/x/y") == "see http://example.org/a/b and runs/x/y"


@pytest.mark.parametrize(("what", "tries"), [("not safe", True), ("safe", False), ("gave up", False), ("ended", False)])
def test_a_guardian_tries_on_only_where_its_log_says_so_even_after_that_was_deleted(what, tries, tmp_path):
    log = tmp_path / "guardian.log"
    log.write_text(json.dumps({"what": "acting"}) + "\n" + json.dumps({"what": what}) + "\n")
    with log.open() as handle:
        holder = subprocess.Popen(
            [sys.executable, "-c", "import time; time.sleep(30)"],
            pass_fds=(handle.fileno(),),
            stdout=subprocess.DEVNULL,
        )
    log.unlink()
    try:
        assert tries_on(holder.pid) is tries
    finally:
        holder.kill()
        holder.wait()
    assert not tries_on(os.getpid())


@pytest.mark.parametrize(
    "error", [MemoryError(), RuntimeError("can't start new thread"), OSError(24, "Too many open files")]
)
def test_a_machine_without_memory_threads_or_descriptors_is_a_sentence(error, capsys):
    assert exhausted_resource(error) is not None
    with pytest.raises(SystemExit) as caught, explained():
        raise error
    assert caught.value.code == 1
    said = capsys.readouterr().err
    assert re.match("hil: (this machine has no thread|there is not enough memory)", said)
    assert len(said.splitlines()) == 1
    assert exhausted_resource(RuntimeError("a defect")) is None


def test_a_loop_that_cannot_be_closed_costs_no_result(monkeypatch):
    def no_thread(self: object) -> None:
        raise RuntimeError("can't start new thread")

    async def session() -> int:
        import asyncio

        await asyncio.to_thread(lambda: None)
        monkeypatch.setattr("threading.Thread.start", no_thread)
        return 7

    try:
        assert session_result(session()) == 7
    finally:
        monkeypatch.undo()
