"""The results folder of a diagnosis: nothing is lost on the way to the page and to Rerun."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest

from hil.diagnosis.page import page
from hil.diagnosis.results import write, write_data
from hil.diagnosis.store import (
    CURVES,
    DOCUMENT,
    DiagnosisFolderError,
    Findings,
    curves_of,
    has_diagnosis,
    read_curves,
    read_findings,
    write_curves,
)
from hil.diagnosis.wording import after_label, frequency, left_out, reasons
from hil.review import read_columns, read_words, write_findings_review, write_review
from hil.review.plan.styles import path
from tests.hil.made_diagnosis import SAYS, SENSORS, made
from tests.hil.synthetic_journal import make
from tests.hil.synthetic_journal import write as write_journal
from twin.discovery.diagnosis import SensorError

PICTURES = {"residuals", "unknowns", "blocks", "ladder", "others", "errors", "tunables"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("results")
    write(made(), SENSORS, out, {"record": "runs/one/record.parquet", "seconds": 12.0})
    return out


def shown(text: str) -> set[str]:
    """The pictures of a page."""
    return set(re.findall(r'<img id="(\w+)"', text))


def test_curves_come_back_as_they_were_written(tmp_path):
    curves = curves_of(made(), SENSORS)
    write_curves(curves, tmp_path / CURVES)
    back = read_curves(tmp_path / CURVES)
    np.testing.assert_array_equal(back.time_s, curves.time_s)
    assert list(back.residual) == list(SENSORS)
    assert back.band == curves.band
    for name in SENSORS:
        np.testing.assert_array_equal(back.residual[name], curves.residual[name])
        np.testing.assert_array_equal(back.after[name], curves.after[name])
    for a, b in zip(back.unknowns, curves.unknowns, strict=True):
        assert (a.site, a.unit, a.log_evidence) == (b.site, b.unit, b.log_evidence)
        np.testing.assert_array_equal(a.mean, b.mean)
        np.testing.assert_array_equal(a.sd, b.sd)


def test_a_diagnosis_with_another_twin_is_kept_and_one_with_the_same_twin_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("a file of the operator")
    for twin in ("a", "a", "b", "c"):
        write_data(
            made(),
            SENSORS,
            tmp_path,
            {"provenance": {"files": {"twin": {"path": "twin.toml", "sha256": twin}}}, "of": twin},
        )
    found = {str(p.parent.relative_to(tmp_path)): json.loads(p.read_text())["of"] for p in tmp_path.rglob(DOCUMENT)}
    assert found == {".": "c", "before-1": "a", "before-2": "b"}
    assert (tmp_path / "before-2" / CURVES).is_file() and (tmp_path / "mine.txt").is_file()


def test_a_diagnosis_of_another_record_is_kept_with_its_experiment(tmp_path: Path) -> None:
    def document(of: str, record: str | None, path: str = "a.csv") -> dict[str, object]:
        files = {"twin": {"path": "twin.toml", "sha256": "t"}}
        if record is not None:
            files["record"] = {"path": path, "sha256": record}
        return {"provenance": {"files": files}, "record": path, "of": of}

    for extra in (
        document("first", "1"),
        document("again", "1", "copy.csv"),
        document("other", "2"),
        document("live", None, "run"),
        document("later", None, "run"),
    ):
        write_data(made(), SENSORS, tmp_path, extra)
        (tmp_path / "experiment.csv").write_text(str(extra["of"]), encoding="utf-8")
    found = {str(p.parent.relative_to(tmp_path)): json.loads(p.read_text())["of"] for p in tmp_path.rglob(DOCUMENT)}
    assert found == {".": "later", "before-1": "again", "before-2": "other"}
    assert (tmp_path / "before-2" / "experiment.csv").read_text(encoding="utf-8") == "other"


def test_a_folder_without_curves_is_one_sentence(tmp_path, folder):
    assert has_diagnosis(folder) and not has_diagnosis(tmp_path)
    (tmp_path / CURVES).write_text("no parquet", encoding="utf-8")
    with pytest.raises(DiagnosisFolderError, match="diagnose again"):
        read_curves(tmp_path / CURVES)


def test_the_page_begins_with_the_verdict_and_holds_every_picture(folder):
    text = (folder / "diagnosis.html").read_text(encoding="utf-8")
    assert text.index("effect found") < text.index(SAYS) < text.index("<img")
    assert shown(text) == PICTURES
    assert all(f"<h3>{title}</h3>" in text for title in ("Effects", "Other explanations", "Tunables", "Provenance"))


def test_the_page_names_the_twin_and_the_version_above_the_verdict(tmp_path: Path) -> None:
    about = {"files": {"twin": {"path": "twins/loop.toml", "sha256": "ab12" * 16}}, "versions": {"hil": "9.8.7"}}
    write(made(), SENSORS, tmp_path, {"record": "r.parquet", "provenance": about})
    head = page(read_findings(tmp_path)).split('class="verdict')[0]
    assert "twins/loop.toml (sha256 ab12ab12ab12ab12)" in head
    assert "hil 9.8.7" in head


def test_the_page_needs_nothing_else(folder):
    text = (folder / "diagnosis.html").read_text(encoding="utf-8")
    assert re.findall(r"https?://|<script|<link|@import|url\(", text) == []
    assert all(source.startswith("data:") for source in re.findall(r'src="([^"]*)"', text))


def test_what_comes_from_files_cannot_become_markup(folder):
    findings = read_findings(folder)
    evil = "<b onclick=x>&"
    document = findings.document | {
        "summary": evil,
        "warnings": [evil],
        "record": f"{evil}/x.csv",
        "blind_spots": [evil],
        "next_experiment": {"hold": evil},
        "alternatives": [{"kind": evil, "where": evil, "driver": evil, "confidence": 0.0, "why_not": evil}],
    }
    text = page(Findings(document, findings.curves))
    assert evil not in text
    assert text.count("&lt;b onclick=x&gt;&amp;") >= 6


@pytest.mark.parametrize("verdict", ["adequate", "ambiguous", "unexplained"])
def test_every_verdict_has_its_page(verdict):
    diagnosis = made(verdict, summary=f"said of {verdict}")
    findings = Findings(diagnosis.document() | {"record": "r.csv"}, curves_of(diagnosis, SENSORS))
    text = page(findings)
    assert f"said of {verdict}" in text and shown(text) == PICTURES


def test_what_did_not_explain_the_record_is_not_called_the_effect():
    tried = made("unexplained")
    same = {name: dataclasses.replace(e, after=e.before) for name, e in tried.errors.items()}
    assert after_label(tried.document()) == "with the best effect tried"
    assert after_label(dataclasses.replace(tried, errors=same).document()) == "re-tuned"
    assert after_label(made().document()) == "with the effect"


def test_it_is_said_why_the_answer_should_be_believed(folder):
    document = read_findings(folder).document
    by_chance, blocks = reasons(document)
    assert "less than once in a million" in by_chance and "reaches 4.8" in by_chance
    assert "the effect predicts 3 of 4 folds better" in blocks
    text = (folder / "diagnosis.html").read_text(encoding="utf-8")
    assert text.index("Unknown input by place") < text.index(by_chance) < text.index(blocks) < text.index("Evidence")
    # What no scan found has no probability, and a verdict without effects or blocks needs no reasons.
    unscanned = dataclasses.replace(made().effects[0], family_wise=float("nan"))
    assert reasons(made(effects=(unscanned,)).document()) == [blocks]
    assert reasons(dataclasses.replace(made("adequate"), folds=()).document()) == []
    assert [frequency(p) for p in (0.3, 0.004)] == ["in 30 of a hundred records", "once in 250 records"]


def test_the_next_experiment_is_told_step_by_step():
    plan = {
        "why": "a long soak tells a loss from a source",
        "possible": True,
        "steps": [{"time_s": 0.0, "heater_power_W": 700.0}, {"time_s": 5400.0, "heater_power_W": 0.0}],
        "hottest_C": 41.0,
    }
    diagnosis = dataclasses.replace(made("ambiguous"), next_experiment=plan)
    text = page(Findings(diagnosis.document(), curves_of(diagnosis, SENSORS)))
    assert "a long soak tells a loss from a source" in text
    assert "1 h 30 min" in text and '<th class="n">heater_power_W</th>' in text


def test_a_diagnosis_that_shows_little_still_makes_a_page():
    bare = dataclasses.replace(
        made("adequate"), errors={}, courses=(), ladder=(), moved=(), indistinguishable=(), alternatives=(), folds=()
    )
    text = page(Findings(bare.document(), curves_of(bare, SENSORS)))
    assert "adequate" in text and shown(text) == {"residuals"}


def test_rerun_shows_the_curves_and_the_onset(folder, tmp_path):
    rrd = tmp_path / "diagnosis.rrd"
    write_findings_review(folder, rrd)
    curves = read_findings(folder).curves
    for sensor in SENSORS:
        time_s, values = read_columns(rrd, path("diagnosis", "residual", sensor, "stale"))
        np.testing.assert_allclose(time_s, curves.time_s, atol=1e-9)
        np.testing.assert_array_equal(values[:, 0], curves.residual[sensor])
    np.testing.assert_array_equal(
        read_columns(rrd, path("diagnosis", "unknown", "modules"))[1][:, 0], curves.unknowns[0].mean
    )
    assert read_words(rrd, "/diagnosis/onsets") == [(7200.0, SAYS)]
    assert [state for _, state in read_words(rrd, "/diagnosis/state")] == [
        "as commissioned",
        "heat source at modules (constant)",
    ]


def test_the_review_of_a_run_takes_in_the_diagnosis_in_its_folder(tmp_path):
    journal = tmp_path / "journal.sqlite"
    write_journal(journal, make(200))
    write_review(journal, tmp_path / "before.rrd")
    with pytest.raises(KeyError):
        read_columns(tmp_path / "before.rrd", path("diagnosis", "residual", SENSORS[0], "stale"))
    write_data(made(), SENSORS, tmp_path / "diagnosis", {})
    write_review(journal, tmp_path / "after.rrd")
    _, values = read_columns(tmp_path / "after.rrd", path("diagnosis", "residual", SENSORS[0], "after"))
    assert len(values) == 60


def test_the_chance_and_the_limit_of_noise_are_of_the_same_effect():
    """The threshold is the highest of all; beside the chance of another it would contradict it."""
    first, second = made().effects[0], made().effects[0]
    weak = dataclasses.replace(second, z=5.14, family_wise=1.0 / 340.0, noise_z=4.6)
    strong = dataclasses.replace(first, z=30.0, family_wise=1e-9, noise_z=6.4)
    grown = dataclasses.replace(made(effects=(strong, weak)), threshold=6.4, method="growth")
    by_chance = reasons(grown.document())[0]
    assert "5.14" in by_chance and "once in 340 records" in by_chance and "reaches 4.6" in by_chance


def test_what_is_worse_than_re_tuning_is_not_said_to_foretell():
    tried = made("unexplained", errors={"T_tank_C": SensorError(2.26, 1.82, 85.7, 0.2)})
    (blocks,) = (reason for reason in reasons(tried.document()) if "held-out" in reason)
    assert "85.7 K with the best effect tried and by 1.82 K re-tuned alone: the answer does not predict it" in blocks
    assert "better" not in blocks


def test_what_the_reader_left_out_stands_in_the_document_and_on_the_page(tmp_path):
    said = "119 rows from line 3602 on are left out <since>"
    write(dataclasses.replace(made(), read=(said,)), SENSORS, tmp_path, {"record": "one.csv", "seconds": 1.0})
    assert json.loads((tmp_path / DOCUMENT).read_text())["read"] == [said]
    text = (tmp_path / "diagnosis.html").read_text()
    assert "Reading the record" in text and "left out &lt;since&gt;" in text


@pytest.mark.parametrize(
    ("verdict", "says"), [("effect found", "neither supports nor contradicts"), ("unexplained", "does not predict")]
)
def test_a_worse_held_out_segment_speaks_against_an_answer_only_where_that_is_not_claimed(
    verdict: str, says: str
) -> None:
    """An effect that has passed is claimed although re-tuning alone is nearer there."""
    errors = {"T_tank_C": {"before": 0.17, "after": 0.21, "noise": 0.02}}
    document = {
        "verdict": verdict,
        "effects": [{"shape": "pulse"}],
        "left_out": [{"gain": 5.0}],
        "error": {"sensors": errors},
    }
    text = left_out(document)
    assert says in text and "0.21 K" in text and "0.17 K" in text
