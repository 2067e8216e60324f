"""Changes of unit: found for every tag with a witness, converted, and none invented where the plant itself moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.twin.historian.made_station import START_S, ZONE, Instrument, archived, clean_store, instruments, scanned
from twin.historian.defects import Repaired, find_and_repair
from twin.historian.tags import Array, Series
from twin.historian.units import unit_of

DAY_S = 86400.0
SPAN, LATER = (6.2, 8.3), (11.2, 13.3)


def _found(store: list[Series]) -> Repaired:
    return find_and_repair(store, timezone=ZONE, pressure_kPa=95.0, full_speed="50 Hz")


def _in_unit(value: Array, own: str, other: str) -> Array:
    if other == "Hz":
        return value * 0.5
    a, b = unit_of(own), unit_of(other)
    return np.asarray((a.scale * value + a.offset - b.offset) / b.scale)


def _switched(
    plant: list[Instrument], rng: np.random.Generator, spans: list[tuple[str, str, float, float]]
) -> list[Series]:
    store = []
    for one in plant:
        time_s, value = scanned(one, rng)
        for name, unit, low, high in spans:
            if one.tag.name == name:
                inside = (time_s >= START_S + low * DAY_S) & (time_s <= START_S + high * DAY_S)
                value = np.where(inside, np.round(_in_unit(value, one.tag.unit, unit), 3), value)
        store.append(archived(one, (time_s, value)))
    return store


@pytest.mark.parametrize(
    "switched",
    [
        (("T1IN", "degF"), ("PH", "bar")),
        (("T2OUT", "degF"), ("JP", "hp")),
        (("TSUP", "K"), ("JI1", "W")),
        (("TDB", "degF"), ("F1", "kg/s")),
        (("F2", "gpm"), ("RHA", "1")),
        (("SI1", "Hz"), ("PB", "kPa")),
        (("SC2", "1"),),
    ],
)
def test_a_span_in_another_unit_is_converted(switched: tuple[tuple[str, str], ...]) -> None:
    """One station has two of them, days apart."""
    rng = np.random.default_rng(60)
    plant = instruments(rng, 16.0)
    spans = dict(zip(switched, (SPAN, LATER), strict=False))
    repaired = _found(_switched(plant, rng, [(*which, *span) for which, span in spans.items()]))
    found = [one for one in repaired.defects if one.kind == "unit_switch"]
    assert sorted(one.tags for one in found) == sorted((name,) for name, _ in switched)
    assert [one.kind for one in repaired.defects if one.kind != "unit_switch"] == []
    for (name, _), (low, high) in spans.items():
        one = next(one for one in plant if one.tag.name == name)
        again = next(series for series in repaired.series if series.tag.name == name)
        inside = again.between(START_S + low * DAY_S + 600.0, START_S + high * DAY_S - 600.0)
        off = np.abs(inside.value - np.interp(inside.time_s, START_S + 60.0 * np.arange(len(one.truth)), one.truth))
        assert np.median(off) < 3.0 * max(one.noise, one.deviation)


def test_a_switch_that_lasts_and_one_of_hours_are_found() -> None:
    rng = np.random.default_rng(61)
    spans = [("T1IN", "degF", 5.0, 99.0), ("F1", "L/s", 7.0, 7.3), ("F1", "L/s", 11.0, 12.0)]
    found = [one for one in _found(_switched(instruments(rng, 16.0), rng, spans)).defects if one.kind == "unit_switch"]
    assert sorted(one.tags[0] for one in found) == ["F1", "F1", "T1IN"]
    starts = sorted((one.start_s - START_S) / DAY_S for one in found)
    assert starts == pytest.approx([5.0, 7.0, 11.0], abs=0.02)


def test_tags_of_one_controller_that_change_together_are_all_found() -> None:
    rng = np.random.default_rng(62)
    spans = [("T1IN", "degF", *SPAN), ("T1OUT", "degF", *SPAN), ("T1BAS", "degF", *SPAN)]
    found = _found(_switched(instruments(rng, 16.0), rng, spans)).defects
    assert sorted(one.tags[0] for one in found if one.kind == "unit_switch") == ["T1BAS", "T1IN", "T1OUT"]


def test_a_flow_that_falls_by_the_factor_of_a_unit_with_its_witnesses_is_no_switch() -> None:
    rng = np.random.default_rng(63)
    plant = []
    for one in instruments(rng, 16.0):
        minute = np.arange(len(one.truth)) / 1440.0
        inside = (minute >= 6.0) & (minute <= 8.0)
        share = {"F1": 1.0 / 3.6, "JP": 0.6, "PH": 0.7, "V1": 1.0}.get(one.tag.name, 1.0)
        truth = np.where(inside, one.truth * share, one.truth)
        if one.tag.name == "V1":
            truth = np.where(inside, 45.0, truth)
        plant.append(replace(one, truth=truth))
    store = [archived(one, scanned(one, rng)) for one in plant]
    assert [one.says for one in _found(store).defects if one.kind == "unit_switch"] == []


def test_none_is_invented() -> None:
    found = _found(clean_store(np.random.default_rng(64), 16.0))
    assert [one.says for one in found.defects] == []


@pytest.mark.parametrize(
    ("name", "factor", "late"),
    [("F1", 10.0, True), ("F1", 0.1, False), ("JI1", 10.0, False), ("JI1", 0.1, True), ("JP", 10.0, False)],
)
def test_a_meter_that_is_a_decimal_place_off_is_converted(name: str, factor: float, late: bool) -> None:
    """Of a fan the datasheet tells the wrong part; of a meter without a rating the readings before count as right."""
    rng = np.random.default_rng(21)
    store = clean_store(rng, 12.0)
    middle = START_S + 6.0 * DAY_S
    spoilt = [
        replace(one, value=np.where((one.time_s > middle) == late, factor * one.value, one.value))
        if one.tag.name == name
        else one
        for one in store
    ]
    repaired = find_and_repair(spoilt, timezone=ZONE, full_speed="50 Hz", usual={"JI1": (0.4, 60.0)})
    assert [(one.kind, one.tags) for one in repaired.defects] == [("unit_switch", (name,))]
    healthy, found = (next(one for one in part if one.tag.name == name) for part in (store, repaired.series))
    right = 1.0 if late or name == "JI1" else factor
    restored = right * np.interp(found.time_s, healthy.time_s, healthy.value)
    # Hours at rest about the edge are of either scale.
    assert np.isclose(found.value, restored, rtol=1e-6, atol=1e-6).mean() > 0.85


@pytest.mark.parametrize("factor", [8.0, 12.0])
def test_a_range_near_a_decimal_place_is_not_converted(factor: float) -> None:
    store, late = clean_store(np.random.default_rng(25), 12.0), START_S + 6.0 * DAY_S
    spoilt = [
        replace(one, value=np.where(one.time_s > late, factor * one.value, one.value)) if one.tag.name == "JI1" else one
        for one in store
    ]
    assert not [one for one in _found(spoilt).defects if one.kind == "unit_switch"]


def test_spans_of_another_scale_begin_before_they_end() -> None:
    rng = np.random.default_rng(22)
    store = clean_store(rng, 12.0)
    late = START_S + 6.0 * DAY_S
    spoilt = [
        replace(one, value=np.where(one.time_s > late, 10.0 * one.value, one.value)) if one.tag.name == "JP" else one
        for one in store
    ]
    assert all(one.start_s <= one.end_s for one in _found(spoilt).defects)


@pytest.mark.parametrize("late_is_wrong", [True, False])
def test_of_two_units_with_one_edge_the_datasheet_tells_the_wrong_one(late_is_wrong: bool) -> None:
    rng = np.random.default_rng(23)
    store, middle = clean_store(rng, 12.0), START_S + 6.0 * DAY_S
    spoilt = [
        replace(one, value=np.where((one.time_s > middle) == late_is_wrong, 1000.0 * one.value, one.value))
        if one.tag.name == "JI1"
        else one
        for one in store
    ]
    repaired = find_and_repair(spoilt, timezone=ZONE, full_speed="50 Hz", usual={"JI1": (0.4, 60.0)})
    (found,) = repaired.defects
    assert found.kind == "unit_switch" and found.says == "JI1 is in W instead of kW"
    assert (found.start_s > middle - DAY_S) == late_is_wrong
    (power,) = (one for one in repaired.series if one.tag.name == "JI1")
    assert float(power.value.max()) < 60.0


def test_a_pressure_in_a_range_near_the_factor_of_a_unit_is_not_converted() -> None:
    """Inches of mercury are 2.036 times psi; the other tags know the factor of the span to a per cent."""
    rng = np.random.default_rng(24)
    found = []
    for factor in (1.88, 2.036):
        store = []
        for one in instruments(rng, 16.0):
            if one.tag.name == "PH":
                one = replace(one, tag=replace(one.tag, unit="psi"), truth=one.truth / 6.894757, noise=0.05)
                one = replace(one, resolution=0.01, deviation=0.1)
            time_s, value = scanned(one, rng)
            inside = (time_s >= START_S + SPAN[0] * DAY_S) & (time_s <= START_S + SPAN[1] * DAY_S)
            store.append(archived(one, (time_s, np.where(inside & (one.tag.name == "PH"), factor * value, value))))
        found.append([(one.kind, one.tags, one.repair) for one in _found(store).defects])
    assert found == [[("range_change", ("PH",), "left out")], [("unit_switch", ("PH",), "converted")]]
