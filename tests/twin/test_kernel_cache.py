"""The cache of compiled kernels is this user's own, and no file in it is trusted before it is checked."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from drivers.virtual.plant.machine_code import may_cache
from twin.kernel import cache as kernel_cache
from twin.kernel.cache import cache_root, compile_kernel

SOURCE = """
@typed('void(f8[::1])')
def kernel(out):
    out[0] = {value}
"""


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    compile_kernel.cache_clear()
    kernel_cache._no_cache.cache_clear()
    yield tmp_path / "hil-twin"
    compile_kernel.cache_clear()
    kernel_cache._no_cache.cache_clear()


def run(value: float) -> float:
    compile_kernel.cache_clear()
    out = np.zeros(1)
    compile_kernel(SOURCE.format(value=value))(out)
    return float(out[0])


def stamps(root: Path) -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in root.iterdir()}


def test_the_folder_and_all_in_it_are_closed_to_others(root: Path) -> None:
    before = os.umask(0)
    try:
        assert run(1.5) == 1.5
    finally:
        os.umask(before)
    found = [root, *root.rglob("*")]
    assert len(found) == 2
    assert all(path.stat().st_mode & 0o077 == 0 for path in found)


def test_a_second_start_takes_the_machine_code_from_the_cache(root: Path) -> None:
    assert run(2.5) == 2.5
    first = stamps(root)
    assert first and run(2.5) == 2.5
    assert stamps(root) == first


def test_another_source_is_not_answered_with_the_code_of_this_one(root: Path) -> None:
    assert [run(value) for value in (3.5, 3.25, 3.5)] == [3.5, 3.25, 3.5]
    assert len(stamps(root)) == 2


@pytest.mark.parametrize("left", [0, 20, 40, 400])
def test_a_truncated_file_is_compiled_anew(root: Path, left: int) -> None:
    run(4.5)
    (file,) = root.iterdir()
    whole = file.read_bytes()
    file.write_bytes(whole[:left])
    assert run(4.5) == 4.5
    assert file.read_bytes() == whole


def test_machine_code_with_a_changed_byte_is_not_run(root: Path) -> None:
    run(4.75)
    (file,) = root.iterdir()
    whole = file.read_bytes()
    for place in (0, len(whole) // 2, len(whole) - 1):
        file.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        assert run(4.75) == 4.75
        assert file.read_bytes() == whole


def test_a_file_that_others_may_write_is_not_used_although_it_is_unchanged(root: Path) -> None:
    run(5.5)
    first = stamps(root)
    next(root.iterdir()).chmod(0o666)
    assert run(5.5) == 5.5
    assert stamps(root) != first
    assert next(root.iterdir()).stat().st_mode & 0o077 == 0


def test_a_link_in_the_folder_is_not_followed(root: Path, tmp_path: Path) -> None:
    run(6.5)
    (file,) = root.iterdir()
    away = tmp_path / "away.o"
    file.rename(away)
    file.symlink_to(away)
    before = away.read_bytes()
    assert run(6.5) == 6.5
    assert away.read_bytes() == before and not file.is_symlink()


def test_a_pipe_or_a_folder_in_place_of_a_file_does_not_stop_a_start_and_leaves_nothing(root: Path) -> None:
    run(6.75)
    (file,) = root.iterdir()
    file.unlink()
    os.mkfifo(file)
    assert run(6.75) == 6.75
    file.unlink()
    file.mkdir()
    assert run(6.75) == 6.75
    assert list(root.iterdir()) == [file]


@pytest.mark.parametrize(
    "wrong", [np.zeros((1, 1)), np.zeros(1, np.float32), np.zeros(1, np.int64), np.zeros((4, 2))[:, 0]]
)
def test_an_array_of_another_kind_is_refused_before_machine_code_sees_it(root: Path, wrong: np.ndarray) -> None:
    with pytest.raises(TypeError, match="in C order"):
        compile_kernel(SOURCE.format(value=7.5))(wrong)
    with pytest.raises(ValueError, match="argument"):
        compile_kernel(SOURCE.format(value=7.5))()


@pytest.mark.parametrize("mode", [0o777, 0o770, 0o702])
def test_a_folder_that_others_may_write_is_not_used_and_the_user_is_told(
    root: Path, mode: int, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    root.mkdir()
    root.chmod(mode)
    monkeypatch.setenv("HOME", "/proc/self/nowhere")
    with caplog.at_level(logging.WARNING):
        assert run(8.5) == 8.5
        assert run(9.5) == 9.5
    assert not list(root.iterdir())
    assert len(caplog.records) == 1
    assert f"{root} can be written by other users" in caplog.text and "chmod 700" in caplog.text


def test_a_folder_that_others_may_only_read_is_closed(root: Path) -> None:
    root.mkdir(mode=0o755)
    root.chmod(0o755)
    assert cache_root() == root
    assert root.stat().st_mode & 0o777 == 0o700


def test_a_folder_of_another_user_is_not_used(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "getuid", lambda: 12345)
    assert cache_root() is None


def test_a_folder_that_everybody_could_replace_is_not_used(root: Path, tmp_path: Path) -> None:
    root.mkdir(mode=0o700)
    tmp_path.chmod(0o777)
    assert cache_root() != root
    tmp_path.chmod(0o1777)
    assert cache_root() == root


def test_functions_compiled_ahead_are_not_kept_where_others_may_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    assert may_cache()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    tmp_path.chmod(0o700)
    assert may_cache()
    tmp_path.chmod(0o777)
    assert not may_cache()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "nowhere"))
    assert not may_cache()
