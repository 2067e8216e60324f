"""`hil bench tower-governance`: what was known at each time is of the record before it, and is scored by the truth."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from hil.bench.tower_governance import FULL, measure
from hil.bench.tower_governance import trial as trial_module
from hil.bench.tower_governance.cases import CLEANING, PLAIN, RAMP
from hil.bench.tower_governance.figures import (
    auroc,
    cleaning_figures,
    drift_alarms_of,
    false_losses,
    gate_figures,
    persistent_proposals,
    ramp_figures,
)
from hil.bench.tower_governance.known import (
    CellTrial,
    KnownState,
    Proposal,
    StationFolder,
    WindowError,
    calibrated_at,
    third_excited,
)
from hil.bench.tower_governance.tables import tables_of
from hil.bench.tower_governance.trial import read_trial, write_trial
from tests.hil.tower.made_plant import SHEET, files, iso, run, write_points, write_record
from twin.tower import DAY_S, DEVIATIONS

CLEAN = {"fill": 1.0, "air": 1.0, "uniformity": 1.0, "bias": 0.0}


def state(day: float, true: dict[str, float] | None = None, sd: float = 0.01, **values: float) -> KnownState:
    """Return what is known at a day: these values, accepted in three windows; the truth is that of a clean cell."""
    truth = {**CLEAN, **(true or {})}
    proposals = {
        name: Proposal(day * DAY_S, {**CLEAN, **values}[name], sd, truth[name], persistent=True) for name in DEVIATIONS
    }
    return KnownState(day * DAY_S, truth, proposals, proposals)


def cell(*known: KnownState, kind: str = PLAIN, crossed: float | None = None, third: float | None = None) -> CellTrial:
    return CellTrial(
        "X1",
        "A",
        1,
        kind,
        0.0,
        None if crossed is None else crossed * DAY_S,
        None if third is None else third * DAY_S,
        known,
    )


def test_a_ramp_is_found_by_the_first_calibration_whose_fill_has_lost_five_percent() -> None:
    known = (state(31, {"fill": 0.96}, fill=0.97), state(34, {"fill": 0.948}, fill=0.949), state(52, {"fill": 0.87}))
    r = ramp_figures(cell(*known, kind=RAMP, crossed=33.5))
    assert r.delay_d == pytest.approx(0.5) and not r.early
    assert (r.true_loss, r.found_loss) == pytest.approx((0.13, 0.0))
    early = ramp_figures(cell(state(25, {"fill": 0.98}, fill=0.94), state(52, {"fill": 0.87}), kind=RAMP, crossed=33.5))
    assert early.early and early.delay_d == pytest.approx(-8.5)
    held = ramp_figures(cell(known[0], replace(known[1], accepted={}), known[2], kind=RAMP, crossed=33.5))
    assert (r.accepted_day, held.accepted_day) == (34.0, None) and held.found_day == 34.0
    silent = ramp_figures(cell(known[0], replace(known[1], present={}), known[2], kind=RAMP, crossed=33.5))
    assert silent.found_day is None and silent.delay_d is None


def test_a_loss_that_is_not_there_is_false_once_until_it_is_taken_back() -> None:
    fills = (0.99, 0.94, 0.93, 0.99, 0.94)
    assert false_losses(cell(*(state(k, fill=f) for k, f in enumerate(fills)))) == 2
    assert false_losses(cell(*(state(k, {"fill": 0.96}, fill=f) for k, f in enumerate(fills)))) == 0


def test_an_alarm_that_many_calibrations_repeat_counts_once() -> None:
    names = ("coverage", "withheld")
    known = [
        replace(state(20), alarms=((15.0 * DAY_S, names),)),
        replace(state(30), alarms=((15.0 * DAY_S, names), (25.0 * DAY_S, names))),
        replace(state(40), alarms=((25.1 * DAY_S, names), (27.0 * DAY_S, names))),
    ]
    assert [time_s / DAY_S for time_s, _ in drift_alarms_of(cell(*known))] == [25.0, 27.0]


@pytest.mark.parametrize(("fill", "seen"), [(1.0, True), (0.98, False)])
def test_a_cleaning_is_seen_where_the_uniformity_moves_alone(fill: float, seen: bool) -> None:
    before, after = (
        state(37, {"uniformity": 0.86}, uniformity=0.87),
        state(38.25, {"uniformity": 0.95}, uniformity=0.94, fill=fill),
    )
    (found,) = cleaning_figures(cell(before, after, kind=CLEANING, third=38.25))
    assert found.seen is seen and found.when == "3 excited windows"
    assert found.moved["uniformity"] == pytest.approx(7.0) and found.others == pytest.approx(abs(fill - 1.0) / 0.01)
    away = state(38.25, {"uniformity": 0.95}, uniformity=0.80)
    assert not cleaning_figures(cell(before, away, kind=CLEANING, third=38.25))[0].seen


def test_the_third_excited_window_after_a_time_counts() -> None:
    hour = 3600.0
    known = [
        replace(state(1), excited_s=tuple((k * hour, (k + 2) * hour) for k in (0, 2, 4))),
        replace(state(2), excited_s=tuple((k * hour, (k + 2) * hour) for k in (4, 8, 12))),
    ]
    assert third_excited(known, 2.0 * hour) == 10.0 * hour
    assert third_excited(known, 5.0 * hour) is None


def test_gates_are_scored_by_minutes_and_by_windows_with_large_errors() -> None:
    def window(error: float, minutes: int, *codes: str) -> WindowError:
        return WindowError(0.0, codes, (), error, error, minutes)

    windows = [window(0.1, 120), window(0.4, 40), window(0.7, 10, "BYPASS"), window(0.2, 30, "BYPASS"), window(0.9, 5)]
    g = gate_figures(windows)
    assert g.withheld == pytest.approx(0.4) and g.large == 2
    assert g.accepted_K == pytest.approx((12.0 + 16.0 + 4.5) / 165.0) and g.withheld_K == pytest.approx(13.0 / 40.0)
    # One of two large errors is withheld, and one of three small ones.
    assert g.auroc == pytest.approx(0.5 * (1.0 + 1.0 / 2.0 - 1.0 / 3.0)) and g.width_auroc == 1.0
    assert np.isnan(auroc(np.array([1.0, 2.0]), np.array([False, False])))


def test_persistent_proposals_are_confirmed_open_or_false_by_what_an_inspection_would_find() -> None:
    known = (
        state(20, {"fill": 0.99}, fill=0.99),  # within its interval of the clean cell
        state(30, {"fill": 0.90}, fill=0.91),
        state(40, {"fill": 0.90}, fill=0.88),  # an inspection cannot decide between 0.91 and 0.88
        state(50, {"fill": 0.88}, fill=0.98),
    )
    judged = persistent_proposals(cell(*known))
    assert [one.verdict for one in judged] == ["confirmed", "open", "false"]
    assert [one.before for one in judged] == [1.0, 0.91, 0.88] and [one.nearer for one in judged] == [
        True,
        False,
        False,
    ]
    passing = {name: replace(one, persistent=False) for name, one in known[1].present.items()}
    assert persistent_proposals(cell(replace(known[1], present=passing))) == []


@pytest.fixture(scope="module")
def station(tmp_path_factory: pytest.TempPathFactory) -> StationFolder:
    root = tmp_path_factory.mktemp("governance")
    write_record(root / "record", days=6)
    (root / "datasheet.json").write_text(json.dumps(SHEET))
    write_points(root / "points.csv")
    done = run("commission", root / "record", "--cell", 1, *files(root), "--out", root / "cell1.toml")
    assert done.exit_code == 0, done.output
    time = pq.read_table(root / "record" / "cell1.parquet")["time"].to_numpy().astype("datetime64[ms]")
    start = float(time[0].astype(np.int64)) / 1e3
    with (root / "labels.csv").open("w", newline="") as handle:
        rows = [[iso(start + day * DAY_S), 1, "fill", "interval", "", "", 0.9, 1.1, "inspection"] for day in (1, 5)]
        csv.writer(handle).writerows(
            [["time", "cell", "parameter", "kind", "value", "sd", "lo", "hi", "source"], *rows]
        )
    outlet = pq.read_table(root / "record" / "cell1.parquet")["t_out_C"].to_numpy()
    truth: dict[str, Any] = {"time": time, "running": np.isfinite(outlet), "t_out": outlet}
    truth |= {name: np.full(len(time), value) for name, value in CLEAN.items()}
    return StationFolder(root / "record", (root / "cell1.toml",), root / "labels.csv", {1: truth})


def test_a_calibration_at_a_time_knows_nothing_of_later_minutes_and_labels(
    station: StationFolder, tmp_path: Path
) -> None:
    start = float(station.truth[1]["time"][0].astype(np.int64)) / 1e3
    end = start + 4.0 * DAY_S
    known = calibrated_at(station, end, start + 3.0 * DAY_S)[1]
    assert known.true == CLEAN and known.present.keys() == set(DEVIATIONS)
    assert all(one.end_s <= end for one in known.present.values())
    assert known.windows and all(start + 3.0 * DAY_S <= one.start_s < end for one in known.windows)
    # The end of the record and the later label are altered: nothing that was known before changes.
    changed = tmp_path / "record"
    changed.mkdir()
    table = pq.read_table(station.record / "cell1.parquet")
    outlet = table["t_out_C"].to_numpy().copy()
    outlet[table["time"].to_numpy().astype("datetime64[ms]").astype(np.int64) / 1e3 >= end] += 3.0
    at = table.schema.get_field_index("t_out_C")
    pq.write_table(table.set_column(at, "t_out_C", [outlet]), changed / "cell1.parquet")
    (changed / "station.json").write_bytes((station.record / "station.json").read_bytes())
    labels = tmp_path / "labels.csv"
    labels.write_text(station.labels.read_text().replace("0.9,1.1", "0.8,0.9").replace("0.8,0.9", "0.9,1.1", 1))
    assert labels.read_text() != station.labels.read_text()
    again = calibrated_at(replace(station, record=changed, labels=labels), end, start + 3.0 * DAY_S)[1]
    assert again == known


def test_a_finished_station_is_kept_for_the_same_code_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    full = replace(state(40), windows=(WindowError(1.0, ("BYPASS",), (), 0.1, 0.2, 9),), excited_s=((1.0, 2.0),))
    kept = [cell(full, replace(state(52), alarms=((3.0, ("coverage", "withheld")),)), kind=RAMP, crossed=33.0)]
    write_trial(tmp_path / "one.json", "a", kept, 2.0)
    assert read_trial(tmp_path / "one.json", "a") == (kept, 2.0)
    assert read_trial(tmp_path / "one.json", "b") is None
    made: list[str] = []

    def tried(case: Any, *_: object) -> list[CellTrial]:
        made.append(case.name)
        return kept

    monkeypatch.setattr(trial_module, "try_station", tried)
    size = replace(FULL, ramps=1, plain=1)
    page, measured = {"hil/bench/tower_governance/tables.py": "1"}, {"twin/tower": "1"}
    for code, names in (
        (page | measured, ["R1", "P1"]),
        ({**page, "hil/bench/tower_governance/tables.py": "2"} | measured, []),
        (page | {"twin/tower": "2"}, ["R1", "P1"]),
    ):
        made.clear()
        measure(size, 0, tmp_path, None, code, lambda *_: None)
        assert made == names


def test_the_page_has_a_figure_for_each_row_and_says_where_there_is_none() -> None:
    ramp = cell(state(40, fill=0.94), state(52, {"fill": 0.88}, fill=0.87), kind=RAMP, crossed=38.0)
    case = SimpleNamespace(name="R1", design=SimpleNamespace(station="A"), month=1, seed=1, days=53)
    tables = {one.key: one for one in tables_of([ramp], [(case, 3.0, 2)])}  # type: ignore[list-item]
    figures = dict(tables["figures"].rows)
    assert figures["ramps"] == 1 and figures["mean delay at 5 %, d"] == pytest.approx(2.0)
    assert figures["mean absolute error of that loss, % of the clean fill"] == pytest.approx(1.0)
    assert figures["false alarms a cell-year"] is None and figures["cleanings"] == 0
    assert len(tables["ramps"].rows) == 1 and not tables["cleanings"].rows
