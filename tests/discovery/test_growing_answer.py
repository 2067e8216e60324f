"""Diagnoses without a healthy record: a twin that was never commissioned is grown, a commissioned one claims less."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest

from tests.discovery.conftest import Bench
from tests.discovery.test_records import TWINS, cooler, heaters
from twin.discovery.diagnosis import SensorError
from twin.discovery.engine import diagnose
from twin.discovery.evidence.commissioned import as_commissioned
from twin.discovery.growing.answer import LONGEST, diagnose_grown, fits_growth
from twin.discovery.healthy.basis import Columns
from twin.kernel import simulate
from twin.network import Revision, TwinFileError
from twin.revisions import with_elements
from twin.twinfile import load


def test_a_twin_that_was_never_commissioned_is_grown_and_judged_where_no_fit_saw_it() -> None:
    bare, full = load(TWINS / "tclab_bare.toml"), load(TWINS / "tclab.toml")
    record = Columns(*heaters(full, 1))
    assert fits_growth(bare, record)
    found = diagnose_grown(bare, record, more=(Columns(*heaters(full, 2)),), most=3, beam=2)
    assert found.verdict == "effect found" and found.method == "growth" and found.network is not None
    assert {(e.kind, e.where) for e in found.effects} == {
        ("sensor", "heaters"),
        ("coupling", "heater_2"),
        ("heat_loss", "heaters"),
    }
    assert all(e.family_wise < 0.01 and e.onset_s == 0.0 and e.confidence > 0.8 for e in found.effects)
    assert found.held_out_s == (450.0, 599.0)
    for error in found.errors.values():
        assert error.after < 2.0 * error.noise < 0.5 * error.before
    # One rung for each effect; hidden parts of the record speak for them together.
    assert [r.what.count("+") for r in found.ladder] == [0, 0, 1, 2] and found.ladder[0].what == "re-tuned"
    assert len(found.folds) == 12 and sum(f.gain > 0.0 for f in found.folds) >= 9
    assert all(a.why_not for a in found.alternatives)
    assert "read late by" in found.summary and "held-out segment" in found.summary


@pytest.mark.parametrize(("seed", "wander_K"), [(0, 0.0), (5, 0.2)])
def test_a_twin_that_lacks_nothing_stays_as_it_is(seed: int, wander_K: float) -> None:
    bare = load(TWINS / "tclab_bare.toml")
    found = diagnose_grown(bare, Columns(*heaters(bare, seed, wander_K=wander_K)), most=2)
    assert found.verdict == "adequate" and not found.effects and found.network is None


@pytest.mark.skipif(not os.environ.get("HIL_SLOW"), reason="a minute; set HIL_SLOW=1 to repeat it")
def test_what_comes_in_half_way_is_not_taken_for_what_was_always_there() -> None:
    bare = load(TWINS / "tclab_bare.toml")
    hot = with_elements(bare, {"more": {"kind": "heat_source", "node": "heater_1", "power": 0.5}})
    t, u, _ = heaters(bare, 1)
    before = simulate(bare, t[:331], u[:331], np.array([23.0, 23.0]))
    y = np.vstack([before[:-1], simulate(hot, t[330:], u[330:], before[-1])])
    found = diagnose_grown(bare, Columns(t, u, y + np.random.default_rng(1).normal(0.0, 0.1, y.shape)), beam=2)
    assert found.verdict == "unexplained" and not found.effects and found.network is None
    assert "half way" in found.summary


def test_steady_states_are_judged_on_every_fourth() -> None:
    constant = load(TWINS / "dry_cooler_constant.toml")
    truth = constant.with_values({"fins.fan_exponent": 0.65, "fins.UA_100": 24000.0})
    u, y = cooler(truth, 32, 3)
    found = diagnose_grown(constant, Columns(np.arange(32.0), u, y), at_rest=True)
    (effect,) = found.effects
    assert (effect.kind, effect.where, effect.driver) == ("heat_rejection", "core", "fan_speed")
    assert found.verdict == "effect found" and found.method == "growth at rest"
    assert found.hours * 3600.0 == pytest.approx(np.arange(1.0, 33.0)) and found.held_out_s == (4.0, 32.0)
    assert found.errors["T_out_C"].after < 2.0 * found.errors["T_out_C"].noise
    assert "from the beginning" not in found.summary
    with pytest.raises(TwinFileError, match="one file"):
        diagnose_grown(constant, Columns(np.arange(32.0), u, y), more=(Columns(np.arange(32.0), u, y),), at_rest=True)
    with pytest.raises(TwinFileError, match=r"at least 12"):
        diagnose_grown(constant, Columns(np.arange(14.0), u[:14], y[:14]), at_rest=True)


def test_a_commissioned_twin_and_a_long_record_are_left_to_the_contest(bench: Bench) -> None:
    record = bench.record(2.0)
    short = Columns(record.time_s, record.inputs, record.measured)
    assert fits_growth(bench.network, short)
    assert not fits_growth(replace(bench.network, revision=Revision(1)), short)
    assert len(bench.record(16.0).time_s) > LONGEST and not fits_growth(bench.network, bench.record(16.0))


def test_without_a_healthy_record_a_twin_as_good_as_when_commissioned_lacks_nothing(bench: Bench) -> None:
    """What it leaves may look like an effect; the same twin with a real one is not as good."""
    sensors = bench.network.sensor_names
    revision = Revision(1, error_after_K=dict.fromkeys(sensors, 0.06))
    commissioned = replace(bench.network, revision=revision)
    good = dict.fromkeys(sensors, SensorError(0.2, 0.064, 0.05, 0.05))
    assert as_commissioned(commissioned, good)
    assert not as_commissioned(commissioned, good | {sensors[0]: SensorError(0.2, 0.07, 0.05, 0.05)})
    assert not as_commissioned(commissioned, {})
    heated = bench.with_element("more", {"kind": "heat_source", "node": "heater", "power": 40.0})
    found = diagnose(commissioned, bench.record(16.0, changed=heated, onset_h=5.0))
    assert [(e.kind, e.where) for e in found.effects] == [("heat_source", "heater")]
    assert diagnose(commissioned, bench.record(16.0, seed=3)).verdict == "adequate"
