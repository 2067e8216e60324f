"""Checks of a rig file, before a run and online."""
