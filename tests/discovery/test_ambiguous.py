"""Two causes of one record: the set, the experiment that tells them apart, and the record of it that does."""

from __future__ import annotations

import numpy as np
import pytest

from tests.discovery.conftest import Bench
from tests.discovery.plans import STEADY, inputs_of, run, steady
from tests.same_questions import diagnose
from tests.twin.conftest import LOOP
from twin.discovery.evidence.part import Part
from twin.discovery.healthy.basis import Columns, basis
from twin.discovery.planning.design import Runner, informed
from twin.discovery.planning.experiment import MARGIN_K, Limits
from twin.discovery.records.grid import on_grid
from twin.discovery.refit.fitting import fit
from twin.discovery.refit.model import Model
from twin.kernel import Kernel
from twin.network import Network
from twin.twinfile import load

RIG = Limits(
    {"heater_power_W": (0.0, 1000.0), "pump_speed_pct": (0.0, 100.0), "fan_speed_pct": (0.0, 100.0)}, 75.0, "rig"
)
HEATED, GAINED = ("heat_source", "modules", "constant"), ("actuator", "heater_power", "constant")
LOST, WARMED = ("heat_loss", "tank", "temperature_difference"), ("heat_source", "tank", "constant")
PUMPED = ("heat_source", "tank", "pump_speed")


@pytest.fixture(scope="module")
def bench(slow_pair: Bench) -> Bench:
    return slow_pair


@pytest.fixture(scope="module")
def healthy(slow_pair_healthy: Columns) -> Columns:
    return slow_pair_healthy


def truths(bench: Bench) -> dict[tuple[str, str, str], Network]:
    """Networks that have one cause each; in pairs they are the same at one load."""
    source = {"kind": "heat_source", "node": "modules", "power": 40.0}
    warm = {"kind": "heat_source", "node": "tank", "power": 18.0}
    pumped = {
        "kind": "heat_source",
        "node": "tank",
        "driver": "pump_speed_pct",
        "law": "cubed",
        "power_100": 60.0 / 0.85**3,
    }
    return {
        HEATED: bench.with_element("more", source),
        GAINED: bench.with_values(heater_power__factor=1.0 + 40.0 / 700.0),
        WARMED: bench.with_element("more", warm),
        LOST: bench.with_values(tank_loss__hA=0.8),
        PUMPED: bench.with_element("more", pumped),
    }


@pytest.mark.parametrize(("truth", "twin_cause"), [(GAINED, HEATED), (WARMED, LOST)])
def test_causes_alike_at_one_load_are_a_set_and_the_planned_record_names_the_right_one(
    bench: Bench, healthy: Columns, truth: tuple[str, str, str], twin_cause: tuple[str, str, str]
) -> None:
    network, changed = bench.network, truths(bench)[truth]
    record = run(network, steady(8.0), changed, 3.0)
    found = diagnose(network, record, healthy, limits=RIG)
    assert found.verdict == "ambiguous"
    said = {(a.kind, a.where, a.driver): a.confidence for a in found.indistinguishable}
    # Errors of actuators are rarer than heat, by the priors; nothing in the record is against either.
    assert said[truth] > 0.02 and said[twin_cause] > 0.02 and sum(said.values()) < 1.01
    assert "indistinguishable from" in found.summary
    plan = found.next_experiment
    assert plan is not None and plan["possible"] and plan["expected_difference"] > plan["needed_difference"]
    for step in plan["steps"]:
        assert all(RIG.driven[c][0] <= v <= RIG.driven[c][1] for c, v in step.items() if c != "time_s")
    later = run(network, plan["steps"], changed, seed=2)
    settled = diagnose(network, record, healthy, more=(later,), limits=RIG)
    assert settled.verdict == "effect found" and settled.next_experiment is None
    assert [(e.kind, e.where, e.driver) for e in settled.effects] == [truth]
    # Whatever decides between them, the answer's score is still that of the record that it explains.
    assert settled.effects[0].z == pytest.approx(found.effects[0].z, rel=5e-4)


def test_what_an_effect_follows_is_left_open_and_the_planned_record_tells() -> None:
    """Kind and place are sure, so the verdict stands; the pump never changed its speed, so what heats is open.

    Of two volumes, water that heats the tank is not told from its radiator; of the four of the shipped loop it is.
    """
    bench = Bench(load(LOOP))
    healthy = bench.record(10.0, seed=7)
    network, changed = bench.network, truths(bench)[PUMPED]
    record = run(network, steady(8.0), changed, 3.0)
    found = diagnose(network, record, healthy, limits=RIG)
    assert found.verdict == "effect found" and found.effects[0].where == "tank"
    assert PUMPED in {(a.kind, a.where, a.driver) for a in found.indistinguishable}
    assert "it may follow" in found.summary and "pump speed" in found.summary
    assert found.next_experiment is not None and found.next_experiment["possible"]
    later = run(network, found.next_experiment["steps"], changed, seed=2)
    settled = diagnose(network, record, healthy, more=(later,), limits=RIG)
    (effect,) = settled.effects
    assert (effect.kind, effect.where, effect.driver) == PUMPED
    assert effect.value == pytest.approx(60.0 / 0.85**3, rel=0.05)


def test_a_second_plan_goes_on_from_what_the_first_records_told(bench: Bench, healthy: Columns) -> None:
    """Load and fan were moved since, the pump not: only what the pump tells is asked for again."""
    network, changed = bench.network, truths(bench)[PUMPED]
    record = run(network, steady(8.0), changed, 3.0)
    first = diagnose(network, record, healthy, limits=RIG).next_experiment
    warm, slow = {**STEADY, "heater_power_W": 860.0}, {**STEADY, "fan_speed_pct": 40.0}
    since = [{"time_s": 0.0, **STEADY}, {"time_s": 2400.0, **warm}, {"time_s": 4800.0, **slow}]
    later = run(network, [*since, {"time_s": 7200.0, **slow}], changed, seed=2)
    second = diagnose(network, record, healthy, more=(later,), limits=RIG).next_experiment
    assert first is not None and second is not None and second["possible"]
    assert set(second["causes"]) < set(first["causes"])
    assert second["hours"] <= first["hours"]
    speeds = {step["pump_speed_pct"] for step in second["steps"]}
    assert len(speeds) > 1
    settled = diagnose(
        network, record, healthy, more=(later, run(network, second["steps"], changed, seed=3)), limits=RIG
    )
    assert settled.next_experiment is None
    assert [(e.kind, e.where, e.driver) for e in settled.effects] == [PUMPED]


def test_what_a_record_told_of_a_cause_leaves_it_less_room_in_the_next(bench: Bench, healthy: Columns) -> None:
    network = bench.network
    grid = on_grid(network, healthy.time_s, healthy.inputs, healthy.measured)
    known = basis(network, healthy, grid)
    part = Part.of(known, grid.part(0, 720))
    fitted = fit(part.score_test, Model.of(known.probe, ()), part.state)
    state = network.initial_state(grid.measured[:30])
    runner = Runner(known.probe, fitted, np.empty(0), known.prior, state)
    before = runner.precision
    runner.learn(informed(runner, grid, known.noise))
    gained = np.linalg.eigvalsh(runner.precision - before)
    assert gained.min() > -1e-6 * gained.max() and gained.max() > 1.0
    # Where that record began tells nothing of where the next one does.
    q = len(known.probe.scaling.ids)
    assert (runner.precision - before)[q : q + len(network.nodes)] == pytest.approx(0.0)


def test_a_plan_keeps_every_cause_below_the_hottest_that_the_rig_allows(bench: Bench, healthy: Columns) -> None:
    changed = truths(bench)[GAINED]
    record = run(bench.network, steady(8.0), changed, 3.0)

    def hottest(limits: Limits) -> tuple[float, float]:
        """What the plan expects, and what comes of it."""
        plan = diagnose(bench.network, record, healthy, limits=limits).next_experiment
        assert plan is not None and plan["possible"]
        t, u = inputs_of(bench.network, plan["steps"])
        state = np.array(bench.start_C)
        return plan["hottest_C"], float(Kernel(changed, ()).trace(changed.values, state, t, u)[0][0].max())

    expected, free = hottest(RIG)
    assert free < RIG.hottest_C
    cool = Limits(RIG.driven, expected + MARGIN_K - 0.5, "rig")
    colder, read = hottest(cool)
    assert colder < expected and read < cool.hottest_C


def test_no_plan_is_given_that_would_be_too_hot(bench: Bench, healthy: Columns) -> None:
    record = run(bench.network, steady(8.0), truths(bench)[GAINED], 3.0)
    colder = Limits(RIG.driven, float(record.measured.max()) - 4.0, "rig")
    plan = diagnose(bench.network, record, healthy, limits=colder).next_experiment
    assert plan is not None and not plan["possible"] and "steps" not in plan
    assert "keep every reading below" in plan["why"]


def test_without_a_rig_file_a_plan_stays_about_where_the_twin_has_been(bench: Bench, healthy: Columns) -> None:
    record = run(bench.network, steady(8.0), truths(bench)[HEATED], 3.0)
    plan = diagnose(bench.network, record, healthy).next_experiment
    assert plan is not None and plan["possible"]
    for j, column in enumerate(bench.network.input_columns[:3]):
        low, high = healthy.inputs[:, j].min(), healthy.inputs[:, j].max()
        assert all(low - 0.5 * (high - low) <= step[column] <= high for step in plan["steps"])
    assert plan["hottest_C"] < float(record.measured.max()) + 3.0


def test_where_no_input_can_tell_the_measurement_that_can_is_named(bench: Bench, healthy: Columns) -> None:
    """Fins that conduct less and a fan that turns slower than it says."""
    record = run(bench.network, steady(8.0), bench.with_values(fins__UA_100=54.0), 3.0)
    plan = diagnose(bench.network, record, healthy, limits=RIG).next_experiment
    assert plan is not None
    together = [names for names in plan["stay_alike"] if "heat rejection at tank (constant)" in names]
    assert together and "actuator at fan speed" in together[0]
    assert any("tachometer" in text for text in plan["measure"])
