"""Machine code that is kept: the same results from a file as from the compiler, and only files to be trusted."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.virtual.plant.geometry import Cells
from drivers.virtual.plant.kernel import Advance
from drivers.virtual.plant.machine_code import machine_code
from drivers.virtual.plant.plant import Plant

TWICE = """
declare double @exp(double)
declare void @left_over()
define void @unused() {
  call void @left_over()
  ret void
}
define i32 @known(ptr %result, ptr %error, ptr %at, double %factor) {
  %x = load double, ptr %at
  %y = fmul double %x, %factor
  %z = call double @exp(double %y)
  store double %z, ptr %at
  ret i32 0
}
"""


class Compiler:
    """Compiler that counts how often it was asked."""

    def __init__(self) -> None:
        self.asked = 0

    def __call__(self) -> tuple[str, str]:
        self.asked += 1
        return TWICE, "known"


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "cache"
    folder.mkdir(mode=0o700)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder))
    return folder


def called(compiled: Callable[[], tuple[str, str]], *sources: Path) -> float:
    function = machine_code("scaled", compiled, sources, (ctypes.c_void_p, ctypes.c_double))
    value = ctypes.c_double(0.5)
    assert function(None, None, ctypes.addressof(value), 0.0) == 0
    return value.value


def test_the_second_start_reads_what_the_first_compiled(cache: Path) -> None:
    compiler = Compiler()
    assert called(compiler) == called(compiler) == 1.0
    assert compiler.asked == 1
    (file,) = cache.iterdir()
    assert file.stat().st_mode & 0o077 == 0


def test_another_source_is_compiled_anew(cache: Path, tmp_path: Path) -> None:
    compiler, source = Compiler(), tmp_path / "source.py"
    for text in ("a = 1", "a = 2"):
        source.write_text(text, encoding="utf-8")
        assert called(compiler, source) == 1.0
    assert compiler.asked == 2


@pytest.mark.parametrize("damage", ["cut", "changed", "empty", "link", "open to others"])
def test_a_file_that_is_damaged_or_not_ours_alone_is_not_run(cache: Path, tmp_path: Path, damage: str) -> None:
    compiler = Compiler()
    called(compiler)
    (file,) = cache.iterdir()
    content = file.read_bytes()
    if damage == "link":
        file.rename(tmp_path / "elsewhere")
        file.symlink_to(tmp_path / "elsewhere")
    elif damage == "open to others":
        file.chmod(0o666)
    else:
        at = len(content) // 2
        changed = content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :]
        file.write_bytes({"cut": content[:at], "changed": changed, "empty": b""}[damage])
    assert called(compiler) == 1.0
    assert compiler.asked == 2
    assert called(compiler) == 1.0
    assert compiler.asked == 2


def test_nothing_is_kept_where_others_may_write(cache: Path) -> None:
    cache.chmod(0o777)
    compiler = Compiler()
    assert called(compiler) == called(compiler) == 1.0
    assert compiler.asked == 2
    assert list(cache.iterdir()) == []


def test_an_array_that_the_machine_code_would_write_beside_is_refused() -> None:
    plant = Plant()
    given = list(plant._advance._arrays)
    for k, wrong in (
        (14, given[14][:-1]),
        (15, given[15].astype(np.float32)),
        (16, np.zeros((given[16].size, 2))[:, 0]),
    ):
        with pytest.raises(TypeError, match=rf"array {k} of the plant"):
            Advance(Cells(*given[:8]), given[8], *given[9:k], wrong, *given[k + 1 :])


PLANT = """
import sys
from drivers.virtual.plant.plant import Plant
plant = Plant(seed=3)
plant.step(500.0, 1.0, 0.5)
print(plant.junction.tobytes().hex(), "numba" in sys.modules)
"""


def test_the_plant_starts_without_its_compiler_and_moves_as_if_it_had_been_compiled(cache: Path) -> None:
    said = [
        subprocess.run(
            [sys.executable, "-c", PLANT], env=dict(os.environ), capture_output=True, text=True, check=True
        ).stdout.split()
        for _ in range(2)
    ]
    (compiled, with_numba), (kept, without) = said
    assert compiled == kept
    assert (with_numba, without) == ("True", "False")
