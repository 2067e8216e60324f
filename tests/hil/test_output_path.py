"""Files that a command is asked to write: none of them is a file of a run, or one that the command reads."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from hil.cli.verbs import group
from hil.errors import explained
from hil.files import replacing
from hil.run_folder import RunFolderError, require_output
from tests.docs.fences import PROJECT
from tests.hil.command_line import typed
from tests.hil.ended_run import ended_run

OWN = (
    "journal.sqlite",
    "journal.sqlite-wal",
    "record.parquet",
    "review.rrd",
    "twin.toml",
    "twin.before-1.toml",
    "virtual.healthy.parquet",
    "report.html",
    "report.pdf",
    "run.json",
    "notes.jsonl",
    "alarms-notified.json",
    "verdict.json",
    "junit.xml",
    "guardian.log",
    "stream-mqtt-x.json",
    "diagnosis/diagnosis.json",
    "explanation/anything",
)


@pytest.fixture
def run(tmp_path):
    folder, manifest = ended_run(tmp_path / "run", ticks=60)
    folder.write_manifest(manifest)
    for name in ("diagnosis", "explanation"):
        (folder.path / name).mkdir()
    return folder


@pytest.mark.parametrize("name", OWN)
def test_a_file_of_a_run_is_refused_also_through_a_link_and_before_it_is_there(run, tmp_path, name):
    target = run.path / name
    with pytest.raises(RunFolderError, match="is a file of the run"):
        require_output(target, RunFolderError)
    link = tmp_path / "link.html"
    link.symlink_to(target)
    with pytest.raises(RunFolderError, match="is a file of the run"):
        require_output(link, RunFolderError)


def test_another_file_in_or_beside_a_run_is_accepted(run, tmp_path):
    before = sorted(run.path.iterdir())
    require_output(run.path / "temperatures.csv", RunFolderError)
    require_output(tmp_path / "report.html", RunFolderError)  # no run here
    assert sorted(run.path.iterdir()) == before and not (tmp_path / "report.html").exists()  # asked, and not written


def test_a_source_is_refused_by_each_of_its_names(tmp_path):
    source = tmp_path / "source.toml"
    source.write_text("x", encoding="utf-8")
    other = tmp_path / "other.toml"
    os.link(source, other)
    for path in (source, other):
        with pytest.raises(RunFolderError, match="this command reads"):
            require_output(path, RunFolderError, [source])


def test_a_folder_in_which_no_file_can_be_made_is_refused():
    with pytest.raises(RunFolderError, match=r"^/proc: no file can be written there .*; make it writable, or choose"):
        require_output(Path("/proc/network.svg"), RunFolderError)  # not even by root


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (PermissionError(errno.EACCES, "Permission denied", "/x/out.csv"), 2, "/x/out.csv: Permission denied; give"),
        (OSError(errno.ENOSPC, "No space left on device"), 2, "a file: No space left on device; make room"),
    ],
)
def test_a_refusal_of_the_file_system_is_one_sentence(capsys, error, code, said):
    with pytest.raises(SystemExit) as caught, explained():
        raise error
    assert caught.value.code == code
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("verb", ["commission", "track", "run", "test", "explain", "rig", "train"])
def test_a_seed_is_no_negative_number(tmp_path, verb):
    command = group.get_command(None, verb)
    commands = command.commands.values() if isinstance(command, click.Group) else [command]
    seeds = [option for one in commands for option in one.params if "--seed" in option.opts]
    assert seeds
    for option in seeds:
        with pytest.raises(click.BadParameter):
            option.type.convert("-1", option, None)


INPUTS = {"--notify-file", "--cert", "--key", "--trust", "--runs"}
"""Options of a path that need not be there, and that no command writes as a file."""


def outputs() -> set[tuple[str, str]]:
    """Return each option of a path that a command may write as a file, with its command."""
    found = set()

    def walk(name: str, command: click.Command) -> None:
        if isinstance(command, click.Group):
            for verb in command.list_commands(click.Context(command)):
                if (member := command.get_command(click.Context(command), verb)) is not None and verb != "bench":
                    walk(f"{name} {verb}".strip(), member)
        for option in command.params:
            kind = option.type
            if isinstance(option, click.Option) and isinstance(kind, click.Path) and kind.file_okay and not kind.exists:
                found.update((name, word) for word in option.opts if word not in INPUTS)

    walk("", group)
    return found


def calls(run, folder):
    """Return the words of a call for each option of `outputs`, without the option."""
    twin, sheet = PROJECT / "profiles/twins/virtual.toml", folder / "sheet.json"
    sheet.write_text("{}", encoding="utf-8")
    points = ("--datasheet", sheet, "--points", sheet)
    return {
        ("check", "--picture"): ("check", twin),
        ("commission", "--out"): ("commission", run.path, "--twin", twin),
        ("compare", "--out"): ("compare", run.path, run.path),
        ("export", "--out"): ("export", run.path, "--to", "csv", "--force"),
        ("init", "--out"): ("init", "--force"),
        ("review", "--screenshot"): ("review", run.path),
        ("rig", "--out"): ("rig", PROJECT / "profiles/rigs/virtual.toml"),
        ("tower commission", "--out"): ("tower", "commission", folder, "--cell", "1", *points),
        ("tower report", "--picture"): ("tower", "report", folder),
        ("tower serve", "--rig"): ("tower", "serve", folder),
        ("track", "--out"): ("track", run.path, "--twin", twin),
    }


def test_every_output_of_a_command_is_tested(run, tmp_path):
    assert outputs() == set(calls(run, tmp_path))


@pytest.mark.parametrize("name", ["new.csv", "new.svg", "new.png"])
@pytest.mark.parametrize(("command", "option"), sorted(outputs()))
def test_no_command_writes_among_the_results_of_a_run(run, tmp_path, command, option, name):
    words = [str(word) for word in (*calls(run, tmp_path)[command, option], option, run.path / "diagnosis" / name)]
    done = CliRunner().invoke(group, words)
    suffixed = {"check": ".csv", "tower report": ".csv", "track": (".svg", ".png"), "export": (".svg", ".png")}
    if name.endswith(suffixed.get(command, "none")):  # refused for its ending
        assert done.exit_code != 0
        return
    assert "is a file of the run" in str(done.exception), (done.exception, done.output)
    assert not list(run.diagnosis.iterdir())


def test_a_source_of_a_tower_command_is_kept(tmp_path):
    for name in ("tags.csv", "labels.csv", "report.png"):
        (tmp_path / name).write_text("kept", encoding="utf-8")
    labels = tmp_path / "labels.csv"
    for words in (
        ("tower", "serve", tmp_path, "--rig", tmp_path / "tags.csv"),
        ("tower", "report", tmp_path, "--picture", tmp_path / "report.png"),
        ("tower", "commission", tmp_path, "--cell", "1", "--datasheet", labels, "--points", labels, "--out", labels),
    ):
        done = CliRunner().invoke(group, [str(word) for word in words])
        assert "is a file that this command reads" in str(done.exception), (done.exception, done.output)
    assert {path.read_text(encoding="utf-8") for path in tmp_path.iterdir()} == {"kept"}


def test_pictures_and_predictions_replace_no_file_of_a_run(run):
    twin, before = PROJECT / "profiles/twins/virtual.toml", run.journal.read_bytes()
    for words in (
        ("review", run.path, "--screenshot", run.journal),
        ("track", run.path, "--twin", twin, "--out", run.diagnosis / "out.csv"),
        ("check", twin, "--picture", run.path / "report.pdf"),
    ):
        done = typed(*words)
        assert done.returncode == 2 and "is a file of the run" in done.stderr, done.stderr
    assert run.journal.read_bytes() == before
    done = typed("check", twin, "--picture", run.path / "x.abc")
    assert done.returncode == 2 and "a picture is a .svg" in done.stderr and "Traceback" not in done.stderr
    done = CliRunner().invoke(group, ["review", str(run.path), "--screenshot", str(run.path.parent / "load.csv")])
    assert done.exit_code == 2 and "the picture is a PNG" in done.output


def test_no_device_pipe_or_stream_is_replaced_by_a_file(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "stdout").symlink_to("/proc/self/fd/1")
    for name in ("pipe", "stdout", "-"):
        with pytest.raises(RunFolderError, match="name a file"):
            require_output(tmp_path / name, RunFolderError)
    with pytest.raises(OSError, match="a device, pipe or socket"), replacing(tmp_path / "pipe") as unfinished:
        unfinished.write_text("lost")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["pipe", "stdout"]
