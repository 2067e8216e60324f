"""First-order recursion over the samples of a series, without the second of processor time that scipy.signal takes."""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from twin.network import Array


def recursion(terms: Array, keep: float) -> Array:
    """Return y (n,) with y[t] = keep * y[t - 1] + terms[t], and y[-1] = 0.

    It solves the bidiagonal system (I - keep * S) y = terms, S a shift by one sample, by forward substitution.

    Parameters
    ----------
    terms
        (n,), finite.
    keep
        Share of a value that is left in the next one, less than 1 in size.

    Source: a first-order autoregressive filter (Oppenheim and Schafer, Discrete-Time Signal Processing, section 2.5).
    """
    bands = np.empty((2, len(terms)))
    bands[0], bands[1] = 1.0, -keep
    found, _ = lapack.dtbtrs(bands, terms[:, None], uplo="L", diag="U")
    out: Array = found[:, 0]
    return out


def lagged(values: Array, keep: float) -> Array:
    """Return values (n,) behind a first-order lag that is at rest at the first of them; `keep` as for `recursion`.

    The mean of exponential weights: y[t] = keep * y[t - 1] + (1 - keep) * values[t].
    """
    terms = (1.0 - keep) * values
    terms[0] = values[0]
    return recursion(terms, keep)
