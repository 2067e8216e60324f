"""Leads: where to look in what no effect explains, and none in noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from hil.diagnosis.page import page
from hil.diagnosis.store import Findings, curves_of
from hil.diagnosis.terminal.report import print_diagnosis
from hil.tracking.twins import disturbance
from tests.discovery.conftest import Bench
from tests.discovery.test_records import TWINS, cooler
from twin.discovery.diagnosis import Course
from twin.discovery.effects.statement import disturbance_statement
from twin.discovery.engine import diagnose
from twin.discovery.growing.answer import diagnose_grown
from twin.discovery.healthy.basis import Columns
from twin.discovery.leads.concentration import ResidualSquares, input_ranges, segments
from twin.discovery.leads.rows import near_steps, suspicious_inputs, suspicious_readings, suspicious_states
from twin.discovery.leads.words import place_leads
from twin.network import Array
from twin.twinfile import load

SEEDS, CHANCE = 100, 4
"""Records of noise, and how many may give a lead: at one in a hundred, more do so once in three hundred tries."""
BLOCKS, SENSORS = 120, 3


def _white(seed: int) -> Array:
    return np.random.default_rng(seed).standard_normal((BLOCKS, SENSORS))


def _squares(white: Array) -> ResidualSquares:
    known = np.isfinite(white)
    return ResidualSquares((np.where(known, white, 0.0) ** 2).sum(axis=1), known.sum(axis=1))


def _inputs(seed: int) -> Array:
    """Levels that are held for some blocks, and one that wanders."""
    rng = np.random.default_rng(seed + 1000)
    return np.column_stack(
        [
            rng.choice([60.0, 80.0, 100.0], BLOCKS // 4).repeat(4),
            rng.choice([500.0, 700.0], BLOCKS // 3).repeat(3),
            rng.standard_normal(BLOCKS).cumsum(),
        ]
    )


def test_noise_gives_no_segment_and_no_range_beyond_its_level() -> None:
    squares = [_squares(_white(seed)) for seed in range(SEEDS)]
    assert sum(bool(segments(s)) for s in squares) <= CHANCE
    assert sum(bool(input_ranges(s, _inputs(k), 5)) for k, s in enumerate(squares)) <= CHANCE
    assert sum(bool(input_ranges(s, _inputs(k), None)) for k, s in enumerate(squares[:30])) <= CHANCE


@pytest.mark.parametrize("spans", [[(40, 52)], [(0, 9)], [(100, 120)], [(20, 30), (70, 84)]])
@pytest.mark.parametrize("off", [3.0, 30.0])
def test_squares_in_known_blocks_are_found_there(spans: list[tuple[int, int]], off: float) -> None:
    white = _white(7)
    for first, last in spans:
        white[first:last] += off
    found = segments(_squares(white))
    assert len(found) == len(spans)
    for one, (first, last) in zip(found, spans, strict=True):
        rows = np.flatnonzero(one.rows)
        assert abs(rows[0] - first) <= 1 and abs(rows[-1] + 1 - last) <= 1
        assert one.of_record == pytest.approx((last - first) / BLOCKS, abs=0.02)
    assert sum(one.share for one in found) > 0.9


def test_a_misfit_of_one_size_all_over_has_no_segment() -> None:
    assert segments(_squares(5.0 * _white(3))) == ()


def test_a_gap_is_no_change() -> None:
    white = _white(4)
    white[30:60] = np.nan
    assert segments(_squares(white)) == ()
    white[25:30] *= 20.0
    white[60:65] *= 20.0
    (found,) = segments(_squares(white))
    assert np.flatnonzero(found.rows)[[0, -1]].tolist() == [25, 64]
    assert found.of_record == pytest.approx(10 / 90)


def test_a_range_of_an_input_is_found_and_no_other_input() -> None:
    white, inputs = _white(5), _inputs(5)
    white[inputs[:, 0] > 90.0] *= 2.5
    ((column, found),) = input_ranges(_squares(white), inputs, 5)
    assert column == 0 and set(inputs[found.rows, 0]) == {100.0}
    assert found.share > 0.9


def test_a_range_in_the_middle_of_what_an_input_wanders_through_is_found() -> None:
    rng = np.random.default_rng(8)
    wander = 50.0 + 40.0 * np.sin(np.arange(BLOCKS) / 3.0) + rng.normal(0.0, 2.0, BLOCKS)
    white = _white(9)
    there = (wander > 35.0) & (wander < 60.0)
    white[there] *= 4.0
    ((_, found),) = input_ranges(_squares(white), wander[:, None], 3)
    assert (found.rows == there).mean() > 0.9


def test_a_time_is_not_taken_for_a_range() -> None:
    """In some hours every input has some value; one that rises all along has one of its own."""
    named: list[int] = []
    for seed in range(40):
        white = _white(seed)
        white[50:62] *= 4.0
        inputs = np.column_stack([_inputs(seed), np.linspace(20.0, 24.0, BLOCKS)])
        named += [column for column, _ in input_ranges(_squares(white), inputs, 5)]
    # At one in twenty, more than six of forty do so once in a hundred tries.
    assert len(named) <= 6 and 3 not in named


def _readings(seed: int, rows: int = 1500) -> tuple[Array, Array, Array]:
    """Times, readings of a rig that drifts and steps, and what its twin gives."""
    time = 5.0 * np.arange(rows)
    drift = 40.0 + 3.0 * np.sin(time / 900.0)[:, None] + np.where(time > 3000.0, 6.0, 0.0)[:, None]
    noise = np.random.default_rng(seed).normal(0.0, 0.05, (rows, SENSORS))
    return time, drift + noise, np.broadcast_to(drift, noise.shape).copy()


def test_noise_steps_and_drifts_give_no_single_row() -> None:
    sigma = np.full(SENSORS, 0.05)
    drawn = [_readings(seed) for seed in range(SEEDS)]
    assert sum(bool(suspicious_readings(*one, sigma)) for one in drawn) <= CHANCE
    # So do readings that are rounded, and a twin that is off.
    assert sum(bool(suspicious_readings(t, y.round(1), s + 1.0, sigma)) for t, y, s in drawn) <= CHANCE
    assert sum(bool(suspicious_inputs(t, y, sigma)) for t, y, _ in drawn) <= CHANCE
    states = [np.random.default_rng(s).normal(0.0, 1.0, (24, 2)) for s in range(SEEDS)]
    assert sum(bool(suspicious_states(x, np.full(2, 0.1))) for x in states) <= CHANCE


def test_a_spike_and_a_row_in_which_all_readings_jump_are_named() -> None:
    time, measured, simulated = _readings(1)
    measured[400, 1] += 1.0
    measured[900] += 0.22
    first, second = suspicious_readings(time, measured, simulated, np.full(SENSORS, 0.05))
    assert (first.row, first.columns) == (400, (1,)) and first.off[0] == pytest.approx(1.0, abs=0.2)
    assert second.row == 900 and first.times > second.times


def test_a_reading_that_moves_with_its_twin_is_not_suspicious() -> None:
    time, measured, simulated = _readings(2)
    measured[300] += 2.0
    simulated[300] += 2.0
    assert suspicious_readings(time, measured, simulated, np.full(SENSORS, 0.05)) == ()


def test_an_input_that_drops_for_a_row_is_named_unless_it_does_so_by_nature() -> None:
    time = 5.0 * np.arange(1000)
    held = np.where(time < 2000.0, 700.0, 500.0)[:, None].copy()
    least = np.array([100.0])
    held[700] += 1.0
    assert suspicious_inputs(time, held, least) == ()
    held[600] = 0.0
    (found,) = suspicious_inputs(time, held, least)
    assert (found.row, found.off) == (600, (-500.0,))
    held[50::100] = 0.0
    assert suspicious_inputs(time, held, least) == ()


@pytest.mark.parametrize("hold", [30, 700])
def test_noise_in_proportion_to_the_level_of_an_input_names_no_row(hold: int) -> None:
    """A power meter of a percentage of its reading, under loads that are held for long or not."""
    named, seeds = 0, 20
    time = np.arange(21_000) * 1.0
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        level = np.repeat(rng.choice([100.0, 400.0, 800.0, 1200.0, 2000.0], len(time) // hold), hold)
        power = (level * (1.0 + 0.003 * rng.standard_normal(len(level))))[:, None]
        named += bool(suspicious_inputs(time, power, np.array([100.0])))
        power[5000] += 80.0
        assert any(found.row == 5000 for found in suspicious_inputs(time, power, np.array([100.0])))
    assert named <= 2


def test_rows_beside_a_step_of_an_input_are_known_and_noise_and_ramps_make_none() -> None:
    rng = np.random.default_rng(8)
    inputs = np.column_stack([np.repeat([40.0, 80.0], 300), rng.normal(50.0, 1.0, 600), np.linspace(0.0, 100.0, 600)])
    near = near_steps(inputs, np.array([1.0, 0.1, 1.0]))
    assert np.flatnonzero(near).tolist() == [298, 299, 300, 301]
    assert not near_steps(inputs[:, 1:], np.array([0.1, 1.0])).any()


def test_one_state_off_among_many_is_named_and_a_twin_that_fits_none_names_none() -> None:
    left = np.random.default_rng(3).normal(0.0, 2.0, (24, 2))
    assert suspicious_states(left, np.full(2, 0.1)) == ()
    left[13, 1] = 25.0
    (found,) = suspicious_states(left, np.full(2, 0.1))
    assert (found.row, found.columns, found.off) == (13, (1,), (25.0,))


def test_place_sign_and_course_are_told_in_the_words_of_tracking() -> None:
    hours = np.arange(30) / 6.0
    course = Course("tank", "W", hours, np.full(30, -44.0), np.full(30, 3.0), 900.0, "energy", "tank")
    description = {
        "mean": -44.0,
        "range": [-57.0, -32.0],
        "onset_s": 7200.0,
        "driver": "fan_speed",
        "follows": {"fan_speed": -0.9},
    }
    (lead,) = place_leads((course,), description, 0.0)
    assert (lead.kind, lead.where, lead.unit) == ("place", "tank", "W")
    assert lead.says == (
        "tank takes up 44 W on average (32 to 57) that the twin does not model, from 2 h 00 min on; "
        "it falls where there is more of fan speed"
    )
    assert place_leads((), description, 0.0) == ()


@pytest.mark.parametrize(
    ("value", "unit", "interval", "text"),
    [
        (44.0, "W", (32.0, 57.0), "tank gives off 44 W (32 to 57) that the twin does not model, from 1 h 00 min on"),
        (-0.187, "W", None, "tank takes up 0.19 W that the twin does not model, from 1 h 00 min on"),
        (-0.5, "K", (-0.6, -0.4), "tank reads too low by 0.5 K (0.4 to 0.6), from 1 h 00 min on"),
        (0.12, "of the nominal flow", None, "tank has 12 % of the nominal flow more than the twin models, from 1 h"),
    ],
)
def test_tracking_and_diagnosis_state_alike_where_something_enters(
    value: float, unit: str, interval: tuple[float, float] | None, text: str
) -> None:
    said = disturbance_statement("tank", value, unit, interval, 3600.0)
    assert said.startswith(text)
    if unit == "W":
        window = {"disturbed": "tank", "disturbed_W": value, "disturbed_since_s": 3600.0}
        assert disturbance(window | {"disturbed_interval90_W": interval}) == said


def test_a_course_that_goes_both_ways_has_no_mean() -> None:
    assert disturbance_statement("T_tank_C", 0.006, "K", (-0.49, 0.48), 0.0, average=True) == (
        "T_tank_C is off by between -0.49 K and 0.48 K"
    )
    assert "on average" in disturbance_statement("T_tank_C", 0.2, "K", (-0.01, 0.8), 0.0, average=True)


def test_a_cause_that_cannot_be_described_has_its_leads_in_json_terminal_and_page(
    slow_pair: Bench, slow_pair_healthy: Columns
) -> None:
    """A reading in error now and then within two hours, one lost command, one spike, and a room as it never was."""
    record = slow_pair.record(8.0)
    hours, measured, inputs = record.time_s / 3600.0, record.measured.copy(), record.inputs.copy()
    for first, last in ((3.0, 3.5), (3.8, 4.1), (4.5, 5.0)):
        measured[(hours > first) & (hours < last), 1] += 0.8
    measured[1000, 0] += 3.0
    inputs[2000, 0] = 0.0
    found = diagnose(slow_pair.network, replace(record, measured=measured, inputs=inputs), slow_pair_healthy)
    assert (found.effects[0].where, found.effects[0].shape) == ("T_tank_C", "own course")
    by = {kind: [lead for lead in found.leads if lead.kind == kind] for kind in {lead.kind for lead in found.leads}}
    assert set(by) == {"segment", "place", "row"}
    assert min(lead.low for lead in by["segment"]) == pytest.approx(3.0 * 3600.0, abs=900.0)
    assert max(lead.high for lead in by["segment"]) == pytest.approx(5.0 * 3600.0, abs=900.0)
    assert sum(lead.share for lead in by["segment"]) > 0.8
    assert by["place"][0].where == "T_tank_C" and "reads too high by" in by["place"][0].says
    assert {(lead.where, lead.low) for lead in by["row"]} == {("heater_power_W", 10000.0), ("T_modules_C", 5000.0)}
    first = found.effects[0]
    since = first.onset_s if found.description["onset_s"] else None
    assert disturbance_statement("T_tank_C", first.value, "K", first.interval90, since, average=True) in found.summary

    document = found.document()
    assert [lead["says"] for lead in document["leads"]] == [lead.says for lead in found.leads]
    assert all(
        set(lead) == {"kind", "where", "low", "high", "unit", "share", "of_record", "says"}
        for lead in document["leads"]
    )
    console = Console(record=True, width=400)
    print_diagnosis(console, found)
    printed = console.export_text()
    text = page(Findings(document | {"record": "r.csv"}, curves_of(found, slow_pair.network.sensor_names)))
    for lead in found.leads:
        assert f"lead: {lead.says}" in printed and f"<li>{lead.says}</li>" in text


def test_steady_states_name_the_range_that_misfits_or_the_one_state() -> None:
    bare = load(TWINS / "dry_cooler_constant.toml")
    inputs, good = cooler(bare, 40, 3)
    column = bare.input_columns.index("fan_speed_pct")
    slow, odd = inputs[:, column] < 30.0, good.copy()
    odd[slow] += np.random.default_rng(0).choice([-3.0, 3.0], (int(slow.sum()), 1))
    found = diagnose_grown(bare, Columns(np.arange(40.0), inputs, odd), at_rest=True, most=1, beam=2)
    assert found.verdict == "unexplained"
    (lead,) = found.leads
    assert (lead.kind, lead.where) == ("input range", "fan_speed_pct")
    assert lead.low == inputs[:, column].min() and 25.0 < lead.high < 35.0 and lead.share > 0.9
    one = good.copy()
    one[11, 0] += 5.0
    found = diagnose_grown(bare, Columns(np.arange(40.0), inputs, one), at_rest=True, most=1, beam=2)
    assert found.verdict == "unexplained"
    (lead,) = found.leads
    assert lead.kind == "row" and lead.low == 12.0 and "state 12: T_out_C is 5" in lead.says
