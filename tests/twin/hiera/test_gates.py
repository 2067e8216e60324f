"""Gates of a proposal: each closes for its own reason."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from twin.calibrators.hiera_unet.serve import gates


def open_gates() -> gates.Evidently:
    rng = np.random.default_rng(0)
    return gates.Evidently(
        hidden=0.1,
        steps=1440,
        measured=rng.normal(size=(120, 2)),
        noise=np.ones(2),
        condition=30.0,
        told=np.array([True, True]),
        half_width=np.array([0.1, 0.2]),
        missed=np.array([0.1, np.nan]),
        left=np.array([0.02, np.nan]),
        tolerated=0.1,
        lost=(),
        sd=np.array([0.1, 0.1]),
        prior=np.array([0.4, 0.4]),
        distance=0.5,
        leakage=0.0,
    )


def warming(steps: int, *jumps: float) -> Any:
    """Thermometers (n, 2) that rise, and jump by so much in the middle."""
    return np.arange(float(steps))[:, None] / 20.0 + np.repeat([[0.0, 0.0], jumps], steps // 2, axis=0)


@pytest.mark.parametrize(
    ("other", "code", "held"),
    [
        ({}, "", [False, False]),
        ({"hidden": 0.3}, "MISSING_REQUIRED", [True, True]),
        ({"steps": 100}, "SHORT_RECORD", [True, True]),
        ({"told": np.array([False, False])}, "LOW_SENSITIVITY", [True, True]),
        ({"told": np.array([True, False])}, "LOW_SENSITIVITY", [False, True]),
        ({"half_width": np.array([0.1, 0.9])}, "HIGH_UNCERTAINTY", [True, True]),
        ({"sd": np.array([0.3, 0.1])}, "HIGH_UNCERTAINTY", [True, False]),
        ({"distance": 1.2}, "OUT_OF_ENVELOPE", [True, True]),
        ({"missed": np.array([0.5, np.nan]), "left": np.array([0.2, 0.0])}, "CONTRADICTORY_EVENT", [True, True]),
        ({"missed": np.array([0.5, np.nan])}, "", [False, False]),
        ({"missed": np.full(2, 0.09), "half_width": np.full(2, 0.01), "left": np.full(2, 0.2)}, "", [False, False]),
        ({"leakage": 0.1}, "LEAKAGE", [True, True]),
        ({"lost": ("T_ambient_C",)}, "LOST_INPUT", [True, True]),
        ({"measured": warming(500, 25.0, 25.0)}, "SHUFFLED_RECORD", [True, True]),
        ({"measured": warming(120, 0.0, 20.0)}, "", [False, False]),
    ],
)
def test_each_gate_closes_for_its_own_reason(other: dict[str, Any], code: str, held: list[bool]) -> None:
    found = gates.reasons(replace(open_gates(), **other), ("a", "b"))
    assert {r.code for r in found} == ({code} if code else set())
    assert gates.held(found, ("a", "b")).tolist() == held


def test_a_record_that_is_a_little_too_short_is_said_to_be_so() -> None:
    (reason,) = gates.reasons(replace(open_gates(), steps=354), ("a", "b"))
    assert reason.sentence == "29.5 minutes of record have been seen, fewer than 30"
