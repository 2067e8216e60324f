"""Text exports of LabVIEW and SignalExpress: graphs with a time for each plot, and waveforms with lines above them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.record.reader import Record, RecordError, read_record
from tests.hil.command_line import hil

ROWS = 20
TOP = "waveform\t{names}\nt0\t13/04/2026 10:00:00.000000\t13/04/2026 10:00:00.000000\ndelta t\t{steps}\n\n"


def read(tmp_path: Path, text: str) -> Record:
    path = tmp_path / "exported.txt"
    path.write_text(text, encoding="utf-8")
    return read_record(path)


def rows(cells: str) -> str:
    """Return rows with `{t}` the time in s, `{ms}` in ms, `{clock}` a moment, `{a}` and `{b}` values."""
    return "".join(
        cells.format(
            t=i / 2, late=i / 2 + 0.1, ms=500 * i, clock=f"13/04/2026 10:00:{i / 2:09.6f}", a=20 + i, b=1.5 * i
        )
        + "\n"
        for i in range(ROWS)
    )


@pytest.mark.parametrize("end", ["", "\t"])
@pytest.mark.parametrize(
    ("heading", "cells", "names"),
    [
        ("Time - Tank\tAmplitude - Tank\tTime - Pump\tAmplitude - Pump", "{t}\t{a}\t{t}\t{b}", ("Tank", "Pump")),
        ("Time - Plot 0\tAmplitude - Plot 0\tAmplitude - Plot 1", "{t}\t{a}\t{b}", ("Plot 0", "Plot 1")),
        ("Time (ms) - Tank\tDeg C - Tank\tPower (W) - Pump", "{ms}\t{a}\t{b}", ("Tank_C", "Pump_W")),
    ],
)
def test_a_graph_gives_its_plots_as_channels(tmp_path, heading, cells, names, end):
    record = read(tmp_path, f"{heading}{end}\n" + rows(cells + end))
    assert tuple(record.columns) == names
    np.testing.assert_allclose(record.time_s, np.arange(ROWS) / 2)
    np.testing.assert_allclose(record.columns[names[0]], 20 + np.arange(ROWS))
    np.testing.assert_allclose(record.columns[names[1]], 1.5 * np.arange(ROWS))


def test_plots_with_other_times_keep_them(tmp_path):
    heading = "Time - Tank\tAmplitude - Tank\tTime - Pump\tAmplitude - Pump\n"
    record = read(tmp_path, heading + rows("{t}\t{a}\t{late}\t{b}"))
    assert len(record.time_s) == 2 * ROWS
    known = np.isfinite(record.columns["Pump"])
    np.testing.assert_allclose(record.time_s[known], np.arange(ROWS) / 2 + 0.1)
    assert np.isnan(record.columns["Tank"][known]).all()


@pytest.mark.parametrize(
    ("heading", "cells"),
    [
        ("time\tY[0]\tY[1]\n", "{clock}\t{a}\t{b}"),
        ("time[0]\tY[0]\ttime[1]\tY[1]\n", "{clock}\t{a}\t{clock}\t{b}"),
        ("Y[0]\tY[1]\n", "{a}\t{b}"),
        ("", "{a}\t{b}"),
    ],
)
def test_waveforms_have_the_names_above_them_and_times_by_their_step(tmp_path, heading, cells):
    text = TOP.format(names="Tank\tPump", steps="5.0E-1\t5.0E-1") + heading + rows(cells)
    record = read(tmp_path, text)
    assert tuple(record.columns) == ("Tank", "Pump")
    np.testing.assert_allclose(record.time_s, np.arange(ROWS) / 2, atol=1e-6)
    np.testing.assert_allclose(record.columns["Pump"], 1.5 * np.arange(ROWS))
    assert (record.start is None) == ("{clock}" not in cells)
    code, printed = hil("check", tmp_path / "exported.txt")
    assert code == 0 and f"{ROWS} samples" in printed


@pytest.mark.parametrize(
    ("steps", "said"),
    [
        ("5.0E-1\t2.0E-1", r"line 3 gives channels of different 'delta t', and the rows have no times; export"),
        ("fast\tfast", r"line 3 gives no number for 'delta t', and the rows have no times; export"),
    ],
)
def test_waveforms_without_certain_times_are_refused_with_the_remedy(tmp_path, steps, said):
    with pytest.raises(RecordError, match=said):
        read(tmp_path, TOP.format(names="Tank\tPump", steps=steps) + rows("{a}\t{b}"))


def test_a_bad_row_of_waveforms_is_named_by_its_line_in_the_file(tmp_path):
    broken = rows("{a}\t{b}")
    for value in range(20, 24):
        broken = broken.replace(f"{value}\t", "broken\t")
    with pytest.raises(RecordError, match=r"'Tank' .*line 5, is 'broken'"):
        read(tmp_path, TOP.format(names="Tank\tPump", steps="0.5\t0.5") + broken)


@pytest.mark.parametrize(("units", "names"), [("Unit\tDeg F\tkW\n", ("Tank_F", "Pump_kW")), ("", ("Tank", "Pump"))])
def test_signal_express_names_its_lines_otherwise_and_gives_units(tmp_path, units, names):
    top = "Channel name:\tTank\tPump\nStart time\t04/03/2026 10:00:00\t04/03/2026 10:00:00\nTime increment\t0.5\t0.5\n"
    record = read(tmp_path, top + units + "\n" + rows("{a}\t{b}"))
    assert tuple(record.columns) == names
    np.testing.assert_allclose(record.time_s, np.arange(ROWS) / 2)
    np.testing.assert_allclose(record.columns[names[0]], 20.0 + np.arange(ROWS))
    np.testing.assert_allclose(record.columns[names[1]], 1.5 * np.arange(ROWS))


def test_channels_of_signal_express_with_other_steps_are_refused_by_its_own_tag(tmp_path):
    top = "Channel name:\tTank\tPump\nStart time\tx\tx\nTime increment\t0.5\t0.2\nUnit\tDeg C\tkW\n\n"
    with pytest.raises(RecordError, match=r"line 3 gives channels of different 'Time increment', and the rows"):
        read(tmp_path, top + rows("{a}\t{b}"))
