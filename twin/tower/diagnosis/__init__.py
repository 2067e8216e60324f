"""Diagnosis of a calibrated tower cell: undeclared effects by log marginal likelihood with declared priors."""
