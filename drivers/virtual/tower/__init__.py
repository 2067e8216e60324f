"""Virtual cooling-tower station: physics, operation, degradation, historian and device of a plant that no twin knows.

It shares no code and no formula with `twin`: Poppe's method in sectors, a fan curve against a resistance, own moist
air.
"""
