"""Interlocks of a run and the conditions that they watch."""
