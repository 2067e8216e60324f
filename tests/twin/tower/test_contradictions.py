"""Contradictions of a record: steps that no thermometer makes, and the column that jumps there."""

from __future__ import annotations

import numpy as np

from twin.tower.change_detection import Step, contradictory_steps, jumping_column, merged, most_steps, spans_beyond

DAY = 86400.0


def step(day: float, size: float, lasting: bool = True, kind: str = "thermometer") -> Step:
    return Step(day * DAY, day * DAY + 600.0, size, lasting, kind)


def test_the_plausible_number_of_steps_grows_with_the_record() -> None:
    assert [most_steps(days) for days in (7, 21, 56, 365)] == sorted(most_steps(days) for days in (7, 21, 56, 365))
    assert most_steps(21) >= 1 and most_steps(365) >= 3


def test_one_step_within_the_bounds_and_rare_steps_are_a_thermometer_s() -> None:
    assert not contradictory_steps([step(20, 0.6)], 56, 1.0)
    assert not contradictory_steps([step(20, 0.6), step(150, -0.5), step(300, 0.4)], 365, 1.0)


def test_a_step_beyond_the_bounds_contradicts_the_record() -> None:
    (found,) = contradictory_steps([step(20, 1.4), step(21.5, 0.2), step(20.2, 0.1, lasting=False)], 56, 1.0)
    assert found.size == 1.4 and found.start_s == 20 * DAY


def test_many_steps_within_two_days_contradict_the_record_and_span_all_of_them() -> None:
    steps = [step(10 + k / 4, 0.5 * (-1) ** k, lasting=k % 2 == 0) for k in range(9)]
    (found,) = contradictory_steps(steps, 21, 1.0)
    assert found.steps == 5 and found.end_s >= 12 * DAY
    of_water = [step(one.start_s / DAY, one.size, one.lasting, "water") for one in steps]
    assert len(contradictory_steps(of_water, 21, 1.0)) == 1
    assert not contradictory_steps([step(one.start_s / DAY, one.size, kind="fan") for one in steps], 21, 1.0)


def test_a_bias_beyond_its_bounds_gives_its_span_and_spans_close_together_are_one() -> None:
    edges = DAY * np.arange(7.0)
    found = spans_beyond(edges, np.array([0.1, 1.2, 1.5, 0.2, -1.1, 0.0]), 1.0)
    assert [(one.start_s / DAY, one.end_s / DAY, one.size) for one in found] == [(1, 3, 1.5), (4, 5, -1.1)]
    assert [(one.start_s / DAY, one.end_s / DAY) for one in merged(found)] == [(1, 5)]


def test_the_column_with_its_largest_jump_there_is_named_and_none_where_nothing_jumps() -> None:
    time_s = np.arange(0.0, 10 * DAY, 120.0)
    rng = np.random.default_rng(3)
    inlet, flow = 30.0 + rng.normal(0, 0.2, len(time_s)), 100.0 + rng.normal(0, 1.0, len(time_s))
    inside = (time_s >= 4 * DAY) & (time_s < 5 * DAY)
    flow = np.where(inside, 0.3 * flow, flow)
    spans = contradictory_steps([step(4.1, 3.0), step(4.9, -3.0)], 10, 1.0)
    running = np.ones(len(time_s), dtype=bool)
    assert jumping_column(time_s, running, {"t_in_C": inlet, "m_w_kg_s": flow}, spans) == ["m_w_kg_s"]
    assert jumping_column(time_s, running, {"t_in_C": inlet}, spans) == [""]
