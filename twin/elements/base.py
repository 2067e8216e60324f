"""The contract of an element, and the names under which its formulas see the network.

An element turns its parameters, the inputs of the current sample interval and the temperatures of its nodes
into heat flows. It does so as text: short arithmetic expressions that the kernel generator pastes into one
fused loop over lanes. Text rather than calls, because only then does one loop hold the whole network.

The levels of an expression, cheapest first:

``uniform``  once per sample interval, the same for every lane: inputs only (``log(fan/100)``)
``sample``   once per sample interval and lane, only when an input it uses has changed: parameters and inputs
``stage``    in each stage of the integrator: temperatures too
``heat``     the result, W into each node
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

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
    """One parameter of one element as a network holds it: value, bounds, unit, status, one-line source."""

    id: str
    element: str
    name: str
    value: float
    unit: str
    lower: float
    upper: float
    status: Status
    source: str


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
    """

    uniform: tuple[tuple[str, str], ...] = ()
    sample: tuple[tuple[str, str], ...] = ()
    stage: tuple[tuple[str, str], ...] = ()
    heat: Mapping[str, str] = field(default_factory=dict)
    conductance: Mapping[str, str] = field(default_factory=dict)
    observe: str | None = None


@dataclass(frozen=True)
class Names:
    """Names that an element's expressions may use: its parameters, node temperatures, inputs, own locals."""

    element: str
    constants: Mapping[str, float] = field(default_factory=dict)

    def constant(self, name: str) -> float | None:
        """Value of an own parameter that this kernel may take for granted (exactly 0 or 1), or None."""
        return self.constants.get(name)

    def par(self, name: str) -> str:
        """The element's own parameter `name`."""
        return f"<P:{self.element}.{name}>"

    def temperature(self, node: str) -> str:
        """Temperature of a node in the current stage, degC."""
        return f"<T:{node}>"

    def input(self, column: str) -> str:
        """Input column, held from one sample to the next (zero-order hold)."""
        return f"<U:{column}>"

    def local(self, name: str) -> str:
        """A name of the element's own for a `uniform`, `sample` or `stage` expression."""
        return f"<L:{self.element}.{name}>"


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

    def nodes(self) -> tuple[str, ...]:
        """Nodes that the element touches."""
        return self._of_role("node", "nodes")

    def inputs(self) -> tuple[str, ...]:
        """Input columns that drive the element."""
        return self._of_role("input")

    def columns(self) -> tuple[str, ...]:
        """Measured columns that the element reads (sensors only)."""
        return self._of_role("columns")
