"""Intervals of the calibrators against the posterior by Markov chain Monte Carlo.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from hil.lazy_names import lazy_names

__all__ = ["trial"]

__getattr__, __dir__ = lazy_names(__name__, {"": ("trial",)})
