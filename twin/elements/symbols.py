"""Generated identifiers for everything to which an element's formulas may refer.

A formula is text of this project's own: arithmetic between identifiers. Names of elements, nodes, inputs and parameters
come from twin files, which are data. They are keys of the tables here and never part of a formula. The identifiers are
``x3`` state, ``p12`` parameter, ``u2`` input as the elements see it, ``D0`` outlet of a delay, ``f1`` lagged value,
``a0`` command that has arrived, ``L_pipe__late`` a local of an element, ``now`` the stamp.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

REMEMBERED = ("x", "f", "D", "a")
"""First letters of the elements' memory: states, lags, delays, drives."""


class Symbols:
    """Identifiers of one network, handed out element by element.

    Parameters
    ----------
    parameters
        Id -> index in the full parameter vector.
    inputs, nodes
        Names in their order.

    Attributes
    ----------
    names
        First letter -> names in memory, in the order of the index. Nodes are the first states.
    """

    def __init__(
        self, parameters: Mapping[str, int] | None = None, inputs: Iterable[str] = (), nodes: Iterable[str] = ()
    ) -> None:
        self._parameters = dict(parameters or {})
        self._inputs = {name: k for k, name in enumerate(inputs)}
        self.names: dict[str, list[str]] = {letter: [] for letter in REMEMBERED}
        self.names["x"] += nodes
        self._nodes = {name: k for k, name in enumerate(self.names["x"])}
        self._used: dict[str, list[str]] = {letter: [] for letter in REMEMBERED}
        self._locals: dict[tuple[str, str], str] = {}
        self._taken: set[str] = set()

    def parameter(self, name: str) -> str:
        """Return the identifier of a parameter, by its id."""
        return f"p{self._parameters[name]}"

    def input(self, column: str) -> str:
        """Return the identifier of an input column."""
        return f"u{self._inputs[column]}"

    def node(self, name: str) -> str:
        """Return the identifier of a node's temperature."""
        return f"x{self._nodes[name]}"

    def remembered(self, letter: str, name: str) -> str:
        """Return the identifier of an entry in the memory of the present element; `settle` confirms the index."""
        used = self._used[letter]
        if name not in used:
            used.append(name)
        return f"{letter}{len(self.names[letter]) + used.index(name)}"

    def settle(self, declared: Mapping[str, Sequence[str]]) -> None:
        """Assign the indices used by the latest element to its declared memory, or free them for the next.

        Raises
        ------
        ValueError
            The element uses something that is not among its declared memory, or in another order.
        """
        for letter in REMEMBERED:
            own, used = list(declared.get(letter, ())), self._used[letter]
            if own and own[: len(used)] != used:
                raise ValueError(f"an element remembers {', '.join(own)} and uses {', '.join(used)}")
            self.names[letter] += own
            self._used[letter] = []

    def local(self, element: str, name: str) -> str:
        """Return the identifier of a local: readable where the names are identifiers, and never the same for two
        locals.
        """
        key = (element, name)
        if key not in self._locals:
            stem = f"L_{_plain(element)}__{_plain(name)}"
            text, count = stem, 0
            while text in self._taken:
                count += 1
                text = f"{stem}__{count}"
            self._taken.add(text)
            self._locals[key] = text
        return self._locals[key]


@functools.cache
def _plain(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9_]", "_", name)


@dataclass(frozen=True)
class Stream:
    """The flow that feeds a node: the flow's name, the node before it ("" at an inlet) and the pipe between ("")."""

    flow: str
    before: str
    pipe: str


@dataclass(frozen=True)
class Names:
    """Identifiers that an element's formulas may use: its parameters, node temperatures, inputs, own locals."""

    element: str
    constants: Mapping[str, float] = field(default_factory=dict)
    streams: Mapping[str, Stream] = field(default_factory=dict)
    symbols: Symbols = field(default_factory=Symbols)
    changes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def of(self, element: str) -> Names:
        """Return the identifiers of another element, for its parameters and locals."""
        return Names(element, symbols=self.symbols)

    def constant(self, name: str) -> float | None:
        """Return the value of an own parameter that this kernel may assume (exactly 0 or 1), or None."""
        return self.constants.get(name)

    def par(self, name: str) -> str:
        """Return the element's own parameter `name`."""
        return self.symbols.parameter(f"{self.element}.{name}")

    def temperature(self, node: str) -> str:
        """Return the temperature of a node in the current stage, degC."""
        return self.symbols.node(node)

    def input(self, column: str) -> str:
        """Return an input column, held from one sample to the next (zero-order hold)."""
        return self.symbols.input(column)

    def local(self, name: str, element: str = "") -> str:
        """Return a local of the element's own (or of another's) for a `uniform`, `sample` or `stage` expression."""
        return self.symbols.local(element or self.element, name)

    def before(self, name: str) -> str:
        """Return the number that the element's own `SampleMemory` stored in the sample interval before."""
        return self.local(f"{name}_before")

    def span(self) -> str:
        """Return the length of the sample interval, s; for a `SampleMemory` only."""
        return "span"

    def changed_by(self, target: str = "") -> tuple[str, ...]:
        """Return the expressions of the elements that change this one, or that change the input column `target`."""
        return self.changes.get(target or self.element, ())

    def state(self, name: str) -> str:
        """Return the temperature of the element's own `ElementState`, degC."""
        return self.symbols.remembered("x", f"{self.element}.{name}")

    def lagged(self, name: str) -> str:
        """Return the value of the element's own `SensorLag`, degC."""
        return self.symbols.remembered("f", f"{self.element}.{name}")

    def outlet(self) -> str:
        """Return the temperature of the water that the element's own `PlugFlowDelay` lets out, degC."""
        return self.symbols.remembered("D", self.element)

    def arrived(self) -> str:
        """Return the command that has come through the element's own `InputDrive`, in the column's unit."""
        return self.symbols.remembered("a", self.element)

    def time(self) -> str:
        """Return the stamp of the sample, s; for readings only."""
        return "now"
