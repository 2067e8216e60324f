"""Blind trials of the diagnosis."""
