"""Cells of a record as numbers with a unit."""
