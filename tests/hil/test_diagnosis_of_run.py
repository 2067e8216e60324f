"""Diagnosis that a limit `no effect found` judges: of the run's own twin, healthy record and all of its samples."""

from __future__ import annotations

import json

import pytest

from hil.diagnosis.results import provenance, write_document
from hil.journal import JournalReader, export_record, record_sha256, samples_sha256
from hil.run_folder import new_manifest, read_diagnosis_verdict
from hil.testing import judge_run, read_plan
from tests.hil.command_line import typed
from tests.hil.ended_run import ended_run
from tests.hil.made_plan import plan_text


@pytest.fixture
def run(tmp_path):
    """A run that has ended, whose folder has its twin and its record."""
    folder, manifest = ended_run(tmp_path / "run")
    folder.twin.write_text("name = 'one'\n", encoding="utf-8")
    folder.write_manifest(manifest | {"files": new_manifest({"twin": folder.twin})["files"]})
    export_record(folder.journal, folder.record)
    (tmp_path / "plan.toml").write_text(plan_text("no effect found"), encoding="utf-8")
    return folder


def diagnosed(folder, twin, *, verdict="adequate", sha256=None, options=()):
    source = provenance({"twin": twin}, sha256 or record_sha256(folder.record), options)
    folder.diagnosis.mkdir(exist_ok=True)
    write_document({"verdict": verdict, "summary": "Nothing is left.", "provenance": source}, folder.diagnosis)


def found(folder):
    (judged,) = judge_run(read_plan(folder.path.parent / "plan.toml"), folder).judgements
    return judged


def test_a_diagnosis_of_the_run_with_its_twin_is_judged_with_its_summary(run):
    diagnosed(run, run.twin)
    assert (found(run).verdict, found(run).text) == ("pass", "the diagnosis is adequate: Nothing is left")
    diagnosed(run, run.twin, verdict="effect found")
    assert found(run).verdict == "fail"


def test_a_diagnosis_of_another_twin_does_not_count(run):
    revision = run.path / "twin.r2.toml"
    revision.write_text("name = 'one'\n# with an effect\n", encoding="utf-8")
    diagnosed(run, revision)
    assert found(run).verdict == "inconclusive"
    assert "of the twin twin.r2.toml" in found(run).text and "hil diagnose" in found(run).text
    run.twin.write_text("name = 'changed later'\n", encoding="utf-8")
    diagnosed(run, run.twin)
    assert found(run).verdict == "inconclusive"


def test_a_diagnosis_of_a_part_of_the_run_does_not_count(run):
    diagnosed(run, run.twin, sha256="0" * 64)
    assert found(run).verdict == "inconclusive" and "other samples than the run has now" in found(run).text


def test_a_diagnosis_that_states_neither_twin_nor_samples_does_not_count(run):
    diagnosed(run, run.twin)
    path = run.diagnosis / "diagnosis.json"
    document = json.loads(path.read_text(encoding="utf-8"))
    for key in ("files", "samples_sha256"):
        less = {name: value for name, value in document["provenance"].items() if name != key}
        path.write_text(json.dumps(document | {"provenance": less}), encoding="utf-8")
        assert found(run).verdict == "inconclusive" and "it does not state" in found(run).text


@pytest.mark.parametrize("option", ["--no-healthy", "--healthy", "--with", "--at-rest"])
def test_a_diagnosis_with_options_that_hide_an_effect_does_not_count(run, option):
    diagnosed(run, run.twin, options=[option])
    assert found(run).verdict == "inconclusive" and f"made with {option}" in found(run).text


@pytest.mark.parametrize("source", [None, [], {"files": []}, {"files": {"twin": {"sha256": 3}}}, {"options": "x"}])
def test_a_forged_provenance_is_a_doubt(run, source):
    diagnosed(run, run.twin)
    path = run.diagnosis / "diagnosis.json"
    document = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps(document | {"provenance": source, "summary": 3}), encoding="utf-8")
    read = read_diagnosis_verdict(run)
    assert read is not None and read.doubts and found(run).verdict == "inconclusive"


def test_journal_and_record_have_the_same_digest(run):
    reader = JournalReader(run.journal)
    try:
        samples, names = reader.samples(), [signal.column for signal in reader.header.signals]
    finally:
        reader.close()
    good = samples.values.copy()
    good[samples.quality != 0] = float("nan")
    columns = dict(zip(names, good.T, strict=True))
    assert samples_sha256(samples.time_s, columns) == record_sha256(run.record)
    assert samples_sha256(samples.time_s[:-1], {name: x[:-1] for name, x in columns.items()}) != record_sha256(
        run.record
    )
    columns["T_tank_C"] = columns["T_tank_C"] + 1e-9
    assert samples_sha256(samples.time_s, columns) != record_sha256(run.record)


def test_the_report_names_the_doubt(run):
    revision = run.path / "twin.r2.toml"
    revision.write_text("name = 'two'\n", encoding="utf-8")
    diagnosed(run, revision)
    assert typed("report", run.path).returncode == 0
    assert "of the twin twin.r2.toml" in run.report.read_text(encoding="utf-8")
