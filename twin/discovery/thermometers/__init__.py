"""Faults of one thermometer among several of a sensor: bias, drift, lag, intermittent fault, or heat at its place."""
