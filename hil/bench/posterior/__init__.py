"""Intervals of the calibrators against the posterior by Markov chain Monte Carlo. The package names nothing: the
command loads `hil.bench.posterior.trial`.
"""

__all__: list[str] = []
