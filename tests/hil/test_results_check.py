"""Check of published results against a small git repository: missing, uncommitted, old and current commits."""

import json
import subprocess
from pathlib import Path

import pytest

from hil.bench import BENCHMARKS
from hil.bench.measure.results_check import MEASURED, PROJECT, ResultsFolderError, changed_files, check_results, main


def git(project: Path, *arguments: str) -> str:
    identity = ("-c", "user.name=test", "-c", "user.email=test@example.org", "-c", "commit.gpgsign=false")
    done = subprocess.run(["git", *identity, *arguments], cwd=project, check=True, capture_output=True, text=True)
    return done.stdout.strip()


def commit_all(project: Path) -> str:
    git(project, "add", "-A")
    git(project, "commit", "-q", "-m", "step")
    return git(project, "rev-parse", "--short=12", "HEAD")


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """Return a repository with a driver, a fuzz bench and a model."""
    git(tmp_path, "init", "-q")
    for name in ("drivers/modbus/link.py", "hil/bench/fuzz/wire.py", "twin/model.py"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text('"""Module."""\n\nLIMIT = 1\n', encoding="utf-8")
    return tmp_path


def result(project: Path, name: str, **manifest: object) -> None:
    folder = project / "results"
    folder.mkdir(exist_ok=True)
    (folder / f"{name}.json").write_text("{}", encoding="utf-8")
    (folder / f"{name}.manifest.json").write_text(json.dumps(manifest), encoding="utf-8")


def problem(project: Path) -> str | None:
    (state,) = check_results(project / "results", project)
    return state.problem


def test_a_result_of_unchanged_code_is_up_to_date(project: Path) -> None:
    result(project, "wire", command="hil bench wire", commit=commit_all(project))
    (project / "twin/model.py").write_text("LIMIT = 2\n", encoding="utf-8")  # which this bench does not measure
    commit_all(project)
    assert problem(project) is None


@pytest.mark.parametrize("is_committed", [True, False])
def test_a_change_of_the_measured_code_is_reported_with_its_file(project: Path, is_committed: bool) -> None:
    commit = commit_all(project)
    result(project, "wire", command="hil bench wire --count 9", commit=commit)
    (project / "drivers/modbus/link.py").write_text("LIMIT = 2\n", encoding="utf-8")
    if is_committed:
        commit_all(project)
    assert problem(project) == f"was measured at {commit}; since then changed: drivers/modbus/link.py"


def test_a_new_and_a_removed_file_are_changes(project: Path) -> None:
    result(project, "wire", command="hil bench wire", commit=commit_all(project))
    (project / "drivers/modbus/link.py").unlink()
    (project / "drivers/modbus/wire.py").write_text("LIMIT = 1\n", encoding="utf-8")
    commit_all(project)
    assert str(problem(project)).endswith("drivers/modbus/link.py and 1 more")


def test_docstrings_comments_and_pages_are_no_changes(project: Path) -> None:
    result(project, "wire", command="hil bench wire", commit=commit_all(project))
    text = '"""Other words."""\n\n# a comment\nLIMIT   = 1\n"""Limit, 1."""\n'
    (project / "drivers/modbus/link.py").write_text(text, encoding="utf-8")
    (project / "drivers/modbus/README.md").write_text("# modbus\n", encoding="utf-8")
    commit_all(project)
    assert problem(project) is None


def test_imports_and_lists_of_public_names_are_no_changes(project: Path) -> None:
    result(project, "wire", command="hil bench wire", commit=commit_all(project))
    text = 'import math\nfrom twin import model\n\n__all__ = ["LIMIT"]\n\nLIMIT = 1\n'
    (project / "drivers/modbus/link.py").write_text(text, encoding="utf-8")
    assert problem(project) is None
    (project / "drivers/modbus/link.py").write_text(text + "math.tau = 6\n", encoding="utf-8")
    assert problem(project) is not None


def test_a_folder_pattern_does_not_reach_below_the_folder(project: Path) -> None:
    commit = commit_all(project)
    below = project / "twin" / "discovery"
    below.mkdir()
    (below / "model.py").write_text("LIMIT = 3\n", encoding="utf-8")
    (project / "twin/model.py").write_text("LIMIT = 2\n", encoding="utf-8")
    git(project, "add", "-A")
    assert changed_files(project, commit, ("twin/*.py",)) == ["twin/model.py"]
    assert changed_files(project, commit, ("twin",)) == ["twin/discovery/model.py", "twin/model.py"]


@pytest.mark.parametrize(
    ("manifest", "words"),
    [
        ({"command": "hil bench wire"}, "no commit"),
        ({"command": "hil bench wire", "commit": None}, "no commit"),
        ({"command": "hil bench wire", "commit": "0123456789ab"}, "does not have"),
        ({"command": "hil bench wire", "commit": "HEAD + changes"}, "uncommitted changes on HEAD"),
        ({"command": "make wire", "commit": "HEAD"}, "is not one of hil bench"),
    ],
)
def test_a_manifest_that_names_no_measured_code_is_reported(
    project: Path, manifest: dict[str, object], words: str
) -> None:
    commit_all(project)
    result(project, "wire", **manifest)
    assert words in str(problem(project))


def test_a_result_without_a_manifest_is_reported(project: Path) -> None:
    commit_all(project)
    result(project, "wire")
    (project / "results/wire.manifest.json").unlink()
    assert problem(project) == "has no manifest that can be read"


def test_old_results_are_listed_with_exit_code_0(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result(project, "bus", command="hil bench bus")
    assert main([str(project / "results")]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "bus: its manifest has no commit of the measured code",
        "0 of 1 results are up to date",
    ]


def test_a_folder_without_results_is_refused(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ResultsFolderError, match="holds no result"):
        check_results(project, project)
    assert main([str(project)]) == 2
    assert str(project) in capsys.readouterr().err


def test_a_folder_outside_of_git_is_refused(tmp_path: Path) -> None:
    result(tmp_path, "bus", command="hil bench bus")
    with pytest.raises(ResultsFolderError, match="no git repository"):
        check_results(tmp_path / "results", tmp_path)


def test_the_measured_code_of_each_bench_exists() -> None:
    assert set(MEASURED) == set(BENCHMARKS)
    for places in MEASURED.values():
        for place in places:
            assert list(PROJECT.glob(place)), place
