"""Localisation without a catalogue: one unknown quantity at one site, free in each block.

A random walk at the site, given all readings, is the smoother of an augmented Kalman filter (Rauch, Tung & Striebel,
AIAA J. 3 (1965) 1445), solved in one step, since the score test holds the whole record as a quadratic form. Its
marginal likelihood ranks the sites; the walk's step size is profiled.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import solve_triangular

from twin.discovery.diagnosis import Course
from twin.discovery.places.sites import Site
from twin.discovery.scoring.score_tests import ScoreTest
from twin.network import Array

WALK_PER_BLOCK = (0.03, 0.1, 0.3, 1.0, 3.0)
"""Step of the walk from block to block, in typical sizes of the site, that are tried."""

ONSET = 4.0
"""Ratio of the mean squares after and before an onset, at least: twice the amplitude."""


def courses(score_test: ScoreTest, sites: dict[str, Site], begins: float) -> tuple[Course, ...]:
    """Return the posterior courses of an unknown quantity at each site, the likeliest first.

    A course is the cumulative sum of an initial value and independent steps, which are the unknowns: their prior is
    diagonal.

    Args:
        begins: prior standard deviation of the initial value, in typical sizes of the site. It is that of the sizes of
            named laws, since otherwise an unknown would be the likelier of the two for a large fault.
    """
    found = []
    for name, site in sites.items():
        gram, score = score_test.small(site.vector)
        gram, score = _late_sums(_late_sums(gram).T), _late_sums(score)
        best: tuple[float, Array, Any, Any] | None = None
        for share in WALK_PER_BLOCK:
            scale: Array = np.full(score_test.b, share * site.typical)
            scale[0] = begins * site.typical
            lower = np.linalg.cholesky(np.eye(score_test.b) + gram * np.outer(scale, scale))
            half = solve_triangular(lower, scale * score, lower=True, check_finite=False)
            evidence = 0.5 * float(half @ half) - float(np.log(np.diag(lower)).sum())
            if best is None or evidence > best[0]:
                best = evidence, scale, lower, half
        if best is None:
            continue
        evidence, scale, lower, half = best
        root = solve_triangular(lower, np.diag(scale), lower=True, check_finite=False)
        # Rows of root' root are the covariance of the steps; the course is their running sum.
        summed = np.cumsum(root, axis=1)
        mean, sd = summed.T @ half, np.sqrt((summed**2).sum(axis=0))
        counted = min(site.counts * evidence, evidence)
        steps = root.T @ half
        left = score_test.misfit - float(steps @ (2.0 * score - gram @ steps))
        found.append(
            Course(
                site=name,
                unit=site.unit,
                hours=score_test.hours,
                mean=mean,
                sd=sd,
                log_evidence=counted,
                signature=site.signature,
                where=site.where,
                kind=site.kind,
                left=left,
            )
        )
    found.sort(key=lambda c: -c.log_evidence)
    return tuple(found)


def _late_sums(values: Array) -> Array:
    """Return the sums over the first axis from each row on."""
    sums: Array = values[::-1].cumsum(axis=0)[::-1]
    return sums


def describe(course: Course, drivers: dict[str, Array], step_h: float) -> dict[str, Any]:
    """Return onset, size and driver of a course.

    Args:
        drivers: name -> block means (b,) of what it may follow.
    """
    mean, sd = course.mean, course.sd
    significant = np.abs(mean) > 2.0 * sd
    out: dict[str, Any] = {"site": course.site, "unit": course.unit, "present_share": float(significant.mean())}
    onset, first, last = _onset(mean, sd)
    out["onset_s"] = float(course.hours[onset] * 3600.0)
    within_h = step_h if onset else 0.0
    out["onset_interval_s"] = [float(course.hours[first] * 3600.0), float((course.hours[last] + within_h) * 3600.0)]
    after = mean[onset:]
    out["mean"] = float(after.mean())
    out["mean_sd"] = float(np.sqrt(np.mean(sd[onset:] ** 2)))
    low, high = np.percentile(after, [5, 95])
    out["range"] = [float(low), float(high)]
    scores = {}
    for name, values in drivers.items():
        v = values[onset:]
        if np.ptp(v) > 1e-9 * max(float(np.abs(v).max()), 1e-9) and len(v) > 8 and np.std(after) > 0.0:
            scores[name] = float(np.corrcoef(v, after)[0, 1])
    out["follows"] = {name: round(r, 3) for name, r in sorted(scores.items(), key=lambda x: -abs(x[1]))[:3]}
    period, share = _period(after, step_h)
    if share > 0.35:
        out["period_s"] = period
    top = next(iter(out["follows"]), "") if scores else ""
    driver = "history"
    if share > 0.35:
        driver = "periodic"
    elif np.std(after) < 0.15 * abs(float(after.mean())):
        driver = "constant"
    elif top and abs(scores[top]) > 0.7:
        driver = top
    elif _two_valued(after):
        driver = "threshold"
    out["driver"] = driver
    return out


def acts_all_along(course: Course) -> bool:
    """Return True if a course has no onset."""
    return _onset(course.mean, course.sd)[0] == 0


def _onset(mean: Array, sd: Array) -> tuple[int, int, int]:
    """Return the median first block of an unknown quantity, and the 90 % interval of it; 0 for one without onset.

    Its squares, the mean's and the variance's, are those of a smaller variance before and of a larger one after: one
    that comes and goes begins with its first time (change of a variance, Inclan and Tiao, J. Am. Stat. Assoc. 89 (1994)
    913). What is not twice as large after it as before has no onset.
    """
    n = len(mean)
    at = np.arange(1, n - 1)
    if not len(at):
        return 0, 0, 0
    left, right = _halves(mean**2 + sd**2)
    small, large = _halves(mean**2)
    likelihood = -0.5 * (at * np.log(np.maximum(left, 1e-300)) + (n - at) * np.log(np.maximum(right, 1e-300)))
    likelihood = np.where((right > left) & (large >= ONSET * small), likelihood, -np.inf)
    without = -0.5 * n * np.log(max(float(np.mean(mean**2 + sd**2)), 1e-300))
    if likelihood.max() < without + np.log(n):
        return 0, 0, 0  # no likelier than chance makes the best of so many
    chance = np.cumsum(np.exp(likelihood - likelihood.max()))
    first, middle, last = (int(at[i]) for i in np.searchsorted(chance, np.array([0.05, 0.5, 0.95]) * chance[-1]))
    return middle, first, last


def _halves(squares: Array) -> tuple[Array, Array]:
    """Return the means of squares (n,) before and from each of the blocks 1 to n - 2 on."""
    total, at = np.cumsum(squares), np.arange(1, len(squares) - 1)
    return total[at - 1] / at, (total[-1] - total[at - 1]) / (len(squares) - at)


def _period(values: Array, step_h: float) -> tuple[float, float]:
    """Return the strongest period, s, and its share of the variance (with its first harmonic)."""
    if len(values) < 24:
        return 0.0, 0.0
    spectrum = np.abs(np.fft.rfft(values - values.mean())) ** 2
    spectrum[:3] = 0.0
    if spectrum.sum() <= 0.0:
        return 0.0, 0.0
    k = int(np.argmax(spectrum))
    share = (spectrum[max(k - 1, 0) : k + 2].sum() + (spectrum[2 * k] if 2 * k < len(spectrum) else 0.0)) / (
        np.abs(np.fft.rfft(values - values.mean())) ** 2
    ).sum()
    return len(values) * step_h * 3600.0 / k, float(share)


def _two_valued(values: Array) -> bool:
    low, high = np.percentile(values, [10, 90])
    if high <= low:
        return False
    position = (values - low) / (high - low)
    return bool(np.mean((position < 0.25) | (position > 0.75)) > 0.8)
