"""Twins that track a run, and the adoption of their parameters."""
