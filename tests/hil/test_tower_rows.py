"""`hil bench tower-rows`: each row is printed, with the result that its figure gives."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from hil.bench.acceptance import assemble
from hil.bench.acceptance.calibration import WIDTH_OVER_MAE, calibration_rows
from hil.bench.acceptance.criteria import CRITERIA
from hil.bench.acceptance.governance import governance_rows
from hil.bench.acceptance.outcome import FAILED, NOT_MEASURED, REACHED, Published
from hil.bench.acceptance.outlet import ENSEMBLE, outlet_rows
from hil.bench.acceptance.physics import record_size
from hil.bench.acceptance.stations import StationAnswers, outcomes
from hil.bench.commands.bench import command

RESULTS = Path(__file__).resolve().parents[2] / "docs" / "results"


def page(folder: Path, name: str, **tables: tuple[list[str], list[list[object]]]) -> Published:
    found = {key: {"columns": columns, "rows": rows, "notes": []} for key, (columns, rows) in tables.items()}
    (folder / f"{name}.json").write_text(json.dumps({"name": name, "tables": found}))
    return Published(folder)


def steps(folder: Path, within: int, wrong: int = 0) -> Published:
    figures = [
        ["steps", 200],
        ["found within 18 min", within],
        ["found later", 200 - within],
        ["missed", 0],
        ["taken for a change of the water", wrong],
        ["called fouling by the refit", 0],
        ["median minutes to the alarm", 2.0],
    ]
    return page(folder, "tower_steps", steps=(["figure", "value"], figures))


@pytest.mark.parametrize(("within", "result"), [(200, REACHED), (187, FAILED)])
def test_a_row_is_reached_or_failed_by_its_figure(tmp_path: Path, within: int, result: str) -> None:
    found = calibration_rows(steps(tmp_path, within))
    assert found["step"].verdict == result and f"{within} of 200" in found["step"].ours
    assert found["step called fouling"].verdict == REACHED
    assert calibration_rows(steps(tmp_path, within, wrong=1))["step called fouling"].verdict == FAILED


def governance(folder: Path, **changed: float) -> Published:
    figures = {
        "ramps": 4,
        "loss of fill at the end, mean, %": 12.5,
        "true loss of fill then, mean, %": 13.1,
        "mean absolute error of that loss, % of the clean fill": 0.9,
        "ramps with a proposal at the end": 4,
        "ramps proposed at 5 %": 4,
        "ramps proposed too early": 0,
        "mean delay at 5 %, d": 2.5,
        "ramps with a drift alarm": 0,
        "cell-years without a ramp": 1.4,
        "false alarms a cell-year": 0.7,
        "cleanings": 4,
        "cleanings seen within 3 excited windows": 4,
        "uniformity moved, median sd": 5.0,
        "largest other change, sd": 0.6,
        "windows": 4000,
        "windows withheld, %": 8.0,
        "outlet MAE of accepted windows, K": 0.1,
        "outlet MAE of withheld windows, K": 0.25,
        "AUROC of the gates for these": 0.8,
        "AUROC of the width for these": 0.9,
        "persistent proposals": 42,
        "proposals confirmed": 35,
        "proposals open": 4,
        "proposals false": 3,
        "precision of the decided": 35 / 38,
        "proposals nearer to the truth than the value before": 38,
    }
    for name, value in changed.items():
        (key,) = (one for one in figures if one.startswith(name.replace("_", " ")))
        figures[key] = value
    return page(folder, "tower_governance", figures=(["figure", "value"], [list(one) for one in figures.items()]))


def test_rows_of_governance_are_those_of_its_page(tmp_path: Path) -> None:
    found = governance_rows(governance(tmp_path))
    assert {one.verdict for one in found.values()} == {REACHED}
    assert found["ramp"].ours == "11.4 %; 2.5 d" and found["proposals"].ours == "35 / 4 / 3 of 42"
    assert {one.verdict for one in governance_rows(Published(tmp_path / "none")).values()} == {NOT_MEASURED}


@pytest.mark.parametrize(
    ("key", "changed"),
    [
        ("ramp", {"mean_absolute_error": 1.6}),
        ("ramp", {"ramps_proposed_at": 3}),
        ("ramp", {"ramps_proposed_too_early": 1}),
        ("ramp", {"mean_delay": 4.7}),
        ("ramp", {"false_alarms": 1.1}),
        ("cleaning", {"cleanings_seen": 3}),
        ("withheld error", {"outlet_MAE_of_withheld": 0.19}),
        ("proposals", {"precision": 0.89}),
        ("proposals", {"proposals_nearer": 37}),
    ],
)
def test_a_row_of_governance_fails_by_each_of_its_figures(tmp_path: Path, key: str, changed: dict[str, float]) -> None:
    found = governance_rows(governance(tmp_path, **changed))
    assert {name for name, one in found.items() if one.verdict == FAILED} == {key}


def test_every_row_is_printed_once_and_what_nobody_measured_says_so(tmp_path: Path) -> None:
    (table, reasons, count), left_out = assemble(tmp_path, tmp_path, 0, None)
    assert len(table.rows) == len(CRITERIA) and {str(row[0]) for row in table.rows} == {f"A{k}" for k in range(1, 29)}
    assert {row[table.columns.index("result")] for row in table.rows} == {NOT_MEASURED}
    assert {row[0] for row in reasons.rows} == {row[0] for row in table.rows} and left_out
    assert dict(count.rows)[NOT_MEASURED] == len(CRITERIA)


def test_the_outlet_of_the_network_needs_its_gain_as_well_as_its_error(tmp_path: Path) -> None:
    columns = ["method", "MAE K", "RMSE K", "p90 K", "p99 K", "readings MAE K"]
    outlet = (columns, [[ENSEMBLE, 0.09, 0.14, 0.2, 0.5, 0.1], ["commissioned", 1.2, 1.5, 2.0, 3.0, 1.2]])
    goals = (["goal", "change", "95 % from", "to", "at most", "reached"], [["outlet", -0.12, -0.2, 0.01, -0.1, "no"]])
    found = outlet_rows(page(tmp_path, "tower_network", outlet_all=outlet, goals=goals))
    assert found["network"].verdict == found["commissioned"].verdict == REACHED
    assert found["network gain"].verdict == FAILED and found["network gain"].interval == "-20.0 to +1.0 %"
    assert found["tcn"].verdict == NOT_MEASURED and "cells" not in found


def test_rivals_need_three_seeds_and_an_ablation_a_sure_sign(tmp_path: Path) -> None:
    columns = ["method", "seeds", "MAE K", "change %", "95 % from", "to"]
    outlet = (columns, [["TCN", 3, 0.094, 1.0, -2.0, 4.0], ["BiLSTM", 2, 0.095, 2.0, 1.0, 3.0]])
    parts = (
        ["part left out", "seeds", "last step: change %", "95 % from", "to"],
        [["no memory", 3, 4.0, 1.0, 7.0], ["no hierarchy", 3, 2.0, 0.5, 3.0]],
    )
    found = outlet_rows(page(tmp_path, "tower_rivals", outlet=outlet, parts=parts))
    assert found["tcn"].verdict == REACHED and found["tcn"].interval == "-2.0 to +4.0 %"
    assert found["bilstm"].verdict == FAILED and found["unet"].verdict == NOT_MEASURED
    assert found["ablations"].verdict == REACHED and "no memory +4.0 %" in found["ablations"].ours
    parts[1][1][3] = -0.5
    unsure = outlet_rows(page(tmp_path, "tower_rivals", outlet=outlet, parts=parts))["ablations"]
    assert unsure.verdict == FAILED and "1 of 2" in unsure.why


def test_intervals_narrower_than_their_errors_allow_fail(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    sd = np.exp(rng.normal(0.0, 0.7, 200_000))
    mae = float(np.abs(sd * rng.normal(size=len(sd))).mean())
    assert float(2.0 * 1.645 * sd.mean()) == pytest.approx(WIDTH_OVER_MAE * mae, rel=0.01)
    columns = ["cell", "part", "calibrated K", "within 90 %", "width K"]
    for width, result in ((0.30, FAILED), (0.45, REACHED)):
        found = calibration_rows(page(tmp_path, "tower", outlet=(columns, [[1, "all", 0.1, 0.9, width]])))
        assert found["width smoothed"].verdict == result and found["coverage smoothed"].verdict == REACHED


def answers(error: float, bias: float = 0.3) -> StationAnswers:
    shape, count = (50, 120), 50
    flat = np.random.default_rng(0).normal(0.0, 1.0, shape)
    return StationAnswers(
        error=error * flat,
        half=np.full(shape, 1.645 * error),
        drive=np.full(shape, 10.0),
        fall=np.full(shape, 5.0),
        wet=np.full(shape, 27.0),
        bias=np.full(count, bias),
        true_bias=np.full(count, 0.3),
        condition=np.full(count, 50.0),
        signs=np.ones(count, dtype=bool),
    )


def test_heat_effectiveness_and_levels_follow_from_the_outlet() -> None:
    near, far = (outcomes(answers(e), answers(e), "one") for e in (0.05, 0.5))
    for key in ("effectiveness", "cross effectiveness", "heat"):
        assert (near[key].verdict, far[key].verdict) == (REACHED, FAILED), key
    # Half a kelvin times the mean of a half-normal law, over 10 K.
    assert float(far["effectiveness"].ours) == pytest.approx(100.0 * 0.5 * 0.798 / 10.0, rel=0.02)
    assert near["hot"].ours == "100.0 %" and far["hot"].verdict == FAILED
    assert near["ece"].verdict == REACHED and near["counterfactual"].verdict == REACHED
    wide = outcomes(replace(answers(0.05), half=np.full((50, 120), 1.0)), answers(0.05), "one")
    assert wide["ece"].verdict == FAILED


def test_the_sign_of_a_bias_counts_where_the_day_identifies_it() -> None:
    assert outcomes(answers(0.05), answers(0.05), "one")["bias sign"].verdict == REACHED
    assert outcomes(answers(0.05, bias=-0.1), answers(0.05), "one")["bias sign"].verdict == FAILED
    unclear = replace(answers(0.05), condition=np.full(50, 500.0))
    assert "bias sign" not in outcomes(unclear, unclear, "one")


def test_records_of_a_year_are_smaller_than_the_papers() -> None:
    found = record_size()
    assert found.verdict == REACHED and 20.0 < float(found.ours) < 46.0


def test_the_command_lists_published_rows_and_names_a_damaged_page(tmp_path: Path) -> None:
    done = CliRunner().invoke(command, ["tower-rows", "--no-measure", "--json", "--results", str(RESULTS)])
    assert done.exit_code == 0, done.output
    rows = json.loads(done.stdout)["tables"]["rows"]["rows"]
    assert [row[0] for row in rows if row[10] == "tower_steps"] == ["A18", "A18"]
    (tmp_path / "tower.json").write_text("[]")
    done = CliRunner().invoke(command, ["tower-rows", "--no-measure", "--results", str(tmp_path)])
    assert done.exit_code == 1 and "tower.json: is no result of a bench" in done.output
