"""Candidate superset: one network with every effect of a catalogue, hidden masses, effects shared by equivalent
places.
"""
