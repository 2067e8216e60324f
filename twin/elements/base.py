"""Contract of an element, and the names under which its formulas see the network.

An element turns its parameters, the inputs of the current sample interval and the temperatures of its nodes
into heat flows. It does so by short arithmetic expressions, which the kernel generator puts into one fused loop over
lanes. They are expressions rather than calls, because only then does one loop hold the whole network. They are written
in the generated identifiers of `twin.elements.symbols`: no name from a file is ever part of one.

The levels of an expression, cheapest first:

``uniform``  inputs only, the same for every lane (``log(fan/100)``)
``sample``   parameters and inputs; computed again only when an input it uses has changed
``stage``    temperatures too
``heat``     the result, W into each node

An element may also have memory. An `ElementState` is a temperature of its own that is integrated with those of the
nodes. A `SensorLag` follows a temperature without acting on it. A `PlugFlowDelay` hands on water after the flow has
pushed it through. An `InputDrive` stands between an input column and the value that the elements see. A `SampleMemory`
is renewed once a sample, for switches with hysteresis and for quantities that follow an input.

An element may change another one (`changes`, `change`): its formula becomes part of the other's.

The kernel generator takes apart every expression that is affine in the temperatures, so an element need not care how it
writes it down. Every parameter that switches an effect off should do so at exactly 0 or 1. While such a parameter is
fixed there, `Names.constant` returns that value, and the element may leave the effect out.
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
STAMP = "time_s"
"""Input column that holds the stamps of the samples; the kernels fill it, so no record needs it."""


@dataclass(frozen=True)
class ParameterSpec:
    """Declaration of a parameter by its kind; a twin file may narrow or replace everything but the unit.

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
    """A parameter of one element in a network: value, bounds, unit, status, one-line source.

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

    Attributes
    ----------
    name
        Name within the element.
    rate
        dT/dt, K/s.
    start
        Temperature at rest, in node temperatures.
    speed
        Upper bound on the dependence of the rate on the state itself, 1/s, free of temperatures.
    """

    name: str
    rate: str
    start: str
    speed: str


@dataclass(frozen=True)
class SensorLag:
    """A first-order lag, constant * dz/dt = of - z, on which nothing but a reading depends.

    Attributes
    ----------
    name
        Name within the element; `Names.lagged` is the identifier of z.
    of
        Weighted mean of temperatures.
    constant
        Time constant in s, free of temperatures, 0 allowed.
    """

    name: str
    of: str
    constant: str


@dataclass(frozen=True)
class PlugFlowDelay:
    """Water that comes out when the flow has pushed `volume` through: plug flow.

    The kernel provides two names. ``Names.outlet()`` is the temperature of the water that comes out after the delay,
    and ``Names.local("late")`` the share of the water that is delayed. That is 1, except for a volume that the flow
    fills in less than one step: there the rest passes at once and the mean delay stays right. So the outlet is ``(1 -
    late) * water + late * outlet``, which is continuous in the volume down to 0.

    Attributes
    ----------
    water
        Temperature of the water that enters.
    flow, volume
        L/s, and L, free of temperatures.
    start
        Temperature of the contents at rest, in node temperatures.
    """

    water: str
    flow: str
    volume: str
    start: str


@dataclass(frozen=True)
class InputDrive:
    """The value that the elements see instead of an input column.

    Attributes
    ----------
    column
        The input.
    value
        Expression of ``Names.arrived()``, the command after dead time and lag.
    dead_time, lag
        s, parameters only, or None.
    varies
        True if `value` depends on more than the command and parameters.
    """

    column: str
    value: str
    dead_time: str | None = None
    lag: str | None = None
    varies: bool = False


@dataclass(frozen=True)
class SampleMemory:
    """A number that is renewed once a sample interval, at its beginning, and holds during it.

    `Names.local` of `name` is the identifier of its value in the interval, `Names.before` that of the number that was
    stored in the interval before, and `Names.span` the length of the interval, s. Its expressions use inputs,
    parameters, and temperatures at the sample. A simulation that knows no past sees `start` as the number stored.

    Attributes
    ----------
    name
        Name within the element.
    value
        Value in the interval.
    after
        Number that is stored at the end of the interval.
    start
        Number that is stored before the first interval, in node temperatures and inputs.
    """

    name: str
    value: str
    after: str
    start: str


@dataclass(frozen=True)
class Export:
    """A quantity that a `meter` can read, beside the heat that the network needs.

    Attributes
    ----------
    unit
        W, kW, kg/s or %.
    value
        Expression of anything but the outlets of delays.
    steps
        (local name, expression) that `value` needs beyond `uniform`, `sample` and `stage`; computed only where a meter
        reads it.
    """

    unit: str
    value: str
    steps: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Metered:
    """The quantity of an element that a meter reads: the local `name` is `factors[unit]` times the export's value."""

    element: str
    quantity: str
    name: str
    factors: Mapping[str, float]


@dataclass(frozen=True)
class Fragment:
    """An element's part of the kernel.

    Attributes
    ----------
    uniform
        (local name, expression) evaluated once per sample interval.
    sample
        (local name, expression) evaluated per interval and lane when an input has changed.
    stage
        (local name, expression) evaluated in every stage of the integrator.
    heat
        Node -> expression, W into the node.
    conductance
        Node -> expression of `uniform`, `sample` and parameters only: an upper bound on the dependence of the heat on
        the node's own temperature, W/K. It sets the substeps.
    observe
        Expression of an instrument's reading, degC of a thermometer, or None.
    exports
        Quantity -> what a meter can read of the element.
    metered
        What the element reads of another one; meters only.
    states, lags, delay, drive, memories
        The element's memory.
    """

    uniform: tuple[tuple[str, str], ...] = ()
    sample: tuple[tuple[str, str], ...] = ()
    stage: tuple[tuple[str, str], ...] = ()
    heat: Mapping[str, str] = field(default_factory=dict)
    conductance: Mapping[str, str] = field(default_factory=dict)
    observe: str | None = None
    exports: Mapping[str, Export] = field(default_factory=dict)
    metered: Metered | None = None
    states: tuple[ElementState, ...] = ()
    lags: tuple[SensorLag, ...] = ()
    delay: PlugFlowDelay | None = None
    drive: InputDrive | None = None
    memories: tuple[SampleMemory, ...] = ()

    def remembered(self, element: str) -> dict[str, tuple[str, ...]]:
        """Return the names in the element's memory, by the first letter of their identifiers."""
        return {
            "x": tuple(f"{element}.{s.name}" for s in self.states),
            "f": tuple(f"{element}.{lag.name}" for lag in self.lags),
            "D": (element,) if self.delay else (),
            "a": (element,) if self.drive else (),
        }


SHAPES = ("step", "ramp", "saturating")
"""Time courses of an effect: at once, growing in proportion to time, or growing to a final size."""


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
    shapes
        Possible time courses.
    lumped
        Size that a twin of mixed volumes may seem to lack, more without pipes, without any fault.
    near
        Function that makes similar forms, which are tested where this one scores.
    begins
        Input column whose temperature an added mass has at its onset, or "" for that of its place.
    slow_s, slower
        Time constant of a temperature of its own, s, or 0, and a function that makes the same with another one.
    column, follows, injects, reads, adopts
        Of an open law: the column that its elements follow, a function of stamps (n,) and inputs (n, c) that makes its
        values (n,), the nodes and the sensors on which a value of 1 acts with these weights, if it acts on nothing
        else, and what an adopted law's element has.
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
    column: str = ""
    follows: Callable[[Any, Any], Any] | None = None
    injects: Mapping[str, float] = field(default_factory=dict)
    reads: Mapping[str, float] = field(default_factory=dict)
    adopts: Mapping[str, Any] = field(default_factory=dict)

    @property
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


def input_target(column: str) -> str:
    """Return the name under which `Element.changes` names an input column; no element can have it."""
    return f"input {column}"


def place(role: Literal["node", "nodes", "input", "columns", "choice", "element"], about: str, **extra: Any) -> Any:
    """Return a dataclass field that a twin file fills: a place of the element, or its driver.

    Parameters
    ----------
    role
        ``node`` one node; ``nodes`` a list of nodes; ``input`` an input column; ``columns`` measured columns;
        ``choice`` one of ``choices``; ``element`` another element, of one of the kinds ``kinds``.
    about
        One line for the error message and the documentation.
    extra
        ``default`` makes the key optional; ``choices`` lists the possible values of a choice; ``key`` is the key in the
        file where it cannot be a Python name (``from``).
    """
    metadata = {"role": role, "about": about, **{k: v for k, v in extra.items() if k != "default"}}
    if "default" in extra:
        return field(default=extra["default"], metadata=metadata)
    return field(metadata=metadata)


@dataclass(frozen=True)
class Element(ABC):
    """A piece of physics between nodes. Subclasses are frozen dataclasses of their places."""

    kind: ClassVar[str]
    parameters: ClassVar[tuple[ParameterSpec, ...]] = ()
    linear: ClassVar[bool] = True
    """True if the heat is affine in the temperatures; selects the kernel's integrator."""

    name: str

    def parameter_specs(self) -> tuple[ParameterSpec, ...]:
        """Return the parameters of this very element; a kind with one parameter per station overrides it."""
        return self.parameters

    @abstractmethod
    def emit(self, n: Names) -> Fragment:
        """Return the formulas of this element, written with the names `n`."""

    def problem(self, values: Mapping[str, float]) -> str | None:
        """Return a plain sentence if these parameter values are inconsistent, else None."""
        return None

    @classmethod
    def missing_candidates(cls, sites: Sites) -> tuple[Candidate, ...]:
        """Return elements of this kind that a twin may lack, at every possible place."""
        return ()

    def changed_candidates(self, sites: Sites) -> tuple[Candidate, ...]:
        """Return parameters of this element that may have changed since it was commissioned."""
        return ()

    def parameter_candidate(
        self, name: str, kind: str, where: str, driver: str, size: EffectSize, says: str
    ) -> Candidate:
        """Return the candidate of one parameter of this element, its size in the parameter's own unit."""
        changes = {f"{self.name}.{name}": 1.0}
        limits = (size.unit, size.typical, size.lower, size.upper)
        return Candidate(kind, where, driver, "existing", changes, *limits, says)

    @classmethod
    def places(cls) -> dict[str, dataclasses.Field[Any]]:
        """Return key in the twin file -> dataclass field, for everything but the name."""
        return {f.metadata.get("key", f.name): f for f in dataclasses.fields(cls) if f.name != "name"}

    def _of_role(self, *roles: str) -> tuple[str, ...]:
        found: list[str] = []
        for f in dataclasses.fields(self):
            if f.metadata.get("role") in roles:
                value = getattr(self, f.name)
                found.extend((value,) if isinstance(value, str) else (value or ()))
        return tuple(found)

    def feeds(self) -> Mapping[str, str]:
        """Return node -> node before it on the element's flow path ("" at an inlet); flows only."""
        return {}

    def changes(self) -> str:
        """Return the element (or, as `input_target`, the input column) that `change` changes; "" for none."""
        return ""

    def change(self, n: Names) -> str:
        """Return the expression that enters into the formulas of `changes`, in names that any element may use."""
        return ""

    def nodes(self) -> tuple[str, ...]:
        """Return the nodes that the element touches."""
        return self._of_role("node", "nodes")

    def inputs(self) -> tuple[str, ...]:
        """Return the input columns that drive the element."""
        return self._of_role("input")

    def columns(self) -> tuple[str, ...]:
        """Return the measured columns that the element reads (sensors and meters only)."""
        return self._of_role("columns")
