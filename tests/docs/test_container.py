"""The Dockerfile, as far as it can be checked without Docker: its files, extras, pins, user and command."""

from __future__ import annotations

import fnmatch
import json
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

from tests.docs.fences import PROJECT

TEXT = (PROJECT / "Dockerfile").read_text(encoding="utf-8")
LINES = [
    line.strip()
    for line in re.sub(r"\\\n\s*", "", re.sub(r"^#.*\n", "", TEXT, flags=re.MULTILINE)).splitlines()
    if line.strip()
]
IGNORE = (PROJECT / ".dockerignore").read_text(encoding="utf-8").splitlines()
LIBRARIES = {"hil", "drivers", "twin", "profiles"}
WITHOUT_TORCH = "import runpy, sys; sys.modules['torch'] = None; runpy.run_module('hil', run_name='__main__')"


def arguments(instruction: str) -> list[str]:
    return [line.removeprefix(instruction).strip() for line in LINES if line.startswith(f"{instruction} ")]


def copied() -> set[str]:
    return {source for words in arguments("COPY") for source in words.split()[:-1]}


def test_every_file_that_is_copied_is_there_and_not_ignored():
    kept = {line.removeprefix("!") for line in IGNORE if line.startswith("!")}
    assert "*" in IGNORE
    for source in copied():
        assert (PROJECT / source).exists() and source in kept, source
    assert kept == copied()


def test_the_packages_and_files_of_the_installation_are_copied():
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))
    found = project["tool"]["setuptools"]["packages"]["find"]["include"]
    assert {pattern.removesuffix("*") for pattern in found} <= copied()
    assert {project["project"]["readme"], *project["project"]["license-files"]} <= copied()
    for extras in re.findall(r"\.\[([\w,]+)\]", TEXT):
        assert set(extras.split(",")) <= set(project["project"]["optional-dependencies"])


def test_versions_are_pinned_and_torch_is_never_taken_from_a_registry():
    installs = re.findall(r"pip install [^&;]+", "\n".join(arguments("RUN")))
    assert installs and all("-c constraints.txt" in words for words in installs)
    assert all("--no-index" in words for words in installs if re.search(r"\btorch\b", words))
    assert re.search(r"^torch==", (PROJECT / "constraints.txt").read_text(encoding="utf-8"), re.MULTILINE)
    assert "://" not in TEXT  # no registry's host


def test_the_python_is_one_that_the_project_supports():
    version = re.search(r"^FROM python:(\d+)\.(\d+)-slim", TEXT, re.MULTILINE)
    assert version is not None
    assert (int(version[1]), int(version[2])) >= (3, 11)


def test_the_program_does_not_run_as_root():
    users = [number for number, line in enumerate(LINES) if line.startswith("USER ")]
    assert LINES[users[-1]] not in ("USER root", "USER 0") and users[-1] > max(
        number for number, line in enumerate(LINES) if line.startswith("RUN ")
    )
    name = LINES[users[-1]].removeprefix("USER ")
    assert re.search(rf"useradd .*{name}\b", TEXT) and f"chown {name}:{name} /work" in TEXT


def test_the_command_runs_from_the_copied_files_alone(tmp_path: Path):
    assert json.loads(arguments("ENTRYPOINT")[0]) == ["hil"]
    words = json.loads(arguments("CMD")[0])
    assert {"run", "--virtual", "--lockstep"} <= set(words)
    image, work = tmp_path / "image", tmp_path / "work"
    work.mkdir()
    left_out = [line.removeprefix("**/") for line in IGNORE if line.startswith("**/")]
    for name in copied() & LIBRARIES:
        shutil.copytree(
            PROJECT / name,
            image / name,
            ignore=lambda _, names: [n for n in names if any(fnmatch.fnmatch(n, p) for p in [*left_out, "trained"])],
        )
    done = subprocess.run(
        [sys.executable, "-P", "-c", WITHOUT_TORCH, *words, "--check-only"],
        cwd=work,
        env={"PATH": "/usr/bin:/bin", "PYTHONPATH": str(image), "HOME": str(work)},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0 and "ready to run" in done.stdout, done.stdout + done.stderr
