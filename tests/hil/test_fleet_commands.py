"""Jobs of a fleet that are commands of hil in a process of their own: benchmarks and trainings, from end to end."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from hil.fleet import FleetError, read_fleet
from hil.fleet.kinds import GivenJob, perform_job, subcommand
from tests.hil.command_line import typed


def fleet(folder: Path, jobs: str) -> Path:
    file = folder / "tiny.toml"
    file.write_text(f'id = "tiny"\n{jobs}', encoding="utf-8")
    return file


def test_a_benchmark_is_a_job_with_its_report_as_files(tmp_path):
    file, out = fleet(tmp_path, '[[job]]\nkind = "bench"\nbench = "wire"\narguments = ["--quick"]\n'), tmp_path / "out"
    done = typed("fleet", file, "--on", "here", "--out", out)
    assert done.returncode == 0, done.stdout + done.stderr
    (row,) = pq.read_table(out / "results.parquet").to_pylist()
    report = json.loads((out / "files" / row["job"] / "bench.json").read_text(encoding="utf-8"))
    assert row["status"] == "done" and row["attempts"] == 1 and row["answer"] == f"wire: {row['rows']} rows"
    assert row["rows"] == sum(len(table["rows"]) for table in report["tables"].values()) > 0
    assert (out / "files" / row["job"] / "wire.md").is_file()
    assert row["cpu_s"] > 0.2 and row["seconds"] > 0.2, "the time of the command's own process counts"


@pytest.mark.parametrize(
    ("job", "words", "said"),
    [
        (
            'kind = "bench"\nbench = "wire"',
            '"--seed=3"',
            "--seed cannot be given here: seeds of the entry are the seeds",
        ),
        ('kind = "bench"\nbench = "wire"', '"--out", "x"', "--out cannot be given here: the fleet keeps the files"),
        ('kind = "train"', '"--minutes", "1"', "--minutes cannot be given here: a job is a whole training"),
        ('kind = "train"', '"--data", "x"', "--data cannot be given here: the key data names the windows"),
    ],
)
def test_an_option_that_the_fleet_gives_itself_is_refused_with_its_line(tmp_path, job, words, said):
    with pytest.raises(FleetError) as found:
        read_fleet(fleet(tmp_path, f"[[job]]\n{job}\narguments = [{words}]\n"))
    assert said in str(found.value) and f"tiny.toml, line {4 + job.count(chr(10))}: arguments of job" in str(
        found.value
    )


@pytest.mark.parametrize(
    ("bench", "arguments", "said"),
    [
        ("wires", (), "hil bench wires: No such command 'wires'."),
        ("wire", ("--fast",), "hil bench wire: No such option"),
    ],
)
def test_what_a_command_refuses_is_its_own_sentence(bench, arguments, said):
    given = GivenJob("bench", 0, {"bench": bench, "arguments": arguments}, {}, {}, {})
    heard: list[str] = []
    with pytest.raises(FleetError, match=said):
        perform_job(given, heard.append)
    assert not any("kinds" in line for line in heard), "the command is named as a user types it"


def test_a_silent_command_is_cancelled_at_its_next_sign_of_life(monkeypatch):
    class GivenUp(BaseException):
        pass

    def say(text: str) -> None:
        if text.startswith("runs for"):
            raise GivenUp

    monkeypatch.setattr(subcommand, "ALIVE_S", 0.05)
    with pytest.raises(GivenUp):
        perform_job(GivenJob("bench", 0, {"bench": "files", "arguments": ()}, {}, {}, {}), say)
