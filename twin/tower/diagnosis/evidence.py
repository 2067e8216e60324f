"""Log marginal likelihood of an effect on a calibrated cell, linear and Gaussian in its size.

With the residuals r of the calibrated cell, their weights W, the Jacobian J of all that the calibration leaves open
and its posterior covariance C, the covariance of the data without an effect is S = W^-1 + J P0 J'. For a column h, the
response of the outlet to an effect of size 1, and a Gaussian prior of the size with variance s^2

    A = h'S^-1 h = h'W h - h'W J C J'W h,    b = h'S^-1 (y - prior prediction) = h'W r
    log Bayes factor = s^2 b^2 / (2 (1 + s^2 A)) - log(1 + s^2 A) / 2,    size = s^2 b / (1 + s^2 A)

so the slow deviations and the constants of the cell are marginalised: an effect that they can imitate gains nothing.
Source: Kass & Raftery, J. Am. Stat. Assoc. 90 (1995) 773; the Woodbury identity.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr

from twin.tower.air import Array
from twin.tower.calibration import Fitted
from twin.tower.diagnosis.validation import jacobian_of
from twin.tower.effects import CellEffect, pattern
from twin.tower.model import NAMES, SLOW, CellModel

FORM_ERROR = 0.1
"""Relative error of an effect's form once it is in the twin: its next hour is not that of the law."""
FORM_BLOCKS = 12
"""Blocks of ten minutes over which a form's error stays the same, two hours."""
SHARE = 0.05
"""Share of exhaust by which the outlet's slope is taken."""
STRUCTURE_K = 0.15
"""Standard deviation of each term of the twin's own error, K: Merkel's method misses Poppe's by some tenths of a kelvin
over flows, fan speeds, wet bulb and humidity (Kloppers & Kroeger 2005)."""


@dataclass(frozen=True)
class Forms:
    """Evidence for forms (m,): log Bayes factors against no effect, sizes and their standard deviations."""

    gain: Array
    size: Array
    sd: Array


class Evidence:
    """Linear evidence about a fitted cell; rows that the fit did not use weigh nothing.

    The twin's own error over its operating points, `structural_error`, is marginalised too.
    """

    def __init__(self, fitted: Fitted, columns: Mapping[str, Array]) -> None:
        self.fitted, self.columns = fitted, columns
        p = fitted.posterior
        self.residual = np.nan_to_num(p.linear_residual)
        self.weights = p.linear_weights * np.isfinite(p.linear_residual)
        self.jacobian = jacobian_of(p)
        self._discount_form_error()
        self.structure = structural_error(fitted)
        self._structure = self._solve(self.structure)
        self._inner = np.eye(self.structure.shape[1]) + self.structure.T @ self._structure

    def _solve(self, h: Array) -> Array:
        """Return S^-1 h (n, m) without the structure's columns."""
        weighted = h * self.weights[:, None]
        inside = self.jacobian @ (self.fitted.posterior.covariance @ (self.jacobian.T @ weighted))
        return np.asarray(weighted - inside * self.weights[:, None])

    def solve(self, h: Array) -> Array:
        """Return S^-1 h (n, m), all that the calibration leaves open marginalised."""
        direct = self._solve(h)
        return np.asarray(direct - self._structure @ np.linalg.solve(self._inner, self.structure.T @ direct))

    def error(self) -> Array:
        """Return S^-1 (y - prior prediction) (n,)."""
        direct = self.weights * self.residual
        return np.asarray(direct - self._structure @ np.linalg.solve(self._inner, self.structure.T @ direct))

    def _discount_form_error(self) -> None:
        """Weigh the blocks down by the form error of the effects that the model has already."""
        f = self.fitted
        for k, one in enumerate(f.model.effects):
            h = self.sensitivity(one.path) * f.blocks.operation.patterns[:, k]
            self.weights = self.weights / (1.0 + self.weights * FORM_BLOCKS * (FORM_ERROR * one.size * h) ** 2)

    def sensitivity(self, path: str) -> Array:
        """Return the outlet's slope by what a path moves (n,)."""
        f, p = self.fitted, self.fitted.posterior
        if path == "outlet":
            return np.ones(len(self.residual))
        if path == "past_fill":
            o = f.blocks.operation
            return np.asarray(o.inputs.t_in - f.model.outlet(o, p.slow[p.cell], p.constant))
        if path in ("wetted", "water"):
            return np.asarray(-p.jacobian[:, SLOW.index("uniformity" if path == "wetted" else "flow_meter")])
        if path == "exhaust":
            return self._by_exhaust()
        name = {"inlet": "inlet_bias", "wet_bulb": "wet_bulb_bias"}[path]
        return np.asarray(p.jacobian[:, len(SLOW) + NAMES.index(name)])

    def _by_exhaust(self) -> Array:
        """Return the outlet's rise for a share of 1 of exhaust in the entering air (n,), from that of `SHARE`."""
        f, p = self.fitted, self.fitted.posterior
        o = f.blocks.operation
        further = CellEffect("recirculation", "exhaust", "always", size=SHARE)
        drivers = o.patterns if o.patterns.size else np.zeros((len(o.wind), 0))
        there = replace(o, patterns=np.concatenate([drivers, np.ones((len(o.wind), 1))], axis=1))
        model = CellModel(f.model.design, f.model.site, (*f.model.effects, further))
        here = f.model.outlet(o, p.slow[p.cell], p.constant)
        return np.asarray((model.outlet(there, p.slow[p.cell], p.constant) - here) / SHARE)

    def responses(self, forms: Sequence[CellEffect]) -> Array:
        """Return the outlet's response to each form at size 1, by block (n, m)."""
        time_s, m_w0 = self.fitted.minutes.time_s, self.fitted.model.design.m_w0
        slopes = {path: self.sensitivity(path) for path in {one.path for one in forms}}
        return np.stack(
            [slopes[one.path] * self.block_means(pattern(one, time_s, self.columns, m_w0)) for one in forms], axis=1
        )

    def score(self, h: Array, size_sd: Array, sign: int, offset: Array | None = None) -> Forms:
        """Return the evidence for columns h (n, m).

        Parameters
        ----------
        offset
            h'S^-1 of what is added to the data, as that of an effect that the model has (m,).
        """
        weighted = h * self.weights[:, None]
        u = self.jacobian.T @ weighted
        a = np.einsum("ij,ij->j", h, weighted) - np.einsum("ij,ij->j", u, self.fitted.posterior.covariance @ u)
        v = self._structure.T @ h
        a -= np.einsum("ij,ij->j", v, np.linalg.solve(self._inner, v))
        b = h.T @ self.error()
        return gain(np.maximum(a, 0.0), b if offset is None else b + offset, size_sd, sign)

    def block_means(self, values: Array) -> Array:
        """Return means by block of values by minute (n,)."""
        of = self.fitted.of_minute
        rows, count = of >= 0, len(self.fitted.blocks.time_s)
        return np.asarray(
            np.bincount(of[rows], values[rows], count) / np.maximum(np.bincount(of[rows], minlength=count), 1)
        )


def structural_error(fitted: Fitted) -> Array:
    """Return the terms of the twin's own error, a quadratic of the operating point, each scaled to its prior (n, 20).

    The operating point is wet bulb, depression of the wet bulb, inlet over wet bulb, fan speed and flow. An error that
    follows these is model discrepancy (Kennedy & O'Hagan 2001) and no undeclared effect.
    """
    u = fitted.blocks.operation.inputs
    points = [u.wet, u.dry - u.wet, u.t_in - u.wet, u.speed, u.m_w / fitted.model.design.m_w0]
    used = np.isfinite(fitted.blocks.outlet)
    scaled = [(v - np.mean(v[used])) / max(float(np.std(v[used])), 1e-6) / 2.0 for v in points]
    terms = scaled + [scaled[i] * scaled[j] for i in range(len(scaled)) for j in range(i, len(scaled))]
    return np.clip(np.stack(terms, axis=1), -3.0, 3.0) * STRUCTURE_K


def gain(a: Array, b: Array, size_sd: Array, sign: int) -> Forms:
    """Return log Bayes factor, size and standard deviation from the quadratic form of each column.

    Parameters
    ----------
    sign
        1 or -1 where only one half of the size's prior is possible, else 0.
    """
    total = 1.0 + size_sd**2 * a
    size, sd = size_sd**2 * b / total, size_sd / np.sqrt(total)
    found = 0.5 * size_sd**2 * b**2 / total - 0.5 * np.log(total)
    if sign:
        found = found + np.log(2.0) + log_ndtr(sign * size / sd)
    return Forms(found, size, sd)
