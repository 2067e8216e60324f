"""Crash-safe journal of a run, its states, and the export of its record."""
