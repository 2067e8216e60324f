"""Signals: points, units, roles, and codecs of raw numbers."""
