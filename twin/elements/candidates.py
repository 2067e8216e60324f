"""Candidate effects that an element offers to a diagnosis, and the sites at which they may act."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from twin.elements.base import Element

LASTING = ("step", "ramp", "saturating")
"""Time courses of effects that last: at once, growing in proportion to time, or growing to a final size."""
INTERMITTENT = ("transient", "periodic", "pulse")
"""Time courses of transient effects: one that ends, one that returns periodically, and one that fades."""


@dataclass(frozen=True)
class Candidate:
    """An effect that a twin may lack, or a parameter of it that may have changed.

    Attributes
    ----------
    kind, where, driver, change
        Labels in the vocabulary of a diagnosis.
    changes
        Parameter id -> weight. At size s a parameter is its neutral (or present) value plus weight times s; with
        `inverse`, weight over s.
    unit, typical, lower, upper
        Unit of the size, a size of interest, and bounds, which contain its possible signs.
    says
        The effect in words, with ``{value}`` for the size and its unit, ``{share}`` for it in percent, and ``{slow}``
        for the time constant. "more" and "too high" right after it turn into their opposites where it is negative.
    adds
        Name -> table of the elements that are added.
    replaces
        Element -> keys of its table that differ.
    exhausts
        True if `upper` is all that there is, such as the water of a volume: a size may end there.
    total_loss
        Size at which all of a flow is lost, or 0 for other laws. Much of such a loss acts otherwise than a little: a
        volume cut off from its water is not only warmer, but slower. It is tried whatever a little of it explains.
    shapes
        Possible time courses.
    lumped
        Size that a twin of mixed volumes may seem to lack, more without pipes, without any fault.
    near
        Function that makes similar forms, which are tested where this one scores.
    at_level
        Of a thermometer that sticks, or of an actuator that is limited: function that makes the same at another level.
    level
        That level, in the unit of its column; None of other laws.
    begins
        Input column whose temperature an added mass has at its onset, or "" for that of its place.
    slow_s, slower
        Time constant of a temperature of its own, s, or 0, and a function that makes the same with another one.
    column, follows, injects, reads, adopts
        Of an open law: the column that its elements follow, a function of stamps (n,) and inputs (n, c) that makes its
        values (n,), the nodes and the sensors on which a value of 1 acts with these weights, if it acts on nothing
        else, and what an adopted law's element has. A law that follows a node has only the last.
    """

    kind: str
    where: str
    driver: str
    change: Literal["new", "existing"]
    changes: Mapping[str, float]
    unit: str
    typical: float
    lower: float
    upper: float
    says: str
    adds: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    replaces: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    inverse: bool = False
    exhausts: bool = False
    total_loss: float = 0.0
    shapes: tuple[str, ...] = (*LASTING, *INTERMITTENT)
    lumped: float = 0.0
    near: Callable[[], tuple[Candidate, ...]] | None = None
    at_level: Callable[[float], Candidate] | None = None
    level: float | None = None
    begins: str = ""
    slow_s: float = 0.0
    slower: Callable[[float], Candidate] | None = None
    column: str = ""
    follows: Callable[[Any, Any], Any] | None = None
    injects: Mapping[str, float] = field(default_factory=dict)
    reads: Mapping[str, float] = field(default_factory=dict)
    adopts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def is_open(self) -> bool:
        """Return True for a law without a name."""
        return bool(self.adopts)

    @property
    def is_limit(self) -> bool:
        """Return True for an actuator that delivers less above a level."""
        return self.kind == "actuator" and self.at_level is not None

    @property
    def has_level(self) -> bool:
        """Return True for a law with a level of its own; shares of several levels together are a gain of any size."""
        return self.sticks or self.is_limit

    @property
    def sticks(self) -> bool:
        """Return True for a thermometer that reads the same whatever it measures."""
        return self.kind == "sensor" and any("_sticks" in name for name in self.adds)

    def at_bound(self, size: float) -> bool:
        """Return True if a size is on a bound that is not all there is: such a size is not known.

        All there is are the water of a volume (`exhausts`), all of a share or nothing of it, and the least of what the
        twin has already.
        """
        ends = (-1.0, 1.0) if self.unit == "1" else ()
        low = size <= self.lower and self.lower not in ends and self.change == "new"
        return low or (size >= self.upper and self.upper not in ends and not self.exhausts)

    @property
    def is_event(self) -> bool:
        """Return True for an event, such as a refill, which is always transient."""
        return self.shapes == INTERMITTENT

    @cached_property
    def id(self) -> str:
        """Return a text that is unique within a catalogue."""
        weights = ",".join(f"{name}*{weight:.4g}" for name, weight in self.changes.items())
        others = "".join(f"|{key}={value}" for keys in self.replaces.values() for key, value in keys.items())
        others += f"|from {self.begins}" if self.begins else ""
        others += f"|{sorted(self.adopts.items())}" if self.adopts else ""
        return f"{self.kind}@{self.where}~{self.driver}[{weights}{others}]{self.typical:.3g}"


@dataclass(frozen=True)
class EffectSize:
    """Size of an effect: its unit, a size of interest, and bounds."""

    unit: str
    typical: float
    lower: float
    upper: float


@dataclass(frozen=True)
class Sites:
    """The places of a network at which an element may be missing.

    Attributes
    ----------
    nodes, inputs
        Names.
    room, clock
        Input columns of the room temperature and the time of day, or "".
    before
        Node -> the node before it on a flow path.
    places
        Node -> the operator's name of the place.
    groups
        Place -> nodes that are alike and are named together.
    elements, values
        Every element, and id -> present value.
    litres_per_s
        Largest nominal flow, L/s.
    scales
        Input column -> its declared range.
    """

    nodes: tuple[str, ...]
    inputs: tuple[str, ...]
    room: str
    clock: str
    before: Mapping[str, str]
    places: Mapping[str, str]
    groups: Mapping[str, tuple[str, ...]]
    elements: tuple[Element, ...]
    values: Mapping[str, float]
    litres_per_s: float = 0.0
    scales: Mapping[str, float] = field(default_factory=dict)

    def having(self, kind: str) -> tuple[Any, ...]:
        """Return the network's elements of a kind."""
        return tuple(e for e in self.elements if e.kind == kind)


def free_name(stem: str, elements: Iterable[Element]) -> str:
    """Return a name that no element has: `stem`, or with a number after it."""
    taken = {e.name for e in elements}
    return next(name for k in range(1, len(taken) + 2) if (name := stem if k == 1 else f"{stem}_{k}") not in taken)


def with_free_names(candidate: Candidate, elements: tuple[Element, ...]) -> Candidate:
    """Return a candidate, and those that it makes, whose added elements have names that no element of a twin has."""
    names = {name: free_name(name, elements) for name in candidate.adds}
    near, slower, at_level = candidate.near, candidate.slower, candidate.at_level
    if near is not None:
        candidate = replace(candidate, near=partial(_free_near, near, elements))
    if slower is not None:
        candidate = replace(candidate, slower=partial(_with_free_names, slower, elements))
    if at_level is not None:
        candidate = replace(candidate, at_level=partial(_with_free_names, at_level, elements))
    if all(name == free for name, free in names.items()):
        return candidate
    changes = {}
    for key, weight in candidate.changes.items():
        element, _, parameter = key.rpartition(".")
        changes[f"{names.get(element, element)}.{parameter}"] = weight
    return replace(candidate, adds={names[name]: table for name, table in candidate.adds.items()}, changes=changes)


def _free_near(near: Callable[[], tuple[Candidate, ...]], elements: tuple[Element, ...]) -> tuple[Candidate, ...]:
    return tuple(with_free_names(one, elements) for one in near())


def _with_free_names(make: Callable[[float], Candidate], elements: tuple[Element, ...], value: float) -> Candidate:
    return with_free_names(make(value), elements)


def input_target(column: str) -> str:
    """Return the name under which `Element.changes` names an input column; no element can have it."""
    return f"input {column}"
