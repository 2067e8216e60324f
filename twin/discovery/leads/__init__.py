"""Leads: segments, input ranges, places and rows of an unexplained record in which the misfit is significant."""
