"""Experiments of the paper and public records, with published figures."""
