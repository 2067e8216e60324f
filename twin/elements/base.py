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
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

from twin.elements.candidates import Candidate, EffectSize, Sites
from twin.elements.fragments import (
    Fragment,
)
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
        ``default`` makes the key optional; ``unit`` is that in which an input column is read; ``choices`` lists the
        possible values of a choice; ``key`` is the key in the file where it cannot be a Python name (``from``).
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
    def upper_of(cls, name: str) -> float:
        """Return the upper bound of a parameter of this kind, up to which its changes are looked for.

        How large an effect may be is a matter of the rig's size, of which an element knows nothing else.
        """
        return next(spec.upper for spec in cls.parameters if spec.name == name)

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
