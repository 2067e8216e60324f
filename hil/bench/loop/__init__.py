"""Timing of the loop and of the buses."""
