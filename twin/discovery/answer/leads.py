"""Leads of a diagnosis: segments, ranges and places in which the misfit concentrates that the answer leaves."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
from scipy.fft import idct

from twin.discovery.answer.assessed_finding import AssessedFinding
from twin.discovery.diagnosis import Diagnosis, Lead
from twin.discovery.healthy.basis import Columns
from twin.discovery.leads.concentration import NOTED, ResidualSquares
from twin.discovery.leads.words import outside_leads, place_leads, range_leads, record_rows, segment_leads
from twin.discovery.refit.fitting import look_at
from twin.discovery.refit.model import Model
from twin.discovery.scoring.score_tests import ScoreTest
from twin.network import Array


def with_leads(found: Diagnosis, case: AssessedFinding, record: Columns, healthy: Columns | None) -> Diagnosis:
    """Return a diagnosis with its leads: none where the twin is adequate.

    Where effects were found, only what they leave beyond noise gives leads. Where nothing explains the record, there is
    at least one: that the misfit lies all over it.

    Parameters
    ----------
    record
        The record that was diagnosed, at its own stamps.
    """
    if found.verdict == "adequate":
        return found
    network = case.known.probe.network
    explained = found.verdict != "unexplained"
    score_test = _after(case) if explained else case.whole
    squares = squares_of(score_test)
    leads: list[Lead] = []
    if squares.present and (not explained or squares.beyond > NOTED * case.whole.misfit):
        times = case.grid.time[0] + score_test.edges * case.grid.step_s
        inputs = score_test.block_means(case.grid.inputs)
        leads += segment_leads(squares, times[:-1], times[1:])
        leads += range_leads(network, squares, inputs, score_test.memory)
        if healthy is not None:
            leads += outside_leads(network, squares, inputs, healthy)
    if not explained:
        leads += place_leads(case.free, dict(found.description), float(case.grid.time[0]))
    leads += record_rows(network, record, _simulated(case, record))
    return replace(found, leads=tuple(leads))


def squares_of(score_test: ScoreTest) -> ResidualSquares:
    """Return the squares, by blocks with readings, of the residual of a twin that is re-tuned within its prior.

    The residual is whitened by the expected noise and transformed back into time.
    """
    white = score_test.residual - score_test.slopes @ score_test.moved(np.empty((0, 0)), np.empty(0))
    left = idct(white.reshape(score_test.b, score_test.m), type=2, norm="ortho", axis=0)
    known = score_test.known
    return ResidualSquares(np.where(known, left**2, 0.0).sum(axis=1), known.sum(axis=1))


def _after(case: AssessedFinding) -> ScoreTest:
    """Return the score test of all of the record at the residual that the effects leave."""
    score_test, fit = copy.copy(case.whole), case.finding.fit
    if fit is not None:
        # Segments that the fit has not seen begin as the readings tell.
        state, unseen = score_test.probe.first_state(case.grid), score_test.slopes.shape[1] - len(fit.moved)
        begun = np.concatenate([fit.state, state[len(fit.state) :]])
        moved = np.concatenate([fit.moved, np.zeros(unseen)])
        look_at(score_test, Model.of(score_test.probe, fit.entries), replace(fit, state=begun, moved=moved))
    return score_test


def _simulated(case: AssessedFinding, record: Columns) -> Array:
    """Return the readings of the commissioned twin at the record's stamps (N, m), degC."""
    grid, probe = case.grid, case.known.probe
    readings = probe.run(grid, probe.first_state(grid)).readings
    stamps = grid.time + grid.centre * grid.step_s
    return np.stack([np.interp(record.time_s, stamps, each) for each in readings.T], axis=1)
