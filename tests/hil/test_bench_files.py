"""`hil bench files`: a subset of the mutations, and outcomes of readers that are wrong on purpose."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from click.testing import CliRunner

from drivers.signals.points import ConfigurationError
from hil.bench.fuzz import readers as fuzz_files
from hil.bench.fuzz import tables as files
from hil.bench.fuzz.readers import HANG, READ, REFUSED, TRACEBACK, UNCLEAR, outcome_of

KINDS = (
    "rig file",
    "twin file",
    "effects file",
    "scenario",
    "register table",
    "Telegraf",
    "Home Assistant",
    "DBC",
    "data sheet",
    "model card",
    "run.json",
    "diagnosis.json",
    "journal",
)


@pytest.mark.parametrize("kind", KINDS)
def test_a_mutated_file_is_read_or_refused_in_a_sentence_that_names_it(kind):
    found = fuzz_files.fuzz_files(60, 7, kinds=(kind,))
    if not found:
        pytest.skip("PyYAML is not installed")
    assert found[kind].failures == 0, found[kind].examples
    assert found[kind].counts[REFUSED] > 0
    assert kind == "model card" or found[kind].counts[READ] > 0


def reading(said: str, kind: type[Exception] = ConfigurationError):
    """Return a reader that raises an error with these words."""

    def read(path: Path) -> None:
        raise kind(said.format(path=path))

    return read


@pytest.mark.parametrize(
    ("read", "outcome"),
    [
        (lambda path: None, READ),
        (reading("{path}, line 3: x is missing; add it"), REFUSED),
        (reading("{path}: a\n{path}: b"), REFUSED),
        (reading("{path}: a\nb"), UNCLEAR),
        (reading("x is missing"), UNCLEAR),
        (reading(""), UNCLEAR),
        (reading("{path}: Input should be a valid dictionary"), UNCLEAR),
        (reading("{path}: 'int' object has no attribute 'get'"), UNCLEAR),
        (reading("{path}: x", AttributeError), TRACEBACK),
    ],
)
def test_outcomes_tell_a_clear_refusal_from_another(tmp_path, read, outcome):
    assert outcome_of(read, tmp_path / "a.toml")[0] == outcome


def test_a_reader_that_does_not_end_is_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr(fuzz_files, "LONGEST_S", 0.05)

    def read(path: Path) -> None:
        until = time.process_time() + 5.0
        while time.process_time() < until:
            pass

    assert outcome_of(read, tmp_path / "a.toml")[0] == HANG


def test_the_command_counts_every_kind_and_fails_where_one_does(monkeypatch):
    from hil.bench.commands.bench import command

    monkeypatch.setattr(files, "RECORDS", "hil.bench.no_such_module")
    done = CliRunner().invoke(command, ["files", "--count", "3", "--json"])
    assert done.exit_code == 0, done.output
    assert '"data sheet"' in done.output
    bad = fuzz_files.ReaderOutcomes()
    bad.counts[TRACEBACK] += 1
    monkeypatch.setattr(files, "fuzz_files", lambda count, seed, progress: {"rig file": bad})
    assert CliRunner().invoke(command, ["files", "--count", "3", "--json"]).exit_code == 1
