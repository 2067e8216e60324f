"""What real records asked of growing (decision 0035): masses of the record's own time scales and two to a place, sets
that are asked whatever made them, members of a family that differ, sensors without a reading."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from tests.discovery.test_a_room import ROOM
from tests.discovery.test_records import TWINS, heaters
from twin.discovery.effects.catalogue import catalogue
from twin.discovery.growing.answer import diagnose_grown
from twin.discovery.growing.beam import Beam, FittedSet
from twin.discovery.growing.merit import Merit
from twin.discovery.growing.wardrobe import unsized
from twin.discovery.healthy.basis import Columns
from twin.discovery.scoring.search import Entry
from twin.elements.base import Candidate
from twin.network import Network
from twin.twinfile import load, parse

DAY_S = 86400.0


@pytest.fixture(scope="module")
def room() -> Network:
    return parse(ROOM)


def bare() -> Network:
    return load(TWINS / "tclab_bare.toml")


def a_set(candidates: list[Candidate], score: float, squares: float = 1.0) -> FittedSet:
    """A set with no fit behind it."""
    samples = SimpleNamespace(sigma=np.ones(1))
    fit = SimpleNamespace(
        entries=tuple(unsized(c, 1.0) for c in candidates), residual=np.array([math.sqrt(squares)]), cost=score
    )
    return FittedSet(SimpleNamespace(samples=samples), fit, score)  # type: ignore[arg-type]


def test_a_set_that_asking_has_fitted_is_asked_in_its_turn() -> None:
    """What is left of a set without a member that is not needed may be better than all that the beam had fitted."""
    one, other, *_ = (c for c in catalogue(bare()) if not c.replaces)
    empty, both, small = a_set([], 100.0), a_set([one, other], 10.0), a_set([one], 20.0)
    known = {s.ids: s for s in (empty, both)}
    rows = SimpleNamespace(samples=SimpleNamespace(time=np.arange(12)))

    class Asked(Merit):
        def _weakest(self, found: FittedSet) -> Entry | None:
            if found is both:
                known[small.ids] = small
                return both.fit.entries[1]
            return None

    beam = cast(Beam, SimpleNamespace(known=known, levels=[[empty], [both]], empty=rows))
    assert Asked(beam).earned() is small


def test_a_sensor_without_a_reading_is_named_and_spoils_nothing() -> None:
    t, u, y = heaters(bare(), 0)
    y[:, 1] = np.nan
    found = diagnose_grown(bare(), Columns(t, u, y), most=1)
    assert found.verdict == "adequate" and set(found.errors) == {"T1_C"}
    assert any(w.startswith("T2_C has no reading") for w in found.warnings)
