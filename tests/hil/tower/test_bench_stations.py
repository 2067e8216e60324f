"""`hil bench tower --stations`: reports of alignments against their keys, and the tables of the trials."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from hil.bench.tower_stations import NamedEffect, StationTrials, match_defects, tables_of
from hil.cli.verbs import group

DAY = "2022-05-0{}T{:02d}:00:00Z"


def defect(kind: str, tags: list[str], day: int, first_h: int, last_h: int) -> dict[str, Any]:
    return {"type": kind, "tags": tags, "from": DAY.format(day, first_h), "to": DAY.format(day, last_h)}


def test_a_finding_counts_with_its_type_a_tag_and_its_span() -> None:
    seeded = [defect("stuck", ["A"], 1, 2, 10), defect("stuck", ["B"], 1, 2, 10), defect("duplicates", [], 2, 0, 20)]
    seeded.append(defect("range_change", ["WT"], 3, 1, 22))
    findings = [
        defect("stuck", ["A"], 1, 4, 9),  # inside the seeded span
        defect("stuck", ["B"], 2, 2, 10),  # a day late
        defect("swap", ["A", "B"], 1, 2, 10),  # another type
        defect("duplicates", ["A", "C"], 2, 1, 22),  # seeded without tags
        defect("contradicted", ["WT"], 3, 1, 22),  # an air instrument of another range, by the other instruments
    ]
    found = match_defects(7, "A", seeded, findings)
    assert found.seeded == {"stuck": 2, "duplicates": 1, "range_change": 1}
    assert found.found == {"stuck": 1, "duplicates": 1, "range_change": 1}
    assert found.invented == {"stuck": 1, "swap": 1}


def test_goals_are_printed_whether_they_are_reached_or_not() -> None:
    errors = {"before": 0.2, "after": 0.1, "before_without_offset": 0.2, "after_without_offset": 0.1}
    effects = (
        NamedEffect(0, "A", 70.0, 0.12, True, {"from_deg": 80.0, "size": 0.13, "p_value": 0.005}, errors, ()),
        NamedEffect(1, "B", 90.0, 0.1, False, {}, errors, ("solar by solar",)),
    )
    spoilt = match_defects(0, "A", [defect("stuck", ["A"], 1, 2, 10)], [])
    clean = match_defects(0, "A", [], [defect("stuck", ["A"], 1, 2, 10)])
    spoilt = replace(spoilt, cpu_s=12.0, cell_days=120.0)
    tables = {one.key: one for one in tables_of(StationTrials(2.0, effects, (spoilt,), (clean,)))}
    assert [row[2:] for row in tables["goals"].rows] == [("no",)] * 3
    assert [row[1] for row in tables["goals"].rows] == [0.5, 0.0, 1]
    assert tables["defects"].rows[-1] == ("all", 1, 0, 0.0, 0, 1)
    assert tables["recirculation"].rows[0][4:7] == (80.0, 0.12, 0.13)
    assert tables["recirculation"].rows[1][-1] == "solar by solar"
    assert tables["cost"].rows[0] == ("with defects", 1, 120.0, 12.0, pytest.approx(36.5, rel=0.01))
    assert tables["cost"].rows[1][-1] is None


@pytest.mark.slow
def test_a_station_is_simulated_aligned_and_diagnosed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HIL_DATA", str(tmp_path))
    words = ["bench", "tower", "--stations", 1, "--months", 0.5, "--seed", 3, "--out", tmp_path]
    done = CliRunner().invoke(group, [str(word) for word in words])
    assert done.exit_code == 0, done.output + repr(done.exception)
    tables = json.loads((tmp_path / "tower_stations.json").read_text())["tables"]
    (row,) = tables["recirculation"]["rows"]
    assert row[0] == "3" and row[3] in ("yes", "no")
    total = tables["defects"]["rows"][-1]
    assert total[1] > 10 and total[2] >= 0.8 * total[1]


def test_a_bench_without_a_record_is_refused() -> None:
    done = CliRunner().invoke(group, ["bench", "tower"])
    assert done.exit_code == 2 and "--stations" in done.output
