"""Rigs that the project did not write: commissioned from their data sheets, then diagnosed."""

import json
from pathlib import Path

import pytest

from hil.record import read_record
from tests.twin.conftest import stranger  # noqa: F401
from twin.commission import commission
from twin.datasheet import from_datasheet
from twin.discovery.basis import Columns
from twin.discovery.engine import diagnose


@pytest.mark.parametrize("case", [f"d{k}" for k in range(8)])
def test_a_stranger_is_diagnosed(stranger: Path, case: str) -> None:  # noqa: F811
    key = json.loads((stranger / "KEY.json").read_text())[case]
    twin = from_datasheet(stranger / case / "datasheet.json")
    record = read_record(stranger / case / "commissioning.parquet")
    healthy = Columns.of(twin, record.time_s, record.columns)
    twin = commission(twin, healthy.time_s, healthy.inputs, healthy.measured).network
    record = read_record(stranger / case / "campaign.parquet")
    found = diagnose(twin, Columns.of(twin, record.time_s, record.columns), healthy)
    truth = key["answer"]
    if truth["kind"] == "none":
        assert found.verdict == "adequate"
        return
    assert found.verdict == "effect found"
    (effect,) = found.effects
    assert (effect.kind, effect.where, effect.change) == (truth["kind"], truth["where"], truth["change"])
    assert effect.driver in truth["driver"].split("|")
    assert abs(effect.onset_s - key["onset_s"]) < 1800.0 or effect.onset_interval90_s[0] <= key["onset_s"]
    for error in found.errors.values():
        # A large effect leaves a little of its form; on a small one the floor is reached.
        assert error.after < max(2.2 * error.noise, 0.03 * error.stale)
