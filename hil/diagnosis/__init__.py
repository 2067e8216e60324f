"""Diagnosis of a record or a run: input, results as files, page."""
