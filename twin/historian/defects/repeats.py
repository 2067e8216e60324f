"""Samples that were stored more than once under one time stamp."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.historian.tags import Defect, Series

JOINED_S = 3.0 * 3600.0
LEAST = 5
"""Repeated stamps within a run; fewer are single slips of an archive, and are only counted by the reader."""


def repeated_stamps(raw: Sequence[Series]) -> list[Defect]:
    """Return a defect for each span in which tags have several samples with one time stamp."""
    times: list[float] = []
    names: list[str] = []
    for series in raw:
        ordered = np.sort(series.time_s)
        again = ordered[1:][np.diff(ordered) == 0.0]
        times += again.tolist()
        names += [series.tag.name] * len(again)
    if not times:
        return []
    order = np.argsort(times, kind="stable")
    at = np.asarray(times)[order]
    found = []
    for part in np.split(np.arange(len(at)), np.flatnonzero(np.diff(at) > JOINED_S) + 1):
        if len(part) < LEAST:
            continue
        tags = tuple(sorted({names[order[k]] for k in part}))
        says = f"{len(part)} samples stored again under the same time stamp, of {len(tags)} tags"
        found.append(Defect("duplicates", tags, float(at[part[0]]), float(at[part[-1]]), says, "last one taken"))
    return found
