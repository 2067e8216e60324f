"""Errors of a twin that last: reference values show them, and nothing in the record does."""

from __future__ import annotations

import numpy as np
import pytest

from twin.tower.calibration import label_conflicts, widened, with_lasting_errors
from twin.tower.cell_observations import Label
from twin.tower.estimates import DAY_S, WALK, Estimate
from twin.tower.model import SLOW

BIAS, SD, LABEL_SD = SLOW.index("bias"), 0.03, 0.05


def _posterior(values: list[float], days: int = 60) -> Estimate:
    """Return a posterior with no bias at all, known to `SD` without each of some reference values, K."""
    cells = days * 2
    # A label's own Gaussian is part of the posterior; the cavity takes it off again.
    own = (SD**-2 + LABEL_SD**-2) ** -0.5
    sites, slow = [], np.zeros((cells, len(SLOW)))
    for k, value in zip(np.linspace(10, cells - 10, len(values)).astype(int), values, strict=True):
        label = Label(float(k) * 0.5 * DAY_S + 1.0, 1, "bias", value, value, LABEL_SD)
        sites.append((label, value, LABEL_SD))
        slow[k, BIAS] = value * own**2 / LABEL_SD**2
    none = np.zeros(0)
    return Estimate(
        np.arange(cells + 1) * 0.5 * DAY_S,
        slow,
        none,
        np.eye(slow.size) * own**2,
        (0.1, 0.03),
        none,
        none,
        np.zeros(0, dtype=np.intp),
        np.zeros((0, len(SLOW))),
        1.0,
        none,
        none,
        label_sites=tuple(sites),
    )


def _drawn(lasting_K: float, count: int, seed: int) -> list[float]:
    rng = np.random.default_rng(seed)
    return list(rng.normal(0.0, np.hypot(np.hypot(SD, LABEL_SD), lasting_K), count))


def test_values_as_good_as_stated_widen_little() -> None:
    found = [with_lasting_errors(_posterior(_drawn(0.0, 12, seed))) for seed in range(40)]
    widths = [float(p.sd()[0, BIAS]) for p in found]
    before = float(_posterior([0.0]).sd()[0, BIAS])
    assert np.median(widths) < 1.2 * before


def test_an_error_that_lasts_is_found_in_its_size() -> None:
    lasting = 0.08
    found = [with_lasting_errors(_posterior(_drawn(lasting, 12, seed))) for seed in range(40)]
    sizes = [float(p.lasting[BIAS]) if p.lasting.size else 0.0 for p in found]
    assert np.median(sizes) == pytest.approx(lasting, rel=0.3)
    assert all(not p.lasting.size or not np.delete(p.lasting, BIAS).any() for p in found)


@pytest.mark.parametrize("count", [1, 3])
def test_a_few_values_show_no_error_that_lasts(count: int) -> None:
    off = 2.5 * float(np.hypot(SD, LABEL_SD))
    assert not with_lasting_errors(_posterior([off] * count)).lasting.size


def test_a_wrong_value_stays_a_contradiction() -> None:
    values = [0.0, 0.01, 0.9, -0.01, 0.0, 0.02]
    found = with_lasting_errors(_posterior(values))
    assert not found.lasting.size or found.lasting[BIAS] < 0.02
    (one,) = label_conflicts(found, WALK)
    assert one.label.low == 0.9


def test_an_interval_reaches_a_single_value_that_contradicts_and_not_one_that_many_others_contradict() -> None:
    wrong = 6.0 * float(np.hypot(SD, LABEL_SD))
    single, many = _posterior([wrong]), _posterior([wrong, *[0.0] * 15])
    factors = [widened(p, label_conflicts(p, WALK)).widening[BIAS] for p in (single, many)]
    assert factors == pytest.approx([6.0, 1.5], rel=0.05)


def test_values_as_good_as_stated_hardly_ever_contradict_however_many_there_are() -> None:
    assert sum(bool(label_conflicts(_posterior(_drawn(0.0, 60, seed)), WALK)) for seed in range(40)) <= 2
