"""Sentence on the model discrepancy that a healthy record shows."""

from __future__ import annotations

import numpy as np

from twin.discovery.scoring.structure import Structure
from twin.elements.candidates import Candidate


def _delay(where: str, lower: float) -> Candidate:
    changes = {f"{where}.lag_s": 1.0}
    return Candidate("actuator", where, "history", "new", changes, "s", 60.0, lower, 3600.0, "is late by {value}")


def test_a_negative_delay_is_not_named_and_the_next_law_is() -> None:
    candidates = (_delay("pump", 0.0), _delay("fan", 0.0))
    structure = Structure(candidates, np.array([-6.0, 5.0]), np.diag([0.01, 0.01]))
    assert "late by 5" in structure.sentence and "-6" not in structure.sentence


def test_nothing_is_said_where_no_law_can_have_its_size() -> None:
    assert Structure((_delay("pump", 0.0),), np.array([-6.0]), np.array([[0.01]])).sentence == ""
