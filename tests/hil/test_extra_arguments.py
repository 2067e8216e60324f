"""Arguments beyond those of a command, and memory that runs out: one sentence with the remedy."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from hil.errors import explained
from tests.docs.fences import PROJECT
from tests.hil.command_line import typed


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ("diagnose", "a", "b"),
            "hil diagnose takes one RUN|RECORD, and b came besides; give one command for each (`for",
        ),
        (("diagnose", "a", "b"), "further records of the same rig go behind --with"),
        (("review", "a", "b", "a", "b", "a"), "takes one RUN, and b a b ... came besides"),
        (("twin", "revert", "a.toml", "b.toml"), 'do hil twin revert "$x"'),
        (
            ("init", "registers.csv"),
            "hil init takes no argument, and registers.csv is one; give a file behind its option",
        ),
    ],
)
def test_several_files_where_one_is_taken_are_refused_with_the_loop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in "ab":
        (tmp_path / name).mkdir()
        (tmp_path / f"{name}.toml").touch()
    done = typed(*words)
    assert done.returncode == 2
    assert said in " ".join(done.stderr.split())


def _unloaded() -> None:
    raise ImportError("libarrow.so.1: failed to map segment from shared object")


def _translated() -> None:
    try:
        raise MemoryError("malloc of size 131072 failed")
    except MemoryError as error:
        raise ValueError("the file is no CSV") from error


@pytest.mark.parametrize("fail", [_unloaded, _translated])
def test_a_lack_of_memory_is_reported_as_one_whatever_a_library_made_of_it(
    fail: object, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended, explained():
        fail()  # type: ignore[operator]
    said = capsys.readouterr().err
    assert ended.value.code == 1
    assert said.startswith("hil: there is not enough memory") and len(said.splitlines()) == 1


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="limits of the address space are those of Linux")
def test_a_record_is_not_blamed_for_a_limit_of_memory(tmp_path: Path) -> None:
    path = tmp_path / "record.csv"
    path.write_text("time_s,T_in_C\n0,20\n1,21\n2,22\n", encoding="utf-8")
    # Python starts in 0.2 GB, and the library that reads records does not.
    limited = f"ulimit -v 200000; exec {sys.executable} -m hil check {path}"
    done = subprocess.run(
        ["bash", "-c", limited], capture_output=True, text=True, env=os.environ, timeout=60, check=False
    )
    sentences = [line for line in done.stderr.splitlines() if line.startswith("hil: ")]
    assert "`ulimit -v` allows 0.2 GB" in sentences[0]
    assert done.returncode == 1 and "there is not enough memory within the 0.2 GB" in sentences[-1]
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("verb", ["run", "track"])
def test_a_file_that_is_no_card_is_refused_by_its_own_name(verb, tmp_path):
    notes = tmp_path / "README.md"
    notes.write_text("notes", encoding="utf-8")
    done = typed(verb, PROJECT / "profiles/loads/battle_10h.csv", "--network", notes)
    assert done.returncode == 2 and f"{notes} is no card of a network" in done.stderr
    assert "README.md.json" not in done.stderr
