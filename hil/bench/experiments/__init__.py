"""Experiments of the paper and public records, beside published figures."""
