"""Contract of every bus: values with quality and time of arrival.

The names below are the package's interface. Other modules are private to the package.
"""

from drivers.bus.arrival import RECEIVE_TIMEOUT_S, Arrivals, Stamps
from drivers.bus.contract import Bus, Clock, Judge, Readings, judge, judge_of
from drivers.bus.sensor_watch import SensorWatch, watches
from drivers.bus.steady_time import steady_s

__all__ = [
    "RECEIVE_TIMEOUT_S",
    "Arrivals",
    "Bus",
    "Clock",
    "Judge",
    "Readings",
    "SensorWatch",
    "Stamps",
    "judge",
    "judge_of",
    "steady_s",
    "watches",
]
