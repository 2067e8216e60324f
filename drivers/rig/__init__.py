"""Rig: all buses of a rig file together."""
