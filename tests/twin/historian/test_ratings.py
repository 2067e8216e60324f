"""Tags that are possible in their unit and contradict the datasheet or another tag throughout."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.twin.historian.made_station import clean_store
from twin.historian.plausible import exchanged_meters, in_usual_units
from twin.historian.ratings import Ratings
from twin.historian.tags import Array, Series, Tag

RATINGS = Ratings(water_flow_kg_s=180.0, pressure_kPa=95.0, fan_kW=40.0, motor_kW=45.0, cells=2)


@pytest.fixture(scope="module")
def clean() -> list[Series]:
    return clean_store(np.random.default_rng(5), 8.0)


def judged(
    clean: list[Series], changes: dict[str, Callable[[Array], Array]], units: dict[str, str] | None = None
) -> tuple[set[str], str]:
    """Names of the tags that were left out, and the remarks, of series whose values and units are changed."""
    series = [
        replace(
            one,
            tag=replace(one.tag, unit=(units or {}).get(one.tag.name, one.tag.unit)),
            value=changes.get(one.tag.name, lambda v: v)(one.value),
        )
        for one in clean
    ]
    kept, remarks = in_usual_units(series, {}, RATINGS)
    return {one.tag.name for one in series} - {one.tag.name for one in kept}, " ".join(remarks)


def test_a_station_without_a_wrong_unit_has_no_remark(clean: list[Series]) -> None:
    assert judged(clean, {}) == (set(), "")


@pytest.mark.parametrize(
    ("name", "change", "unit"),
    [
        ("JI1", lambda v: 1000.0 * v, "W"),
        ("JI1", lambda v: v / 0.293071, "kBTU/h"),
        ("SI1", lambda v: 0.6 * v, "Hz"),
        ("QH", lambda v: v / 3.516853, "ton"),
        ("QH", lambda v: v / 0.293071, "kBTU/h"),
        ("PB", lambda v: v * 0.750062, "mmHg"),
        ("PB", lambda v: v * 0.0145038, "psi"),
        ("T1OUT", lambda v: 10.0 * v, "0.1 degC"),
        ("T1IN", lambda v: v + 273.15, "K"),
    ],
)
def test_a_tag_in_another_unit_is_left_out_with_the_unit_to_give(
    clean: list[Series], name: str, change: Callable[[Array], Array], unit: str
) -> None:
    left_out, remarks = judged(clean, {name: change})
    assert left_out == {name}
    assert name in remarks and unit in remarks


@pytest.mark.parametrize("names", [("TDB",), ("TWB",), ("TDB", "TWB")])
def test_a_bulb_in_degc_that_is_called_degf_does_not_go_with_the_humidity(
    clean: list[Series], names: tuple[str, ...]
) -> None:
    left_out, remarks = judged(clean, {}, dict.fromkeys(names, "degF"))
    assert left_out == set(names)
    assert "K off that of TDB" in remarks and "degC" in remarks


def test_a_dry_bulb_whose_zero_changed_for_most_of_the_record_is_in_no_other_unit(clean: list[Series]) -> None:
    """All units that shrink both bulbs would bring them together; the first weeks show that the unit is right."""
    for since in (0.2, 0.4, 0.6):
        shifted = {"TDB": lambda v, since=since: np.where(np.arange(len(v)) > since * len(v), v + 4.0, v)}
        left_out, remarks = judged(clean, shifted)
        assert left_out == set() and remarks == ""


def test_a_power_in_horsepower_is_named_and_used(clean: list[Series]) -> None:
    left_out, remarks = judged(clean, {"JI1": lambda v: v / 0.7457})
    assert left_out == set() and "JI1 is 1.3" in remarks and "give it the unit hp" in remarks


def test_a_flow_far_from_the_design_flow_is_named_and_used(clean: list[Series]) -> None:
    left_out, remarks = judged(clean, {name: (lambda v: v / 3.61) for name in ("F1", "F2")})
    assert left_out in (set(), {"F1", "F2"}) and "F1" in remarks and "kg/s" in remarks


def test_a_meter_whose_range_changed_is_in_no_other_unit_throughout(clean: list[Series]) -> None:
    for name in ("JI1", "JP"):
        left_out, remarks = judged(clean, {name: lambda v: np.where(np.arange(len(v)) > 0.55 * len(v), 10.0 * v, v)})
        assert left_out == set() and remarks == ""


def test_a_fan_whose_range_changed_early_is_in_no_other_unit_throughout(clean: list[Series]) -> None:
    for name in ("JI1", "SI1"):
        left_out, remarks = judged(clean, {name: lambda v: np.where(np.arange(len(v)) > 0.15 * len(v), 1.86 * v, v)})
        assert left_out == set() and remarks == ""


@pytest.mark.parametrize(("factor", "since"), [(2.2, 0.05), (3.0, 0.12), (3.6, 0.12), (3.6, 0.25)])
def test_a_flow_in_another_unit_for_most_of_the_record_leaves_out_no_tag(factor: float, since: float) -> None:
    """It was right before, so that the edge tells its span; by their sum the other cell's flow is not judged."""
    clean = clean_store(np.random.default_rng(5), 20.0)
    series = [
        replace(one, value=np.where(np.arange(len(one.value)) > since * len(one.value), factor * one.value, one.value))
        if one.tag.name == "F1"
        else one
        for one in clean
    ]
    kept, remarks = in_usual_units(series, {}, RATINGS)
    assert {one.tag.name for one in kept} == {one.tag.name for one in series}
    assert not any("F2" in one for one in remarks)


@pytest.mark.parametrize("name", ["T1IN", "T1OUT"])
@pytest.mark.parametrize(("since", "until"), [(0.2, 1.0), (0.6, 1.0), (0.0, 0.7), (0.3, 0.8)])
def test_a_thermometer_in_degf_for_most_of_the_record_is_left_to_the_unit_switches(
    clean: list[Series], name: str, since: float, until: float
) -> None:
    def switched(values: Array) -> Array:
        rows = np.arange(len(values)) / len(values)
        return np.where((rows >= since) & (rows < until), 1.8 * values + 32.0, values)

    assert judged(clean, {name: switched}) == (set(), "")


@pytest.mark.parametrize("factor", [10.0, 0.1])
@pytest.mark.parametrize("late", [True, False])
def test_the_wrong_part_of_an_exchanged_flow_meter_is_left_out(clean: list[Series], factor: float, late: bool) -> None:
    middle = clean[0].time_s[0] + 4.3 * 86400.0
    series = [
        replace(one, value=np.where((one.time_s > middle) == late, factor * one.value, one.value))
        if one.tag.name == "F1"
        else one
        for one in clean
    ]
    kept, (remark,) = in_usual_units(series, {}, RATINGS)
    (flow,) = (one for one in kept if one.tag.name == "F1")
    (whole,) = (one for one in clean if one.tag.name == "F1")
    assert "as of a meter that was exchanged" in remark
    assert abs(len(flow.time_s) - ((whole.time_s > middle) != late).sum()) < 60
    assert np.quantile(flow.value, 0.95) == pytest.approx(np.quantile(whole.value, 0.95), rel=0.1)


def _with_makeup(clean: list[Series], more: float) -> list[Series]:
    """Return a station whose makeup is opened for some minutes an hour; every other two days it flows `1 + more` times
    as much."""
    of = {one.tag.name: one for one in clean}
    time_s = np.arange(of["F1"].time_s[0], of["F1"].time_s[-1], 120.0)
    heat = np.zeros(len(time_s))
    for cell in (1, 2):
        flow, hot, cold = (
            np.interp(time_s, of[name].time_s, of[name].value) for name in (f"F{cell}", f"T{cell}IN", f"T{cell}OUT")
        )
        heat += 4.18 * 0.277 * np.maximum(flow, 0.0) * (hot - cold)
    opens = (time_s // 120.0) % 30 < 6
    by_turns = 1.0 + more * ((time_s // (2.0 * 86400.0)) % 2)
    gone = np.where(opens, 5.0 * np.median(heat) / 2430.0 * by_turns, 0.0)
    tag = Tag("FM", "kg/s", "makeup_flow", None, 120.0)
    return [*clean, Series(tag, time_s, np.round(gone, 2), np.full(len(time_s), 192, dtype=np.int16))]


def test_a_makeup_ten_times_off_does_not_go_with_the_heat(clean: list[Series]) -> None:
    """Its valve opens by turns, and cells of which nothing is recorded draw more of it in some days."""
    station = _with_makeup(clean, 1.4)
    assert judged(station, {}) == (set(), "")
    left_out, remarks = judged(station, {"FM": lambda v: 20.0 * v})
    assert left_out == {"FM"} and "the evaporation which the heat of the cells asks for" in remarks


def test_a_makeup_whose_range_changed_is_a_defect_from_then_on(clean: list[Series]) -> None:
    station = _with_makeup(clean, 0.0)
    middle = station[-1].time_s[0] + 4.3 * 86400.0
    flow = station[-1]
    flow = replace(flow, value=np.where(flow.time_s > middle, 10.0 * flow.value, flow.value))
    assert exchanged_meters(station, RATINGS) == []
    (found,) = exchanged_meters([*station[:-1], flow], RATINGS)
    assert found.kind == "range_change" and found.tags == ("FM",)
    assert abs(found.start_s - middle) < 7200.0 and found.end_s == flow.time_s[-1]


@pytest.mark.parametrize("wrap", [1e9, 65536.0, 1000.0])
@pytest.mark.parametrize("name", ["F1", "JI1"])
def test_a_totaliser_is_no_rate(clean: list[Series], name: str, wrap: float) -> None:
    left_out, remarks = judged(clean, {name: lambda v: np.round(np.cumsum(np.abs(v)) / 12.0, 1) % wrap})
    assert left_out == {name} and "as a totaliser does" in remarks
