"""An unknown within the error that the law of one of the twin's own elements may have is no finding."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twin.discovery.answer import acceptance
from twin.discovery.diagnosis import Course
from twin.discovery.places.sites import Site
from twin.network import Array

WANDERS = np.random.default_rng(4).uniform(-1.0, 1.0, 240)
LATE = np.where(np.arange(240) < 120, 0.0, WANDERS)
RADIATOR = Site(np.zeros((8, 240)), 2.0, "W/K", "energy", "heat_rejection", "radiator", present=40.0)
TANK = Site(np.zeros((8, 240)), 20.0, "W", "energy", "heat_source", "tank")


def case(monkeypatch: pytest.MonkeyPatch, site: str, mean: Array, unlisted: float = 50.0) -> Any:
    """A finding in which an unknown at a site is likelier than every law."""
    monkeypatch.setattr(acceptance, "sites_of", lambda *_: {"rejection": RADIATOR, "tank": TANK})
    monkeypatch.setattr(acceptance, "explains_too_little", lambda *_: False)
    course = Course(site, "W/K", np.arange(240) / 12.0, mean, np.ones(240), 60.0)
    finding = SimpleNamespace(odds=20.0, fit=None, entries=(), unlisted=unlisted, claim=12.0)
    known = SimpleNamespace(probe=SimpleNamespace(network=None))
    grid = SimpleNamespace(measured=None)
    more = {"errors": {}, "laws": (), "usual": False}
    return SimpleNamespace(free=(course,), finding=finding, known=known, whole=None, grid=grid, **more)


def test_a_radiator_that_is_off_by_some_per_cent_all_along_is_adequate(monkeypatch: pytest.MonkeyPatch) -> None:
    assert acceptance.adequate(case(monkeypatch, "rejection", 5.0 * WANDERS))


@pytest.mark.parametrize(
    ("site", "mean"),
    [("rejection", 20.0 * WANDERS), ("rejection", 5.0 * LATE), ("tank", 5.0 * WANDERS)],
    ids=["more than a law's error", "not from the beginning", "no law of the twin"],
)
def test_what_may_be_no_error_of_a_law_is_not_adequate(site: str, mean: Array, monkeypatch: pytest.MonkeyPatch) -> None:
    assert not acceptance.adequate(case(monkeypatch, site, mean))


def test_a_law_that_is_likelier_than_the_unknown_is_not_adequate(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not acceptance.adequate(case(monkeypatch, "rejection", 5.0 * WANDERS, unlisted=15.0))
