"""A source that begins as its place is warmer than ever before may be one that a temperature switches on."""

from __future__ import annotations

from tests.discovery.conftest import Bench
from tests.discovery.plans import run
from twin.discovery.engine import diagnose
from twin.discovery.healthy.basis import Columns

POWERS = (700.0, 640.0, 700.0, 640.0, 700.0, 640.0, 860.0, 800.0, 860.0, 800.0, 860.0, 800.0)
HOURLY = tuple(
    {"time_s": 3600.0 * h, "heater_power_W": p, "pump_speed_pct": 85.0, "fan_speed_pct": 70.0}
    for h, p in enumerate((*POWERS, 0.0))
)


def test_what_begins_at_a_new_highest_temperature_may_have_been_switched(bench: Bench, healthy: Columns) -> None:
    more = bench.with_element("leak", {"kind": "heat_source", "node": "tank", "power": {"value": 60.0}})

    # Half an hour into the highest power so far, the tank is as warm as never before.
    switched = diagnose(bench.network, run(bench.network, HOURLY, more, onset_h=6.5), healthy)
    assert [(e.kind, e.where, e.driver) for e in switched.effects] == [("heat_source", "tank", "constant")]
    other = [a for a in switched.indistinguishable if a.driver == "threshold"]
    assert [(a.kind, a.where) for a in other] == [("heat_source", "tank")] and 0.15 < other[0].confidence < 1.0
    assert any("a temperature may switch it on" in note and "cool below" in note for note in switched.notes)
    assert "a temperature that switches it instead, which is not identifiable from this record" in switched.summary

    # Half an hour into a lower power, no temperature has switched anything on.
    begun = diagnose(bench.network, run(bench.network, HOURLY, more, onset_h=5.5), healthy)
    assert [(e.kind, e.where) for e in begun.effects] == [("heat_source", "tank")]
    assert not [a for a in begun.indistinguishable if a.driver == "threshold"]
