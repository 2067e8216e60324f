"""Folders that one process at a time writes, and whose files are replaced together or not at all."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from hil.files import held, replacing_all, require_complete


def own(name: str) -> bool:
    return name.endswith(".txt")


def content(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir()}


def _replace(folder: Path, *names: str, error: Exception | None = None) -> None:
    """Replace the result by new files of these names, or meet an error after they are written."""
    with replacing_all(folder, own) as part:
        for name in names:
            (part / name).write_text("new")
        if error is not None:
            raise error


def test_a_second_process_is_refused_and_the_lock_ends_with_its_holder(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    code = "import sys, time, pathlib\nfrom hil.files import held\nwith held(pathlib.Path(sys.argv[1]), OSError):\n"
    code += "    (pathlib.Path(sys.argv[1]) / 'a').touch()\n    print('held', flush=True)\n    time.sleep(60)\n"
    other = subprocess.Popen([sys.executable, "-c", code, str(folder)], stdout=subprocess.PIPE, text=True)
    try:
        assert other.stdout is not None and other.stdout.readline() == "held\n"
        with pytest.raises(RuntimeError, match="another process works on this folder"), held(folder, RuntimeError):
            pass
    finally:
        other.kill()
        other.wait()
        if other.stdout is not None:
            other.stdout.close()
    with held(folder, RuntimeError):
        assert folder.is_dir()


def test_a_folder_that_was_made_and_stays_empty_goes_with_its_parents(tmp_path: Path) -> None:
    with held(tmp_path / "a" / "b", RuntimeError):
        assert (tmp_path / "a" / "b").is_dir()
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "there").mkdir()
    with held(tmp_path / "there", RuntimeError):
        pass
    assert (tmp_path / "there").is_dir()


def test_new_files_replace_the_old_ones_and_files_of_others_stay(tmp_path: Path) -> None:
    for name in ("one.txt", "two.txt", "other.md"):
        (tmp_path / name).write_text("old")
    with replacing_all(tmp_path, own) as part:
        (part / "one.txt").write_text("new")
        assert content(part) == {"one.txt": "new"} and (tmp_path / "one.txt").read_text() == "old"
    assert content(tmp_path) == {"one.txt": "new", "other.md": "old"}


def test_an_error_leaves_the_old_files(tmp_path: Path) -> None:
    (tmp_path / "one.txt").write_text("old")
    with pytest.raises(ZeroDivisionError):
        _replace(tmp_path, "one.txt", error=ZeroDivisionError())
    assert content(tmp_path) == {"one.txt": "old"}


@pytest.mark.parametrize("moved", [0, 1], ids=["before the first file was moved", "after it"])
def test_a_replacement_that_was_cut_is_completed_by_the_next_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moved: int
) -> None:
    for name in ("one.txt", "three.txt"):
        (tmp_path / name).write_text("old")
    replace, count = Path.replace, 0

    def cut(self: Path, target: Path) -> Path:
        nonlocal count
        count += 1
        if count > moved:
            raise KeyboardInterrupt
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", cut)
    with pytest.raises(KeyboardInterrupt):
        _replace(tmp_path, "one.txt", "two.txt")
    monkeypatch.undo()
    with pytest.raises(RuntimeError, match="was cut while it replaced the files; run that command again"):
        require_complete(tmp_path, RuntimeError)
    (tmp_path / ".99.part").mkdir()  # of a process that was killed before it was ready
    with pytest.raises(ZeroDivisionError):
        _replace(tmp_path, error=ZeroDivisionError())
    require_complete(tmp_path, RuntimeError)
    assert content(tmp_path) == {"one.txt": "new", "two.txt": "new"}
