"""Restore of a run that was interrupted: its position, its temperatures, its calibrators."""
