"""Sentences of limits: their parsed form, and refusals that name the place."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.testing.limits import (
    Amount,
    Bound,
    Compared,
    Follows,
    NoEffect,
    NoTrip,
    SentenceError,
    Settles,
    Trips,
    TwinError,
    Window,
    parse,
    parse_time,
)


@pytest.mark.parametrize(
    ("text", "statement"),
    [
        ("T_modules_C < 75", Compared("value", "T_modules_C", Bound("<", Amount(75.0)))),
        ("T_modules_C<75degC", Compared("value", "T_modules_C", Bound("<", Amount(75.0, "degC")))),
        ("flow ≥ 2 L/min", Compared("value", "flow", Bound(">=", Amount(2.0, "L/min")))),
        ("x between -1 and 2.5 K", Compared("value", "x", Bound(">=", Amount(-1.0, "K"), Amount(2.5, "K")))),
        ("mean of x > 1e3 W", Compared("mean", "x", Bound(">", Amount(1000.0, "W")))),
        ("95th percentile of x < 3", Compared("percentile", "x", Bound("<", Amount(3.0)), percent=95.0)),
        (
            "longest time of x above 4 W < 2 min",
            Compared("longest", "x", Bound("<", Amount(2.0, "min")), threshold=Bound(">", Amount(4.0, "W"))),
        ),
        ("fall of x over 30 s < 2 K/min", Compared("ramp", "x", Bound("<", Amount(2.0, "K/min")), 0.0, None, 30.0, -1)),
        ("x settles within 2 min to 0.5 K", Settles("x", 120.0, Amount(0.5, "K"))),
        ("x settles within 9 s to 1 % of 45 W", Settles("x", 9.0, Amount(1.0, "%"), Amount(45.0, "W"))),
        ("x measured within 5 % of set-point", Follows("x", Amount(5.0, "%"))),
        ("x measured within 2 W of its set-point once constant for 10 s", Follows("x", Amount(2.0, "W"), 10.0)),
        ("rmse of twin at x < 0.3 K", TwinError("rmse", "twin", "x", Bound("<", Amount(0.3, "K")))),
        ("largest error of pso at x < 1 K", TwinError("largest", "pso", "x", Bound("<", Amount(1.0, "K")))),
        ("RMSE of the twin at x < 0.3 K", TwinError("rmse", "twin", "x", Bound("<", Amount(0.3, "K")))),
        ("Mean of x > 1 W", Compared("mean", "x", Bound(">", Amount(1.0, "W")))),
        ("x measured within 5 percent of setpoint", Follows("x", Amount(5.0, "%"))),
        ("x measured within 5 % of its set point", Follows("x", Amount(5.0, "%"))),
        ("no effect found", NoEffect()),
        ("no trip", NoTrip()),
        ("trip", Trips()),
        ("Trip of T_tank", Trips("T_tank")),
        ("trip < 3", Compared("value", "trip", Bound("<", Amount(3.0)))),
    ],
)
def test_a_sentence_has_one_meaning(text, statement):
    sentence = parse(text)
    assert sentence.statement == statement
    assert sentence.window == Window()


def test_times_and_conditions_end_a_sentence():
    window = parse("x < 1 W from 2 min to 0.5 h while y > 3 W").window
    assert (window.from_s, window.to_s) == (120.0, 1800.0)
    assert window.while_ is not None and window.while_.signal == "y"
    assert parse("x < 1 W after 90 s before 2 d").window == Window(90.0, 172800.0)
    assert parse_time("1.5 h") == 5400.0


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("", "is empty"),
        ("x", "has its end after 'x'; write one of <"),
        ("median of x < 3", "asks for the median of a signal, which is not known; there are mean, max"),
        ("x <", "has its end after '<'; write a number"),
        ("x = 5", "has '='"),
        ("x << 5", "has '<<'"),
        ("x < 7,5 degC", "decimal point"),
        ("x < 5 W or y < 3", "has 'or' after 'W'; end the limit there"),
        ("x < 5 W and y < 3", "another limit"),
        ("x < 5 W after 10", "unit of time"),
        ("x < 5 W from 10 s to 4 s", "not after its beginning"),
        ("x < 5 W after -3 s", "negative"),
        ("x between 5 and 2 W", "lesser one first"),
        ("x settles within 0 s to 1 K", "positive"),
        ("x settles within 5 s", "'to'"),
        ("101th percentile of x < 3 W", "from 0 to 100"),
        ("75 > x", "a signal first"),
        ("__import__('os').system('true') < 1", "no signal"),
        ("x < 1" + " " * 400, "characters long"),
        (
            "x < 5 W from 0 s to 9 s from 20 s to 30 s",
            "has a second begin, 'from 20 s to 30 s' after 'from 0 s to 9 s'",
        ),
        ("x < 5 W after 10 s after 300 s", "has a second begin, 'after 300 s' after 'after 10 s'"),
        ("x < 5 W from 0 s to 9 s before 8 s", "has a second end, 'before 8 s' after 'from 0 s to 9 s'"),
        ("x < 5 W before 9 s after 1 s before 8 s", "has a second end"),
        ("x < 5 W while y > 1 W while z > 2", "has a second condition, 'while z > 2' after 'while y > 1 W'"),
        ("x < 1e999", "has the number 1e999, which is too large"),
        ("x between -1e400 and 5 W", "too large"),
        ("x settles within 1e308 h to 1 K", "which is too long"),
    ],
)
def test_a_refusal_names_the_place(text, place):
    if "no signal" in place:  # a name like any other, and no code
        assert isinstance(parse(text).statement, Compared)
        return
    with pytest.raises(SentenceError, match=place):
        parse(text)


@given(st.lists(st.sampled_from([*"x<>=5", "between", "and", "of", "mean", "time", "above", "s", "to", "-1e9", "%"])))
def test_any_words_are_a_sentence_or_refused(words):
    try:
        parse(" ".join(words))
    except SentenceError as error:
        assert str(error)


@given(st.text(max_size=60))
def test_any_text_is_a_sentence_or_refused(text):
    try:
        parse(text)
    except SentenceError as error:
        assert str(error)
