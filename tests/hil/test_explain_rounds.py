"""Rounds of `hil explain`: which comes next, what is kept, and what is refused; diagnoses and runs are made by hand."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

import hil.explain.session as session
from drivers.signals import ConfigurationError
from hil.diagnosis.experiment_file import write_experiment
from hil.diagnosis.session import Written
from hil.explain.experiment import RigChoice, run_request
from hil.explain.explanation import DOCUMENT, PAGE, Explanation, ExplanationError, beliefs_of, read_explanation
from hil.explain.session import explain
from hil.explain.terminal_report import advice
from hil.profile.load_profile import ProfileError
from hil.run_folder.folder import RunFolder
from tests.hil.made_diagnosis import effect
from tests.hil.made_explanation import PLAN, RIG, Scripted, diagnosis, made_files, request_of

OPEN, FOUND = diagnosis("ambiguous", PLAN), diagnosis("effect found", share=0.98)


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Path]:
    """Files of a request; a round writes its experiment alone, since figures take seconds."""

    def brief(ready, found, folder, *, empirical, began):
        folder.mkdir(parents=True, exist_ok=True)
        return Written(experiment=write_experiment(found, folder, ready.request.rig)), {}

    monkeypatch.setattr(session, "write_results", brief)
    return made_files(tmp_path)


def kept(folder: Path) -> Explanation:
    found = read_explanation(folder / "out")
    assert found is not None
    return found


@pytest.mark.parametrize("verdict", ["adequate", "effect found", "unexplained"])
def test_a_verdict_that_leaves_no_ambiguity_needs_no_experiment(tmp_path, files, verdict):
    operator = Scripted(diagnosis(verdict))
    found = explain(request_of(tmp_path, files), operator)
    assert (found.end, [one.verdict for one in found.rounds]) == ("settled", [verdict])
    assert operator.asked == [] and operator.runs == []
    assert (tmp_path / "out" / PAGE).is_file()


def test_rounds_go_on_until_the_cause_is_settled_each_with_all_records_so_far(tmp_path, files):
    operator = Scripted(OPEN, OPEN, FOUND)
    found = explain(request_of(tmp_path, files), operator)
    assert [one.verdict for one in found.rounds] == ["ambiguous", "ambiguous", "effect found"]
    assert operator.given == [0, 1, 2] and len(operator.runs) == 2
    assert all(run.calibrators == () and run.mode == "lockstep" for run in operator.runs)
    assert "heater power changes between 600 and 900 W" in operator.asked[0]
    assert "for 1 h" in operator.asked[0] and "fan speed stays at 70 %" in operator.asked[0]
    page = (tmp_path / "out" / PAGE).read_text(encoding="utf-8")
    assert page.count("heater power changes between 600 and 900 W") >= 2
    assert "heat source at modules" in page and "70\xa0%" in page and "98\xa0%" in page


def test_a_virtual_rig_ages_from_round_to_round(tmp_path, files):
    operator = Scripted(OPEN, OPEN, FOUND)
    request = request_of(tmp_path, files)
    assert request.rig is not None
    explain(replace(request, rig=replace(request.rig, age_s=1800.0)), operator)
    assert operator.runs[0].start_s == 1800.0
    assert operator.runs[1].start_s == pytest.approx(1800.0 + 1800.0, abs=10.0)


def test_no_more_experiments_are_run_than_allowed_and_more_may_be_allowed_later(tmp_path, files):
    operator = Scripted(OPEN, OPEN)
    found = explain(request_of(tmp_path, files, rounds=1), operator)
    assert found.end == "no more rounds" and len(operator.runs) == 1
    assert any("--rounds 2" in line for line in advice(found, "hil explain X", ""))
    later = Scripted(FOUND)
    found = explain(request_of(tmp_path, files, rounds=2), later)
    assert found.end == "settled" and later.given == [2]
    assert len(kept(tmp_path).rounds) == 3


def test_a_finished_explanation_is_shown_again_and_nothing_is_run(tmp_path, files):
    explain(request_of(tmp_path, files), Scripted(OPEN, FOUND))
    again = Scripted()
    found = explain(request_of(tmp_path, files), again)
    assert found.end == "settled" and again.runs == [] and again.given == []


@pytest.mark.parametrize("ends", ["aborted", "faulted"])
def test_an_experiment_that_did_not_end_is_begun_again_by_the_next_call(tmp_path, files, ends):
    found = explain(request_of(tmp_path, files), Scripted(OPEN, ends=ends))
    assert found.end == "stopped" and ends in found.reason and len(kept(tmp_path).rounds) == 1
    assert any("hil resume" in line for line in advice(found, "hil explain X", ""))
    again = Scripted(FOUND)
    found = explain(request_of(tmp_path, files), again)
    assert found.end == "settled" and len(again.runs) == 1 and again.given == [1]
    assert any(f"experiment {ends}; a new run begins" in note and "hil resume" in note for note in again.notes)


def test_an_experiment_that_was_completed_since_is_not_run_again(tmp_path, files):
    """Either `hil resume` did so, or `hil explain` was killed between the run and the diagnosis."""
    explain(request_of(tmp_path, files), Scripted(OPEN, ends="aborted"))
    (path,) = (tmp_path / "runs").iterdir()
    manifest = RunFolder(path).read_manifest()
    RunFolder(path).write_manifest(manifest | {"exit_status": "done"})
    again = Scripted(FOUND)
    found = explain(request_of(tmp_path, files), again)
    assert found.end == "settled" and again.runs == []
    assert [Path(one.path) for one in found.last.records] == [path / "record.parquet"]


def test_a_run_of_the_same_profile_from_before_the_plan_does_not_count(tmp_path, files):
    explain(request_of(tmp_path, files), Scripted(OPEN, ends="done", approves=False))
    operator = Scripted(FOUND)
    profile = Path(kept(tmp_path).last.next.profile)
    request = request_of(tmp_path, files)
    older = operator.run(run_request(request.rig, kept(tmp_path).last.next, files["twin"], 0.0))
    older.folder.write_manifest(older.folder.read_manifest() | {"started": "2020-01-01T00:00:00+00:00"})
    assert older.folder.read_manifest()["files"]["profile"]["path"] == str(profile)
    explain(request, operator)
    assert len(operator.runs) == 2


def test_an_operator_who_declines_keeps_the_plan(tmp_path, files):
    found = explain(request_of(tmp_path, files), Scripted(OPEN, approves=False))
    assert found.end == "declined" and found.last.next is not None and Path(found.last.next.profile).is_file()
    assert not (tmp_path / "runs").exists()


def test_without_a_rig_the_plan_is_written_and_its_record_goes_on(tmp_path, files):
    found = explain(request_of(tmp_path, files, rig=None), Scripted(OPEN))
    assert found.end == "no rig"
    lines = advice(found, "hil explain RUN", "--rig my_rig.toml")
    assert any("hil explain RUN --rig my_rig.toml" in line for line in lines)
    assert any("hil explain RUN --with <the new run>" in line for line in lines)
    helper = Scripted()
    run = helper.run(run_request(RigChoice(RIG, tmp_path / "runs"), found.last.next, files["twin"], 0.0))
    again = Scripted(FOUND)
    found = explain(request_of(tmp_path, files, rig=None, more=(run.folder.record,)), again)
    assert found.end == "settled" and again.given == [1]
    assert found.last.ran is not None and "heater power" in found.last.ran.sentence
    # The same record once more adds nothing.
    idle = Scripted()
    assert explain(request_of(tmp_path, files, rig=None, more=(run.folder.record,)), idle).end == "settled"
    assert idle.given == []


def test_causes_that_no_input_separates_end_with_the_measurement_that_does(tmp_path, files):
    why = "no sequence separates them; the flow by bucket and stopwatch would"
    found = explain(request_of(tmp_path, files), Scripted(diagnosis("ambiguous", {"possible": False, "why": why})))
    assert found.end == "not separable" and found.reason == why
    assert why in (tmp_path / "out" / PAGE).read_text(encoding="utf-8")


def test_a_plan_made_without_this_rig_is_made_anew_within_its_limits(tmp_path, files):
    explain(request_of(tmp_path, files, rig=None), Scripted(OPEN))
    operator = Scripted(OPEN, FOUND)
    found = explain(request_of(tmp_path, files), operator)
    assert [one.verdict for one in found.rounds] == ["ambiguous", "effect found"]
    assert operator.given == [0, 1] and any("designed anew" in text for text in operator.notes)


def test_a_plan_beyond_the_limits_of_the_rig_is_refused_before_anything_runs(tmp_path, files):
    hot = [{**step, "heater_power_W": 5000.0} for step in PLAN["steps"]]
    operator = Scripted(diagnosis("ambiguous", {**PLAN, "steps": hot}))
    with pytest.raises(ProfileError, match="heater_power_W"):
        explain(request_of(tmp_path, files), operator)
    assert operator.runs == []


def test_a_rig_without_the_columns_of_the_twin_is_refused_before_the_question(tmp_path, files):
    text = RIG.read_text(encoding="utf-8").replace('twin = "../twins/virtual.toml"', "")
    text = text.replace("T_tank", "T_basin").replace("thermocouples.dbc", str(RIG.parent / "thermocouples.dbc"))
    (tmp_path / "rig.toml").write_text(text, encoding="utf-8")
    request = request_of(tmp_path, files)
    operator = Scripted(OPEN)
    with pytest.raises(ConfigurationError):
        explain(replace(request, rig=replace(request.rig, rig=tmp_path / "rig.toml")), operator)
    assert operator.asked == [] and any("are kept in" in note for note in operator.notes)


def test_another_record_or_twin_does_not_continue_an_explanation(tmp_path, files):
    explain(request_of(tmp_path, files), Scripted(FOUND))
    files["twin"].write_text(files["twin"].read_text(encoding="utf-8") + "\n# changed\n", encoding="utf-8")
    with pytest.raises(ExplanationError, match=r"with the twin .* differs.*--out"):
        explain(request_of(tmp_path, files), Scripted())


@pytest.mark.parametrize("content", ["", "{", "[]", '{"rounds": 3}', '{"record": {"path": 1}}', "[" * 100_000])
def test_a_damaged_document_is_one_sentence_with_the_remedy(tmp_path, content):
    (tmp_path / DOCUMENT).write_text(content, encoding="utf-8")
    with pytest.raises(ExplanationError) as error:
        read_explanation(tmp_path)
    assert str(tmp_path / DOCUMENT) in str(error.value) and "\n" not in str(error.value)


def test_a_lost_record_of_an_experiment_is_named(tmp_path, files):
    explain(request_of(tmp_path, files), Scripted(OPEN, FOUND))
    record = Path(kept(tmp_path).last.records[0].path)
    record.unlink()
    with pytest.raises(ExplanationError, match=r"record\.parquet, the record of an experiment"):
        explain(request_of(tmp_path, files), Scripted())


def test_a_folder_that_cannot_be_made_is_named(tmp_path, files):
    (tmp_path / "out").write_text("a file", encoding="utf-8")
    with pytest.raises(ExplanationError, match="--out"):
        explain(request_of(tmp_path, files), Scripted())


def test_shares_of_one_kind_and_place_are_added_over_drivers():
    document = diagnosis("ambiguous").document()
    document["effects"] = []
    document["indistinguishable"] = [
        {"kind": "heat_source", "where": "tank", "driver": driver, "confidence": share}
        for driver, share in (("constant", 0.4), ("pump_speed", 0.2), ("fan_speed", 0.001))
    ] + [{"kind": "sensor", "where": "T_tank_C", "driver": "constant", "confidence": 0.39}]
    first, second = beliefs_of(document)
    assert (first.label, first.drivers) == ("heat source at tank", {"constant": 0.4, "pump speed": 0.2})
    assert first.share == pytest.approx(0.6) and second.label == "sensor T_tank_C"


def test_two_effects_together_keep_a_share_each(tmp_path, files):
    both = (effect(confidence=0.97), effect(20.0, "tank", confidence=0.9))
    two = replace(diagnosis("effect found"), effects=both, indistinguishable=())
    found = explain(request_of(tmp_path, files), Scripted(two))
    assert [(b.label, b.share) for b in found.last.beliefs] == [
        ("heat source at modules", 0.97),
        ("heat source at tank", 0.9),
    ]
    assert json.loads((tmp_path / "out" / DOCUMENT).read_text())["end"] == "settled"


def test_an_effect_whose_driver_is_open_is_settled_and_the_experiment_is_offered(tmp_path, files):
    operator = Scripted(diagnosis("effect found", PLAN))
    found = explain(request_of(tmp_path, files), operator)
    assert found.end == "settled" and operator.asked == []
    (line,) = advice(found, "hil explain X", "")
    assert "driver is still open" in line and found.last.next.profile in line
