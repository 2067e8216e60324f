"""Prior probabilities of the diagnosis, all of them, and the two decisions that are made with the posterior.

A hypothesis is a set of effects. An effect is a class (kind and place), a law in that class, a time course and a size.
Each part has a probability before any data; their product and the marginal likelihood are its posterior odds against
a twin that lacks nothing. Logarithms are natural.
"""

from __future__ import annotations

import math

from twin.discovery.scoring.search import Entry

FAULT = 0.05
"""Probability of a fault in a record, and of each further independent one. A judgement: a factor of 2 in it shifts all
odds by 0.7, little beside `CLAIM`."""
MISSING_IN_HEALTH = 0.5
"""Probability that a twin lacks a law which its rig has always had, and of each further one. A judgement: every lumped
twin lacks some, but only what a record shows again matters."""
UNLISTED = 0.1
"""Share of faults that are of no named law. A judgement, not a count."""
SPREADS = (5.0, 50.0)
"""Standard deviations of a size, in typical sizes of its law, each as likely: most faults are of a few typical sizes,
and a fault ten times as large is rare but no less a fault. With one Gaussian of five typical sizes, an error of
forty costs 32 in log odds, more than what distinguishes one cause from another."""
ALL_ALONG = 0.5
"""Probability that an effect was there when the record began; else any moment of it is as likely as any other."""
AT_ONCE = 0.5
"""Probability that an effect comes in at once, where it may grow too, come and go, come back or fade; the others share
the rest, each family alike and within it each course."""
FORM_ERRORS = (0.001, 0.01, 0.1)
"""Standard deviations of an effect's error of form, as shares of its size, each as likely: no law is quite right."""
FORM_S = 7200.0
"""Time over which an error of form keeps its sign, s: that of a load step and of a change of the weather."""
CLAIM = 12.0
"""Log posterior odds from which something is claimed. In that prototype 23 healthy records came to -6 at most, and the
weakest true effect to 15; the plants of `hil bench zoo` have not been used to set it."""
SURE = 0.85
"""Share of the posterior that one class must have to be named alone."""
KINDS = {
    "heat_source": 1.0,
    "heat_loss": 1.0,
    "heat_rejection": 1.0,
    "flow": 0.7,
    "thermal_mass": 0.7,
    "sensor": 0.7,
    "coupling": 0.4,
    "delay": 0.5,
    "actuator": 0.3,
    "heat_transfer": 0.3,
}
"""Probability of a kind of fault at a place where it may be, relative to hidden heat. Judgements; heat transfer is
rated like an actuator."""
DRIVERS = {"temperature": 0.6, "fan_speed": 0.5, "pump_speed": 0.5, "heater_power": 0.5, "time_of_day": 0.3}
"""Probability that a fault follows a driver, relative to one that is constant or follows a difference of temperatures.
Judgements."""


def size_prior_sd(typical: float, size: float) -> float:
    """Return the standard deviation of the prior's component that a size most likely comes from, in its unit."""
    narrow, wide = (spread * typical for spread in SPREADS)
    far = 0.5 * size**2 * (narrow**-2.0 - wide**-2.0) > math.log(wide / narrow)
    return wide if far else narrow


def plausibility(entry: Entry) -> float:
    """Return the probability of a kind and driver of effect relative to constant hidden heat, apart from its place."""
    return KINDS.get(entry.candidate.kind, 0.5) * DRIVERS.get(entry.candidate.driver, 1.0)
