"""Outputs of a rig: set-points, read-back, heaters, safe values."""
