"""Prior probabilities of the diagnosis, all of them, and the two decision thresholds of the posterior.

A hypothesis is a set of effects. An effect is a class (kind and place), a law in that class, a time course and a size.
Each part has a prior probability; their product and the marginal likelihood give its posterior odds against a twin that
lacks nothing. Logarithms are natural.
"""

from __future__ import annotations

from twin.discovery.scoring.search import Entry
from twin.elements.candidates import Candidate

FAULT = 0.05
"""Probability of a fault in a record, and of each further independent one. A judgement: a factor of 2 in it shifts all
odds by 0.7, little beside `CLAIM`."""
MISSING_IN_HEALTH = 0.5
"""Probability that a twin lacks a law which its rig has always had, and of each further one. A judgement: every lumped
twin lacks some, but only laws whose misfit returns in a record matter."""
UNLISTED = 0.1
"""Share of faults that are of no named law. A judgement, not a count."""
SPREAD = 5.0
"""Standard deviation of a size, in typical sizes of its law. In a prototype on 40-hour records of independent plants
the odds changed by 1 to 1.5 between 2 and 15. A size may be of any greater order, which is less likely by the ratio of
the two: typical sizes are of a rig of some hundred watts, and rigs differ by orders."""
ALL_ALONG = 0.5
"""Probability that an effect was present when the record began; otherwise any onset in it is equally likely."""
AT_ONCE = 0.5
"""Probability of a step, for an effect that may also grow, be transient, return or decay; the other families share the
rest equally, and within a family its courses."""
FORM_ERRORS = (0.01, 0.03, 0.1)
"""Standard deviations of an effect's form error, as equally likely shares of its size: no law is exact."""
FORM_LIMIT = 2.0 * max(FORM_ERRORS)
"""Share of what a law has that an error of its form may amount to: two standard deviations."""
FORM_SHARE = FORM_LIMIT**2
"""Share of the log odds of an effect that an error of its form, of two standard deviations, may amount to."""
COINCIDENT_SHARE = (3.0 * max(FORM_ERRORS)) ** 2
"""The same of two effects that begin at one moment, for a form error of three standard deviations. Independent faults
at one moment are rarer than that: a further fault has a probability of `FAULT`, and of beginning within minutes in a
record of a day less than a hundredth of it."""
FORM_S = 7200.0
"""Time over which a form error keeps its sign, s: that of a load step and of a change of the weather."""
CLAIM = 12.0
"""Log posterior odds from which an effect is claimed. In that prototype 23 healthy records came to -6 at most, and the
weakest true effect to 15; the plants of `hil bench zoo` have not been used to set it."""
SURE = 0.85
"""Posterior probability that one class must have to be named alone."""
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
FILLED_IN = 0.2
"""Probability that water is filled in at a place, relative to heat there. A judgement: a loop is closed but for its
refills, and heat has many causes."""
TAKES_UP = 0.05
"""Probability that heat which follows no temperature is taken up instead of given off, where a law admits both. A
judgement: heat leaves by itself along a difference of temperatures only, which is a loss, and else needs a chiller."""


def is_filled_in(candidate: Candidate) -> bool:
    """Return True for water that is filled in, which brings its own temperature."""
    return candidate.unit == "kg/s"


def law_weight(candidate: Candidate) -> float:
    """Return the probability of a law in its class, relative to a constant one."""
    return DRIVERS.get(candidate.driver, 1.0) * (FILLED_IN if is_filled_in(candidate) else 1.0)


def sign_weight(entry: Entry) -> float:
    """Return the probability of the sign of an effect's size, relative to that of both signs being equally likely."""
    c = entry.candidate
    given_off = c.kind == "heat_source" and c.change == "new" and c.driver != "temperature"
    if not given_off or not c.lower < 0.0 < c.upper:
        return 1.0
    return 2.0 * (TAKES_UP if entry.size < 0.0 else 1.0 - TAKES_UP)


def plausibility(entry: Entry) -> float:
    """Return the probability of a kind and driver of effect relative to constant hidden heat, apart from its place."""
    return KINDS.get(entry.candidate.kind, 0.5) * law_weight(entry.candidate)
