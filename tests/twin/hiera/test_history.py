"""The last two hours of a stream: what was read when, and what was read last."""

from __future__ import annotations

import json

import numpy as np
import pytest

from twin.calibrators.hiera_unet.data.series import STEP_S, filled_forward
from twin.calibrators.hiera_unet.serve.history import LASTS, SPAN_S, History


def stream(seconds: int, lost_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Once a second: two inputs, the second read up to `lost_s` only, and one thermometer."""
    t = np.arange(float(seconds))
    inputs = np.column_stack([t, np.where(t < lost_s, 7.0, np.nan)])
    return t, inputs, np.full((seconds, 1), 30.0)


@pytest.mark.parametrize("pieces", [72, 360])
def test_an_input_counts_as_read_for_a_minute_and_is_remembered_for_ever(pieces: int) -> None:
    """However the stream is cut, and long after its last value has left the history."""
    last_s = 600.0
    history = History(2, 1)
    for part in np.array_split(np.arange(3 * int(SPAN_S)), pieces):
        history.push(*(a[part] for a in stream(3 * int(SPAN_S), last_s)))
        series = history.series()
    assert not np.isfinite(series.inputs[:, 1]).any() and np.isfinite(series.inputs[:, 0]).all()
    assert series.earlier is not None and series.earlier[1] == 7.0
    assert (filled_forward(series.inputs, np.zeros(2), series.earlier)[:, 1] == 7.0).all()
    again = History(2, 1)
    again.restore(json.loads(json.dumps(history.state())))
    assert np.array_equal(again.series().earlier, series.earlier)
    assert np.array_equal(again.series().inputs, series.inputs, equal_nan=True)


def test_a_minute_after_its_last_value_an_input_is_lost() -> None:
    history = History(2, 1)
    history.push(*stream(1200, 600.0))
    read = np.isfinite(history.series().inputs[:, 1])
    assert read.sum() == 600.0 / STEP_S + LASTS and read[: read.sum()].all()


def test_what_is_written_down_when_it_changes_is_never_lost() -> None:
    """A setting that was noted twice in three hours holds, before and after its notes have left the history."""
    t, inputs, measured = stream(3 * 3600, 0.0)
    inputs[[0, 4000], 1] = 3.0, 9.0
    history = History(2, 1)
    for part in np.array_split(np.arange(len(t)), 36):
        history.push(t[part], inputs[part], measured[part])
        series = history.series()
        assert (series.inputs[:, 1] == np.where(series.time < 4000.0, 3.0, 9.0)).all()
