"""The contract of an element, and the names under which its formulas see the network.

An element turns its parameters, the inputs of the current sample interval and the temperatures of its nodes
into heat flows. It does so by short arithmetic expressions, which the kernel generator puts into one fused loop over
lanes. Expressions rather than calls, because only then does one loop hold the whole network. They are written in the
generated identifiers of `twin.elements.symbols`: no name from a file is ever part of one.

The levels of an expression, cheapest first:

``uniform``  inputs only, the same for every lane (``log(fan/100)``)
``sample``   parameters and inputs; computed again only when an input it uses has changed
``stage``    temperatures too
``heat``     the result, W into each node

An element may also remember. A `State` is a temperature of its own that is integrated with those of the nodes; a
`Lag` follows a temperature without acting on it; a `Delay` hands on water after the flow has pushed it through; a
`Drive` stands between an input column and what the elements see of it.

Whatever is affine in the temperatures is taken apart by the kernel generator, so an element need not care how it
writes it down. Every parameter that switches an effect off should do so at exactly 0 or 1: while such a parameter is
fixed there, `Names.constant` tells, and the element may leave the effect out.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

from twin.elements.symbols import Names

Status = Literal["fixed", "boundary", "tunable"]
STATUSES: tuple[Status, ...] = ("fixed", "boundary", "tunable")


@dataclass(frozen=True)
class ParameterSpec:
    """What a kind says about one of its parameters; a twin file may narrow or replace everything but the unit.

    ``default`` None means that the file must give a value. ``lower`` and ``upper`` are the physical bounds
    inside which the kernel is guaranteed to stay finite.
    """

    name: str
    unit: str
    default: float | None
    lower: float
    upper: float
    status: Status
    source: str


@dataclass(frozen=True)
class Parameter:
    """One parameter of one element as a network holds it: value, bounds, unit, status, one-line source.

    With `same_as`, the id of another parameter, it has no value of its own but that parameter's.
    """

    id: str
    element: str
    name: str
    value: float
    unit: str
    lower: float
    upper: float
    status: Status
    source: str
    same_as: str = ""


@dataclass(frozen=True)
class ElementState:
    """A temperature of the element's own, integrated like a node's; `Names.state` is its identifier.

    Attributes:
        name: within the element. rate: dT/dt, K/s. start: temperature at rest, in node temperatures.
        speed: upper bound on how strongly the rate depends on the state itself, 1/s, free of temperatures.
    """

    name: str
    rate: str
    start: str
    speed: str


@dataclass(frozen=True)
class SensorLag:
    """A first-order follower, constant * dz/dt = of - z, that nothing but a reading depends on.

    Attributes:
        name: within the element; `Names.lagged` is the identifier of z.
        of: weighted mean of temperatures. constant: time constant in s, free of temperatures, 0 allowed.
    """

    name: str
    of: str
    constant: str


@dataclass(frozen=True)
class PlugFlowDelay:
    """Water that comes out when the flow has pushed `volume` through: plug flow.

    The kernel provides two names. ``Names.outlet()`` is the temperature of what comes out after the delay, and
    ``Names.local("late")`` the share of the water that is delayed: 1, but for a volume that the flow fills in less
    than one step, where the rest passes at once and the mean delay stays right. So the outlet is
    ``(1 - late) * water + late * outlet``, which is continuous in the volume down to 0.

    Attributes:
        water: temperature of the water that enters. flow: L/s. volume: L, free of temperatures.
        start: what the pipe is filled with at rest, in node temperatures.
    """

    water: str
    flow: str
    volume: str
    start: str


@dataclass(frozen=True)
class InputDrive:
    """What the elements see of an input column, instead of the column.

    Attributes:
        column: the input. value: expression of ``Names.arrived()``, the command after dead time and lag.
        dead_time, lag: s, parameters only, or None.
    """

    column: str
    value: str
    dead_time: str | None = None
    lag: str | None = None


@dataclass(frozen=True)
class Fragment:
    """What an element adds to the kernel.

    Attributes:
        uniform: (local name, expression) evaluated once per sample interval.
        sample: (local name, expression) evaluated per interval and lane when an input has changed.
        stage: (local name, expression) evaluated in every stage of the integrator.
        heat: node -> expression, W into the node.
        conductance: node -> expression of `uniform`, `sample` and parameters only: an upper bound on how
            strongly the heat depends on the node's own temperature, W/K. It sets the substeps.
        observe: expression of a sensor's reading, degC, or None.
        states, lags, delay, drive: what the element remembers.
    """

    uniform: tuple[tuple[str, str], ...] = ()
    sample: tuple[tuple[str, str], ...] = ()
    stage: tuple[tuple[str, str], ...] = ()
    heat: Mapping[str, str] = field(default_factory=dict)
    conductance: Mapping[str, str] = field(default_factory=dict)
    observe: str | None = None
    states: tuple[ElementState, ...] = ()
    lags: tuple[SensorLag, ...] = ()
    delay: PlugFlowDelay | None = None
    drive: InputDrive | None = None

    def remembered(self, element: str) -> dict[str, tuple[str, ...]]:
        """Return the names of what the element remembers, by the first letter of their identifiers."""
        return {
            "x": tuple(f"{element}.{s.name}" for s in self.states),
            "f": tuple(f"{element}.{lag.name}" for lag in self.lags),
            "D": (element,) if self.delay else (),
            "a": (element,) if self.drive else (),
        }


SHAPES = ("step", "ramp", "saturating")
"""How an effect may come in: at once, growing in proportion to time, or growing to a final size."""


@dataclass(frozen=True)
class Candidate:
    """An effect that a twin may lack, or a parameter of it that may have moved.

    Attributes:
        kind, where, driver, change: in the vocabulary of a diagnosis.
        changes: parameter id -> weight. At size s a parameter is its neutral (or present) value plus weight times s;
            with `inverse`, weight over s.
        unit, typical, lower, upper: of the size. typical: a size of interest; bounds hold its possible signs.
        says: the effect in words, with ``{value}`` for the size and its unit, or ``{share}`` for it in percent, and
            ``{slow}`` for how slow it is; "more" and "too high" right after it turn into their opposites where it is
            negative.
        adds: name -> table of the elements that are added.
        replaces: element -> keys of its table that differ.
        shapes: time shapes in which it may come in.
        lumped: size that a twin of mixed volumes may seem to lack, more without pipes, without anything being wrong.
        near: makes other forms of the same, which are looked at where this one scores.
        begins: input column whose temperature what is added begins at when it comes in, or "" for that of its place.
        slow_s: time constant of a temperature of its own, s, or 0. slower: makes the same with another one.
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
    shapes: tuple[str, ...] = SHAPES
    lumped: float = 0.0
    near: Callable[[], tuple[Candidate, ...]] | None = None
    begins: str = ""
    slow_s: float = 0.0
    slower: Callable[[float], Candidate] | None = None

    @property
    def id(self) -> str:
        """Unique within a catalogue."""
        weights = ",".join(f"{name}*{weight:.4g}" for name, weight in self.changes.items())
        others = "".join(f"|{key}={value}" for keys in self.replaces.values() for key, value in keys.items())
        others += f"|from {self.begins}" if self.begins else ""
        return f"{self.kind}@{self.where}~{self.driver}[{weights}{others}]{self.typical:.3g}"


@dataclass(frozen=True)
class Sites:
    """What a network offers to an element that it may lack.

    Attributes:
        nodes, inputs: names. room, clock: input columns of the room temperature and the time of day, or "".
        before: node -> the node before it on a flow path. places: node -> what an operator calls the place.
        groups: place -> nodes that are alike and are named together.
        elements: every element. values: id -> present value. litres_per_s: of the largest nominal flow.
        scales: input column -> how far it goes, as declared.
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
        """The network's elements of a kind."""
        return tuple(e for e in self.elements if e.kind == kind)


def place(role: Literal["node", "nodes", "input", "columns", "choice"], about: str, **extra: Any) -> Any:
    """A dataclass field that a twin file fills: where the element stands, or what drives it.

    Args:
        role: ``node`` one node; ``nodes`` a list of nodes; ``input`` an input column; ``columns`` measured
            columns; ``choice`` one of ``choices``.
        about: one line for the error message and the documentation.
        extra: ``default`` makes the key optional; ``choices`` lists what a choice may be; ``key`` is the key
            in the file where it cannot be a Python name (``from``).
    """
    metadata = {"role": role, "about": about, **{k: v for k, v in extra.items() if k != "default"}}
    if "default" in extra:
        return field(default=extra["default"], metadata=metadata)
    return field(metadata=metadata)


@dataclass(frozen=True)
class Element(ABC):
    """One piece of physics between nodes. Subclasses are frozen dataclasses of their places."""

    kind: ClassVar[str]
    parameters: ClassVar[tuple[ParameterSpec, ...]] = ()
    linear: ClassVar[bool] = True
    """Whether the heat is affine in the temperatures; decides how the kernel integrates."""

    name: str

    def parameter_specs(self) -> tuple[ParameterSpec, ...]:
        """Parameters of this very element; a kind with one parameter per station overrides it."""
        return self.parameters

    @abstractmethod
    def emit(self, n: Names) -> Fragment:
        """Formulas of this element, written with the names `n`."""

    def problem(self, values: Mapping[str, float]) -> str | None:
        """A plain sentence if these parameter values make no sense together, else None."""
        return None

    @classmethod
    def missing(cls, sites: Sites) -> tuple[Candidate, ...]:
        """Elements of this kind that a twin may lack, at every place where one may stand."""
        return ()

    def moved(self, sites: Sites) -> tuple[Candidate, ...]:
        """Parameters of this element that may have changed since it was commissioned."""
        return ()

    def moves(
        self,
        name: str,
        kind: str,
        where: str,
        driver: str,
        unit: str,
        typical: float,
        low: float,
        high: float,
        says: str,
    ) -> Candidate:
        """Candidate of one parameter of this element, its size in the parameter's own unit."""
        return Candidate(kind, where, driver, "existing", {f"{self.name}.{name}": 1.0}, unit, typical, low, high, says)

    @classmethod
    def places(cls) -> dict[str, dataclasses.Field[Any]]:
        """Key in the twin file -> dataclass field, for everything but the name."""
        return {f.metadata.get("key", f.name): f for f in dataclasses.fields(cls) if f.name != "name"}

    def _of_role(self, *roles: str) -> tuple[str, ...]:
        found: list[str] = []
        for f in dataclasses.fields(self):
            if f.metadata.get("role") in roles:
                value = getattr(self, f.name)
                found.extend((value,) if isinstance(value, str) else (value or ()))
        return tuple(found)

    def feeds(self) -> Mapping[str, str]:
        """Node -> node before it on the element's flow path ("" at an inlet); flows only."""
        return {}

    def nodes(self) -> tuple[str, ...]:
        """Nodes that the element touches."""
        return self._of_role("node", "nodes")

    def inputs(self) -> tuple[str, ...]:
        """Input columns that drive the element."""
        return self._of_role("input")

    def columns(self) -> tuple[str, ...]:
        """Measured columns that the element reads (sensors only)."""
        return self._of_role("columns")
