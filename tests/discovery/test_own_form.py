"""What an effect does not say quite rightly of itself is not told as another one."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from twin.discovery.selection.ladder import of_own_form

from tests.discovery.conftest import Bench
from twin.discovery.answer.judging import REFUTED_LEFT
from twin.discovery.diagnosis import SensorError
from twin.discovery.effects.shapes import Shape
from twin.discovery.engine import diagnose
from twin.discovery.evidence.held_out import FAR_SHARE, contradicted
from twin.discovery.evidence.part import ENDS, Part, ended
from twin.discovery.healthy.basis import Columns, basis
from twin.discovery.records.grid import on_grid
from twin.discovery.refit.fitting import Fit
from twin.discovery.scoring.search import Entry
from twin.kernel import Kernel

PIECE_S = 300.0


def growing(bench: Bench, amount: Callable[[float], float], **coming: float) -> Columns:
    """Twenty hours of the loop while parameters change by `coming` times an amount of time, every five minutes."""
    t, u = bench.inputs(20.0, 1)
    changes = {name.replace("__", "."): by for name, by in coming.items()}
    kernel, values = Kernel(bench.network, tuple(changes)), bench.network.values
    edges = np.append(np.searchsorted(t, np.arange(0.0, t[-1], PIECE_S)), len(t) - 1)
    state, parts = np.array([37.0, 36.8, 34.5, 34.0]), []
    for low, high in pairwise(edges.tolist()):
        now = values.copy()
        now[bench.network.index(tuple(changes))] += amount(0.5 * (t[low] + t[high])) * np.array([*changes.values()])
        read, ends = kernel.trace(now, state, t[low : high + 1], u[low : high + 1])
        parts.append(read[0][:-1])
        state = ends[0][: len(bench.network.nodes)]
    y = np.vstack(parts)
    return Columns(t[:-1], u[:-1], y + bench.network.sigma * np.random.default_rng(3).normal(0.0, 1.0, y.shape))


def test_fouling_that_ends_in_the_last_hours_is_one_effect(bench: Bench, healthy: Columns) -> None:
    change = -0.35 * bench.network.parameters["fins.UA_100"].value
    record = growing(
        bench, lambda t: float(np.clip((t - 3.0 * 3600.0) / (13.6 * 3600.0), 0.0, 1.0)), fins__UA_100=change
    )
    found = diagnose(bench.network, record, healthy)
    assert found.verdict == "effect found"
    (effect,) = found.effects
    assert (effect.kind, effect.where, effect.driver) == ("heat_rejection", "radiator", "elapsed_time")
    assert effect.value == pytest.approx(change, rel=0.05)


@pytest.fixture(scope="module")
def part(bench: Bench, healthy: Columns) -> Part:
    grid = on_grid(bench.network, healthy.time_s, healthy.inputs, healthy.measured)
    return Part.of(basis(bench.network, healthy, grid), grid)


def test_what_eases_off_is_tried_as_what_stopped(part: Part, monkeypatch: pytest.MonkeyPatch) -> None:
    """As large at the record's end, and at its end at some shares of the record."""
    law = next(law for law in part.laws if law.candidate.kind == "heat_rejection")
    eased = Entry(law, Shape("saturating", 3600.0, 40_000.0), np.empty(0), -5.0, 0.0, 0.0)
    found = SimpleNamespace(chi=2.0 * part.contest.expected, entries=(eased,))
    monkeypatch.setattr("twin.discovery.evidence.part.fitted", lambda _, groups: groups)
    groups: Any = ended(part, found, ())  # type: ignore[arg-type]
    span_s = part.grid.span_s
    assert [(g.shape.onset_s + g.shape.growth_s) / span_s for (g,) in groups] == pytest.approx(ENDS)
    reached = -5.0 * eased.shape.mean(span_s - 1.0, span_s)
    assert all(g.shape.name == "ramp" and g.size == pytest.approx(reached) for (g,) in groups)
    assert ended(part, SimpleNamespace(chi=0.0, entries=(eased,)), ()) == []  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("where", "onset_s", "left", "won", "own"),
    [
        ("T_modules_C", 14_460.0, 1.6, 300.0, True),
        ("T_tank_C", 14_460.0, 1.6, 300.0, False),
        ("T_modules_C", 25_000.0, 1.6, 300.0, False),
        ("T_modules_C", 14_460.0, 2.5, 300.0, False),
        ("T_modules_C", 14_460.0, 1.6, 900.0, False),
    ],
)
def test_what_reads_otherwise_at_a_loss_and_since_then_mends_its_form(
    part: Part, where: str, onset_s: float, left: float, won: float, own: bool
) -> None:
    laws = {(law.candidate.kind, law.candidate.where, law.candidate.driver): law for law in part.laws}
    loss, reading = laws["heat_loss", "modules", "temperature_difference"], laws["sensor", where, "constant"]
    one = Entry(loss, Shape("step", 14_400.0), np.empty(0), 7.0, 0.1, 9000.0).refreshed(part.contest)
    other = Entry(reading, Shape("step", onset_s), np.empty(0), -0.3, 0.01, 200.0).refreshed(part.contest)
    none = np.empty(0)
    before = Fit((one,), none, none, none, 1000.0, left * part.contest.expected, 4.0, True)
    best = Fit((one, other), none, none, none, 1000.0 - won, 0.7 * part.contest.expected, 4.0, True)
    assert of_own_form(before, best, part.contest, 600.0) is own


@pytest.mark.parametrize(("left", "plainly", "refuted"), [(0.1, False, False), (0.3, False, True), (0.6, True, True)])
def test_an_answer_beside_which_more_scored_has_to_foretell_better(
    bench: Bench, left: float, plainly: bool, refuted: bool
) -> None:
    errors = {"T_tank_C": SensorError(2.0, 1.6, 1.6 * left, 0.05, (2.0, 1.6, 1.6 * left), 0.05)}
    assert contradicted(errors, bench.network, FAR_SHARE) is plainly
    assert contradicted(errors, bench.network, REFUTED_LEFT) is refuted
