"""Comparison of runs: aligned on profile time, differences of good values, drift of parameters, page with plots."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import shutil
import sqlite3
from dataclasses import replace

import numpy as np
import pytest

from hil.comparison import compare_runs, difference_row
from hil.comparison.differences import Difference, aligned
from hil.files import document, plot_data
from hil.journal.writer import JournalWriter
from hil.report import SCRIPT
from hil.report.zoom import thinned
from hil.run_folder.folder import RunFolder
from tests.hil.command_line import typed
from tests.hil.ended_run import ended_run
from tests.hil.made_plan import made_run
from tests.hil.synthetic_journal import make, put_ticks

TICKS = 300


def later(path, *, pause: int, warmer_K: float) -> RunFolder:
    """A run like `ended_run`, its profile paused for `pause` ticks at tick 100, and its tank warmer."""
    path.mkdir(parents=True)
    folder, truth = RunFolder(path), make(TICKS)
    truth.values[:, [signal.column for signal in truth.header.signals].index("T_tank_C")] += warmer_K
    writer = JournalWriter(folder.journal, truth.header)
    writer.state(0, 0.0, 0.0, "restoring", "start", "running", "the test")
    put_ticks(writer, truth, 0, TICKS)
    if pause:
        writer.state(100, 100.0, 99.0, "running", "pause", "paused", "the test")
        writer.state(100 + pause, 100.0 + pause, 99.0, "paused", "resume", "running", "the test")
    writer.close()
    return folder


@pytest.fixture
def runs(tmp_path):
    first, manifest = ended_run(tmp_path / "first", ticks=TICKS)
    first.write_manifest(
        manifest | {"parameters": {"pso": {"tank.hA": (3.0, 0.1, False), "fan.UA": (60.0, 5.0, False)}}}
    )
    second = later(tmp_path / "second <b>", pause=0, warmer_K=1.5)
    second.write_manifest(
        manifest | {"parameters": {"pso": {"tank.hA": (3.5, 0.1, False), "fan.UA": (62.0, 5.0, True)}}}
    )
    return first, second


def test_differences_are_of_good_values_on_profile_time(runs):
    made = compare_runs(runs)
    tank = next(item for item in made.differences if item.column == "T_tank_C")
    assert (tank.bias, tank.rms) == (pytest.approx(1.5), pytest.approx(1.5))
    assert 0.9 < tank.share < 1.0  # stale and lost values are left out
    heater = next(item for item in made.differences if item.column == "T_heater_C")
    assert heater.bias == heater.largest == 0.0
    assert not any(item.column.startswith(("heartbeat", "alarm")) for item in made.differences)


def test_a_pause_shifts_nothing(tmp_path, runs):
    paused = later(tmp_path / "paused", pause=50, warmer_K=0.0)
    shutil.copyfile(runs[0].manifest, paused.manifest)
    made = compare_runs([runs[0], paused])
    before, after = made.data[0], made.data[1]
    assert after.time_s[-1] == before.time_s[-1] - 51.0
    assert (np.diff(after.time_s) == 1.0).all()


def test_runs_of_other_periods_are_aligned_to_the_nearest_tick():
    first = made_run()
    thin = made_run()
    coarse = type(thin)(thin.time_s[::4], {name: x[::4] for name, x in thin.columns.items()}, (), 4.0, thin.duration_s)
    found = aligned(first, coarse, "cycles")
    assert np.abs(found - first.time_s).max() <= 2.0
    assert np.isnan(aligned(first, made_run(100.0), "cycles")[103:]).all()


def test_drift_is_marked_where_it_exceeds_both_intervals(runs):
    made = compare_runs(runs)
    drifts = {drift.parameter: drift for drift in made.drifts}
    assert drifts["tank.hA"].beyond == (False, True)
    assert drifts["fan.UA"].beyond == (False, False)
    assert drifts["tank.hA"].values == (3.0, 3.5)


def test_the_page_runs_its_own_script_alone_and_holds_all_text_as_data(runs, tmp_path):
    out = tmp_path / "out.html"
    done = typed("compare", *(run.path for run in runs), "--out", out)
    assert done.returncode == 0 and "tank.hA (pso): 3 has become 3.5" in done.stdout
    page = out.read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(SCRIPT.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in page and f"<script>{SCRIPT}</script>" in page
    assert page.count("<script>") == 1 and "second &lt;b&gt;" in page and "second <b>" not in page
    assert not re.search(r"https?://", page)
    blocks = [
        json.loads(text) for text in re.findall(r'<script type="application/json" class="plot">(.*?)</script>', page)
    ]
    tank = next(block for block in blocks if block["title"] == "T_tank_C / °C")
    assert [series["name"] for series in tank["series"]] == ["first", "second <b>"]
    assert None in tank["series"][0]["y"]


def test_the_tables_are_there_for_scripts(runs, tmp_path):
    done = typed("compare", *(run.path for run in runs), "--out", tmp_path / "out.html", "--json")
    made = json.loads(done.stdout)
    assert made["runs"] == ["first", "second <b>"] and made["requirements"] is None
    assert {"column", "bias", "rms", "largest", "largest_at_s", "share"} <= set(made["differences"][0])


def test_one_run_and_runs_without_a_common_signal_are_refused(runs, tmp_path):
    done = typed("compare", runs[0].path)
    assert done.returncode == 2 and "two or more" in done.stderr
    assert "is given twice" in typed("compare", runs[0].path, runs[0].path).stderr


@pytest.mark.parametrize("name", ["journal.sqlite", "record.parquet", "notes.jsonl", "diagnosis/diagnosis.json"])
def test_a_page_never_replaces_a_file_of_a_run(runs, name):
    path = runs[1].path / name
    path.parent.mkdir(exist_ok=True)
    before = path.read_bytes() if path.exists() else b"mine"
    path.write_bytes(before)
    done = typed("compare", *(run.path for run in runs), "--out", path)
    assert done.returncode == 2 and "is a file of the run" in done.stderr
    assert path.read_bytes() == before


def test_a_page_goes_to_no_folder_no_missing_one_and_no_other_file(runs, tmp_path):
    notes = tmp_path / "notes.txt"
    notes.write_text("mine", encoding="utf-8")
    link = tmp_path / "page.html"
    link.symlink_to(runs[0].journal)
    for out, said in (
        (tmp_path, "is a folder"),
        (tmp_path / "none" / "c.html", "is no folder that is there"),
        (notes, "is no page"),
        (link, "is a file of the run"),
    ):
        done = typed("compare", *(run.path for run in runs), "--out", out)
        assert done.returncode == 2 and said in done.stderr and len(done.stderr.splitlines()) == 1
    assert notes.read_text(encoding="utf-8") == "mine"


def test_runs_are_named_once_and_noise_is_no_mean_difference(runs, tmp_path):
    done = typed("compare", *(run.path for run in runs), "--out", tmp_path / "c.html")
    assert done.stdout.count("second <b>") == 2  # in the list, and with the parameter that has changed
    assert "run 1: first (reference)" in done.stdout
    item = Difference("T_C", "degC", "second <b>", 1.0, 20.0, 20.0, -6.305e-07, 0.05, 0.1, 3.0)
    made = replace(compare_runs(runs), differences=(item,))
    assert difference_row(made, item)[4] == "0"
    assert difference_row(made, replace(item, bias=-0.0123456))[4] == "-0.01235"
    assert difference_row(made, replace(item, rms=1e-7))[4] == "-6.305e-07"


def test_values_too_large_to_be_squared_leave_a_document(runs, tmp_path):
    database = sqlite3.connect(runs[1].journal)
    database.execute("UPDATE samples SET T_tank_C = 1e300, T_pm1_C = 1.7e308 WHERE tick = 20")
    database.execute("UPDATE samples SET T_pm1_C = -1.7e308 WHERE tick = 21")
    database.commit()
    database.close()
    done = typed("compare", *(run.path for run in runs), "--out", tmp_path / "c.html", "--json")
    assert done.returncode == 0 and done.stderr == ""
    rows = {item["column"]: item for item in json.loads(done.stdout, parse_constant=pytest.fail)["differences"]}
    assert rows["T_tank_C"]["rms"] > 1e298 and rows["T_tank_C"]["largest"] == 1e300


def test_a_thinned_curve_keeps_its_extremes_and_gaps():
    time_s = np.arange(100_000.0)
    values = np.sin(time_s / 500.0)
    values[54_321], values[12_345] = 9.0, np.nan
    at, kept = thinned(time_s, values)
    assert len(at) <= 4000
    assert np.nanmax(kept) == 9.0 and np.isnan(kept).any()
    assert (np.diff(at) > 0).all() and (at[0], at[-1]) == (0.0, 99_999.0)


def test_data_of_a_plot_end_no_element():
    page = document("t", "", [plot_data({"name": "</script><script>alert(1)</script>&amp;"})], "run();")
    assert page.count("</script>") == 2
    with pytest.raises(ValueError):
        document("t", "", [], "if (a < b) {}")
