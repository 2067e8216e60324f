"""Noise and model error that a healthy record shows."""
