"""The benchmarks run at tiny sizes, agree with each other, and print tables that a person can read."""

from __future__ import annotations

import json
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from hil.bench import BENCHMARKS
from hil.bench.commands.bench import command
from hil.bench.experiments import paper
from hil.bench.experiments import public_tables as public
from hil.bench.experiments.campaigns import virtual_record
from hil.bench.experiments.tracked import windows_to_recover
from hil.bench.kernel import contestants, fit, speed, variants
from hil.bench.kernel.problems import made_up
from hil.bench.kernel.windows import SCHEDULES, job
from hil.bench.measure import report
from hil.bench.peers import Absent, c_peer, optimisers
from hil.bench.peers.formulas import sensor_rows
from hil.record.reader import read_record
from twin.calibrators import UNTRAINED_CALIBRATORS
from twin.twinfile import load

LOOP = load(speed.TWINS / "loop.toml")
MANIFEST = {"command": "hil bench x", "seed": 0, "date": "today", "machine": {"cpu": "a CPU", "cores": 2}}


def test_without_a_name_the_benchmarks_are_listed():
    done = CliRunner().invoke(command)
    assert done.exit_code == 0
    assert all(name in done.output for name in BENCHMARKS)


@pytest.mark.parametrize("schedule", SCHEDULES)
def test_all_swarms_cost_the_same(schedule):
    window = job(LOOP, schedule, count=40, samples=60)
    exact = contestants.ours(window)()
    for peer in contestants.swarms():
        if schedule not in peer.schedules or peer.name.startswith("jax"):
            continue
        try:
            costs = peer.prepare(window)()
        except Absent:
            continue
        assert costs == pytest.approx(exact, rel=1e-4), peer.name


def test_solvers_with_tight_settings_agree_with_the_oracle():
    window = job(LOOP, "stepped", count=1, samples=40)
    exact = contestants.oracle(window)[:, sensor_rows(LOOP)]
    assert np.abs(contestants.our_readings(window)() - exact).max() < 1e-6
    for peer in contestants.singles():
        if "restarted" in peer.name:
            assert np.abs(peer.prepare(window)()[:, sensor_rows(LOOP)] - exact).max() < 1e-6, peer.name


def test_speed_tables_name_what_was_left_out(monkeypatch):
    def gone(job):
        raise Absent("torch: not installed")

    monkeypatch.setattr(contestants, "_torch_steps", gone)
    monkeypatch.setattr(contestants, "_jax", gone)
    tiny = speed.SpeedSize(
        samples=30, counts=(1, 40), schedules=("each s",), whole_h=0.05, slow=False, processes=False, budget_s=1e-3
    )
    tables, skipped = speed.measure(tiny, seed=0)
    assert "torch: not installed" in skipped
    assert {t.key for t in tables} == {"single", "swarm", "whole", "goals"}
    ratios = [row[-1] for row in tables[1].rows if row[0] == "ours"]
    assert ratios == [pytest.approx(1.0)]


def test_tables_fit_into_a_hundred_columns_and_numbers_stay_legible(capsys):
    wide = report.ReportTable(
        "t", "title", tuple(f"a column {i}" for i in range(9)), ((*(1.23456e5 for _ in range(9)),),)
    )
    document = report.BenchReport("x", (wide,), ("nothing",), MANIFEST)
    report.show(document)
    assert max(len(line) for line in capsys.readouterr().out.splitlines()) <= report.WIDTH
    assert [report.number(x) for x in (1.0e6, 123456.0, 12.345, 0.05, 7e-8, None, float("nan"), 3)] == [
        "1 M",
        "123 k",
        "12.3",
        "0.050",
        "7e-08",
        "-",
        "-",
        "3",
    ]


def test_a_report_is_written_with_its_manifest(tmp_path):
    table = report.ReportTable("t", "A title", ("what", "K"), (("a", 0.5), ("b", float("nan"))), ("a note",))
    paths = report.write(report.BenchReport("x", (table,), (), MANIFEST), tmp_path / "new")
    assert [p.name for p in paths] == ["x.json", "x.md", "x.manifest.json"]
    assert json.loads(paths[0].read_text())["tables"]["t"]["rows"] == [["a", 0.5], ["b", None]]
    assert "| a | 0.500 |" in paths[1].read_text()
    assert json.loads(paths[2].read_text())["seed"] == 0


def test_positions_and_values_are_inverse():
    problem = made_up(LOOP, "twelve", 1, seed=3, samples=60)[0]
    inside = np.linspace(0.1, 0.9, len(problem.ids))
    assert problem.positions(problem.values(inside)) == pytest.approx(inside)


def test_fits_are_measured_against_the_best_known(monkeypatch):
    monkeypatch.setattr(fit, "PEERS", (("scipy least_squares", optimisers.least_squares), ("gone", gone)))
    tables, skipped = fit.measure(fit.FitSize(windows=2, samples=120, sets=("paper4",), whole_h=0.4), seed=0)
    assert skipped == ("gone: not installed",)
    rows = {row[0].removesuffix(" *"): row for row in tables[0].rows}
    assert {f"ours: {name}" for name in UNTRAINED_CALIBRATORS} <= rows.keys()
    assert all(row[2] >= -1e-9 for row in rows.values())
    assert rows["scipy least_squares"][2] < rows["ours: pso_paper"][2]
    assert {row[0] for row in tables[-2].rows} == set(UNTRAINED_CALIBRATORS)
    assert rows[fit.DESCENT][4] == "100 %"
    assert len(tables[-1].rows) == 4


def test_peers_that_are_here_find_the_optimum():
    for peer in (optimisers.pyswarms_global, optimisers.cma_es, optimisers.differential_evolution):
        problem = made_up(LOOP, "paper4", 1, seed=1, samples=120)[0]
        try:
            found = peer(problem, 0)
        except Absent:
            continue
        assert problem.rmse(found)[0] < 1.1 * problem.rmse(optimisers.refine(problem, problem.truth))[0]


def test_the_papers_experiments_run_beside_its_figures(tmp_path):
    size = paper.PaperSize(
        rigs=("inverse", "stranger"),
        calibrators=("pso", "least_squares"),
        hours=2.5,
        draws=1,
        recovery_h=1.0,
        onset_s=3600.0,
    )
    tables, skipped = paper.measure(size, 0, tmp_path, tmp_path / "no data")
    assert all("HIL_DATA" in line for line in skipped)
    by_key = {table.key: table for table in tables}
    tracking = {row[0].strip(): row for row in by_key["tracking_inverse"].rows}
    assert tracking["paper: tracked"][3] == 0.071
    static, fitted = tracking["by hand: static"], tracking["least_squares, fitted"]
    assert all(a < b for a, b in zip(fitted[1:5], static[1:5], strict=True))
    for change, where in (("modules_heat", "modules"), ("tank_insulation", "tank")):
        assert [row[-2:] for row in by_key[f"{change}_place"].rows] == [(where, "yes")]
        recovered = {row[1]: row[2] for row in by_key[change].rows[1:]}
        assert recovered["least_squares"] <= 2
    assert {row[1]: row[5] for row in by_key["randomised"].rows[1:]}["least_squares"] <= 3
    assert tmp_path.exists() and not any(tmp_path.iterdir())


def test_a_recovery_must_last():
    def window(fitted, ahead):
        return SimpleNamespace(error_K=fitted, error_before_K=ahead)

    windows = [window(0.05, 0.9), window(0.3, 0.05), window(0.05, 0.2), window(0.04, 0.05)]
    assert windows_to_recover(windows, 0.1, ahead=False) == 3
    assert windows_to_recover(windows, 0.1, ahead=True) == 4
    assert windows_to_recover(windows[:2], 0.01, ahead=True) is None


def test_a_record_of_the_virtual_rig_is_made_once(tmp_path):
    load_profile = tmp_path / "short.csv"
    load_profile.write_text(
        "time_s,heater_power_W,pump_speed_pct,fan_speed_pct\n0,700,100,70\n600,700,100,70\n", encoding="utf-8"
    )
    said: list[str] = []
    first = virtual_record(load_profile, "healthy", 5, tmp_path / "cache", said.append)
    again = virtual_record(load_profile, "healthy", 5, tmp_path / "cache", said.append)
    assert first == again and len(said) == 1
    assert [path.name for path in (tmp_path / "cache").iterdir()] == [first.name]
    assert read_record(first).time_s[-1] >= 599.0


def test_public_records_become_tables():
    @dataclass
    class Row:
        name: str
        rmse_K: float

    @dataclass
    class Group:
        name: str
        rows: list[Row]

    flat = list(public.tables_of("records", "Public records", [Row("a", 0.1), Row("b", 0.2)]))
    assert [(t.columns, t.rows) for t in flat] == [(("name", "rmse K"), (("a", 0.1), ("b", 0.2)))]
    nested = list(public.tables_of("records", "Public records", [Group("TCLab", [Row("a", 0.1)])]))
    assert [t.title for t in nested] == ["TCLab", "TCLab: rows"]


def gone(problem, seed):
    raise Absent("gone: not installed")


def test_peers_leave_the_process_as_it_was():
    """Libraries linked with -ffast-math turn denormal numbers off for everybody."""
    try:
        c_peer.library(16, 5)
    except Absent as reason:
        pytest.skip(str(reason))
    assert np.array([2.0**-1030])[0] / 4 > 0.0


def test_networks_that_remember_are_told_from_those_with_an_exponential():
    assert not contestants.remembers(LOOP)
    assert contestants.remembers(variants.nine_volumes())
