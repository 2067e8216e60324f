"""Leads of a growth: segments, ranges and places in which the misfit of a grown twin concentrates."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from twin.discovery.diagnosis import Lead, Verdict
from twin.discovery.growing.growth_problem import SampledRecord
from twin.discovery.healthy.basis import Columns
from twin.discovery.leads.concentration import NOTED, ResidualSquares
from twin.discovery.leads.rows import suspicious_states
from twin.discovery.leads.words import range_leads, record_rows, row_leads, segment_leads
from twin.discovery.scoring.score_tests import MOST_BLOCKS
from twin.network import Array, Network


def leads_of(
    network: Network, record: Columns, whole: SampledRecord, left: Array, before: Array, verdict: Verdict
) -> tuple[Lead, ...]:
    """Return the leads in residuals of the whole record: none where the twin is adequate.

    Squares are in units of the declared noise, since nothing else is known of it.

    Parameters
    ----------
    record
        The record at its own stamps.
    whole
        The samples, or steady states, of which `left` and `before` (n, m) K are the residuals: of the answer, and of
        the re-tuned twin.
    """
    if verdict == "adequate":
        return ()
    rows = _squares(left, whole.sigma)
    noted = rows.present and (verdict == "unexplained" or rows.beyond > NOTED * _squares(before, whole.sigma).beyond)
    if whole.at_rest:
        return _of_states(network, whole, left, rows if noted else None)
    start, leads = float(record.time_s[0]), list[Lead]()
    if noted:
        edges = np.linspace(0, len(left), min(len(left), MOST_BLOCKS) + 1).astype(int)
        blocks, times = _summed(rows, edges), whole.time + start
        leads += segment_leads(blocks, times[edges[:-1]], times[edges[1:] - 1])
        inputs = np.stack([whole.inputs[a:b].mean(axis=0) for a, b in pairwise(edges.tolist())])
        leads += range_leads(network, blocks, inputs, 0)
    readings = whole.measured - left
    simulated = np.stack([_at(record.time_s, whole.time + start, each) for each in readings.T], axis=1)
    return (*leads, *record_rows(network, record, simulated))


def _of_states(
    network: Network, whole: SampledRecord, left: Array, squares: ResidualSquares | None
) -> tuple[Lead, ...]:
    """Return the leads of steady states, `squares` None where nothing is to be looked into but single states.

    A state in a range of an input that misfits is not suspicious by itself. The order of states matters only where no
    range does.
    """
    names = network.sensor_names
    ranges = () if squares is None else range_leads(network, squares, whole.inputs, None)
    columns = list(network.input_columns)
    inside = np.zeros(len(left), dtype=bool)
    for lead in ranges:
        values = whole.inputs[:, columns.index(lead.where)]
        inside |= (values >= lead.low) & (values <= lead.high)
    alone = np.where(inside[:, None], np.nan, left)
    states = [(s, [names[j] for j in s.columns], ["K"] * len(s.columns)) for s in suspicious_states(alone, whole.sigma)]
    rows = row_leads(states, lambda row: (row + 1.0, f"state {row + 1}"))
    order: tuple[Lead, ...] = ()
    if squares is not None and not ranges:
        edges = np.linspace(0, len(left), min(len(left), MOST_BLOCKS) + 1).astype(int)
        numbers = np.arange(1.0, len(left) + 1.0)
        named = {lead.low for lead in rows}
        found = segment_leads(_summed(squares, edges), numbers[edges[:-1]], numbers[edges[1:] - 1], at_rest=True)
        order = tuple(lead for lead in found if lead.low < lead.high or lead.low not in named)
    return (*order, *ranges, *rows)


def _summed(rows: ResidualSquares, edges: np.ndarray) -> ResidualSquares:
    """Return the squares of blocks of rows that begin at `edges`, the last of which is the end."""
    return ResidualSquares(np.add.reduceat(rows.total, edges[:-1]), np.add.reduceat(rows.count, edges[:-1]))


def _squares(residual: Array, sigma: Array) -> ResidualSquares:
    known = np.isfinite(residual)
    return ResidualSquares(np.where(known, residual / sigma, 0.0).__pow__(2).sum(axis=1), known.sum(axis=1))


def _at(time_s: Array, known_s: Array, values: Array) -> Array:
    """Return values (N,) at `time_s`, on straight lines between those that are known."""
    good = np.isfinite(values)
    found: Array = np.interp(time_s, known_s[good], values[good]) if good.any() else np.full(len(time_s), np.nan)
    return found
