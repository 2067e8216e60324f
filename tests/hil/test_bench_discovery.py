"""The blind trial: what an answer is worth, the order of sealing, and a small trial from end to end."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.rig_file.reader import load_rig
from drivers.virtual.plant.effects import load_effects
from drivers.virtual.plant.thermocouple_module import ThermocoupleModule
from hil.bench.discovery import repeated as discovery_again
from hil.bench.discovery import sides
from hil.bench.discovery import trial as discovery
from hil.bench.discovery.detectability import course_of, visible
from hil.bench.discovery.injector import RIG, opened, seal
from hil.bench.discovery.ledger import Ledger, LedgerError, sha256_of
from hil.bench.discovery.repeated import RigRecords
from hil.bench.discovery.score import AnswerScore, alike, judge, risk_at_coverage, volume, wilson
from hil.bench.discovery.tables import failure, tables
from hil.bench.discovery.worker import Worker, WorkerError
from hil.cli import group
from hil.profile.load_profile import read_profile
from hil.record.reader import read_record
from hil.synthetic.hidden_effects import effects_text, lasting, truth
from hil.synthetic.plant_record import direct_record
from hil.synthetic.settings import KINDS, profile, profile_text, setting
from twin import NORMAL90


def effect(kind: str = "heat_source", where: str = "tank", driver: str = "constant", **more: Any) -> dict[str, Any]:
    return {
        "kind": kind,
        "where": where,
        "driver": driver,
        "value": 44.0,
        "unit": "W",
        "onset_s": 3600.0,
        "z": 20.0,
        "interval90": [38.0, 50.0],
        "onset_interval90_s": [3300.0, 3900.0],
        "confidence": 0.9,
        "shape": "step",
        **more,
    }


def answer(verdict: str, *effects: dict[str, Any], others: tuple[tuple[str, str], ...] = ()) -> dict[str, Any]:
    sensors = {"T_tank_C": {"before": 0.3, "after": 0.05, "noise": 0.04}}
    return {
        "verdict": verdict,
        "effects": list(effects),
        "error": {"sensors": sensors},
        "indistinguishable": [{"kind": k, "where": w} for k, w in others],
    }


HIDDEN = {
    "group": "one",
    "what": "heat_source at tank (constant), power_W 40",
    "effects": [{"onset_s": 3000.0}],
    "labels": [["heat_source", "tank", "constant"]],
}


def judged(said: dict[str, Any], hidden: dict[str, Any] | None = None) -> AnswerScore:
    return judge("case_0", "steps", hidden or HIDDEN, said, (1.0, 1.0), 12.0, ((40.0, "W"),))


def test_sizes_in_different_units_are_not_compared() -> None:
    other = judge("case_0", "steps", HIDDEN, answer("effect found", effect()), (1.0, 1.0), 12.0, ((40.0, "W/K"),))
    assert other.right and other.size is None


def test_a_right_answer_scores_in_every_respect() -> None:
    o = judged(answer("effect found", effect()))
    assert (o.exact, o.top1, o.class1, o.in_set, o.place, o.driver, o.right) == (True,) * 7
    assert o.onset_min == pytest.approx(10.0)
    assert o.size == pytest.approx(0.1)
    assert (o.size_held, o.onset_held) == (True, False)
    assert o.errors_K == pytest.approx((0.3, 0.05, 0.04))
    assert failure(o) is None


def test_an_effect_too_many_is_not_exact() -> None:
    o = judged(answer("effect found", effect(), effect("sensor", "T_tank_C")))
    assert o.top1 and not o.exact
    assert failure(o) == "one too many"


def test_the_set_counts_and_its_size() -> None:
    o = judged(answer("ambiguous", effect("heat_loss", "heater"), others=(("heat_source", "tank"), ("flow", "loop"))))
    assert (o.top1, o.class1, o.in_set, o.set_size, o.place) == (False, True, True, 3, False)
    assert failure(o) == "equivalent only"


def test_classes_of_what_no_record_tells_apart() -> None:
    assert alike(("flow", "loop"), ("actuator", "pump_speed"), ())
    assert alike(("heat_source", "pm3"), ("heat_source", "modules"), ())
    assert not alike(("heat_source", "tank"), ("heat_loss", "tank"), ())
    assert [volume(w) for w in ("T_pm2_C", "pm4", "element", "T_tank_C", "T_modules_C")] == [
        "modules",
        "modules",
        "heater",
        "tank",
        "modules",
    ]


def test_adequate_on_a_case_with_an_effect_is_no_wrong_name() -> None:
    o = judged(answer("adequate"))
    assert (o.top1, o.in_set, o.right) == (None, None, False)
    assert failure(o) == "missed"


def test_outside_the_catalogue_abstention_or_kind_and_place_of_an_own_course_is_right() -> None:
    hidden = HIDDEN | {"group": "outside", "labels": [["heat_source", "tank", "periodic"]]}
    unknown = judged(answer("unexplained", effect("unknown", "T_tank_C")), hidden)
    assert unknown.right and unknown.place
    named = judged(answer("effect found", effect()), hidden)
    assert not named.right
    assert failure(named) == "named a cause outside the catalogue"
    for where, right in (("tank", True), ("heater", False)):
        own = effect("heat_source", where, "history") | {"shape": "own course"}
        assert judged(answer("effect found", own), hidden).right is right


def test_what_came_and_went_may_be_told_by_two_steps() -> None:
    hidden = HIDDEN | {"group": "outside", "labels": [["flow", "loop", "history"]]}
    steps = (effect("actuator", "pump_speed"), effect("actuator", "pump_speed"))
    assert judged(answer("effect found", *steps), hidden).right
    assert not judged(answer("effect found", *steps, effect("flow", "loop")), hidden).right
    assert not judged(answer("effect found", steps[0]), hidden).right


def test_a_thermometer_that_stands_still_may_be_called_that_and_nothing_else() -> None:
    hidden = HIDDEN | {"group": "outside", "labels": [["sensor", "T_tank_C", "constant"]]}
    assert judged(answer("effect found", effect("sensor", "T_tank_C", shape="stuck")), hidden).right
    assert not judged(answer("effect found", effect("sensor", "T_heater_C", shape="stuck")), hidden).right
    assert not judged(answer("effect found", effect("sensor", "T_tank_C")), hidden).right


def test_of_two_effects_the_lesser_counts_beside_the_other() -> None:
    """Two that nearly do the same are each plain alone, and neither is beside the other; what is not there has 0."""
    contest = SimpleNamespace(across=lambda s: s.T @ s)
    first, second = np.array([10.0, 0.0]), np.array([9.9, math.sqrt(100.0 - 9.9**2)])
    alone, beside = visible(contest, [first, second])  # type: ignore[arg-type]
    assert alone == pytest.approx([10.0, 10.0])
    assert beside == pytest.approx([math.sqrt(100.0 - 9.9**2)] * 2)
    assert visible(contest, [first, first])[1] == pytest.approx([0.0, 0.0], abs=1e-6)  # type: ignore[arg-type]
    assert visible(contest, [first, np.zeros(2)])[1] == pytest.approx([10.0, 0.0])  # type: ignore[arg-type]
    assert visible(contest, [first])[1] == pytest.approx([10.0])  # type: ignore[arg-type]


def test_risk_counts_the_surest_first() -> None:
    sure = judged(answer("effect found", effect(confidence=0.99)))
    wrong = judged(answer("effect found", effect("heat_loss", "heater", confidence=0.5)))
    assert [(n, bad) for _, n, bad, _ in risk_at_coverage([wrong, sure], (0.5, 1.0))] == [(1, 0), (2, 1)]


def test_wilson_against_published_values() -> None:
    # Brown, Cai and DasGupta, Stat. Sci. 16 (2001) 101: symmetric about 1/2, and exact at the ends.
    low, high = wilson(5, 10)
    assert low + high == pytest.approx(1.0)
    assert wilson(0, 20)[1] == pytest.approx(NORMAL90**2 / (20 + NORMAL90**2))
    assert np.isnan(wilson(0, 0)).all()


def test_the_ledger_keeps_the_order(tmp_path: Path) -> None:
    ledger = Ledger(tmp_path / "ledger.jsonl")
    hidden = truth(1, 0, 24.0)
    sealed = seal(hidden, tmp_path / "sealed" / "case_1.json")
    assert sealed == sha256_of(tmp_path / "sealed" / "case_1.json")
    assert opened(tmp_path / "sealed" / "case_1.json")["group"] == hidden.group
    ledger.write("case_1", "sealed", sealed)
    with pytest.raises(LedgerError, match="cannot be opened"):
        ledger.write("case_1", "opened", sealed)
    ledger.write("case_1", "answered", "a" * 64)
    with pytest.raises(LedgerError, match="not the one that was sealed"):
        ledger.write("case_1", "opened", "b" * 64)
    ledger.write("case_1", "opened", sealed)
    with pytest.raises(LedgerError, match="cannot be answered"):
        ledger.write("case_1", "answered", "a" * 64)


def test_a_changed_ledger_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "ledger.jsonl"
    ledger = Ledger(path)
    ledger.write("case_1", "sealed", "a" * 64)
    ledger.write("case_1", "answered", "b" * 64)
    Ledger(path)
    path.write_text(path.read_text(encoding="utf-8").replace("a" * 64, "c" * 64), encoding="utf-8")
    with pytest.raises(LedgerError, match="does not follow"):
        Ledger(path)


def test_cases_are_quarters_and_valid(tmp_path: Path) -> None:
    drawn = [truth(n, 3, 24.0) for n in range(80)]
    groups = [t.group for t in drawn]
    assert groups.count("none") == groups.count("outside") == 20
    assert 0 < groups.count("two") < groups.count("one")
    for n, hidden in enumerate(drawn):
        assert bool(hidden.effects) == (hidden.group != "none")
        if hidden.effects:
            path = tmp_path / f"{n}.toml"
            path.write_text(effects_text(hidden.effects), encoding="utf-8")
            assert len(load_effects(path)) == len(hidden.effects)


def test_records_of_a_kind_are_their_own(tmp_path: Path) -> None:
    pairs = [truth(n, 3, 24.0, "double") for n in range(20)]
    assert {t.group for t in pairs} == {"two"}
    assert all(a[:2] != b[:2] for a, b in (t.labels for t in pairs))
    assert truth(0, 3, 24.0, "healthy").group == "none"
    assert len({setting(4, 3, 24.0, kind).seed for kind in KINDS}) == len(KINDS)


def test_a_profile_is_one_that_hil_run_reads(tmp_path: Path) -> None:
    made = profile(setting(5, 0, 24.0))
    path = tmp_path / "case.csv"
    path.write_text(profile_text(made), encoding="utf-8")
    back = read_profile(path)
    assert back.duration_s == 24 * 3600.0
    assert np.array_equal(back.values, made.values)


def test_a_direct_record_is_that_of_the_specimen() -> None:
    made = profile(setting(2, 0, 0.2))
    rig = load_rig(RIG)
    one = direct_record(made, rig, seed=5, unit=1)
    assert np.array_equal(one.columns["T_tank_C"], direct_record(made, rig, seed=5, unit=1).columns["T_tank_C"])
    other = direct_record(made, rig, seed=6, unit=1)
    assert not np.array_equal(one.columns["T_tank_C"], other.columns["T_tank_C"])
    assert np.array_equal(ThermocoupleModule(5, unit=1).offsets_K, ThermocoupleModule(6, unit=1).offsets_K)
    assert one.time_s[-1] == 720.0
    counts = one.columns["T_tank_C"] * 100.0
    assert np.abs(counts - counts.round()).max() < 1e-9


def test_courses_follow_onset_ramp_and_growth() -> None:
    edges = np.linspace(0.0, 100.0, 11)
    assert course_of({"onset_s": 50.0}, edges).tolist() == [0.0] * 5 + [1.0] * 5
    assert course_of({"onset_s": 0.0, "ramp_s": 100.0}, edges)[-1] == pytest.approx(0.95)
    assert course_of({"onset_s": 0.0, "tau_s": 10.0}, edges)[0] == pytest.approx(1.0 - np.exp(-0.5))


def test_a_worker_reports_errors_and_goes_on(tmp_path: Path) -> None:
    with Worker("hil.bench.discovery.answerer") as worker:
        for _ in range(2):
            with pytest.raises(WorkerError, match="nowhere"):
                worker.ask(record="x", twin=str(tmp_path / "nowhere.toml"), healthy="x", hour=8.0, out=str(tmp_path))


TRIAL = ("bench", "discovery", "--blind", "--case", "0", "--case", "6", "--hours", "1", "--json")
"""In one of them an effect is named; their searches are among the shortest of the first ten."""


@pytest.fixture(scope="module")
def in_turn(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Work folder of a trial of two cases, one after the other, and its report."""
    work = tmp_path_factory.mktemp("trial")
    done = CliRunner().invoke(group, [*TRIAL, "--work", str(work)])
    assert done.exit_code == 0, done.output
    report: dict[str, Any] = json.loads(done.stdout)
    return work, report


def ledger_of(work: Path) -> Path:
    (ledger,) = work.rglob("ledger.jsonl")
    return ledger


def test_two_cases_from_end_to_end(in_turn: tuple[Path, dict[str, Any]]) -> None:
    work, report = in_turn
    assert sum(row[1] for row in report["tables"]["verdicts"]["rows"]) == 2
    lines = ledger_of(work).read_text(encoding="utf-8").splitlines()
    assert [json.loads(line)["event"] for line in lines] == ["sealed", "answered", "opened"] * 2
    again = CliRunner().invoke(group, [*TRIAL, "--work", str(work)])
    assert json.loads(again.stdout)["tables"] == report["tables"]
    assert len(ledger_of(work).read_text(encoding="utf-8").splitlines()) == 6


def test_cases_on_two_workers_are_those_of_one(in_turn: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    # The specimen of one case is that of the other trial; that of the other case is made anew, on a worker.
    known = setting(0, 0, 1.0).unit
    assert known != setting(6, 0, 1.0).unit
    files = list(in_turn[0].rglob(f"rigs/unit_{known}.*"))
    assert len(files) == 2
    for path in files:
        there = tmp_path / path.relative_to(in_turn[0])
        there.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, there)
    done = CliRunner().invoke(group, [*TRIAL, "--jobs", "2", "--work", str(tmp_path)])
    assert done.exit_code == 0, done.output
    answers = []
    for work in (in_turn[0], tmp_path):
        ledger = ledger_of(work)
        cases = {path.name: json.loads(path.read_text(encoding="utf-8")) for path in ledger.parent.glob("case_?.json")}
        timed = {"seconds", "cpu_s"}
        answers.append(
            {
                name: ({k: v for k, v in one["outcome"].items() if k not in timed}, one["ablation"])
                for name, one in cases.items()
            }
        )
        lines = [json.loads(line) for line in ledger.read_text(encoding="utf-8").splitlines()]
        for case in ("case_0", "case_6"):
            assert [line["event"] for line in lines if line["case"] == case] == ["sealed", "answered", "opened"]
    assert answers[0].keys() == {"case_0.json", "case_6.json"}
    assert answers[0] == answers[1]


def test_a_crash_counts_as_no_answer() -> None:
    o = judged(discovery.no_answer("LinAlgError: Singular matrix"))
    assert failure(o) == "no answer"
    size = discovery.TrialSize((0,), (), 4.0, True)
    found = tables([discovery.FinishedCase(o, {}, None)], size)
    assert any("error" in str(row[0]) for table in found for row in table.rows)


def test_a_direct_record_is_like_one_over_the_wire(tmp_path: Path) -> None:
    case = setting(5, 0, 0.5)
    asked = {"setting": dataclasses.asdict(case), "draw": 0, "kind": "healthy", "direct": False}
    made = sides.make_case(asked, lambda text: None)
    assert hashlib.sha256(made["truth"]).hexdigest() == made["sealed"]
    path = tmp_path / "record.parquet"
    path.write_bytes(made["record"])
    wire = read_record(path)
    direct = direct_record(profile(case), load_rig(RIG), seed=case.seed, unit=case.unit)
    assert set(direct.columns) <= set(wire.columns)
    for name, values in direct.columns.items():
        # The loop needs some seconds to arm the rig, so the two are shifted a little.
        late = wire.columns[name][-300:]
        assert np.isfinite(late).all()
        assert late.mean() == pytest.approx(values[-300:].mean(), rel=0.01), name
        if name.startswith("T_"):
            assert np.diff(late).std() == pytest.approx(np.diff(values[-300:]).std(), rel=0.3), name


def test_effects_that_a_twin_is_asked_about_again_stay_and_differ() -> None:
    for number in range(20):
        first, second = lasting(number, 3, 24.0)
        assert first.labels[0][:2] != second.labels[0][:2]
        for drawn in (first, second):
            assert drawn.labels[0][2] != "elapsed_time" and not {"ramp_s", "drift_per_h"} & set(drawn.effects[0])


def test_a_twin_that_took_up_an_effect_is_counted_by_its_later_records() -> None:
    found = judged(answer("effect found", effect()))
    calm = judged(answer("adequate"), {**HIDDEN, "group": "none", "labels": [], "effects": []})
    alarm = judged(answer("effect found", effect()), {**HIDDEN, "group": "none", "labels": [], "effects": []})
    wrong = judged(answer("effect found", effect(where="heater")))
    chains = [RigRecords(found, calm, found), RigRecords(found, alarm, wrong), RigRecords(found)]
    scores, failures = discovery_again.tables(chains, 24.0)
    counts = {row[0]: row[1:3] for row in scores.rows}
    assert counts["first record: right within the ambiguity group"] == (3, 3)
    assert counts["first record: a revision saved"] == (2, 3)
    assert counts["later record, nothing new: adequate"] == (1, 2)
    assert counts["later record, a second effect: right within the ambiguity group, of found"] == (1, 2)
    assert [row[1] for row in failures.rows] == ["false alarm", "wrong"]
