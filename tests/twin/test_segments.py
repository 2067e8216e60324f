"""Records with gaps in which nobody knows what drove the rig."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.tracking.twins import TrackingConfig, Twins
from tests.discovery.conftest import Bench
from twin.commission import commission
from twin.discovery.effects.probe import Probe
from twin.discovery.engine import diagnose
from twin.discovery.healthy.basis import Columns
from twin.discovery.records.grid import on_grid
from twin.kernel import Kernel
from twin.network import Array, Network
from twin.segments import (
    LONG_GAP_S,
    MOST_GAPS,
    SHORT_GAP_S,
    find_segments,
    segment_rows,
    separate_columns,
    simulate_segments,
)
from twin.twinfile import load

from .conftest import LOOP

STATE = np.array([37.0, 36.8, 34.5, 34.0])


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench(load(LOOP))


def without(record: Columns, *gaps: tuple[float, float]) -> Columns:
    """The record without its rows between two times, h, of each gap."""
    keep = np.ones(len(record.time_s), dtype=bool)
    for first, last in gaps:
        keep &= ~((record.time_s > 3600.0 * first) & (record.time_s < 3600.0 * last))
    return Columns(record.time_s[keep], record.inputs[keep], record.measured[keep])


def steady(network: Network, hours: float, step_s: float = 5.0) -> tuple[Array, Array]:
    time = np.arange(0.0, 3600.0 * hours, step_s)
    return time, np.tile([700.0, 85.0, 70.0, 22.0], (len(time), 1))


def test_a_record_without_gaps_is_one_stretch(bench: Bench) -> None:
    time, inputs = bench.inputs(4.0, 1)
    found = find_segments(bench.network, time, inputs)
    assert found.begins == (0,) and not found.lost.any() and not found.sentence


@pytest.mark.parametrize(
    ("gap_s", "moved", "begins"),
    [
        (LONG_GAP_S + 60.0, False, True),
        (0.5 * LONG_GAP_S, False, False),
        (0.5 * LONG_GAP_S, True, True),
        (0.5 * SHORT_GAP_S, True, False),
    ],
)
def test_a_gap_is_lost_where_it_is_long_or_an_input_moved_in_it(
    bench: Bench, gap_s: float, moved: bool, begins: bool
) -> None:
    time, inputs = steady(bench.network, 3.0)
    inputs[time >= 3600.0 + gap_s, 0] += 200.0 * moved
    keep = (time <= 3600.0) | (time >= 3600.0 + gap_s)
    found = find_segments(bench.network, time[keep], inputs[keep])
    assert len(found.begins) == 1 + begins
    if begins:
        assert time[keep][found.begins[1]] == pytest.approx(3600.0 + gap_s, abs=5.0)


def test_rows_without_a_heater_power_are_a_gap_and_a_missing_room_is_none(bench: Bench) -> None:
    time, inputs = steady(bench.network, 3.0)
    dark = (time > 3600.0) & (time < 5400.0)
    inputs[dark, 3] = np.nan
    assert find_segments(bench.network, time, inputs).begins == (0,)
    inputs[dark, 0] = np.nan
    found = find_segments(bench.network, time, inputs)
    assert len(found.begins) == 2 and (found.lost == dark).all()
    assert "30 min at 1.0 h" in found.sentence


def test_what_is_written_down_when_it_changes_loses_nothing(bench: Bench) -> None:
    time, inputs = steady(bench.network, 3.0)
    inputs[time % 1800.0 > 0.0, 2] = np.nan
    assert find_segments(bench.network, time, inputs).begins == (0,)


def test_of_very_many_gaps_the_longest_count(bench: Bench) -> None:
    time, inputs = steady(bench.network, 40.0)
    keep = np.ones(len(time), dtype=bool)
    for k in range(36):
        keep[(time > 3600.0 * (k + 1)) & (time < 3600.0 * (k + 1) + 400.0 + 10.0 * k)] = False
    found = find_segments(bench.network, time[keep], inputs[keep])
    assert len(found.begins) == MOST_GAPS + 1
    assert min(b - a for a, b in found.gaps) > 400.0 + 10.0 * (36 - MOST_GAPS - 1)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.integers(1, 39), min_size=0, max_size=5, unique=True), st.integers(1, 3))
def test_stretches_cover_all_rows_and_slopes_are_their_own(cuts: list[int], k: int) -> None:
    begins = (0, *sorted(cuts))
    rows = np.concatenate([np.arange(40)[part] for part in segment_rows(begins, 40)])
    assert (rows == np.arange(40)).all()
    slopes = np.ones((40, 2, k))
    each = separate_columns(slopes, begins)
    assert each.shape == (40, 2, len(begins) * k)
    assert (each.sum(axis=2) == k).all()


def test_runs_that_begin_where_they_would_have_been_are_the_run_itself(bench: Bench) -> None:
    time, inputs = bench.inputs(3.0, 2)
    kernel = Kernel(bench.network, ())
    whole, _ = kernel.trace(bench.network.values, STATE, time, inputs)
    begins = (0, 700, 1500)
    at = [kernel.trace(bench.network.values, STATE, time[: b + 1], inputs[: b + 1])[1][0] for b in begins[1:]]
    states = np.concatenate([STATE, *(a[: len(STATE)] for a in at)])
    again = simulate_segments(kernel, bench.network.values[None], states[None], time, inputs, begins)
    assert again == pytest.approx(whole, abs=1e-9)


def test_slopes_of_every_beginning_are_those_of_a_run_with_it_moved(bench: Bench) -> None:
    probe = Probe(bench.network, bench.network.tunables("commission"))
    record = without(bench.record(6.0), (2.0, 2.5), (4.0, 4.6))
    grid = on_grid(bench.network, record.time_s, record.inputs, record.measured)
    assert len(grid.begins) == 3
    state = probe.first_state(grid)
    slopes = probe.sensitivities(grid, state)[..., probe.q :]
    assert slopes.shape[2] == len(state) == 3 * probe.k
    for i in (0, 5, 11):
        moved = state.copy()
        moved[i] += 0.5
        change = (probe.run(grid, moved).readings - probe.run(grid, state).readings) / 0.5
        assert slopes[..., i] == pytest.approx(change, abs=2e-3)


def test_heat_of_a_block_is_forgotten_where_the_rig_is_followed_anew(bench: Bench) -> None:
    probe = Probe(bench.network, bench.network.tunables("commission"))
    record = without(bench.record(6.0), (3.0, 3.5))
    grid = on_grid(bench.network, record.time_s, record.inputs, record.measured)
    state = probe.first_state(grid)
    edges = np.linspace(0, len(grid.time), 37).round().astype(np.intp)
    heat = probe.blocks(grid, state, edges)
    block = int(np.searchsorted(edges, grid.begins[1]))
    assert np.abs(heat[block:, :, : block - 1]).max() < 1e-9
    assert np.abs(heat[block - 2, :, : block - 4]).max() > 1e-5
    # Heat in the last blocks is felt as without a gap.
    injected = np.zeros((len(grid.time), probe.k))
    injected[edges[-3] : edges[-2], 1] = 10.0
    means = np.stack([(probe.run(grid, state, injected=injected).readings - probe.run(grid, state).readings)])[0]
    last = means[edges[-2] : edges[-1]].mean(axis=0) / 10.0
    assert heat[-1, :, -2, 1] == pytest.approx(last, rel=0.05)


def test_commissioning_is_the_same_across_gaps(bench: Bench) -> None:
    record = bench.record(10.0, seed=3)
    start = bench.with_values(fins__UA_100=40.0, tank_loss__hA=4.0)
    gapped = without(record, (2.1, 2.9), (5.2, 5.6))
    whole, broken = (commission(start, r.time_s, r.inputs, r.measured) for r in (record, gapped))
    assert any("restarts" in note for note in broken.notes)
    for name, value in whole.values.items():
        if name not in whole.unidentifiable:
            low, high = broken.interval90[name]
            spread = max(high - low, 0.02 * abs(value))
            assert abs(broken.values[name] - value) < 1.5 * spread, name
    assert max(broken.rmse_after.values()) < 1.2 * max(whole.rmse_after.values())


def test_an_effect_is_found_across_gaps_in_which_the_load_moved(bench: Bench) -> None:
    changed = bench.with_values(modules_power__power=60.0)
    record = without(bench.record(16.0, 1, changed, onset_h=5.0), (3.1, 3.8), (7.3, 8.1), (13.2, 13.9))
    healthy = without(bench.record(10.0, seed=7), (4.0, 4.7))
    found = diagnose(bench.network, record, healthy)
    (effect,) = found.effects
    assert (effect.kind, effect.where) == ("heat_source", "modules")
    assert effect.value == pytest.approx(60.0, rel=0.08) and abs(effect.onset_s - 18000.0) < 600.0
    assert any("3 gaps" in note for note in found.notes)
    # The last gap lies in the part that no fit saw.
    assert all(e.after < 1.3 * e.noise for e in found.errors.values())


def test_a_healthy_record_with_gaps_stays_adequate(bench: Bench) -> None:
    healthy = bench.record(10.0, seed=7)
    record = without(bench.record(16.0, 4), (3.1, 3.8), (9.0, 9.1), (14.0, 14.5))
    found = diagnose(bench.network, record, healthy)
    assert found.verdict == "adequate" and not found.effects


def test_twins_that_track_a_record_begin_again_after_a_gap(bench: Bench) -> None:
    record = without(bench.record(8.0, 3), (2.1, 2.9), (5.2, 5.6))
    columns = dict(zip(bench.network.input_columns, record.inputs.T, strict=True))
    for j, sensor in enumerate(bench.network.sensors):
        columns |= dict.fromkeys(sensor.measured, record.measured[:, j])
    twins = Twins(TrackingConfig(LOOP, tuple(columns), ("least_squares",)))
    done = [rows for rows, _ in twins.over(record.time_s, columns, 700)]
    assert done[-1] == len(record.time_s) and (np.diff(done) > 0).all() and max(np.diff(done)) <= 700
    errors = twins.comparison().errors
    static = errors.columns.index("static")
    assert all(row[static] < 1.6 * errors.noise_K[name] for name, row in errors.rows.items())
