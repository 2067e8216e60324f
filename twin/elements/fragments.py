"""Parts of an element's formula: text for the kernel generator, with the memory that it needs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


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
