"""Inputs that a record takes where the healthy one never was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.discovery.conftest import HOUR, Bench
from tests.hil.made_diagnosis import made
from twin.discovery import diagnose
from twin.discovery.healthy.basis import Columns
from twin.discovery.healthy.operating_range import range_notes, with_range_notes
from twin.kernel import simulate

LIKE = "may always have been so"


def _with(record: Columns, column: int, low: float, high: float) -> Columns:
    inputs = record.inputs.copy()
    inputs[:, column] = np.linspace(low, high, len(inputs))
    return replace(record, inputs=inputs)


@pytest.mark.parametrize(
    ("then", "here", "said"),
    [
        (
            (600.0, 800.0),
            (600.0, 1200.0),
            "heater_power was 604 to 796 W in the healthy record and up to 1188 W here",
        ),
        ((600.0, 800.0), (200.0, 700.0), "heater_power was 604 to 796 W in the healthy record and down to 210 W here"),
        ((600.0, 800.0), (200.0, 1200.0), "and 220 to 1180 W here"),
        ((700.0, 700.0), (200.0, 700.0), "heater_power was 700 W in the healthy record and down to 210 W here"),
        ((600.0, 800.0), (550.0, 850.0), ""),
        ((700.0, 700.0), (690.0, 710.0), ""),
    ],
)
def test_an_input_that_goes_where_it_was_not_in_health_is_told(
    bench: Bench, then: tuple[float, float], here: tuple[float, float], said: str
) -> None:
    good = bench.record(1.0)
    found = range_notes(bench.network, _with(good, 0, *here), _with(good, 0, *then))
    assert [said in note and LIKE in note for note in found] == ([True] if said else [])


def test_a_moment_is_not_told_nor_a_time_of_day(bench: Bench) -> None:
    good = bench.record(1.0)
    brief = good.inputs.copy()
    brief[:5, 0] = 0.0
    assert range_notes(bench.network, replace(good, inputs=brief), good) == []


@pytest.mark.parametrize("verdict", ["effect found", "adequate"])
def test_a_note_stands_beside_what_is_claimed_alone(bench: Bench, verdict: str) -> None:
    good = bench.record(1.0)
    found = with_range_notes(made(verdict), bench.network, _with(good, 0, 0.0, 3000.0), good)
    assert len(found.notes) == (verdict != "adequate") and found.verdict == verdict
    assert not with_range_notes(made(verdict), bench.network, _with(good, 0, 0.0, 3000.0), None).notes


@pytest.mark.parametrize("hot", [True, False])
def test_what_shows_where_no_healthy_rig_was_is_told_with_that(pair: Bench, pair_healthy: Columns, hot: bool) -> None:
    """A thermometer wanders for two hours, while the heater gives more than ever in health or as ever."""
    t, u = pair.inputs(12.0, 5)
    amid = (t > 6.0 * HOUR) & (t < 9.0 * HOUR)
    u[amid, 0] *= 1.8 if hot else 1.0
    rng = np.random.default_rng(6)
    y = simulate(pair.network, t, u, np.array(pair.start_C))
    y += pair.network.sigma * rng.normal(0.0, 1.0, y.shape)
    walk = np.cumsum(rng.normal(0.0, 0.02, len(t)))
    y[amid, 1] += (walk - walk[amid][0])[amid]
    found = diagnose(pair.network, Columns(t, u, y), pair_healthy)
    assert found.verdict != "adequate"
    assert any(LIKE in note for note in found.notes) == hot
