"""Forms and time courses of laws: the kernel's formulas, the arrays' and the definitions agree."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.elements.law_forms import COURSES, FORMS, course_text, follow_text, form_text, switch_text
from twin.kernel import Kernel
from twin.kernel.generated_code import evaluate_formula
from twin.laws.values import law_values
from twin.twinfile import parse

BOUNDS = {
    "size": (-1e5, 1e5),
    "gain": (-1e5, 1e5),
    "reference": (-1e3, 1e3),
    "scale": (1e-3, 1e6),
    "exponent": (0.25, 4.0),
    "width": (0.0, 1e3),
    "on": (-1e3, 1e3),
    "off": (-1e3, 1e3),
    "lag_s": (1.0, 1e7),
    "start_s": (-1e4, 1e4),
    "end_s": (1e4, 2e4),
    "settle_s": (1.0, 1e7),
    "period_s": (1.0, 1e4),
    "duty": (0.0, 1.0),
    "decay_s": (1e-3, 1e7),
    "edge_s": (1e-2, 1e3),
}
# Thresholds and drivers on a grid: at a distance of rounding from a threshold, a switch may be half on.
GRID = {name: st.floats(*bounds).map(lambda v: round(v, 3)) for name, bounds in BOUNDS.items()}


def by_text(form: str, course: str, p: dict[str, float], x: np.ndarray, time: np.ndarray) -> np.ndarray:
    """The formulas of the kernel, sample by sample, with its memory."""
    spans = np.append(np.diff(time), np.diff(time)[-1])
    before = x[0] if form in ("memory", "rate") else None
    found = []
    for now, stamp, span in zip(x.tolist(), time.tolist(), spans.tolist(), strict=True):
        names = {**p, "x": now, "t": stamp, "span": span}
        if form == "threshold":
            text, start = switch_text("x", str, "before")
            names["before"] = evaluate_formula(start, names) if before is None else before
            names["m"] = before = evaluate_formula(text, names)
        elif form in ("memory", "rate"):
            text, after = follow_text("x", str, "before", "span")
            names["before"] = before
            names["m"], before = evaluate_formula(text, names), evaluate_formula(after, names)
        value = evaluate_formula(form_text(form, "x", str, "m"), names)
        share = course_text(course, "t", str)
        found.append(value * (evaluate_formula(share, names) if share else 1.0))
    return np.array(found)


@pytest.mark.parametrize("form", FORMS)
@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_formulas_of_a_form_are_those_of_arrays(form: str, data: st.DataObject) -> None:
    p = {name: data.draw(GRID[name], label=name) for name in FORMS[form]}
    x = np.array(data.draw(st.lists(GRID["on"], min_size=2, max_size=12)))
    time = np.cumsum(data.draw(st.lists(st.floats(0.5, 600.0), min_size=x.size, max_size=x.size)))
    values = law_values(form, "always", p, x, time)
    whole = max(1.0, abs(values).max(), abs(p.get("gain", 0.0)) * np.ptp(x))
    assert by_text(form, "always", p, x, time) == pytest.approx(values, rel=1e-9, abs=1e-8 * whole)


@pytest.mark.parametrize("course", COURSES)
@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_formulas_of_a_course_are_those_of_arrays(course: str, data: st.DataObject) -> None:
    p = {name: data.draw(GRID[name], label=name) for name in COURSES[course]} | {"size": 1.0}
    time = np.cumsum(data.draw(st.lists(st.floats(0.5, 2e3), min_size=2, max_size=20))) - 2e3
    values = law_values("constant", course, p, None, time)
    # A mean over an edge is a difference of integrals, and loses the digits that they have in common.
    longest = max(p.get("settle_s", 0.0), p.get("decay_s", 0.0), 4e4)
    rounding = 1e-9 + 1e-15 * longest / p.get("edge_s", 1.0)
    assert by_text("constant", course, p, np.zeros(time.size), time) == pytest.approx(values, abs=rounding)
    assert (values > -1e-6).all() and (values < 1.0 + 1e-6).all()


def test_a_switch_waits_for_its_other_threshold_on_both_sides() -> None:
    x, time = np.array([50.0, 60.0, 50.0, 40.0, 50.0, 61.0]), np.arange(6.0)
    high = law_values("threshold", "always", {"size": 2.0, "on": 60.0, "off": 40.0}, x, time)
    assert high.tolist() == [0.0, 2.0, 2.0, 0.0, 0.0, 2.0]
    low = law_values("threshold", "always", {"size": 2.0, "on": 40.0, "off": 60.0}, x, time)
    assert low.tolist() == [0.0, 0.0, 0.0, 2.0, 2.0, 0.0]


def test_courses_are_what_their_names_say_and_lose_nothing_between_samples() -> None:
    time = np.arange(0.0, 1000.0, 10.0)
    interval = law_values(
        "constant", "interval", {"size": 1.0, "start_s": 95.0, "end_s": 303.0, "edge_s": 10.0}, None, time
    )
    assert interval.sum() * 10.0 == pytest.approx(303.0 - 95.0) and interval[20] == 1.0 and interval[40] == 0.0
    pulse = {"amount": 5000.0, "start_s": 42.0, "decay_s": 0.5, "edge_s": 10.0}
    assert law_values("constant", "pulse", pulse, None, time).sum() * 10.0 == pytest.approx(5000.0)
    switched = {"size": 1.0, "start_s": 100.0, "period_s": 60.0, "duty": 0.5, "edge_s": 10.0}
    assert law_values("constant", "periodic", switched, None, time)[8:22].tolist() == [
        0.0,
        0.0,
        *3 * [1.0],
        *3 * [0.0],
        *3 * [1.0],
        *3 * [0.0],
    ]
    ramp = law_values("constant", "ramp", {"size": 1.0, "start_s": 100.0, "end_s": 300.0, "edge_s": 10.0}, None, time)
    assert ramp[[5, 20, 40]] == pytest.approx([0.0, 0.525, 1.0])
    grown = law_values(
        "constant", "settling", {"size": 1.0, "start_s": 0.0, "settle_s": 50.0, "edge_s": 1e-2}, None, time
    )
    assert grown == pytest.approx(1.0 - np.exp(-time / 50.0), abs=1e-4)


@pytest.mark.parametrize(
    ("form", "course", "parameters", "driver", "said"),
    [
        ("cubic", "always", {}, None, "no law 'cubic'"),
        ("constant", "later", {"size": 1.0}, None, "course 'later'"),
        ("linear", "always", {"gain": 1.0}, [1.0], "lacks reference"),
        ("linear", "always", {"gain": 1.0, "reference": 0.0}, None, "needs a driver"),
    ],
)
def test_an_incomplete_law_is_refused(form, course, parameters, driver, said) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ValueError, match=said):
        law_values(form, course, parameters, driver, [0.0])


VALUES = {
    "size": 40.0,
    "gain": 3.0,
    "reference": 45.0,
    "scale": 20.0,
    "exponent": 1.7,
    "width": 8.0,
    "on": 60.0,
    "off": 35.0,
    "lag_s": 70.0,
    "start_s": 155.0,
    "end_s": 1204.0,
    "settle_s": 200.0,
    "period_s": 130.0,
    "duty": 0.3,
    "decay_s": 150.0,
    "edge_s": 5.0,
}
REMEMBERING = [("threshold", "always"), ("memory", "periodic"), ("rate", "always")]
LAWS = [*((form, "always") for form in FORMS), *(("linear", course) for course in COURSES)]


def stores(laws: list[tuple[str, str]]) -> str:
    """A node without losses for each law, and a law in each."""
    text = 'format = 1\nname = "stores"\n[inputs]\nfan_speed_pct = { nominal = 50.0 }\ntime_s = { nominal = 0.0 }\n'
    for k, (form, course) in enumerate(laws):
        text += f'[elements.n{k}]\nkind = "node"\ncapacitance = 1000.0\n'
        text += f'[elements.T_{k}_C]\nkind = "sensor"\nnode = "n{k}"\ncolumns = ["T_{k}_C"]\n'
        text += f'[elements.x{k}]\nkind = "law_heat"\nnode = "n{k}"\nform = "{form}"\ncourse = "{course}"\n'
        text += 'driver = "fan_speed_pct"\n' if form != "constant" else ""
        text += "".join(f"{name} = {VALUES[name]}\n" for name in (*FORMS[form], *COURSES[course]))
    return text


@pytest.mark.parametrize(("laws", "particles"), [(LAWS, 1), (REMEMBERING, 3)])
def test_a_compiled_store_gains_the_heat_of_its_law(laws: list[tuple[str, str]], particles: int) -> None:
    """Cut in two: the second part goes on from the memory of the first."""
    net = parse(stores(laws))
    time = np.cumsum(np.random.default_rng(1).choice([5.0, 5.0, 20.0], 200))
    fan = np.repeat(np.random.default_rng(2).uniform(20.0, 90.0, 40), 5)
    inputs, start = np.column_stack([fan, np.full(200, -1.0)]), np.full(len(laws), 20.0)  # the kernel fills the stamps
    free = tuple(p.id for p in net.parameters.values() if p.name in VALUES) if particles > 1 else ()
    kernel, full = Kernel(net, free), np.tile(net.values, (particles, 1))
    first, state = kernel.trace(full, start, time[:90], inputs[:90])
    second, _ = kernel.trace(full, state, time[89:], inputs[89:])
    readings = np.concatenate([first[-1], second[-1][1:]])
    for k, (form, course) in enumerate(laws):
        heat = law_values(form, course, VALUES, fan if form != "constant" else None, time)
        gained = 20.0 + np.concatenate([[0.0], np.cumsum(heat[:-1] * np.diff(time)) / 1000.0])
        assert readings[:, k] == pytest.approx(gained, rel=1e-8, abs=1e-7), (form, course)
