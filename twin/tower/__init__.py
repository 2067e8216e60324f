"""Cooling-tower cell: moist air, Merkel's method with four deviations, and its calibration.

The deviations multiply a clean cell: `fill` its Merkel number, `air` its air flow at full speed, `uniformity` the
wetted share of its plan. `bias` is that of the outlet thermometer, K.
"""
