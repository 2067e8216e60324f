"""Samples that the historian itself marks as uncertain or bad."""

from __future__ import annotations

import numpy as np

from twin.historian.tags import GOOD, Defect, Series

JOINED_S = 3600.0
"""Runs of bad samples less than this apart are one defect: an exception-reporting historian stores one an hour."""


def bad_quality(series: Series) -> list[Defect]:
    """Return a defect for each run of samples of a tag whose quality is not good or that hold no number."""
    bad = ~series.good
    if not bad.any():
        return []
    rows = np.flatnonzero(bad)
    order = rows[np.argsort(series.time_s[rows], kind="stable")]
    times = series.time_s[order]
    joined = max(JOINED_S, 3.0 * series.tag.scan_s)
    cuts = np.flatnonzero(np.diff(times) > joined) + 1
    found = []
    for part in np.split(order, cuts):
        codes = sorted({int(code) for code in series.quality[part] if code < GOOD})
        what = f"quality {', '.join(map(str, codes))}" if codes else "no number"
        first, last = float(series.time_s[part[0]]), float(series.time_s[part[-1]])
        says = f"{len(part)} samples of {series.tag.name} with {what}"
        found.append(Defect("bad_quality", (series.tag.name,), first, last, says, "left out"))
    return found
