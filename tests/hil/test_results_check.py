"""Check of published results against a small git repository: missing, uncommitted, old, rewritten commits."""

import ast
import json
import subprocess
from pathlib import Path

import pytest
from click.testing import CliRunner

from hil.bench import BENCHMARKS
from hil.bench.commands.bench import command
from hil.bench.measure.measured_code import MEASURED, PROJECT, code_digests, code_state, is_within, places_of
from hil.bench.measure.results_check import ResultsFolderError, add_digests, changed_files, check_results, main


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
    changed = "drivers/modbus (drivers/modbus/link.py)"
    assert problem(project) == f"was measured at {commit}; since then changed: {changed}"


def test_a_new_and_a_removed_file_are_changes(project: Path) -> None:
    result(project, "wire", command="hil bench wire", commit=commit_all(project))
    (project / "drivers/modbus/link.py").unlink()
    (project / "drivers/modbus/wire.py").write_text("LIMIT = 1\n", encoding="utf-8")
    commit_all(project)
    assert str(problem(project)).endswith("drivers/modbus (drivers/modbus/link.py and 1 more)")


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
        ({"command": "make wire", "commit": "HEAD"}, "has no command 'make wire'"),
        ({"command": "hil bench twin", "commit": "HEAD"}, "'hil bench twin' with a result wire"),
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


def digests(project: Path) -> dict[str, str]:
    return code_digests(project, MEASURED["wire"]["wire"])


def test_digests_outlast_a_commit_that_was_rewritten(project: Path) -> None:
    commit_all(project)
    result(project, "wire", command="hil bench wire", commit="0123456789ab", digests=digests(project))
    assert problem(project) is None
    (project / "drivers/modbus/link.py").write_text("LIMIT = 2\n", encoding="utf-8")
    assert problem(project) == (
        "was measured at 0123456789ab, which this repository does not have; since then changed: drivers/modbus"
    )


def test_digests_name_the_files_where_the_commit_is_known(project: Path) -> None:
    commit = commit_all(project)
    result(project, "wire", command="hil bench wire", commit=commit, digests=digests(project))
    (project / "drivers/modbus/link.py").write_text("LIMIT = 2\n", encoding="utf-8")
    (project / "drivers/modbus/new.py").write_text("LIMIT = 3\n", encoding="utf-8")
    assert problem(project) == (  # git does not list a file that it does not track
        f"was measured at {commit}; since then changed: drivers/modbus (drivers/modbus/link.py)"
    )


def test_digests_state_the_code_of_uncommitted_changes(project: Path) -> None:
    commit = commit_all(project)
    (project / "hil/bench/fuzz/wire.py").write_text("LIMIT = 2\n", encoding="utf-8")
    result(project, "wire", command="hil bench wire", commit=f"{commit} + changes", digests=digests(project))
    assert problem(project) is None
    git(project, "checkout", "-q", "hil")
    assert str(problem(project)).endswith(f"changes on {commit}; since then changed: hil/bench/fuzz")


def test_a_place_without_a_digest_is_compared_with_the_commit(project: Path) -> None:
    commit = commit_all(project)
    known = digests(project)
    del known["drivers/modbus"]
    result(project, "wire", command="hil bench wire", commit=commit, digests=known)
    assert problem(project) is None
    (project / "drivers/modbus/link.py").write_text("LIMIT = 2\n", encoding="utf-8")
    assert "drivers/modbus/link.py" in str(problem(project))
    result(project, "wire", command="hil bench wire", commit="0123456789ab", digests=known)
    assert "drivers/modbus (its manifest has no digest of it)" in str(problem(project))


def test_digests_are_added_at_the_commit_of_a_manifest(project: Path) -> None:
    commit, then = commit_all(project), digests(project)
    (project / "drivers/modbus/link.py").write_text("LIMIT = 2\n", encoding="utf-8")
    result(project, "wire", command="hil bench wire", commit=commit, seed=3)
    result(project, "files", command="hil bench files", commit="0123456789ab")
    assert add_digests(project / "results", project) == ["wire"]
    written = json.loads((project / "results/wire.manifest.json").read_text(encoding="utf-8"))
    assert written["digests"] == then and written["seed"] == 3
    assert "digests" not in json.loads((project / "results/files.manifest.json").read_text(encoding="utf-8"))


def test_a_digest_counts_what_runs_alone(project: Path) -> None:
    path, place = project / "twin/model.py", "twin/*.py"
    before = code_digests(project, [place])
    path.write_text('"""Other words."""\nimport math\n\n# a comment\nLIMIT = (1)\n', encoding="utf-8")
    (path.parent / "__init__.py").write_text('"""Package."""\n', encoding="utf-8")
    (path.parent / "README.md").write_text("# twin\n", encoding="utf-8")
    assert code_digests(project, [place]) == before
    path.rename(path.with_name("other.py"))
    assert code_digests(project, [place]) != before


EVERY_SYNTAX = """
@cache
class A(B, metaclass=C): pass
def f(a, /, b: int = 1, *c, d=None, **e) -> None:
    global x
    async with y as z: yield -1.5e300 ** 2j
    return {**e, "k": [*c, ...]}, b"\\x00", u"\u00fc\U0001fae8", f"{{a}}{a!r:>{b}}" "tail" f"{d=}"
match x:
    case {"a": [1, *_], **rest} if rest: del x[1:2, ::3]
    case P(q=None) | True: (n := lambda *, k: k)
try: raise E from None
except* (F, G) as h: assert h, "m"
"""
"""Syntax of Python 3.11, with names of letters outside of ASCII and texts of which versions make different trees."""


def test_a_digest_is_the_same_in_each_version_of_python(project: Path) -> None:
    (project / "twin/model.py").write_text(EVERY_SYNTAX, encoding="utf-8")
    ast.parse(EVERY_SYNTAX)
    assert code_digests(project, ["twin"]) == {"twin": "c685fb5b013c093e"}


def test_the_state_of_the_code_names_its_commit_and_changes(project: Path) -> None:
    commit = commit_all(project)
    assert code_state("wire", project).commit == commit
    assert code_state("wire", project).digests == digests(project)
    (project / "twin/model.py").write_text("LIMIT = 2\n", encoding="utf-8")
    assert code_state("wire", project).commit == f"{commit} + changes"


def test_the_measured_code_of_each_bench_exists() -> None:
    assert set(MEASURED) == set(BENCHMARKS) == set(command.commands)
    files = [
        path.relative_to(PROJECT).as_posix()
        for top in ("hil", "drivers", "twin")
        for path in PROJECT.glob(f"{top}/**/*")
    ]
    for place in {place for results in MEASURED.values() for places in results.values() for place in places}:
        kinds = {Path(name).suffix for name in files if is_within(name, place) and "__pycache__" not in name}
        assert ".py" in kinds, place
        assert kinds <= {".py", ".md", ".typed", ""}, f"{place}: digests read Python files alone"


def names_of(value: ast.expr) -> set[str]:
    parts = [value.body, value.orelse] if isinstance(value, ast.IfExp) else [value]
    return {str(ast.literal_eval(part)) for part in parts}


def test_the_code_of_each_result_that_a_bench_writes_is_known() -> None:
    written: set[str] = set()
    for path in (PROJECT / "hil/bench/commands").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "finish":
                written |= names_of(node.args[0])
    assert written == {name for results in MEASURED.values() for name in results}


def test_each_published_result_has_a_command_with_measured_code() -> None:
    for path in (PROJECT / "docs/results").glob("*.manifest.json"):
        content = json.loads(path.read_text(encoding="utf-8"))
        name = path.name.removesuffix(".manifest.json")
        assert places_of(content.get("result", name), content["command"].split()[2]), name


def test_a_renamed_page_has_the_code_of_its_result() -> None:
    assert places_of("discovery_wire", "discovery") == MEASURED["discovery"]["discovery"]
    assert places_of("discovery_records", "discovery") == MEASURED["discovery"]["discovery_records"]
    assert places_of("tower_steps") == MEASURED["tower"]["tower_steps"]
    assert places_of("tower", "zoo") is None


def test_a_bench_writes_commit_and_digests_of_the_code_at_its_start(tmp_path: Path) -> None:
    done = CliRunner().invoke(command, ["wire", "--count", "1", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    manifest = json.loads((tmp_path / "wire.manifest.json").read_text(encoding="utf-8"))
    assert manifest["result"] == "wire"
    assert manifest["commit"] == code_state("wire").commit
    assert manifest["digests"] == digests(PROJECT)


def test_each_bench_notes_its_code_when_it_begins() -> None:
    for bench in command.commands.values():
        (out,) = (option for option in bench.params if option.name == "out")
        assert out.callback is not None, bench.name
