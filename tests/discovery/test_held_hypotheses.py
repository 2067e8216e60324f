"""Hypotheses that are kept from one search to the next, and what is told where a healthy record does not reach."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

from tests.discovery.conftest import Bench
from twin.discovery.evidence.part import Part
from twin.discovery.evidence.search import searched
from twin.discovery.evidence.split_search import with_fewer_effects
from twin.discovery.healthy.basis import Columns, basis
from twin.discovery.records.grid import on_grid


def hypothesis(odds: float, *effects: tuple[str, str, str]) -> SimpleNamespace:
    entries = tuple(
        SimpleNamespace(candidate=SimpleNamespace(kind=kind, where=where, driver=driver))
        for kind, where, driver in effects
    )
    return SimpleNamespace(odds=odds, entries=entries, fit=object())


def test_effects_that_a_shorter_part_showed_are_fitted_in_a_longer_one(bench: Bench, healthy: Columns) -> None:
    """The record shows nothing, so that no scan would lead to them."""
    record = bench.record(8.0, seed=6)
    grid = on_grid(bench.network, record.time_s, record.inputs, record.measured)
    part = Part.of(basis(bench.network, healthy, grid), grid)
    flow = next(e for e in part.scanned if e.candidate.kind == "flow")
    given = (replace(flow, size=0.2 * flow.candidate.upper),)
    assert not any(h.fit is not None and h.labels == (flow.label,) for h in searched(part).hypotheses)
    (fitted,) = [h for h in searched(part, given=(given,)).hypotheses if h.labels == (flow.label,)]
    assert fitted.fit is not None and abs(fitted.entries[0].size) < abs(given[0].size)


def test_of_two_effects_one_is_told_by_another_law_of_its_place() -> None:
    both = hypothesis(100.0, ("sensor", "T_tank_C", "constant"), ("flow", "loop", "constant"))
    other_law = hypothesis(97.0, ("sensor", "T_tank_C", "pump_speed"))
    elsewhere = hypothesis(99.0, ("sensor", "T_heater_C", "constant"))
    unlikely = hypothesis(60.0, ("flow", "loop", "constant"))
    assert with_fewer_effects(both, [both, elsewhere, other_law, unlikely], 96.0) == [other_law]  # type: ignore[arg-type,list-item]
