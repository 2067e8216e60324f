"""Records for a twin with a law of time: its column of stamps need not be recorded."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.diagnosis.columns import columns_of
from hil.record.reader import Record
from twin.network import Network
from twin.revisions.law_adoption import adopt_law
from twin.twinfile import load

LOOP = Path(__file__).resolve().parents[2] / "profiles" / "twins" / "loop.toml"


@pytest.fixture
def twin() -> Network:
    law = {"kind": "law_heat", "node": "tank", "form": "constant", "course": "step"}
    return adopt_law(load(LOOP), law, {"size": 50.0, "start_s": 100.0}, sample_s=1.0)


def test_stamps_are_an_input_that_no_record_needs(twin: Network) -> None:
    assert "time_s" in twin.input_columns and "time_s" not in twin.recorded_inputs
    time = 5.0 + np.arange(200.0)
    names = (*twin.recorded_inputs, *(c for s in twin.sensors for c in s.measured))
    record = Record(time, {name: np.full(200, 30.0) for name in names})
    found = columns_of(twin, record, None)
    assert np.array_equal(found.inputs[:, twin.input_columns.index("time_s")], time)
