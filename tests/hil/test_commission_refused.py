"""`hil commission` on records that do not support a twin, and records whose clock is not the rig's."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from hil.record.reader import Record, read_record, write_record
from tests.discovery.conftest import Bench
from tests.hil.command_line import hil
from tests.hil.made_record import written
from tests.twin.conftest import LOOP
from twin.commissioning import CommissionOptions, CommissionResult, commission
from twin.commissioning.checks import clock_warning, refusal_reason
from twin.discovery.healthy.basis import Columns
from twin.twinfile import load


@pytest.fixture(scope="module")
def made() -> tuple[Bench, Columns]:
    bench = Bench(load(LOOP))
    return bench, bench.record(3.0, seed=4)


@pytest.fixture(scope="module")
def fitted(made: tuple[Bench, Columns]) -> CommissionResult:
    bench, record = made
    return commission(bench.network, record.time_s, record.inputs, record.measured, CommissionOptions(starts=1))


def test_a_healthy_record_has_nothing_against_it(made: tuple[Bench, Columns], fitted: CommissionResult) -> None:
    assert refusal_reason(fitted, made[1].measured) == ""
    assert clock_warning(fitted) == ""


def test_a_twin_of_whose_tunables_none_is_identified_is_refused(
    made: tuple[Bench, Columns], fitted: CommissionResult
) -> None:
    untold = dataclasses.replace(fitted, unidentifiable=tuple(fitted.values))
    assert refusal_reason(untold, made[1].measured).startswith("the record identifies none of the")
    nearly = dataclasses.replace(fitted, unidentifiable=tuple(fitted.values)[1:])
    assert refusal_reason(nearly, made[1].measured) == ""


@pytest.mark.parametrize(("wrong", "refused"), [(1, False), (3, True), (4, True)])
def test_a_twin_that_errs_by_as_much_as_a_constant_is_refused(
    made: tuple[Bench, Columns], fitted: CommissionResult, wrong: int, refused: bool
) -> None:
    measured = made[1].measured
    moved = measured.std(axis=0)
    errors = [1.1 * s if j < wrong else 0.1 for j, s in enumerate(moved)]
    said = ""
    for part in ("rmse_after", "rmse_fitted"):
        absurd = dataclasses.replace(fitted, **{part: dict(zip(fitted.rmse_after, errors, strict=True))})
        said = refusal_reason(absurd, measured)
        assert bool(said) == refused
    assert ("the fitted twin predicts the readings no better than a constant does" in said) == refused
    endless = dataclasses.replace(fitted, rmse_after=dict.fromkeys(fitted.rmse_after, float("inf")))
    assert refusal_reason(endless, measured)


@pytest.mark.parametrize(("factor", "asked"), [(0.1, True), (0.5, False), (2.0, False), (8.0, True)])
def test_heat_capacities_that_all_change_alike_put_the_clock_in_question(
    fitted: CommissionResult, factor: float, asked: bool
) -> None:
    units = {name: fitted.network.parameters[name].unit for name in fitted.values}
    values = {name: fitted.start[name] * (factor if units[name] == "J/K" else 1.0) for name in fitted.values}
    said = clock_warning(dataclasses.replace(fitted, values=values, unidentifiable=()))
    assert ("give --time-scale" in said) == asked
    assert not asked or f"about {factor:.2g} times" in said


def test_no_file_is_written_where_the_error_is_absurd(tmp_path: Path, made: tuple[Bench, Columns]) -> None:
    """Milliwatts in a column of watts, and readings of a rig that stands still."""
    bench, record = made
    path = written(bench.network, record, tmp_path / "wrong.parquet")
    wrong = read_record(path)
    rng = np.random.default_rng(1)
    columns = {
        name: values * 1000.0
        if name.endswith("_W")
        else 25.0 + rng.normal(0.0, 0.05, len(values))
        if name.startswith("T_")
        else values
        for name, values in wrong.columns.items()
    }
    write_record(Record(wrong.time_s, columns), path)
    code, printed = hil("commission", path, "--twin", LOOP, "--out", tmp_path / "new.toml")
    assert code == 2 and f"{path}: no twin is written: " in printed and "Traceback" not in printed
    assert not list(tmp_path.glob("new*"))


def test_a_twin_is_not_fitted_while_a_question_about_units_is_open(tmp_path: Path, made: tuple[Bench, Columns]) -> None:
    bench, record = made
    path = written(bench.network, record, tmp_path / "kilowatts.parquet")
    right = read_record(path)
    write_record(
        Record(right.time_s, {**right.columns, "pump_speed_pct": 0.01 * right.columns["pump_speed_pct"]}), path
    )
    said = ["commission", path, "--twin", LOOP, "--out", tmp_path / "new.toml"]
    code, printed = hil(*said)
    assert code == 2 and "is it a fraction of 1?" in printed and "--units-checked" in printed
    assert not list(tmp_path.glob("new*"))
    code, printed = hil(*said, "--units-checked")
    assert "open question of units" not in printed


def test_readings_of_a_stuck_channel_are_left_out_of_the_fit_and_of_what_is_stored(
    tmp_path: Path, made: tuple[Bench, Columns]
) -> None:
    bench, record = made
    path = written(bench.network, record, tmp_path / "good.parquet")
    good = read_record(path)
    tank = good.columns["T_tank_C"].copy()
    rows = slice(len(tank) // 5, len(tank) // 2)
    values = []
    for name, level in (("stuck", float(tank.mean())), ("missing", np.nan)):
        tank[rows] = level
        write_record(Record(good.time_s, {**good.columns, "T_tank_C": tank}), tmp_path / f"{name}.parquet")
        out = tmp_path / f"{name}.toml"
        code, printed = hil("commission", tmp_path / f"{name}.parquet", "--twin", LOOP, "--out", out)
        assert code == 0 and ("without any noise from" in printed) == (name == "stuck")
        values.append(load(out).values)
        assert np.isnan(read_record(tmp_path / f"{name}.healthy.parquet").columns["T_tank_C"][rows]).all()
    assert np.array_equal(*values)


def test_an_overload_changes_nothing_in_a_twin(tmp_path: Path, made: tuple[Bench, Columns]) -> None:
    bench, record = made
    path = written(bench.network, record, tmp_path / "good.parquet")
    good = read_record(path)
    tank = good.columns["T_tank_C"].copy()
    tank[7::60] = 9.9e37
    write_record(Record(good.time_s, {**good.columns, "T_tank_C": tank}), tmp_path / "overload.csv")
    tank[7::60] = np.nan
    write_record(Record(good.time_s, {**good.columns, "T_tank_C": tank}), tmp_path / "missing.csv")
    twins = []
    for name in ("overload", "missing"):
        code, printed = hil("commission", tmp_path / f"{name}.csv", "--twin", LOOP, "--out", tmp_path / f"{name}.toml")
        assert code == 0 and ("(the first, line 9, is 9.9e+37): missing" in printed) == (name == "overload")
        twins.append(load(tmp_path / f"{name}.toml").values)
    assert np.array_equal(*twins)


def test_a_scale_of_the_clock_is_understood_by_every_command(tmp_path: Path, made: tuple[Bench, Columns]) -> None:
    """A record of a rig that runs sixty times as fast as its clock, with its minutes called by another name."""
    bench, record = made
    path = written(bench.network, record, tmp_path / "slow.parquet")
    slow = read_record(path)
    fast = tmp_path / "fast.csv"
    names = ["clock", *slow.columns]
    table = np.column_stack([slow.time_s / 60.0, *slow.columns.values()])
    np.savetxt(fast, table, delimiter=",", header=",".join(names), comments="", fmt="%.9g")
    scaled = ["--time-column", "clock", "--time-scale", "60"]
    code, printed = hil("check", fast, *scaled)
    assert code == 0 and f"{slow.time_s[-1] / 3600:.2f} h" in printed
    out = tmp_path / "twin.toml"
    code, printed = hil("commission", fast, "--twin", LOOP, "--out", out, *scaled)
    assert code == 0 and "clock is taken 60 times, as --time-scale says" in printed
    assert read_record(tmp_path / "twin.healthy.parquet").time_s == pytest.approx(slow.time_s, abs=1e-3)
    code, printed = hil("track", fast, "--twin", out, "--calibrator", "least_squares", *scaled)
    assert code == 0 and f"over {slow.time_s[-1] / 3600:.1f} h" in printed
    code, printed = hil("diagnose", fast, "--twin", out, "--dry", *scaled)
    assert code == 0 and "adequate" in printed


def test_options_of_a_record_are_refused_for_other_files() -> None:
    code, printed = hil("check", LOOP, "--decimal", ",")
    assert code == 2 and "--decimal, --dates, --time-column and --time-scale describe a record" in printed
