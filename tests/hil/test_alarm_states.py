"""State table of an alarm, and the list that is folded by it: properties over any course of events."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.alarms.alarm_list import Act, Change, fold, refusal
from hil.alarms.definitions import AlarmDefinition
from hil.alarms.states import ACTIVE, SHELVED, TABLE, WAITING, AlarmEvent, AlarmState, next_alarm_state

EVENTS = st.lists(st.sampled_from(AlarmEvent), max_size=30)


def after(events: list[AlarmEvent], latching: bool) -> list[AlarmState]:
    """Return the states of an alarm that starts normal; an event without a transition changes nothing."""
    states = [AlarmState.NORMAL]
    for event in events:
        states.append(next_alarm_state(states[-1], event, latching=latching) or states[-1])
    return states


@given(EVENTS, st.booleans())
def test_the_state_is_active_exactly_while_the_condition_is_there(events, latching):
    present = False
    for event, state in zip(events, after(events, latching)[1:], strict=True):
        present = {AlarmEvent.RAISE: True, AlarmEvent.CLEAR: False}.get(event, present)
        assert (state in ACTIVE) is present


@given(EVENTS, st.booleans())
def test_a_condition_that_comes_asks_for_an_operator_unless_it_is_shelved(events, latching):
    states = after([*events, AlarmEvent.CLEAR, AlarmEvent.RAISE], latching)
    assert states[-1] in (AlarmState.UNACKNOWLEDGED, AlarmState.SHELVED_ACTIVE)
    assert (states[-1] is AlarmState.SHELVED_ACTIVE) is (states[-2] in SHELVED)


@given(EVENTS, st.booleans())
def test_every_alarm_is_normal_after_its_condition_went_and_an_operator_acted(events, latching):
    last = [AlarmEvent.CLEAR, AlarmEvent.UNSHELVE, AlarmEvent.ACKNOWLEDGE, AlarmEvent.ACKNOWLEDGE]
    assert after([*events, *last], latching)[-1] is AlarmState.NORMAL


@given(EVENTS)
def test_a_latching_alarm_is_never_normal_again_without_an_act_after_its_condition_went(events):
    for (before, event), state in zip(
        zip(after(events, True), events, strict=False), after(events, True)[1:], strict=True
    ):
        if event is AlarmEvent.CLEAR and before in ACTIVE and before not in SHELVED:
            assert state in WAITING


def test_the_table_leads_to_each_state_and_out_of_it():
    assert set(TABLE.values()) | {AlarmState.LATCHED} == set(AlarmState)
    assert {source for source, _ in TABLE} == set(AlarmState)


A = AlarmDefinition(id="T.H", kind="high", priority="high", points=("T",), limit=50.0, unit="degC")
COURSE = st.lists(st.tuples(st.integers(0, 20), st.sampled_from(["acknowledge", "shelve", "unshelve"])), max_size=12)


@given(st.lists(st.integers(0, 20), max_size=10, unique=True).map(sorted), COURSE)
def test_a_list_follows_the_table_and_every_shelving_ends(edges, acts):
    changes = [Change(tick, float(tick), 1e9 + tick, "T.H", k % 2 == 0, 51.0) for k, tick in enumerate(edges)]
    done = [Act(name, "T.H", tick, 1e9 + tick + 0.5, "op", "why", 1e9 + tick + 3.0) for tick, name in sorted(acts)]
    kept = fold([A], changes, done, 1e9 + 100.0)
    for record in kept.records:
        assert next_alarm_state(record.source, record.event) is record.target
    for one, other in pairwise(kept.records):
        assert one.target is other.source and one.wall_s <= other.wall_s
    status = kept.statuses["T.H"]
    assert status.state not in SHELVED
    assert (status.state in ACTIVE) is bool(len(edges) % 2)
    assert status.count == sum(record.event is AlarmEvent.RAISE for record in kept.records)


def test_an_acknowledgement_holds_for_the_alarms_that_its_operator_had_seen():
    changes = [Change(k, float(k), 1e9 + k, "T.H", k % 2 == 0, 51.0) for k in (10, 11, 12)]
    seen = fold([A], changes, [Act("acknowledge", "T.H", 10, 1e9 + 12.4, "op")], 1e9 + 20)
    assert seen.statuses["T.H"].state is AlarmState.UNACKNOWLEDGED  # of tick 12, which the operator had not seen
    assert [r.event.value for r in seen.records] == ["raise", "acknowledge", "clear", "raise"]


def test_a_shelved_alarm_whose_condition_lasts_asks_again_at_the_end():
    changes = [Change(10, 10.0, 1e9 + 10, "T.H", True, 51.0)]
    acts = [Act("shelve", "T.H", 12, 1e9 + 12, "op", "cleaning", 1e9 + 60)]
    assert fold([A], changes, acts, 1e9 + 59).standing()[0].state is AlarmState.SHELVED_ACTIVE
    over = fold([A], changes, acts, 1e9 + 60)
    assert over.standing()[0].state is AlarmState.UNACKNOWLEDGED
    assert (over.records[-1].wall_s, over.records[-1].reason) == (1e9 + 60, "the shelving has ended")
    assert math.isnan(over.statuses["T.H"].until_s)


@pytest.mark.parametrize(
    ("events", "act", "said"),
    [
        ([], "acknowledge", "T.H is normal, so there is nothing to acknowledge"),
        ([], "unshelve", "T.H is normal, so there is no shelving to end"),
        ([True, False], "shelve", "only waits to be acknowledged"),
    ],
)
def test_an_act_that_the_state_does_not_admit_is_refused_in_a_sentence(events, act, said):
    changes = [Change(k, float(k), 1e9 + k, "T.H", active) for k, active in enumerate(events)]
    assert said in str(refusal(fold([A], changes, [], 2e9).statuses["T.H"], act))


def test_what_waits_for_an_operator_comes_first_and_then_by_priority():
    ids = {"a": "low", "b": "critical", "c": "high"}
    definitions = [AlarmDefinition(id=name, kind="run", priority=rank) for name, rank in ids.items()]
    changes = [Change(k, float(k), 1e9 + k, name, True) for k, name in enumerate(ids)]
    kept = fold(definitions, changes, [Act("acknowledge", "b", 5, 1e9 + 5, "op")], 1e9 + 10)
    assert [item.definition.id for item in kept.standing()] == ["c", "a", "b"]


def test_a_change_of_unknown_time_ends_no_shelving():
    acts = [Act("shelve", "T.H", 1, 1e9, "op", "cleaning", 1e9 + 60)]
    changes = [Change(2, 2.0, math.nan, "T.H", True, 51.0)]
    assert fold([A], changes, acts, 1e9 + 30).statuses["T.H"].state is AlarmState.SHELVED_ACTIVE
