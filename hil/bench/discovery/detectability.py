"""Visibility of a true effect in a record, and its size in the catalogue's unit; computed after answers are sealed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hil.bench.discovery.score import family, same_driver
from twin import Array, Network
from twin.discovery.effects.laws import CandidateLaw
from twin.discovery.scoring.score_tests import ScoreTest

_UNITS = {"bias": "K", "drift_per_h": "K", "lag_s": "s"}


def signature(score_test: ScoreTest, shown: Array, without: Array) -> Array:
    """Return the whitened signature (b * m,) of an effect, from readings (n, m) with it and without it.

    A record that was ended early has fewer rows; what it lacks counts as no difference.
    """
    rows = len(score_test.grid.time)
    change = np.zeros((rows, shown.shape[1]))
    both = min(rows, len(shown), len(without))
    change[:both] = np.nan_to_num(shown[:both] - without[:both])
    return score_test.features(score_test.seen(change))


def visible(score_test: ScoreTest, signatures: Sequence[Array]) -> tuple[list[float], list[float]]:
    """Return scores of true effects: each alone, and each with the sizes of the others fitted.

    Tunables and initial state are projected out, with their prior. What is not visible beside the others has a score
    of 0.
    """
    gram = score_test.across(np.column_stack(signatures))
    alone = np.sqrt(np.maximum(np.diag(gram), 0.0))
    beside = []
    for i in range(len(gram)):
        others = np.arange(len(gram)) != i
        shared, *_ = np.linalg.lstsq(gram[np.ix_(others, others)], gram[others, i], rcond=1e-12)
        beside.append(float(np.sqrt(max(gram[i, i] - gram[others, i] @ shared, 0.0))))
    return alone.tolist(), beside


def true_size(
    found: Sequence[CandidateLaw],
    network: Network,
    table: Mapping[str, Any],
    label: tuple[str, str, str],
    span_s: float,
) -> tuple[float, str] | None:
    """Return size and unit of a true effect at the end of a record of `span_s`, as of its candidate; None if it has
    none.
    """
    laws_of: list[CandidateLaw] = []
    for where in dict.fromkeys((label[1], family(label[1]))):
        laws_of = laws_of or [w for w in found if (w.candidate.kind, w.candidate.where) == (label[0], where)]
    # A growing effect is the steady law in a growing shape.
    driver = "constant" if table.get("driver") == "elapsed_time" else str(table.get("driver"))
    reached = float(course_of(table, np.array([span_s - 1.0, span_s]))[-1])
    for law in [w for w in laws_of if same_driver(w.candidate.driver, driver)] or laws_of:
        size = catalogue_size(table, law, network)
        if size is not None:
            return size * reached, law.candidate.unit
    return None


def course_of(table: Mapping[str, Any], edges_s: Array) -> Array:
    """Return the share of its size that an effect has in each block."""
    middle = 0.5 * (edges_s[1:] + edges_s[:-1])
    since = np.maximum(middle - table.get("onset_s", 0.0), 0.0)
    course = np.clip((edges_s[1:] - table.get("onset_s", 0.0)) / np.diff(edges_s), 0.0, 1.0)
    if table.get("ramp_s"):
        course = np.clip(since / table["ramp_s"], 0.0, 1.0)
    if "tau_s" in table:
        course = -np.expm1(-since / table["tau_s"])
    if "drift_per_h" in table:
        course = since / 3600.0
    if "end_s" in table:
        course = np.where(middle > table["end_s"], 0.0, course)
    return np.asarray(course, dtype=np.float64)


def catalogue_size(table: Mapping[str, Any], law: CandidateLaw, network: Network) -> float | None:
    """Return the size of an effect in the unit of its candidate; None if the two measure different quantities.

    So it is with the radiator's conductance and the fan's exponent, of the fins in the rig and of the whole way from
    water to air in the twin, and with a mass, whose capacity the catalogue has in steps.
    """
    c = law.candidate
    kind, driver = table["kind"], table.get("driver")
    if kind == "heat_source" and driver in ("constant", "elapsed_time", "pump_speed", "fan_speed"):
        return float(table["power_W"])
    if kind == "heat_source" and driver == "heater_power":
        return float(table["power_W"]) / 1000.0
    if kind == "heat_loss" and c.unit == "W/K":
        return float(table["conductance_W_per_K"])
    if kind == "flow" and "lost_fraction" in table and "circuit.factor" in c.changes:
        return -float(table["lost_fraction"]) * network.parameters["circuit.factor"].value
    for key in ("bypass_fraction", "bias", "drift_per_h", "lag_s"):
        if key in table and c.unit == _UNITS.get(key, c.unit):
            return float(table[key])
    if kind == "actuator":
        return float(table["gain"]) - 1.0
    return None
