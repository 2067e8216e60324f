"""Swaps of two outlets: found where the thermometers drift apart, and not where a single thermometer errs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from twin.historian.defects.panel import STEP_S, TagPanel
from twin.historian.defects.swaps import _Span, swapped
from twin.historian.events import Event
from twin.historian.tags import Array, Series, Tag

START_S = 1.65e9
DAY = 96
"""Rows of a day."""


def _panel(rng: np.random.Generator, days: int, drift_K: float) -> TagPanel:
    """Return two cells whose outlets follow their fans; the second outlet's reading drifts from a third of the span."""
    n = DAY * days
    hours = np.arange(n) / 4.0
    fans = [50.0 + 25.0 * np.sin(2.0 * np.pi * hours / period) + _rough(rng, n, 8.0) for period in (24.0, 17.0)]
    water = 28.0 + 3.0 * np.sin(2.0 * np.pi * hours / 24.0 + 1.0) + _rough(rng, n, 0.5)
    outlets = [water - 4.0 + 0.02 * (50.0 - fan) + 0.1 * rng.standard_normal(n) for fan in fans]
    outlets[1] = outlets[1] + drift_K * np.clip(np.arange(n) / n - 1.0 / 3.0, 0.0, None)
    names = [("T1", "degC", "water_outlet_temperature", 1), ("T2", "degC", "water_outlet_temperature", 2)]
    names += [
        ("F1", "%", "fan_speed", 1),
        ("F2", "%", "fan_speed", 2),
        ("TW", "degC", "return_header_temperature", None),
    ]
    grid = START_S + STEP_S * np.arange(n)
    values = np.stack([*outlets, *fans, water])
    series = tuple(
        Series(Tag(name, unit, role, cell, 120.0), grid, row, np.full(n, 192, dtype=np.int16))
        for (name, unit, role, cell), row in zip(names, values, strict=True)
    )
    return TagPanel(series, grid, values)


def _series(panel: TagPanel) -> list[Series]:
    """Return the samples of the panel's values."""
    return [replace(one, value=row) for one, row in zip(panel.series, panel.values, strict=True)]


def _rough(rng: np.random.Generator, n: int, size: float) -> Array:
    return size * np.convolve(rng.standard_normal(n + 7), np.ones(8) / np.sqrt(8.0), "valid")


def _entry(panel: TagPanel, row: int) -> Event:
    time_s = float(panel.grid_s[row])
    return Event(time_s - 86400.0, True, 0, "instrument_work", "CMMS", "Transmitters of T1 and T2 exchanged")


def test_a_swap_of_thermometers_that_drift_apart_is_found_with_its_edges() -> None:
    panel = _panel(np.random.default_rng(1), 120, 6.0)
    low, high = 50 * DAY, 58 * DAY
    panel.values[:2, low:high] = panel.values[1::-1, low:high].copy()
    (found,) = swapped(_series(panel), [_entry(panel, low)])
    assert found.tags == ("T1", "T2")
    assert abs(found.start_s - panel.grid_s[low]) < 86400.0 and abs(found.end_s - panel.grid_s[high]) < 2 * 86400.0


def test_a_pair_that_was_exchanged_back_is_not_exchanged_again_with_fewer_witnesses() -> None:
    """What is left of the tags that predict it may contradict the right values; one entry is of one exchange."""
    panel = _panel(np.random.default_rng(1), 60, 0.0)
    low, high = 20 * DAY, 28 * DAY
    (first,) = swapped(_swapped_at(panel, low, high), [_entry(panel, low)])
    contradicted = _swapped_at(panel, low, high - 4 * DAY)
    assert len(swapped(contradicted, [_entry(panel, low)])) == 1
    assert swapped(contradicted, [_entry(panel, low)], [first]) == []


def _swapped_at(panel: TagPanel, low: int, high: int) -> list[Series]:
    """Return the samples with the outlets exchanged between two rows."""
    values = panel.values.copy()
    values[:2, low:high] = values[1::-1, low:high].copy()
    return [replace(one, value=row) for one, row in zip(panel.series, values, strict=True)]


def test_an_edge_does_not_move_over_days_of_right_values() -> None:
    panel = _panel(np.random.default_rng(2), 45, 0.0)
    low, high = 17 * DAY, 25 * DAY
    panel.values[:2, low:high] = panel.values[1::-1, low:high].copy()
    panel.values[0, low - 8 * DAY : low] += 0.3  # a bias that ends where the swap begins
    (found,) = swapped(_series(panel), [_entry(panel, low)])
    assert abs(found.start_s - panel.grid_s[low]) < 6 * 3600.0 and abs(found.end_s - panel.grid_s[high]) < 6 * 3600.0


@pytest.mark.parametrize(("standing_C", "after"), [(14.0, DAY // 2), (40.0, 2 * DAY)])
def test_standing_water_within_a_swap_moves_no_edge(standing_C: float, after: int) -> None:
    """Nothing predicts what a thermometer reads there, so that it is no evidence for either order."""
    for seed in (6, 7):
        panel = _panel(np.random.default_rng(seed), 45, 0.0)
        low, high = 17 * DAY, 25 * DAY
        stop = slice(low + after, low + after + DAY + DAY // 2)
        panel.values[0, stop] = standing_C
        panel.values[:2, low:high] = panel.values[1::-1, low:high].copy()
        on = np.ones(panel.values.shape[1])
        on[stop] = 0.0
        state = replace(panel.series[2], tag=Tag("ON1", "0/1", "cell_in_service", 1, 120.0), value=on)
        (found,) = swapped([*_series(panel), state], [_entry(panel, low)])
        edges = (found.start_s - panel.grid_s[low], found.end_s - panel.grid_s[high])
        assert max(abs(edge) for edge in edges) < 6 * 3600.0


def test_a_single_faulty_thermometer_is_no_swap() -> None:
    panel = _panel(np.random.default_rng(3), 45, 0.0)
    low, high = 20 * DAY, 23 * DAY
    difference = panel.values[0] - panel.values[1]
    panel.values[0, low:high] -= 2.0 * difference[low:high]  # the difference reversed by one of the two alone
    assert swapped(_series(panel)) == []


def test_of_two_pairs_that_a_swap_reverses_the_swapped_one_is_told() -> None:
    """Basins follow the outlets, so that exchanged outlets reverse the prediction of the basins, too."""
    rng = np.random.default_rng(4)
    panel = _panel(rng, 45, 0.0)
    basins = panel.values[:2] + 0.05 * rng.standard_normal((2, panel.values.shape[1]))
    series = [
        *_series(panel),
        *(
            replace(
                one,
                tag=Tag(f"B{k + 1}", "degC", "basin_temperature", k + 1, 120.0),
                value=basins[k],
            )
            for k, one in enumerate(panel.series[:2])
        ),
    ]
    low, high = 17 * DAY, 25 * DAY
    for k in range(2):
        value = series[k].value.copy()
        value[low:high] = panel.values[1 - k, low:high]
        series[k] = replace(series[k], value=value)
    (found,) = swapped(series, [_entry(panel, low)])
    assert found.tags == ("T1", "T2")


def test_two_cells_that_stand_for_hours_were_not_exchanged() -> None:
    """Their thermometers show standing water, whatever the plant predicts; of that, hours prove little."""
    invented = 0
    for seed in range(4, 7):
        rng = np.random.default_rng(seed)
        panel = _panel(rng, 45, 0.0)
        low, high = 20 * DAY, 20 * DAY + 66
        panel.values[2:4, low:high] = np.array([[35.0], [65.0]]) + 0.5 * _rough(rng, 2 * 66, 8.0).reshape(2, 66)
        wanted = 0.02 * (panel.values[3] - panel.values[2])[low:high]
        off = -0.5 - 0.25 * (wanted - wanted.mean()) + 0.1 * rng.standard_normal(66)
        standing = panel.values[4, low:high] - 4.0
        panel.values[0, low:high], panel.values[1, low:high] = standing + 0.5 * off, standing - 0.5 * off
        invented += len(swapped(_series(panel)))
    assert invented == 0


def _shared_basin(rng: np.random.Generator, hot: Sequence[int]) -> list[Series]:
    """Return four cells that drain into a basin of two halves, and which of them is hot on each day.

    Its fan stands; the fans of the others keep the mixture of all at one temperature.
    """
    n = DAY * len(hot)
    excess = 4.0 + _rough(rng, n, 1.0)
    outlets = np.tile(23.0 - excess / 3.0, (4, 1))
    which = np.repeat(np.asarray(hot) - 1, DAY)
    outlets[which, np.arange(n)] = 23.0 + excess
    halves = outlets[:2].mean(axis=0), outlets[2:].mean(axis=0)
    rows = [(f"T{k + 1}", "water_outlet_temperature", k + 1, outlets[k]) for k in range(4)]
    rows += [(f"B{k + 1}", "basin_temperature", k + 1, 0.85 * halves[k // 2] + 0.15 * outlets[k]) for k in range(4)]
    rows.append(("TSUP", "supply_temperature", None, np.full(n, 23.0)))
    grid, good = START_S + STEP_S * np.arange(n), np.full(n, 192, dtype=np.int16)
    return [
        Series(Tag(name, "degC", role, cell, 120.0), grid, value + 0.05 * rng.standard_normal(n), good)
        for name, role, cell, value in rows
    ]


def test_water_of_another_cell_in_a_shared_basin_exchanges_none_of_its_thermometers() -> None:
    """The second cell warms the first one's half for days, as the third one does the fourth one's otherwise."""
    hot = [3, 3, 3, 1, 3, 3, 3, 4] * 5
    hot[22:26] = [2, 2, 2, 2]
    series = _shared_basin(np.random.default_rng(5), hot)
    assert swapped(series) == []
    first, last = series[4], series[7]
    low, high = 10 * DAY, 15 * DAY
    for k, own, other in ((4, first, last), (7, last, first)):
        value = own.value.copy()
        value[low:high] = other.value[low:high]
        series[k] = replace(own, value=value)
    (found,) = swapped(series)
    assert found.tags == ("B1", "B4")
    assert abs(found.start_s - first.time_s[low]) < 3600.0 and abs(found.end_s - first.time_s[high]) < 3600.0


def test_an_edge_that_moves_beyond_the_other_one_moves_neither() -> None:
    """The rows between the beginning and its new place are right, those between the end and its new place are, too."""
    wanted = np.sin(np.arange(400) / 5.0)
    changes = wanted.copy()
    span = _Span(100, 120, 80.0, changes, wanted)
    assert span.moved(100, 120, 150, 300) == (100, 120)


def test_a_pair_that_a_single_faulty_witness_contradicts_was_not_exchanged() -> None:
    """A basin's thermometer tells most of the difference of two outlets, and reads the other way for three days."""
    rng = np.random.default_rng(6)
    n, low, high = 40 * DAY, 20 * DAY, 23 * DAY
    difference, water = _rough(rng, n, 1.0), 28.0 + _rough(rng, n, 1.0)
    basin = np.where((np.arange(n) >= low) & (np.arange(n) < high), -difference, difference)
    rows = [
        ("T1", "water_outlet_temperature", 1, water + difference),
        ("T2", "water_outlet_temperature", 2, water - difference),
        ("B1", "basin_temperature", 1, 20.0 + basin),
        ("TIN1", "water_inlet_temperature", 1, 33.0 + water + 0.3 * difference + 0.5 * rng.standard_normal(n)),
        ("TRET", "return_header_temperature", None, 5.0 + water),
    ]
    grid, good = START_S + STEP_S * np.arange(n), np.full(n, 192, dtype=np.int16)
    series = [
        Series(Tag(name, "degC", role, cell, 120.0), grid, value + 0.05 * rng.standard_normal(n), good)
        for name, role, cell, value in rows
    ]
    assert swapped(series) == []
    first, last = series[0], series[1]
    true = [row[3] for row in rows[:2]]
    series[2] = replace(series[2], value=20.0 + difference + 0.05 * rng.standard_normal(n))
    for k, own, other in ((0, first, true[1]), (1, last, true[0])):
        series[k] = replace(own, value=np.where(basin == difference, own.value, other))
    (found,) = swapped(series)
    assert found.tags == ("T1", "T2")
