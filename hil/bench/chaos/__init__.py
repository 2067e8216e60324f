"""Chaos campaign: attacks at random instants on a run in a process of its own."""
