"""Synthetic records with hidden effects, drawn from a seed."""
