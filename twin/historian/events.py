"""Events of a station and the time that each influences the record.

A DCS event has its minute. An entry of the maintenance system (CMMS) has a day, which is up to three days off, and some
entries are missing. So an event is evidence that something may have changed, never a proof, and the absence of one is
no proof either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.historian.tags import Array

DAY_S = 86400.0
DAYS_OFF = 3.0
"""Days by which the date of a maintenance entry may be off, either way."""


@dataclass(frozen=True)
class Event:
    """An event: seconds since 1970 (UTC), cell (0: the station), class, source and text; `by_day`: only the day is
    known."""

    time_s: float
    by_day: bool
    cell: int
    kind: str
    source: str
    text: str = ""

    @property
    def window_s(self) -> tuple[float, float]:
        """Times between which the event happened."""
        if not self.by_day:
            return self.time_s, self.time_s
        return self.time_s - DAYS_OFF * DAY_S, self.time_s + (1.0 + DAYS_OFF) * DAY_S


@dataclass(frozen=True)
class Influence:
    """Effect of a class of events: hours for which the record is disturbed, and the parameters that may jump."""

    hours: float
    parameters: tuple[str, ...] = ()


INFLUENCE: dict[str, Influence] = {
    "fan_trip": Influence(4.0),
    "station_outage": Influence(36.0),
    "load_step": Influence(2.0),
    "performance_test": Influence(10.0),
    "overflow": Influence(2.0),
    "makeup_event": Influence(1.0),
    "cleaning": Influence(24.0, ("fill", "uniformity")),
    "fill_cleaning": Influence(24.0, ("fill", "uniformity")),
    "nozzle_cleaning": Influence(24.0, ("uniformity",)),
    "fan_maintenance": Influence(24.0, ("air",)),
    "belt_change": Influence(24.0, ("air",)),
    "blade_pitch": Influence(24.0, ("air",)),
    "drift_eliminator": Influence(24.0, ("air",)),
    "instrument_work": Influence(12.0, ("bias",)),
    "thermometer_replacement": Influence(12.0, ("bias",)),
    "calibration": Influence(12.0, ("bias",)),
    "reference_thermometer": Influence(48.0),
    "inspection": Influence(12.0),
    "airflow_traverse": Influence(6.0),
}
"""Influence by class. Hours: a shared basin of 420 m3 at 500 kg/s settles within an hour of an upset; outages and tests
by their usual length; work in a cell takes a shift, and is dated by the day."""

WORDS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("thermometer", ("bias",)),
    ("transmitter", ("bias",)),
    ("rtd", ("bias",)),
    ("nozzle", ("uniformity",)),
    ("fill", ("fill", "uniformity")),
    ("clean", ("fill", "uniformity")),
    ("wash", ("fill", "uniformity")),
    ("blade", ("air",)),
    ("belt", ("air",)),
    ("pitch", ("air",)),
    ("eliminator", ("air",)),
    ("fan", ("air",)),
)
"""Words of a class that is not in the table, and the parameters that it may move."""
CHANGES = ("clean", "replace", "exchang", "adjust", "repair", "wash", "maint", "renew", "change")


def influence_of(kind: str, text: str = "") -> Influence:
    """Return the influence of a class; of one that is not known by the words of its name and text."""
    known = INFLUENCE.get(kind)
    if known is not None:
        return known
    words = f"{kind} {text}".lower().replace("_", " ")
    parameters: list[str] = []
    if any(word in words for word in CHANGES):
        for word, moved in WORDS:
            if word in words:
                parameters += [name for name in moved if name not in parameters]
    return Influence(24.0, tuple(parameters))


def disturbed(events: Sequence[Event], cell: int, minute_s: Array) -> NDArray[np.bool_]:
    """Return the minutes that an event of known minute disturbs, of the cell or the station (n,)."""
    rows = np.zeros(len(minute_s), dtype=bool)
    for event in events:
        if event.by_day or event.cell not in (0, cell):
            continue
        end = event.time_s + 3600.0 * influence_of(event.kind, event.text).hours
        rows |= (minute_s >= event.time_s) & (minute_s < end)
    return rows


def naming(events: Sequence[Event], tags: Sequence[str], time_s: float) -> tuple[Event, ...]:
    """Return the events whose text names all of the tags and that may have happened around `time_s`."""
    found = []
    for event in events:
        low, high = event.window_s
        if low - DAY_S / 2 <= time_s <= high + DAY_S / 2 and all(tag in event.text for tag in tags):
            found.append(event)
    return tuple(found)
