"""Noise of one record: that of the healthy record, as far as the record's own residual does not show less.

A healthy record of some hours has few slow coefficients, and other loads. Its covariances therefore have factors of
caution, shrink the correlation of sensors, and count some of the model error twice: in 16 healthy records of the zoo
the residual had, in the slowest band, between a fiftieth and a third of the variance that they claim. An effect has to
exceed the noise, and one that is told by the difference between two sensors was lost in it.

The covariance has an inverse Wishart prior about the healthy one, the least informative that has a mean. Given the
record's own coefficients, its posterior mean is the noise of the record. It is never more than the healthy one, so that
no effect counts as noise.

Source: conjugate prior of a Gaussian's covariance (Gelman et al., Bayesian Data Analysis, 2013, sec. 3.6).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.discovery.records.noise import bands
from twin.discovery.scoring.score_tests import ScoreTest
from twin.discovery.scoring.search import Entry
from twin.network import Array

LEAST = 1e-3
"""Smallest ratio of a variance to that in health; smaller ones are rounding."""


def relative_covariances(score_test: ScoreTest, effects: Sequence[Entry]) -> Array:
    """Return the covariances (bands, m, m) of a record's noise, in whitened units of the healthy noise.

    Parameters
    ----------
    effects
        What is subtracted from the residual before, with sizes, tunables and initial state estimated jointly.
    """
    s = score_test
    vectors = np.array([e.vector for e in effects]).reshape(len(effects), s.sites, s.b)
    sizes = s.estimate(vectors).sizes
    left = s.residual - s.slopes @ s.moved(vectors, sizes)
    if effects:
        left = left - s.signatures(vectors) @ sizes
    rows, share = left.reshape(s.b, s.m), s.share_of_noise
    band, least = bands(s.b, s.step_s), s.m + 2.0
    found = np.repeat(np.eye(s.m)[None], len(s.noise.roots), axis=0)
    for b in np.unique(band):
        here = np.flatnonzero(band == b)
        squares = (rows[here] * share[here, None]).T @ rows[here]
        values, axes = np.linalg.eigh((least * np.eye(s.m) + squares) / (least + share[here].sum()))
        found[b] = (axes * np.clip(values, LEAST, 1.0)) @ axes.T
    return found
