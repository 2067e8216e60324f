"""What a named effect has to beat: an unknown of no listed form, and its own error of form."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.discovery.conftest import HOUR, Bench
from twin.discovery import diagnose
from twin.discovery.answer import acceptance
from twin.discovery.effects.catalogue import catalogue
from twin.discovery.evidence.hypotheses import Found
from twin.discovery.evidence.marginal import form_basis
from twin.discovery.evidence.part import Part
from twin.discovery.evidence.priors import CLAIM
from twin.discovery.healthy.basis import Columns, basis
from twin.discovery.records.grid import on_grid
from twin.revisions.law_adoption import adopt_law


def part_of(bench: Bench, healthy: Columns, record: Columns) -> Part:
    grid = on_grid(bench.network, record.time_s, record.inputs, record.measured)
    return Part.of(basis(bench.network, healthy, grid), grid)


def test_a_large_constant_error_is_no_likelier_an_unknown_than_itself(bench: Bench, healthy: Columns) -> None:
    """An error of forty typical sizes is as unusual for an unknown as for a named effect."""
    record = bench.record(10.0, seed=8)
    measured = record.measured.copy()
    j = bench.network.sensor_names.index("T_tank_C")
    measured[:, j] += 8.0
    part = part_of(bench, healthy, replace(record, measured=measured))
    own = [e for e in part.scanned if (e.candidate.where, e.candidate.driver) == ("T_tank_C", "constant")]
    named = max(e.log_bayes for e in own)
    unknown = next(course.log_evidence for course in part.free if course.site == "T_tank_C")
    assert own[0].size == pytest.approx(8.0, abs=0.1)
    assert unknown < named - CLAIM


@pytest.mark.parametrize(
    ("where", "left", "needed"),
    [
        ("T_tank_C", 1.5, 20.0 - CLAIM),
        ("T_tank_C", 0.5, -math.inf),
        ("tank", 0.5, 20.0),
        ("T_heater_C", 1.5, 20.0),
    ],
)
def test_an_unknown_needs_a_claim_and_misfit_at_the_place_of_a_named_effect_alone(
    where: str, left: float, needed: float
) -> None:
    found = Found((), [], None, {("tank", True): 20.0})  # type: ignore[arg-type]
    candidate = SimpleNamespace(where=where, kind="sensor" if where.startswith("T_") else "heat_source")
    named = SimpleNamespace(entries=(SimpleNamespace(candidate=candidate),), fit=SimpleNamespace(chi=left))
    assert found.rival_of(named, 0.7) == pytest.approx(needed)  # type: ignore[arg-type]
    assert found.unlisted == pytest.approx(20.0)


def test_the_error_of_form_follows_each_input_that_moves(pair: Bench, pair_healthy: Columns) -> None:
    record = pair.record(8.0, seed=3)
    still = record.inputs.copy()
    still[:, 1] = 85.0
    moving, held = (part_of(pair, pair_healthy, replace(record, inputs=u)).score_test for u in (record.inputs, still))
    assert form_basis(moving).shape[1] - form_basis(held).shape[1] == 1
    followed = form_basis(held)[:, -3:]
    assert np.allclose(followed.mean(axis=0), 0.0, atol=1e-9) and np.allclose(followed.std(axis=0), 1.0)
    fan = held.block_means(held.grid.inputs)[:, 2]
    assert np.corrcoef(followed[:, 1], fan)[0, 1] == pytest.approx(1.0)


@pytest.mark.parametrize(("bins", "told"), [(6, True), (40, False)])
def test_less_than_a_block_of_held_out_record_contradicts_nothing(
    monkeypatch: pytest.MonkeyPatch, bins: int, told: bool
) -> None:
    monkeypatch.setattr(acceptance, "contradicted", lambda errors, network: True)
    case = SimpleNamespace(
        finding=SimpleNamespace(fit=object(), entries=()),
        known=SimpleNamespace(probe=SimpleNamespace(network=None)),
        whole=SimpleNamespace(step_s=480.0),
        grid=SimpleNamespace(time=np.arange(100), step_s=30.0),
        split=100 - bins,
        errors={},
    )
    assert acceptance.accepted(case) is told  # type: ignore[arg-type]


def test_an_actuator_may_fail_altogether(pair: Bench) -> None:
    """Also where a tunable of the twin may not go so far."""
    gains = [c for c in catalogue(pair.network) if c.kind == "actuator" and c.driver == "constant" and c.adds]
    assert gains and all(c.lower == -1.0 for c in gains)


def test_a_flow_that_follows_a_temperature_is_named_with_it(brisk: Bench, brisk_healthy: Columns) -> None:
    law = {"kind": "law_flow", "flow": "circuit", "of": "tank", "form": "linear"}
    tank = brisk.network.sensor_names.index("T_tank_C")
    middle = float(np.median(brisk.record(16.0, seed=6).measured[:, tank]))
    changed = adopt_law(brisk.network, law, {"gain": -0.02, "reference": middle})
    found = diagnose(brisk.network, brisk.record(16.0, seed=6, changed=changed, onset_h=4.0), brisk_healthy)
    effect = found.effects[0]
    assert (effect.kind, effect.where, effect.driver) == ("flow", "loop", "temperature")
    assert effect.onset_s == pytest.approx(4.0 * HOUR, abs=HOUR / 4)
