"""What a twin can be asked about of a run that was cut."""

from __future__ import annotations

import numpy as np
import pytest

from hil.record.segments import Parts
from twin.segments import LONG_GAP_S


def rows(*spans: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) s, 10 s apart, and segments (n,) of spans from and to, s."""
    times = [np.arange(low, high + 1.0, 10.0) for low, high in spans]
    return np.concatenate(times), np.repeat(np.arange(1, len(spans) + 1), [len(t) for t in times])


@pytest.mark.parametrize("gap_s", [10.0, 290.0, 300.0, 5000.0])
def test_every_gap_is_one_to_a_twin_however_short_it_was(gap_s: float) -> None:
    time_s, segment = rows((0.0, 3600.0), (3600.0 + gap_s, 9000.0), (9010.0, 20000.0))
    parts = Parts.of(time_s, segment)
    assert parts.rows == slice(0, len(time_s))
    kept = time_s[~parts.aside]
    begun = kept[1:][np.diff(kept) > LONG_GAP_S]
    assert begun == pytest.approx([max(3600.0 + gap_s, 3610.0 + LONG_GAP_S), 9010.0 + LONG_GAP_S])
    assert not parts.aside[segment == 1].any()


def test_of_a_run_that_was_away_longer_than_there_the_longest_part_is_taken() -> None:
    time_s, segment = rows((0.0, 1000.0), (90_000.0, 95_000.0), (95_010.0, 95_500.0))
    parts = Parts.of(time_s, segment)
    assert (time_s[parts.rows][0], time_s[parts.rows][-1]) == (90_000.0, 95_000.0)
    assert not parts.aside.any() and len(parts.aside) == parts.rows.stop - parts.rows.start


def test_a_run_that_was_never_cut_is_taken_as_it_is() -> None:
    time_s, segment = rows((0.0, 1000.0))
    parts = Parts.of(time_s, segment)
    assert parts.rows == slice(0, len(time_s)) and not parts.aside.any()
