"""Changes of range: told with tag, time and size, left out, and none made of a step of the plant or a usual bias."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.twin.historian.made_station import START_S, ZONE, Instrument, archived, clean_store, instruments, scanned
from twin.historian.defects import find_and_repair
from twin.historian.defects.panel import panel
from twin.historian.defects.range_changes import range_changes
from twin.historian.defects.range_changes.candidates import LeapCandidate, leap_candidates
from twin.historian.defects.range_changes.judgement import others_moved, return_map, unusual_changes
from twin.historian.defects.range_changes.maps import Leap
from twin.historian.tags import Defect, Series, Tag

DAY_S = 86400.0


def _store(
    plant: list[Instrument], rng: np.random.Generator, changes: list[tuple[str, float, float, float, float]]
) -> list[Series]:
    """Return the samples with changes of tags: name, from and to in days, factor and constant."""
    store = []
    for one in plant:
        time_s, value = scanned(one, rng)
        for name, low, high, factor, constant in changes:
            inside = (time_s >= START_S + low * DAY_S) & (time_s <= START_S + high * DAY_S)
            value = np.where(inside & (one.tag.name == name), factor * value + constant, value)
        store.append(archived(one, (time_s, value)))
    return store


def _running(plant: list[Instrument], first_day: float) -> float:
    """Return a day in the middle of two on which both cells run, and at which the fans turn fast."""
    by_name = {one.tag.name: one.truth for one in plant}
    on = (by_name["ON1"] > 0.5) & (by_name["ON2"] > 0.5)
    steady = np.convolve(on, np.ones(2880), mode="same") > 2879.5
    fast = np.convolve(np.minimum(by_name["SI1"], by_name["SI2"]) > 50.0, np.ones(61), mode="same") > 60.5
    rows = np.flatnonzero(steady & fast)
    return float(rows[rows > first_day * 1440][0]) / 1440.0


def _found(store: list[Series]) -> list[Defect]:
    return list(find_and_repair(store, timezone=ZONE, pressure_kPa=95.0, full_speed="50 Hz").defects)


@pytest.mark.parametrize(
    "changes",
    [
        (("T1OUT", 1.0, 5.0, "5 degC more than it did"), ("F1", 1.37, 0.0, "1.37 times what it did")),
        (("JI1", 1.6, 0.0, "1.6 times what it did"), ("PH", 1.25, 0.0, "1.25 times what it did")),
        (("PB", 1.0, -40.0, "40 hPa less than it did"),),
    ],
)
def test_a_change_of_range_is_told_with_tag_time_and_size(changes: tuple[tuple[str, float, float, str], ...]) -> None:
    """One station has two of them, days apart."""
    rng = np.random.default_rng(70)
    plant = instruments(rng, 20.0)
    days = [_running(plant, first) for first in (6.0, 11.0)][: len(changes)]
    made = [(name, at, 99.0, factor, constant) for (name, factor, constant, _), at in zip(changes, days, strict=True)]
    store = _store(plant, rng, made)
    found = {one.tags: one for one in _found(store)}
    assert [one.kind for one in found.values()] == ["range_change"] * len(changes)
    for (name, _, _, words), at in zip(changes, days, strict=True):
        one = found[name,]
        assert abs(one.start_s - START_S - at * DAY_S) < 3600.0
        assert one.end_s == next(series.time_s[-1] for series in store if series.tag.name == name)
        said = one.says.split(" reads ")[1].split(",")[0].split()
        wanted = words.split()
        assert float(said[0]) == pytest.approx(float(wanted[0]), rel=0.06) and said[1:] == wanted[1:]


def test_readings_in_another_range_are_left_out_and_those_after_its_end_kept() -> None:
    rng = np.random.default_rng(71)
    plant = instruments(rng, 20.0)
    at = _running(plant, 5.0)
    repaired = find_and_repair(
        _store(plant, rng, [("T2OUT", at, at + 0.8, 1.0, 6.0)]), timezone=ZONE, pressure_kPa=95.0, full_speed="50 Hz"
    )
    assert [(one.kind, one.repair) for one in repaired.defects] == [("range_change", "left out")]
    assert repaired.defects[0].end_s == pytest.approx(START_S + (at + 0.8) * DAY_S, abs=3600.0)
    outlet = next(one for one in repaired.series if one.tag.name == "T2OUT")
    truth = next(one for one in plant if one.tag.name == "T2OUT").truth
    off = np.abs(outlet.value - np.interp(outlet.time_s, START_S + 60.0 * np.arange(len(truth)), truth))
    assert off.max() < 3.0
    inside = outlet.between(START_S + (at + 0.05) * DAY_S, START_S + (at + 0.75) * DAY_S)
    assert len(inside.time_s) == 0 and len(outlet.between(START_S + (at + 1.0) * DAY_S, np.inf).time_s) > 1000


def test_a_clean_store_has_no_change_of_range() -> None:
    assert range_changes(clean_store(np.random.default_rng(72), 25.0, cells=3)).defects == []


def test_a_step_that_a_redundant_tag_shares_is_one_of_the_plant() -> None:
    rng = np.random.default_rng(75)
    plant = instruments(rng, 20.0)
    at = _running(plant, 6.0)
    both = [("F1", at, 99.0, 1.4, 0.0), ("V1", at, 99.0, 1.0, 30.0), ("PH", at, 99.0, 1.3, 0.0)]
    assert [one for one in _found(_store(plant, rng, both)) if one.kind == "range_change"] == []


def test_a_bias_that_a_calibration_finds_is_no_change_of_range() -> None:
    rng = np.random.default_rng(76)
    plant = instruments(rng, 20.0)
    at = _running(plant, 6.0)
    assert _found(_store(plant, rng, [("T1OUT", at, 99.0, 1.0, 1.0), ("JI1", at, 99.0, 1.15, 0.0)])) == []


def test_a_change_of_range_is_found_where_the_other_cell_starts_in_the_same_minutes() -> None:
    rng = np.random.default_rng(77)
    plant = instruments(rng, 25.0)
    by_name = {one.tag.name: one.truth for one in plant}
    steady = np.convolve(by_name["ON1"] > 0.5, np.ones(2880), mode="same") > 2879.5
    switched = np.concatenate([[False], np.diff(by_name["ON2"]) != 0.0])
    rows = np.flatnonzero(steady & switched)
    at = float(rows[(rows > 5 * 1440) & (rows < 19 * 1440)][0]) / 1440.0
    found = _found(_store(plant, rng, [("T1OUT", at, 99.0, 1.0, 6.0)]))
    assert [(one.kind, one.tags) for one in found] == [("range_change", ("T1OUT",))]
    assert abs(found[0].start_s - START_S - at * DAY_S) < 3600.0


def test_changes_of_both_cells_are_found_and_end_where_the_readings_come_back() -> None:
    rng = np.random.default_rng(78)
    plant = instruments(rng, 25.0)
    first = _running(plant, 6.0)
    changes = [("T1OUT", first, first + 2.5, 1.0, 7.0), ("T2IN", first + 0.5, first + 3.5, 0.72, 0.0)]
    found = {one.tags[0]: one for one in _found(_store(plant, rng, changes)) if one.kind == "range_change"}
    assert set(found) == {"T1OUT", "T2IN"}
    for name, low, high, _, _ in changes:
        assert abs(found[name].start_s - START_S - low * DAY_S) < 3600.0
        assert abs(found[name].end_s - START_S - high * DAY_S) < 3600.0


@pytest.mark.parametrize("factor", [1.6, 0.65])
def test_a_speed_by_a_factor_of_no_unit_is_not_converted_as_a_frequency(factor: float) -> None:
    rng = np.random.default_rng(79)
    plant = instruments(rng, 20.0)
    found = _found(_store(plant, rng, [("SI1", _running(plant, 6.0), 99.0, factor, 0.0)]))
    assert "unit_switch" not in {one.kind for one in found}


@pytest.mark.parametrize("factor", [1.5, 1.9])
def test_a_range_that_was_changed_while_the_fan_stood_is_found_by_the_law_of_the_fan(factor: float) -> None:
    rng = np.random.default_rng(80)
    plant = instruments(rng, 24.0)
    at = _running(plant, 8.0)
    low, high = round(at * 1440) - 180, round(at * 1440) + 180
    for k, one in enumerate(plant):
        if one.tag.name in ("SC1", "SI1", "JI1"):
            truth = one.truth.copy()
            truth[low:high] = 0.0
            plant[k] = replace(one, truth=truth)
    found = [one for one in _found(_store(plant, rng, [("JI1", at, 99.0, factor, 0.0)])) if one.kind == "range_change"]
    assert [one.tags for one in found] == [("JI1",)]
    assert abs(found[0].start_s - START_S - at * DAY_S) < DAY_S
    assert float(found[0].says.split(" reads ")[1].split()[0]) == pytest.approx(factor, rel=0.06)


def test_a_range_that_begins_in_a_rest_after_few_hours_at_work_is_told_by_its_end() -> None:
    """In the five days before, the fan turned for six hours: too few for other tags, and enough for its law."""
    rng = np.random.default_rng(89)
    plant = instruments(rng, 24.0)
    at = _running(plant, 9.0)
    minute = np.arange(24 * 1440) - round(at * 1440)
    rests, turns = (minute > -5 * 1440) & (minute < 180), (minute > -9 * 60) & (minute < -3 * 60)
    for k, one in enumerate(plant):
        if one.tag.name in ("SC1", "SI1", "JI1"):
            turning = 40.0 * 0.7**3 if one.tag.name == "JI1" else 70.0
            plant[k] = replace(one, truth=np.where(turns, turning, np.where(rests, 0.0, one.truth)))
    end = _running(plant, at + 5.0)
    store = _store(plant, rng, [("JI1", at, end, 0.684, 0.0)])
    found = range_changes(store, full_speed="50 Hz").defects
    assert [one.tags for one in found] == [("JI1",)]
    assert abs(found[0].start_s - START_S - at * DAY_S) < 0.3 * DAY_S
    assert abs(found[0].end_s - START_S - end * DAY_S) < 0.3 * DAY_S


@pytest.mark.parametrize("factor", [0.666, 1.0])
def test_a_speed_of_some_hours_between_rests_is_outvoted_by_command_and_power(factor: float) -> None:
    rng = np.random.default_rng(90)
    plant = instruments(rng, 20.0)
    at = _running(plant, 8.0)
    minute = np.arange(20 * 1440) - round(at * 1440)
    # The fan turns for ten hours between two rests, in which the range is changed and changed back.
    rests = ((minute > -1440) & (minute < 0)) | ((minute > 600) & (minute < 2040))
    for k, one in enumerate(plant):
        if one.tag.name in ("SC1", "SI1", "JI1"):
            plant[k] = replace(one, truth=np.where(rests, 0.0, one.truth))
    store = _store(plant, rng, [("SI1", at - 0.5, at + 1.0, factor, 0.0)])
    found = [one for one in _found(store) if one.kind == "range_change"]
    assert [one.tags for one in found] == [("SI1",)] * (factor != 1.0)
    for one in found:
        assert abs(one.start_s - START_S - at * DAY_S) < DAY_S
        assert abs(one.end_s - START_S - (at + 0.4) * DAY_S) < DAY_S


def test_a_factor_of_a_unit_that_the_search_for_units_missed_is_a_change_of_unit() -> None:
    rng = np.random.default_rng(81)
    plant = instruments(rng, 20.0)
    at = _running(plant, 6.0)
    found = range_changes(_store(plant, rng, [("F1", at, 99.0, 1.0 / 3.6, 0.0)]))
    assert found.ranges == () and [one.defect.says for one in found.units] == ["F1 is in L/s instead of m3/h"]
    assert found.units[0].defect.repair == "converted"


def test_a_change_in_the_minutes_of_a_step_of_the_load_starts_where_its_samples_leap() -> None:
    """The plant moves the other way by a third of the change, within the samples about it."""
    rng = np.random.default_rng(82)
    plant = instruments(rng, 24.0)
    at = _running(plant, 6.0)
    low, high = round(at * 1440) - 3, round(at * 1440) + 240
    for k, one in enumerate(plant):
        if one.tag.name in ("TRET", "T1IN", "T2IN"):
            truth = one.truth.copy()
            truth[low:high] -= np.interp(np.arange(low, high), [low, low + 12, high - 60, high], [0.0, 2.0, 2.0, 0.0])
            plant[k] = replace(one, truth=truth)
    store = _store(plant, rng, [("TRET", at, at + 5.5, 1.0, 5.5)])
    found = [one for one in _found(store) if one.kind == "range_change"]
    assert [one.tags for one in found] == [("TRET",)]
    assert abs(found[0].start_s - START_S - at * DAY_S) < 3600.0
    assert abs(found[0].end_s - START_S - (at + 5.5) * DAY_S) < 3600.0


def test_a_humidity_that_was_saturated_for_a_day_is_right_again_after_it() -> None:
    """The leap to saturation is no measure of the leap back."""
    rng = np.random.default_rng(84)
    minute = np.arange(20 * 1440)
    share = 45.0 + 8.0 * np.sin(2 * np.pi * minute / 1440.0) + 12.0 * np.sin(minute / 2500.0)
    high = np.where((minute > 9 * 1440) & (minute < 10.6 * 1440), 97.0 + np.sin(minute / 40.0), share + 1.0)
    made = [
        Instrument(Tag("RHA", "%", "relative_humidity", None, 120.0), high, 0.3, 0.1, 0.8, "met"),
        Instrument(Tag("RHB", "%", "relative_humidity_redundant", None, 120.0), share, 0.3, 0.1, 0.8, "met"),
    ]
    found = range_changes([archived(one, scanned(one, rng)) for one in made]).defects
    assert [one.tags for one in found] == [("RHA",)]
    assert abs(found[0].start_s - START_S - 9.0 * DAY_S) < 3600.0
    assert abs(found[0].end_s - START_S - 10.6 * DAY_S) < 3600.0


def test_a_leap_may_begin_the_span_that_a_later_one_ends() -> None:
    """Which of two levels is right the first leap tells, also where it was found after the second."""
    n = 10 * 1440
    flow = np.full(n, 700.0)
    flow[3 * 1440 : 7 * 1440] *= 0.5
    one = Instrument(Tag("F1", "m3/h", "water_flow", 1, 120.0), flow, 2.0, 1.0, 9.0, "plc1")
    table = panel([archived(one, scanned(one, np.random.default_rng(86)))])
    time_s = table.series[0].time_s
    begins, ends = (int(np.searchsorted(time_s, START_S + day * DAY_S)) for day in (3.0, 7.0))
    end = Leap(float(time_s[ends - 1]), float(time_s[ends]), 2.0, 0.0, 0.01, False)
    at = LeapCandidate(begins - 1, begins, False)
    assert return_map(table, 0, at, []) is None
    assert return_map(table, 0, at, [end]) == (0.5, 0.0)
    assert return_map(table, 0, LeapCandidate(200, 201, False), [end]) is None


def test_a_cell_whose_fan_trips_for_minutes_has_moved() -> None:
    """Before and after the trip its tags stand as they stood."""
    n = 4 * 1440
    trip = np.zeros(n)
    trip[2000:2028] = 1.0
    basin = np.full(n, 25.0)
    basin[2028:] = 21.0
    rng = np.random.default_rng(85)
    made = [
        Instrument(Tag("XA1", "0/1", "fan_fault", 1, 60.0), trip, 0.0, 1.0, 0.5, "mcc"),
        Instrument(Tag("T1BAS", "degC", "basin_temperature", 1, 120.0), basin, 0.05, 0.01, 0.12, "plc1"),
        Instrument(Tag("T3OUT", "degC", "water_outlet_temperature", 3, 120.0), basin, 0.05, 0.01, 0.12, "plc3"),
        Instrument(Tag("T2BAS", "degC", "basin_temperature", 2, 120.0), basin, 0.05, 0.01, 0.12, "plc2"),
    ]
    table = panel([archived(one, scanned(one, rng)) for one in made])
    unusual = unusual_changes(table)
    at_s = START_S + 2028 * 60.0
    assert others_moved(table, 1, at_s, unusual)  # of its own cell
    assert not others_moved(table, 2, at_s, unusual)
    assert others_moved(table, 3, at_s, unusual)  # water of all cells is in the basin
    assert not others_moved(table, 1, at_s + 6 * 3600.0, unusual)


def test_a_leap_between_two_near_samples_is_one_beside_larger_steps_of_longer_times() -> None:
    """A load that is stored every quarter of an hour moves in it by as much as a leap of three minutes."""
    rng = np.random.default_rng(87)
    apart = np.full(600, 900.0)
    apart[300] = 180.0
    time_s = START_S + np.cumsum(apart)
    wander = np.where(np.arange(600) % 8 < 4, 0.15, -0.15) * (1.0 + 0.1 * rng.standard_normal(600))
    value = 5000.0 * np.exp(wander + np.where(np.arange(600) >= 300, np.log(0.66), 0.0))
    value[298:302] = 5000.0 * np.array([1.0, 1.0, 0.66, 0.66])
    load = Tag("QH", "kW", "station_heat_load", None, 180.0)
    other = Tag("TRET", "degC", "return_header_temperature", None, 180.0)
    good = np.full(600, 192, dtype=np.int16)
    table = panel([Series(load, time_s, value, good), Series(other, time_s, 30.0 + wander, good)])
    assert (299, 300) in [(one.row, one.after) for one in leap_candidates(table, 0)]


def test_the_thermometer_of_a_cell_that_stands_has_no_other_range() -> None:
    """Other water comes and goes about it while none passes, which no other tag shows."""
    rng = np.random.default_rng(88)
    n = 10 * 1440
    water = 30.0 + 2.0 * np.sin(np.arange(n) / 230.0) + 0.8 * np.sin(np.arange(n) / 37.0)
    on = np.ones(n)
    on[5 * 1440 : 8 * 1440] = 0.0
    inlet = water.copy()
    inlet[6 * 1440 : 7 * 1440] -= 4.0
    made = [
        Instrument(Tag("ON1", "0/1", "cell_in_service", 1, 60.0), on, 0.0, 1.0, 0.5, "plc1"),
        Instrument(Tag("T1IN", "degC", "water_inlet_temperature", 1, 120.0), inlet, 0.05, 0.01, 0.12, "plc1"),
        Instrument(Tag("TRET", "degC", "return_header_temperature", None, 120.0), water, 0.05, 0.01, 0.12, "dcs"),
    ]
    store = [archived(one, scanned(one, rng)) for one in made]
    assert range_changes(store).defects == []
    changed = replace(made[1], truth=water + np.where(np.arange(n) > 5 * 1440, 4.0, 0.0))
    store[0] = archived(replace(made[0], truth=np.ones(n)), scanned(replace(made[0], truth=np.ones(n)), rng))
    store[1] = archived(changed, scanned(changed, rng))
    assert [one.tags for one in range_changes(store).defects] == [("T1IN",)]
