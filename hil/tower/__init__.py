"""Cooling tower: from a plant historian to a calibrated twin."""
