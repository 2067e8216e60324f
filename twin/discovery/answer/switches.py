"""Heat that begins when its place is warmer than ever before, as if a temperature had switched it on.

No element switches, and a heat source that is switched on within a record looks like any step. The distinction: a
temperature switches at the moment at which its place becomes warmer than before, more probably the faster it rises.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from twin.discovery.diagnosis import Alternative
from twin.discovery.effects.catalogue import sites_of
from twin.discovery.effects.phrases import clock
from twin.discovery.effects.shapes import EARLY_S
from twin.discovery.records.grid import Grid
from twin.discovery.refit.model import Model
from twin.discovery.scoring.equivalence import OPEN
from twin.discovery.scoring.search import Entry
from twin.network import Array

if TYPE_CHECKING:
    from twin.discovery.evidence.finding import Finding

HYSTERESIS_K = 3.0
"""Temperature difference, K, by which a place may cool below the switching temperature without switching off."""
BEFOREHAND = 0.1
"""Prior odds of a switched source against a plain one."""
_WITHIN_K = 0.1
_WITHIN_S = 120.0
"""Excess of an earlier temperature over a switch's that noise may explain, K, and least half width of an onset, s:
some noise standard deviations, and twelve bins."""


def switched(finding: Finding, grid: Grid, start: float) -> tuple[tuple[Alternative, str], ...]:
    """Return, for each constant source that a temperature may have switched on, the alternative and a sentence.

    Args:
        grid: the whole record. start: its first stamp, s.
    """
    if finding.fit is None:
        return ()
    probe = finding.score_test.probe
    places = sites_of(probe.network).places
    out: list[tuple[Alternative, str]] = []
    for entry in finding.fit.entries:
        read = [j for j, s in enumerate(probe.network.sensors) if places[s.node] == entry.candidate.where]
        source = entry.candidate.kind == "heat_source" and entry.driver == "constant"
        if not source or entry.shape.name != "step" or not read:
            continue
        edge = _edge(entry, grid, grid.measured[:, read[0]])
        if edge is None:
            continue
        odds = BEFOREHAND * _odds(_without(finding, entry, grid)[:, read[0]], grid, entry)
        weight = odds / (1.0 + odds)
        if weight > OPEN:
            where = entry.candidate.where.replace("_", " ")
            says = (
                f"the heat at the {where} begins at {clock(start + entry.shape.onset_s)}, as it passes {edge:.1f} degC "
                f"for the first time: a temperature may switch it on; to see, let the {where} cool below "
                f"{edge - HYSTERESIS_K:.0f} degC"
            )
            out.append((Alternative("heat_source", entry.candidate.where, "threshold", weight), says))
    return tuple(out)


def _edge(entry: Entry, grid: Grid, measured: Array) -> float | None:
    """Return the temperature at the onset, degC, if its place was never as warm before and never much cooler after;
    else None.
    """
    since = grid.time - grid.time[0]
    onset, spread = entry.shape.onset_s, _spread(entry)
    # What comes after the onset is warmer by the heat itself.
    before, at, after = since < onset - spread, (since >= onset - spread) & (since <= onset), since > onset + spread
    if onset < EARLY_S or not all(np.isfinite(measured[part]).any() for part in (before, at, after)):
        return None
    edge = float(np.nanmax(measured[at]))
    never_before = float(np.nanmax(measured[before])) <= edge + _WITHIN_K
    return edge if never_before and float(np.nanmin(measured[after])) >= edge - HYSTERESIS_K else None


def _odds(readings: Array, grid: Grid, entry: Entry) -> float:
    """Return the Bayes factor of a switch against an onset at a uniformly random time.

    A switch has a uniformly random temperature between the first and the highest that its place passes.

    Args:
        readings: (n,) degC of the place, without the effect.
    """
    since = grid.time - grid.time[0]
    highest = np.maximum.accumulate(readings)
    spread, passed = _spread(entry), float(highest[-1] - highest[0])
    before, after = np.interp(entry.shape.onset_s + np.array([-spread, spread]), since, highest)
    return float(after - before) / passed * float(since[-1]) / (2.0 * spread) if passed > 0.0 else 0.0


def _spread(entry: Entry) -> float:
    """Return the half width of the onset's interval, s."""
    return max(_WITHIN_S, 2.0 * entry.onset_sd_s)


def _without(finding: Finding, entry: Entry, grid: Grid) -> Array:
    """Return the readings (n, m), degC, of the answer without this effect."""
    assert finding.fit is not None
    fitted = finding.fit
    model = Model.of(finding.score_test.probe, fitted.entries)
    sizes = np.array([[0.0 if e is entry else e.size for e in fitted.entries]])
    state = model.begun(grid.time, grid.inputs, grid.measured, fitted.state, fitted.values, grid.begins)[None]
    return model.run(grid.time, grid.inputs, state, fitted.values[None, :], sizes, begins=grid.begins)[0]
