"""General laws as elements: equal to a named element where they coincide, finite in the corners, plain in refusals."""

import numpy as np
import pytest

from tests.twin.two_nodes import TWO, U, drivers, heat, network, worst_error
from twin.elements import KINDS, Sites
from twin.elements.law import Law
from twin.elements.law_forms import COURSES, FORMS
from twin.kernel import Kernel, simulate
from twin.kernel.codegen import kernel_source
from twin.network import TwinFileError
from twin.reference_simulation import simulate_fine_steps
from twin.twinfile import dump, parse

STAMPED = TWO.replace("[inputs]\n", "[inputs]\ntime_s = { nominal = 0.0 }\n")
FLOW = '[elements.f]\nkind="flow"\npath=["a","b"]\npump="pump_speed_pct"\nnominal=3.0\n'
ACTUATOR = '[elements.act]\nkind="actuator"\ncolumn="heater_power_W"\n'
POWER = '[elements.p]\nkind="heat_source"\nnode="a"\ndriver="heater_power_W"\n'
LOSS = '[elements.l]\nkind="ambient_loss"\nnode="b"\nhA=6.0\n'
METER = '[elements.meter]\nkind="actuator"\ncolumn="T_ambient_C"\n'
START = np.array([70.0, 25.0])


def law(kind: str, **keys: object) -> str:
    lines = (f'{k} = "{v}"' if isinstance(v, str) else f"{k} = {v}" for k, v in keys.items())
    return "\n".join((f'[elements.x]\nkind = "{kind}"', *lines, ""))


def run(extra: str, n: int = 150, text: str = TWO) -> np.ndarray:
    net = parse(text + extra)
    time, u = drivers(n)
    u = np.column_stack([np.zeros(n), u]) if "time_s" in net.inputs else u
    return simulate(net, time, u, START)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (law("law_heat", node="b", size=50.0), '[elements.x]\nkind="heat_source"\nnode="b"\npower=50.0\n'),
        (
            law("law_heat", node="b", driver="fan_speed_pct", form="power", size=80.0, scale=100.0, exponent=3.0),
            '[elements.x]\nkind="heat_source"\nnode="b"\ndriver="fan_speed_pct"\nlaw="cubed"\npower_100=80.0\n',
        ),
        (
            law("law_heat", node="b", of="b", minus_input="T_ambient_C", form="linear", gain=-6.0),
            '[elements.x]\nkind="ambient_loss"\nnode="b"\nhA=6.0\n',
        ),
        (
            law("law_conductance", node="b", ambient="T_ambient_C", size=6.0),
            '[elements.x]\nkind="ambient_loss"\nnode="b"\nhA=6.0\n',
        ),
        (
            law("law_heat", node="b", source="a", of="a", minus="b", form="linear", gain=4.0),
            '[elements.x]\nkind="conduction"\nfrom="a"\nto="b"\nresistance=0.25\n',
        ),
        (
            law("law_conductance", node="b", to="a", size=4.0),
            '[elements.x]\nkind="conduction"\nfrom="a"\nto="b"\nresistance=0.25\n',
        ),
        (FLOW + law("law_flow", flow="f", size=0.2), FLOW + "factor=1.2\n"),
        (
            FLOW
            + law(
                "law_flow", flow="f", size=-0.6, change_in="L_min", driver="pump_speed_pct", form="power", scale=100.0
            ),
            FLOW + "factor=0.8\n",
        ),
        (ACTUATOR + POWER + law("law_actuator", column="heater_power_W", size=-0.1), ACTUATOR + "gain=0.9\n" + POWER),
        (
            ACTUATOR
            + POWER
            + law("law_actuator", column="heater_power_W", driver="heater_power_W", form="linear", gain=-2e-4),
            ACTUATOR + "droop=0.2\nfull=1000.0\n" + POWER,
        ),
        (
            LOSS + METER + law("law_input", column="T_ambient_C", driver="T_ambient_C", form="linear", gain=0.2),
            LOSS + METER + "gain=0.8\n",
        ),
        (LOSS + METER + law("law_input", column="T_ambient_C", size=1.5), LOSS + METER + "offset=-1.5\n"),
    ],
)
def test_a_law_is_a_named_element_where_they_coincide(one: str, other: str) -> None:
    for temperatures, power, speed in (((40.0, 30.0), 500.0, 80.0), ((18.0, 61.0), 950.0, 15.0)):
        inputs = np.where([True, True, True, *5 * [False]], [power, speed, speed, *5 * [0.0]], U)
        expected = heat(other, temperatures, inputs)
        assert np.abs(expected).max() > 0.1 and heat(one, temperatures, inputs) == pytest.approx(expected, abs=1e-9)


def test_kernels_agree_with_the_named_elements_too() -> None:
    laws = (
        law("law_heat", node="b", size=50.0),
        law("law_heat", node="b", of="b", minus_input="T_ambient_C", form="linear", gain=-6.0),
        law("law_conductance", node="b", to="a", size=4.0),
        law("law_flow", flow="f", size=0.2),
        law("law_actuator", column="heater_power_W", driver="heater_power_W", form="linear", gain=-2e-4),
    )
    one = (
        FLOW
        + ACTUATOR
        + POWER
        + "".join(text.replace("[elements.x]", f"[elements.x{k}]") for k, text in enumerate(laws))
    )
    other = FLOW + "factor=1.2\n" + ACTUATOR + "droop=0.2\nfull=1000.0\n" + POWER
    other += '[elements.s]\nkind="heat_source"\nnode="b"\npower=50.0\n'
    other += '[elements.l]\nkind="ambient_loss"\nnode="b"\nhA=6.0\n'
    other += '[elements.c]\nkind="conduction"\nfrom="a"\nto="b"\nresistance=0.25\n'
    # Two integrators: a limited exchange of temperatures is no longer affine. Their errors are those of a jump by 12 K.
    assert np.abs(run(one, 40) - run(other, 40)).max() < 5e-4


def test_a_reading_follows_its_own_temperature_as_a_gain_does() -> None:
    changed = run(law("law_reading", sensor="T_a_C", of="a", form="linear", gain=0.04, reference=10.0))
    plain = run("")
    assert changed[:, 0] == pytest.approx(plain[:, 0] + 0.04 * (plain[:, 0] - 10.0), abs=1e-9)
    assert np.array_equal(changed[:, 1], plain[:, 1])


def test_a_flow_follows_a_temperature_as_it_is_at_each_sample() -> None:
    keys = {"flow": "f", "form": "linear", "gain": -0.02, "reference": 40.0}
    own = run(FLOW + law("law_flow", of="a", **keys))
    assert np.abs(own - run(FLOW)).max() > 0.1
    net = parse(TWO + FLOW + law("law_flow", driver="fan_speed_pct", **keys))
    time, u = drivers(150)
    u[:, net.input_columns.index("fan_speed_pct")] = own[:, 0]
    assert simulate(net, time, u, START) == pytest.approx(own, abs=1e-6)


def test_a_reading_with_memory_or_a_switch_is_that_of_the_sample() -> None:
    time, u = drivers(80)
    plain = run("", 80)[:, 0]
    z = np.empty(80)
    z[0] = u[0, 2]
    for i in range(79):
        z[i + 1] = u[i, 2] + (z[i] - u[i, 2]) * np.exp(-(time[i + 1] - time[i]) / 20.0)
    lagging = run(law("law_reading", sensor="T_a_C", driver="fan_speed_pct", form="memory", gain=0.1, lag_s=20.0), 80)
    assert lagging[:, 0] == pytest.approx(plain + 0.1 * z, abs=1e-7)
    switching = run(
        law("law_reading", sensor="T_a_C", driver="fan_speed_pct", form="threshold", size=1.0, on=60.0, off=60.0), 80
    )
    assert switching[:, 0] == pytest.approx(plain + (u[:, 2] >= 60.0), abs=1e-9)


def test_fluid_warms_a_node_by_its_share_of_the_content() -> None:
    """Twenty kilograms at 80 degC pour through a node that mixes well."""
    text = law("law_fluid", node="b", temperature=80.0, amount=20.0, course="pulse", start_s=3.0, decay_s=4.0)
    alone = STAMPED.replace('[elements.link]\nkind = "conduction"\nfrom = "a"\nto = "b"\nresistance = 0.5\n', "")
    alone += '[elements.l]\nkind="ambient_loss"\nnode="a"\nhA=1.0\n'
    net = parse(alone + text)
    time = np.arange(0.0, 200.0)
    end = simulate(net, time, np.column_stack([time, np.tile(U, (200, 1))]), np.array([30.0, 20.0]))[-1, 1]
    assert end == pytest.approx(80.0 - 60.0 * np.exp(-20.0 * 4180.0 / 4000.0), abs=1e-3)


@pytest.mark.parametrize("form", [f for f in FORMS if f not in ("constant", "threshold", "memory", "rate")])
def test_a_law_of_temperatures_is_integrated_as_its_formula_says(form: str) -> None:
    keys = {"gain": -3.0, "size": -60.0, "scale": 8.0, "exponent": 1.6, "width": 3.0, "reference": 2.0}
    own = {name: value for name, value in keys.items() if name in FORMS[form]}
    assert worst_error(law("law_heat", node="b", of="b", minus_input="T_ambient_C", form=form, **own)) < 1e-4


@pytest.mark.parametrize("form", ["memory", "rate"])
def test_a_memory_of_a_temperature_is_a_state_of_the_kernel(form: str) -> None:
    text = law("law_heat", node="b", of="a", minus_input="T_ambient_C", form=form, gain=2.0, lag_s=30.0)
    net, (time, u) = network(text), drivers(60)
    assert np.abs(simulate(net, time, u, START) - simulate_fine_steps(net, time, u, START)).max() < 2e-4


def test_a_thermostat_switches_at_the_samples_that_reach_its_thresholds() -> None:
    """Heating by 900 W from 40 degC down until 45 degC."""
    text = law("law_heat", node="a", of="a", form="threshold", size=900.0, on=40.0, off=45.0)
    text += '[elements.l]\nkind="ambient_loss"\nnode="a"\nhA=5.0\n'
    time = np.arange(0.0, 4000.0, 1.0)
    a = simulate(network(text), time, np.tile(U, (4000, 1)), np.array([44.0, 44.0]))[:, 0]
    assert a.min() < 40.0 < 39.0 + a.min() and a.max() > 45.0 and np.ptp(a[2000:]) < 8.0
    turns = np.flatnonzero(np.diff(np.sign(np.diff(a))))
    assert len(turns) > 4
    assert all(a[k + 1] < 40.0 + 0.2 or a[k + 1] > 45.0 - 0.2 for k in turns)


def sites() -> list[tuple[str, str]]:
    found = []
    for kind in sorted(k for k, cls in KINDS.items() if issubclass(cls, Law)):
        own = {
            "law_heat": 'node = "a"\nsource = "b"\n',
            "law_fluid": 'node = "a"\ntemperature = 90.0\n',
            "law_conductance": 'node = "a"\nto = "b"\n',
            "law_flow": 'flow = "f"\n',
            "law_reading": 'sensor = "T_a_C"\n',
            "law_actuator": 'column = "heater_power_W"\n',
            "law_input": 'column = "T_ambient_C"\n',
        }[kind]
        found.append((kind, own))
    return found


def sites_by_kind(kind: str) -> tuple[str, str]:
    return next(site for site in sites() if site[0] == kind)


def one_law(name: str, kind: str, own: str, form: str, course: str, driver: str) -> str:
    needed = "".join(f"{n} = {v}\n" for n, v in (("on", 50.0), ("off", 40.0)) if n in FORMS[form])
    times = {"start_s": 20.0, "end_s": 90.0, "settle_s": 50.0, "period_s": 30.0, "decay_s": 20.0}
    needed += "".join(f"{n} = {v}\n" for n, v in times.items() if n in COURSES[course])
    return f'[elements.{name}]\nkind = "{kind}"\n{own}{driver}form = "{form}"\ncourse = "{course}"\n{needed}'


@pytest.mark.parametrize("driver", ['driver = "fan_speed_pct"\n', 'of = "a"\nminus = "b"\n'])
def test_every_corner_of_the_bounds_is_finite(driver: str) -> None:
    """One network with every form of heat, and with every other site."""
    parts = ""
    wanted = [*((sites_by_kind("law_heat"), form) for form in FORMS), *((s, "") for s in sites())]
    for k, ((kind, own), form) in enumerate(wanted):
        switched = kind in ("law_fluid", "law_actuator", "law_input") and "of" in driver
        form = form or ("threshold" if switched else "dead_band")
        parts += one_law(
            f"x{k}", kind, own, form, list(COURSES)[k % len(COURSES)], driver if form != "constant" else ""
        )
    net = parse(STAMPED + FLOW + ACTUATOR + POWER + LOSS + METER + parts)
    ids = tuple(p.id for p in net.parameters.values() if p.element.startswith("x"))
    rng, (low, high) = np.random.default_rng(0), net.bounds(ids)
    full = np.tile(net.values, (32, 1))
    full[:, net.index(ids)] = np.where(rng.random((32, len(ids))) < 0.5, low, high)
    full[0, net.index(ids)], full[1, net.index(ids)] = low, high
    time, u = drivers(12)
    readings, end = Kernel(net, ids).trace(full, START, time, np.column_stack([time, u]))
    assert np.isfinite(readings).all() and np.isfinite(end).all()


def test_a_law_of_zero_strength_changes_nothing() -> None:
    assert np.array_equal(heat(law("law_heat", node="a", of="b", form="dead_band")), [0.0, 0.0])
    fixed = law("law_heat", node="a", course="step", start_s=0.0).replace(
        "[elements.x]", "[elements.x]\nsize = { status = 'fixed' }"
    )
    assert kernel_source(parse(STAMPED + fixed), "trace", (), 1) == kernel_source(parse(STAMPED), "trace", (), 1)


@pytest.mark.parametrize(
    ("extra", "said"),
    [
        (law("law_heat", node="a", form="linear"), "needs a driver"),
        (law("law_heat", node="a", driver="fan_speed_pct"), "follows nothing; leave driver out"),
        (law("law_heat", node="a", driver="fan_speed_pct", of="b", form="linear"), "needs a driver: give either"),
        (law("law_heat", node="a", driver="fan_speed_pct", minus="b", form="linear"), "is no temperature in degC"),
        (law("law_heat", node="a", of="a", minus="a", form="linear"), "same node"),
        (law("law_heat", node="a", source="a"), "the node itself"),
        (law("law_heat", node="a", form="cubic"), "is not one of constant, linear"),
        (law("law_heat", node="a", course="step", start_s=3.0), "needs the input 'time_s'; declare it"),
        (law("law_heat", node="a", form="linear", of="c"), "no such node 'c'"),
        (law("law_conductance", node="a"), "give either a node"),
        (FLOW + law("law_flow", flow="f", of="a", form="memory"), "as it is at each sample"),
        (law("law_flow", flow="a"), "'a' is no element of kind flow"),
        (law("law_reading", sensor="T_c_C"), "did you mean"),
        (law("law_reading", sensor="T_a_C", of="a", form="memory"), "its lag_s"),
        (law("law_actuator", column="heater_power_W"), "has no actuator to change"),
        (law("law_input", column="T_ambient_C"), "has no actuator to change"),
        (ACTUATOR + law("law_input", column="heater_power_W"), "is no temperature in degC"),
    ],
)
def test_inconsistent_laws_are_refused_in_one_sentence(extra: str, said: str) -> None:
    with pytest.raises(TwinFileError, match=said):
        network(extra)


def test_a_spell_must_end_after_it_begins() -> None:
    with pytest.raises(TwinFileError, match="end_s must be later"):
        parse(STAMPED + law("law_heat", node="a", course="interval", start_s=9.0, end_s=3.0))


@pytest.mark.parametrize(("kind", "own"), sites())
def test_a_law_is_written_as_it_is_read(kind: str, own: str) -> None:
    driver = 'driver = "T_supply_C"\nminus_input = "T_ambient_C"\n'
    net = parse(STAMPED + FLOW + ACTUATOR + POWER + METER + one_law("x", kind, own, "threshold", "periodic", driver))
    again = parse(dump(net))
    assert again.elements == net.elements and dict(again.parameters) == dict(net.parameters)


SITES = Sites(("a", "b"), ("fan_speed_pct",), "", "", {}, {"a": "a", "b": "b"}, {}, (), {})


def test_laws_are_proposed_by_no_catalogue_yet() -> None:
    for cls in KINDS.values():
        if issubclass(cls, Law):
            assert cls.missing_candidates(SITES) == ()
