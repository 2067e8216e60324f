"""The report of a run: every signal in numbers and pictures, times in the unit that fits, and nothing that is empty."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.rig_file import file_sha256
from drivers.signals.points import Quality, Signal
from hil import __version__
from hil.journal.rows import JournalSamples, StateRow
from hil.journal.writer import Header, JournalWriter
from hil.report.actuators import pair_actuators
from hil.report.figures import MEASURED, RunCurves, pictures
from hil.report.limit_lines import LimitLine, limit_lines
from hil.report.page import write_report
from hil.report.statistics import NONE, number, set_against_read, signal_statistics, time_unit
from hil.run.engine.status import Outcome
from hil.run.session.manifest import end_entries
from hil.run_folder.folder import RunFolder, new_manifest
from tests.hil.ended_run import ended_run
from tests.hil.synthetic_journal import make

SIGNALS = (
    Signal("heater_power_set", "W", "setpoint", role="heater_power"),
    Signal("fan_speed_set", "%", "setpoint", role="fan_speed"),
    Signal("heater_power", "W", role="heater_power"),
    Signal("fan_speed", "%", role="fan_speed"),
    Signal("T_a", "degC"),
    Signal("T_dead", "degC"),
)


def samples(ticks: int = 200, period_s: float = 1.0) -> JournalSamples:
    """A heater that reads 2 W less than its set-point, which is raised half way, and a thermometer without a value."""
    time_s = np.arange(ticks) * period_s
    wanted = np.where(time_s < time_s[-1] / 2, 100.0, 300.0)
    values = np.column_stack(
        [wanted, 0 * time_s + 50, wanted - 2.0, 0 * time_s + 50, 20 + 0.01 * time_s, np.nan * time_s]
    )
    quality = np.zeros(values.shape, dtype=np.uint8)
    quality[:, 5] = Quality.SENSOR_FAULT
    values[3:4, 4], quality[3:4, 4] = 900.0, Quality.OUT_OF_RANGE
    return JournalSamples(np.arange(ticks), time_s, values, quality, np.zeros(values.shape))


def header(period_s: float = 1.0) -> Header:
    return Header(SIGNALS, {}, (), "load", 200.0, period_s, {})


def page_of(folder: RunFolder) -> str:
    write_report(folder)
    return folder.report.read_text(encoding="utf-8")


def cells(page: str) -> list[list[str]]:
    return [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in re.findall(r"<tr[^>]*>(.*?)</tr>", page)]


def test_statistics_are_of_good_values_alone():
    found = {s.name: s for s in signal_statistics(header(), samples())}
    warm = found["T_a"]
    assert (warm.least, warm.greatest) == (20.0, pytest.approx(21.99))
    assert (warm.good, warm.unit) == (pytest.approx(0.995), "°C")
    dead = found["T_dead"]
    assert np.isnan([dead.least, dead.mean, dead.greatest]).all()
    assert dead.good == 0.0
    assert list(found) == ["heater_power", "fan_speed", "T_a", "T_dead", "heater_power_set", "fan_speed_set"]


def test_a_read_back_is_held_against_a_set_point_that_has_stood():
    told = samples()
    told.values[100:110, 2] = 0.0  # lags behind the step: no difference of a settled one
    heater, fan = set_against_read(header(), told)
    assert (heater.name, heater.settled_difference, heater.settled_greatest) == ("heater_power", -2.0, -2.0)
    assert (fan.set_mean, fan.read_mean, fan.settled_difference) == (50.0, 50.0, 0.0)
    short = set_against_read(header(), samples(10))[0]
    assert np.isnan(short.settled_difference)


@pytest.mark.parametrize(
    ("duration_s", "symbol"), [(0.0, "s"), (100.0, "s"), (700.0, "min"), (8000.0, "min"), (4e4, "h"), (1e6, "d")]
)
def test_times_are_in_the_unit_that_fits(duration_s, symbol):
    assert time_unit(duration_s).symbol == symbol


def test_a_number_that_is_not_known_is_a_dash():
    assert [number(value) for value in (None, float("nan"), float("inf"), 1.25)] == [NONE, NONE, NONE, "1.25"]


def made(path, told: JournalSamples, about: Header) -> RunFolder:
    """A run without a twin, of these samples."""
    path.mkdir()
    folder = RunFolder(path)
    writer = JournalWriter(folder.journal, about)
    for k, tick in enumerate(told.tick.tolist()):
        row = (told.values[k].tolist(), told.quality[k].tolist(), told.source_time_s[k].tolist())
        writer.sample(tick, float(told.time_s[k]), 1e9 + k, 0.001, *row)
    writer.event(0, 0.0, "INFO", "begun")
    writer.close()
    folder.write_manifest(new_manifest({}, network_mode="shadow"))
    return folder


def test_a_run_without_a_twin_shows_every_signal_in_numbers_and_pictures(tmp_path):
    page = page_of(made(tmp_path / "run", samples(), header()))
    rows = {row[0]: row for row in cells(page) if row}
    assert {signal.name for signal in SIGNALS} <= set(rows)
    assert rows["T_dead"] == ["T_dead", "°C", NONE, NONE, NONE, "0.0%"]
    assert rows["T_a"][:3] == ["T_a", "°C", "20"]
    assert "<h2>Set against read</h2>" in page
    assert "<h2>Signals</h2><img" in page
    assert "<h2>Set-points and read-backs</h2><img" in page
    assert "Measured against twin" not in page
    assert "nan" not in re.sub(r"base64,[^\"]*|Provenance", "", page)
    assert rows["0.00 min"][2] == "begun"


def test_a_report_names_the_twin_and_the_version_in_its_first_table(tmp_path):
    folder = made(tmp_path / "run", samples(), header())
    twin = tmp_path / "bench_twin.toml"
    twin.write_text("x = 1\n")
    folder.write_manifest(new_manifest({"twin": twin}, network_mode="shadow"))
    head = cells(page_of(folder).split("</table>")[0])
    assert ["twin", f"{twin} (sha256 {file_sha256(twin)[:16]})"] in head
    assert ["made by", f"hil {__version__}"] in head


def test_a_report_states_what_the_meters_did_not_follow(tmp_path):
    folder = made(tmp_path / "run", samples(), header())
    said = "heater_power_set asked for 100 W in the mean and heater_power read -0.4 W"
    manifest = new_manifest({}, network_mode="shadow")
    folder.write_manifest(manifest | {"exit_status": "done with deviations", "deviations": [said], "safe": True})
    assert f'<p class="WARN">{said}</p>' in page_of(folder)


def test_a_report_of_a_run_that_ended_before_it_wrote_anything_alarms_nobody(tmp_path):
    folder = made(tmp_path / "run", samples(), header())
    manifest = new_manifest({}, network_mode="shadow")
    entries = end_entries(folder, manifest, Outcome("aborted", "stopped by SIGTERM", untouched=True), None, 0.2)
    assert entries["safe"] is None
    folder.write_manifest(manifest | entries)
    page = page_of(folder)
    assert "stopped by SIGTERM. It had written nothing to the rig." in page and "NOT confirmed safe" not in page


def test_a_set_point_stands_beside_the_read_back_that_the_rig_file_declares():
    signals = (
        Signal("heater_1", "%", "setpoint", readback="P1"),
        Signal("heater_2", "%", "setpoint"),
        Signal("heater_1_old", "%"),
        Signal("P1", "%"),
    )
    pairs = pair_actuators(signals)
    assert [signal.name for signal in pairs["heater_1"]] == ["heater_1", "P1"]
    assert [signal.name for signal in pairs["heater_2"]] == ["heater_2"]


def test_curves_that_zoom_have_the_unit_of_the_pictures(tmp_path):
    page = page_of(made(tmp_path / "run", samples(period_s=30.0), header(30.0)))
    assert "<h2>Curves that zoom, over record time / min</h2>" in page
    assert '"range":[0.0,99.5]' in page
    assert '"unit":"min"' in page and "this.d.unit" in page  # of the reading beside the cursor
    on_paper = page[page.index("@media print") : page.index("</style>")]
    assert ".screen { display: none }" in on_paper and "overflow: visible" in on_paper
    assert page.count('<div class="screen"><h2>Curves that zoom') == 1


def test_settings_are_shown_as_people_read_them(tmp_path):
    folder = made(tmp_path / "run", samples(), header())
    settings = {"virtual": True, "control": None, "calibrators": ["pso", "least_squares"], "seed": 0, "left_out": {}}
    folder.write_manifest(folder.read_manifest() | {"settings": settings})
    write_report(folder)
    found = {row[0]: row[1] for row in cells(folder.report.read_text(encoding="utf-8")) if len(row) == 2}
    assert [found[name] for name in settings] == ["yes", NONE, "pso, least_squares", "0", NONE]


@pytest.mark.parametrize("ticks", [0, 1, 2, 5])
def test_the_shortest_runs_are_reported(tmp_path, ticks):
    told = samples(max(ticks, 1))
    if not ticks:
        told = JournalSamples(told.tick[:0], told.time_s[:0], told.values[:0], told.quality[:0], told.source_time_s[:0])
    page = page_of(made(tmp_path / "run", told, header()))
    assert "nan" not in re.sub(r"base64,[^\"]*|Provenance", "", page)


def test_a_run_with_twins_shows_them_the_pump_and_the_fan(tmp_path):
    folder, manifest = ended_run(tmp_path / "run", ticks=900)
    folder.write_manifest(manifest | {"errors_K": {"columns": ["static"], "rows": {"T_x": [None]}, "noise_K": {}}})
    page = page_of(folder)
    for heading in (
        "Measured against twin",
        "Residual (measured - twin), means of 45 s",
        "Signals",
        "Set against read",
    ):
        assert f"<h2>{heading}</h2>" in page
    assert ["T_x", NONE, NONE] in cells(page)
    assert {"pump_speed", "fan_speed", "heater_power"} <= {row[0] for row in cells(page) if len(row) == 6}


class Drawn:
    """What is handed to matplotlib: the curves of every figure, axes by axes."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.axes: list[list[object]] = []
        monkeypatch.setattr("hil.report.figures._embedded", self._keep)

    def _keep(self, figure) -> str:
        self.axes += [axes.get_lines() for axes in figure.axes]
        self.labels = [axes.get_ylabel() for axes in figure.axes]
        return ""


def curves(ticks: int = 300, **changes: object) -> RunCurves:
    truth = make(ticks)
    told = JournalSamples(np.arange(ticks), truth.time_s, truth.values, truth.quality, np.zeros(truth.values.shape))
    columns = [signal.column for signal in truth.header.signals]
    measured = {"T_tank_C": truth.values[:, columns.index("T_tank_C")]}
    twins = {name: values[:, 3:] for name, values in truth.twins.items()}
    return replace(
        RunCurves(truth.header, told, measured, twins, np.zeros(0, dtype=np.int64), time_unit(ticks)), **changes
    )


def test_the_measured_curve_is_above_the_tracked_ones(monkeypatch):
    drawn = Drawn(monkeypatch)
    pictures(curves())
    lines = {line.get_label(): line for line in drawn.axes[0]}
    assert lines["measured"].get_color() == MEASURED
    others = [line for label, line in lines.items() if label != "measured"]
    assert others
    assert all(lines["measured"].get_zorder() > line.get_zorder() for line in others)
    assert all(lines["measured"].get_linewidth() < line.get_linewidth() for line in others)


def test_no_plot_is_empty(monkeypatch):
    drawn = Drawn(monkeypatch)
    pictures(curves(measured={"T_tank_C": np.full(300, np.nan)}, twins={"static": np.full((300, 1), np.nan)}))
    assert drawn.axes
    assert all(
        np.isfinite(line.get_ydata()).any() for lines in drawn.axes for line in lines if len(line.get_ydata()) > 2
    )
    assert all(lines for lines in drawn.axes)


def test_many_signals_of_one_unit_take_several_plots_and_long_names_are_cut_in_the_middle(monkeypatch):
    drawn, names = Drawn(monkeypatch), [f"T_{'of_the_condenser_' * 5}{k:02d}" for k in range(19)]
    told = curves().samples
    values = np.zeros((300, len(names))) + np.arange(len(names))
    told = replace(told, values=values, quality=np.zeros(values.shape, dtype=np.uint8), source_time_s=values)
    about = replace(curves().header, signals=tuple(Signal(name, "degC") for name in names), twin_sensors={})
    pictures(curves(header=about, samples=told, measured={}, twins={}))
    labels = [[line.get_label() for line in lines] for lines in drawn.axes]
    assert [len(row) for row in labels] == [8, 8, 3]
    shown = [label for row in labels for label in row]
    assert len(set(shown)) == len(names) and max(map(len, shown)) <= 40


def test_a_curve_is_broken_where_the_run_was_cut(monkeypatch):
    drawn = Drawn(monkeypatch)
    pictures(curves(cuts=np.array([150])))
    line = next(line for line in drawn.axes[0] if line.get_label() == "measured")
    at = np.flatnonzero(np.isnan(line.get_ydata()))
    assert at[0] == 150
    assert np.isfinite(line.get_ydata()[[149, 151]]).all()
    assert line.get_xdata()[at[0] + 1] == 150.0 / time_unit(300).seconds


LINE = {"columns": ["T_tank_C"], "levels": [60.0], "from_s": 10.0, "to_s": 20.0}
LIMITS = [{"id": "hot", "verdict": "fail", "line": LINE}, {"id": "old", "verdict": "pass"}]
FAILED = {"tests": [{"id": "p", "limits": LIMITS}]}


def test_the_time_of_a_limit_is_that_of_the_record_where_the_profile_stood():
    def row(tick: int, profile_s: float, target: str) -> StateRow:
        return StateRow(tick, tick, float(tick), 0.0, profile_s, "", "", target, "")

    ticks = np.arange(100), np.arange(100.0)
    held = [row(0, 0.0, "running"), row(15, 15.0, "held"), row(45, 15.0, "running")]
    (line,) = limit_lines(FAILED, held, ticks, 1.0)
    assert (line.name, line.from_s, line.to_s, line.is_broken) == ("hot", 10.0, 50.0, True)
    assert limit_lines(FAILED, held, (np.arange(0), np.zeros(0)), 1.0) == ()
    two = {"tests": [*FAILED["tests"], {"id": "q", "limits": []}]}
    (line,) = limit_lines(two, [], ticks, 1.0)
    assert (line.name, line.to_s) == ("p/hot", 20.0)


def test_a_level_far_from_the_curves_is_named_and_does_not_flatten_them(monkeypatch):
    figures: list[Any] = []
    monkeypatch.setattr("hil.report.figures._embedded", lambda figure: figures.append(figure) or "")
    line = LimitLine("hot", frozenset({"T_tank_C"}), (1000.0,), 0.0, 300.0, True, ((5.0, 9.0),))
    pictures(curves(limits=(line, replace(line, name="near", levels=(20.0,), is_broken=False))))
    axes = figures[0].axes[0]
    assert axes.get_ylim()[1] < 500.0
    assert {text.get_text() for text in axes.texts} == {"near", "beyond this axis: hot 1000"}
    assert not any(axes.texts for axes in figures[-1].axes)
