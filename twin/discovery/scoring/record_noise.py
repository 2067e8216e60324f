"""Noise of one record: that of the healthy record, as far as the record's own residual does not show less.

A healthy record of some hours has few slow coefficients, and other loads. Its covariances therefore have factors of
caution, shrink the correlation of sensors, and count some of the model error twice. In the slowest band of 16 healthy
records (`hil bench zoo`, seed 77) the residual had 1.5 to 19 % of the variance that they claim. An effect that shows in
the difference between two sensors was lost in such noise.

The covariance has an inverse Wishart prior about the healthy one. It weighs as much as m + 2 coefficients of m sensors,
and is the least informative prior that has a mean. Given the record's own coefficients, the posterior mean is the noise
of the record. It is never more than the healthy one, so that no effect counts as noise.

Source: conjugate prior of a Gaussian's covariance (Gelman et al., Bayesian Data Analysis, 2013, sec. 3.6).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.discovery.records.noise import bands
from twin.discovery.scoring.score_tests import ScoreTest
from twin.discovery.scoring.search import Entry
from twin.network import Array

ROUNDING = 1e-3
"""Ratio of a variance to that in health below which it is rounding."""


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
    residual, share = left.reshape(s.b, s.m), s.share_of_noise
    freedom = s.m + 2.0
    band = bands(s.b, s.step_s)
    found = np.repeat(np.eye(s.m)[None], len(s.noise.roots), axis=0)
    for b in np.unique(band):
        rows = band == b
        squares = (residual[rows] * share[rows, None]).T @ residual[rows]
        values, axes = np.linalg.eigh((freedom * np.eye(s.m) + squares) / (freedom + share[rows].sum()))
        found[b] = (axes * np.clip(values, ROUNDING, 1.0)) @ axes.T
    return found
