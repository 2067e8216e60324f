"""Diagnosis of a record or a run: hand-over, results as files, page."""
