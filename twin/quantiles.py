"""Quantiles of the normal distribution for intervals."""

NORMAL90 = 1.645
"""Half width of a 90 % interval in standard deviations, as rounded in records, model cards and tables."""
