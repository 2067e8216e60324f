"""The cache of compiled kernels is this user's own, and no file in it is trusted before it is checked."""

from __future__ import annotations

import importlib
import logging
import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from twin.kernel import cache as kernel_cache
from twin.kernel.cache import cache_root, compile_kernel

SOURCE = """
@nb.njit('void(f8[::1])', cache=True)
def kernel(out):
    out[0] = {value}
"""


class Trap:
    """An object that leaves a trace where it is unpickled."""

    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return (os.mkdir, (str(self.trace),))


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
    return {path: path.stat().st_mtime_ns for path in root.rglob("*.nbc")}


def test_the_folder_and_all_in_it_are_closed_to_others(root: Path) -> None:
    before = os.umask(0)
    try:
        assert run(1.5) == 1.5
    finally:
        os.umask(before)
    folders = [root, *(path for path in root.rglob("*") if path.is_dir())]
    assert len(folders) == 3
    assert all(path.stat().st_mode & 0o077 == 0 for path in folders)


def test_a_second_start_takes_the_machine_code_from_the_cache(root: Path) -> None:
    assert run(2.5) == 2.5
    first = stamps(root)
    assert first and run(2.5) == 2.5
    assert stamps(root) == first


@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
def test_a_changed_file_is_not_unpickled_but_compiled_anew(root: Path, suffix: str, tmp_path: Path) -> None:
    run(3.5)
    for path in root.rglob(f"*{suffix}"):
        path.write_bytes(pickle.dumps(Trap(tmp_path / "trace")))
    assert run(3.5) == 3.5
    assert not (tmp_path / "trace").exists()


def test_a_truncated_cache_is_compiled_anew(root: Path) -> None:
    run(4.5)
    for path in root.rglob("*.nbi"):
        path.write_bytes(path.read_bytes()[:40])
    assert run(4.5) == 4.5


def test_a_file_that_others_may_write_is_not_used_although_it_is_unchanged(root: Path) -> None:
    run(5.5)
    first = stamps(root)
    next(root.rglob("*.nbi")).chmod(0o666)
    assert run(5.5) == 5.5
    assert stamps(root) != first


def test_a_link_in_a_kernels_folder_is_not_followed(root: Path, tmp_path: Path) -> None:
    run(6.5)
    index = next(root.rglob("*.nbi"))
    away = tmp_path / "away.nbi"
    index.rename(away)
    index.symlink_to(away)
    before = away.read_bytes()
    assert run(6.5) == 6.5
    assert away.read_bytes() == before and not index.is_symlink()


def test_a_changed_source_beside_good_machine_code_is_not_run(root: Path, tmp_path: Path) -> None:
    run(7.5)
    source = next(root.rglob("kernel_*.py"))
    stamp = source.stat()
    source.write_text(f"import os\nos.mkdir({str(tmp_path / 'trace')!r})\n")
    os.utime(source, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    assert run(7.5) == 7.5
    assert not (tmp_path / "trace").exists()


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


@pytest.mark.parametrize("module", ["twin.kernel.cache", "drivers.virtual.plant.compiled_cache"])
def test_functions_compiled_ahead_are_not_kept_where_others_may_write(
    module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = importlib.import_module(module)
    may_cache = getattr(found, "may_cache", None) or found.numba_may_cache
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    assert may_cache()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    tmp_path.chmod(0o700)
    assert may_cache()
    tmp_path.chmod(0o777)
    assert not may_cache()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "nowhere"))
    assert not may_cache()


SHARED = """
import numpy as np
from twin.kernel.cache import compile_kernel
out = np.zeros(1)
compile_kernel({source!r})(out)
print(out[0])
"""


def test_a_shared_folder_that_numba_is_told_to_use_is_left_alone(root: Path, tmp_path: Path) -> None:
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o777)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(shared)}
    command = [sys.executable, "-c", SHARED.format(source=SOURCE.format(value=10.5))]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "10.5"
    assert not list(shared.iterdir()) and stamps(root)
