"""Samples that the historian itself marks as uncertain or bad."""

from __future__ import annotations

import numpy as np

from twin.historian.tags import GOOD, Defect, Series

JOINED_S = 1800.0
"""Bad runs closer than this are one defect: an instrument that comes back for a few minutes has not been mended."""


def bad_quality(series: Series) -> list[Defect]:
    """Return a defect for each run of samples of a tag whose quality is not good or that hold no number.

    Only a good sample ends a run: an archive that reports by exception stores one sample an hour while nothing moves.
    """
    order = np.argsort(series.time_s, kind="stable")
    time_s, bad = series.time_s[order], ~series.good[order]
    if not bad.any():
        return []
    edge = np.diff(np.concatenate([[0], bad.astype(np.int8), [0]]))
    first, last = np.flatnonzero(edge == 1), np.flatnonzero(edge == -1) - 1
    apart = time_s[first[1:]] - time_s[last[:-1]] > JOINED_S
    first, last = first[np.append(True, apart)], last[np.append(apart, True)]
    found = []
    for begin, end in zip(first, last, strict=True):
        part = order[begin : end + 1]
        codes = sorted({int(code) for code in series.quality[part] if code < GOOD})
        what = f"quality {', '.join(map(str, codes))}" if codes else "no number"
        says = f"{bad[begin : end + 1].sum()} samples of {series.tag.name} with {what}"
        found.append(
            Defect("bad_quality", (series.tag.name,), float(time_s[begin]), float(time_s[end]), says, "left out")
        )
    return found
