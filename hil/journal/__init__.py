"""Crash-safe journal of a run, its states, and the record made from it."""
