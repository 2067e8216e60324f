"""Room for legends, times of events as the axes have them, and a review that is never older than its run."""

from __future__ import annotations

import os

import pytest
from click.testing import CliRunner

from hil.cli.run_commands.review import command as review
from hil.review.plan import make_plan
from hil.review.plan.legends import fitted_title, with_room_for_legends
from hil.review.plan.styles import Panel, Stack, path
from hil.review.rerun_io import axis_time, read_columns
from tests.hil.ended_run import ended_run
from tests.hil.synthetic_journal import make, put_ticks


def panel(*contents: str, **options: object) -> Panel:
    return Panel("lines", "a panel", contents, **options)


def test_a_longer_label_and_a_narrower_plot_need_more_room():
    labels = {"/a": ("short",), "/b": ("a label that is much longer",)}

    def margin(entity: str, *beside: Panel) -> float:
        tab = with_room_for_legends(Stack("columns", (panel(entity), *beside)), labels)
        return tab.parts[0].margin

    assert 0.0 < margin("/a") < margin("/b") < margin("/b", panel("/a")) < margin("/b", panel("/a"), panel("/a"))


def test_plots_above_one_another_keep_one_axis_and_those_without_a_legend_need_no_room():
    labels = {"/long/one": ("a label that is much longer",)}
    parts = (panel("/a"), panel("/long/**"), Panel("lanes", "lanes", ("/state",)))
    first, second, lanes = with_room_for_legends(Stack("rows", parts), labels).parts
    assert first.margin == second.margin == lanes.margin > 0.1
    alone = with_room_for_legends(Stack("columns", (panel("/long/**", legend=False), panel("/a"))), labels).parts
    assert alone[0].margin == 0.0 < alone[1].margin


def test_bands_of_several_twins_are_of_different_widths_and_colours():
    truth = make(100, twins=("static", "pso", "least_squares"))
    lines = {line.entity: line for line in make_plan(truth.header).lines}
    bands = [lines[path("sensors", "T_tank_C", "band", twin)] for twin in ("pso", "least_squares")]
    assert len({band.widths for band in bands}) == len({band.colours for band in bands}) == 2


def test_actuators_of_the_overview_have_their_colours_in_the_title_and_no_legend():
    plan = make_plan(make(100).header)
    titles = {part.title: part for row in plan.tabs[0].parts if isinstance(row, Stack) for part in row.parts}
    driven = titles["pump_speed (blue), fan_speed (green) [%]"]
    assert not driven.legend
    assert not titles["heater_power (red) [W]"].legend


@pytest.mark.parametrize(
    ("time_s", "text"),
    [(0.0, "+00m 00s"), (59.7, "+01m 00s"), (4200.0, "+1h 10m 00s"), (90061.0, "+1d 1h 01m 01s"), (-5.0, "-00m 05s")],
)
def test_times_of_events_are_written_as_on_the_axes(time_s, text):
    assert axis_time(time_s) == text


def shown(folder) -> int:
    """Ticks in the review that `hil review` leaves, without a display."""
    done = CliRunner().invoke(review, [str(folder.path)], env={"DISPLAY": None, "WAYLAND_DISPLAY": None})
    assert done.exit_code == 0, done.output
    return len(read_columns(folder.review, "/sensors/T_tank_C/measured")[0])


def test_a_review_of_a_live_or_resumed_run_is_made_again_when_the_run_has_gone_on(tmp_path):
    from hil.journal.writer import JournalWriter

    folder, manifest = ended_run(tmp_path / "run", ticks=100, ended=False)
    folder.write_manifest(manifest)
    assert shown(folder) == 100
    truth = make(160)
    writer = JournalWriter(folder.journal, make(100).header, again=True)
    put_ticks(writer, truth, 100, 130)
    writer.commit()
    assert shown(folder) == 130  # live: the rows are in the log still
    put_ticks(writer, truth, 130, 160)
    writer.close()
    assert shown(folder) == 160
    folder.write_manifest(manifest | {"exit_status": "done"})
    made = folder.review.stat().st_mtime_ns
    assert shown(folder) == 160
    assert folder.review.stat().st_mtime_ns == made
    os.utime(folder.review, (1e9, 1e9))
    shown(folder)
    assert folder.review.stat().st_mtime_ns >= made


def test_a_long_name_loses_its_middle_and_the_title_keeps_its_unit() -> None:
    title = "condenser_water_supply_temperature: measured - tracked [K]"
    fitted = fitted_title(title, 350.0)
    assert len(fitted) == 40
    assert fitted.startswith("cond")
    assert fitted.endswith("ture: measured - tracked [K]")
    assert fitted_title(title, 1400.0) == title
