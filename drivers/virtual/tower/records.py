"""Records that a station keeps of what happens: events of its control system and maintenance, labels of inspections."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Happening:
    """Something that happened: minute of the simulation, cell (0: the station), source (DCS or CMMS), class and
    text."""

    minute: int
    cell: int
    source: str
    event: str
    text: str


@dataclass(frozen=True)
class InspectionLabel:
    """A parameter found by people: a point with its standard deviation, or an interval."""

    minute: int
    cell: int
    parameter: str
    source: str
    value: float | None = None
    sd: float | None = None
    low: float | None = None
    high: float | None = None
