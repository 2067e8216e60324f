"""Layout of a full state: all that a network remembers from one kernel call to the next, as one flat vector.

    node temperatures | states and lags of elements | contents of delay lines | recent commands

Its shape depends on the network alone, not on the parameters that a kernel varies, so one kernel can take up a state
that another has returned. Memory that a kernel has beyond that (for example a lag varied around 0) starts at rest in
every call, unless the kernel was asked to remember it; its states are then its own.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from twin.kernel.delays import delay_layout
from twin.kernel.generated_code import define_functions
from twin.network import Array, Network, TwinFileError
from twin.network.assembly import NetworkEquations
from twin.network.reference_source import python_source

AT_C = 40.0
"""Temperature, degC, at which what is not affine in the temperatures is linearised."""
COMMANDS = 256
"""Number of values of a command that are remembered for its dead time."""


class StateLayout:
    """Full states of a network, (P, size), for a kernel with `free` parameters.

    Parameters
    ----------
    network
        The network.
    free
        Ids of the parameters that the kernel varies.
    held
        Ids of the parameters that may have any value in the state's memory.

    Attributes
    ----------
    network
        The network.
    nodes
        Number of node temperatures.
    size
        Length of a full state.
    rows
        Rows of delay lines.
    states
        Names of the node temperatures and of the elements' own states, as a kernel holds them.
    """

    def __init__(self, network: Network, free: tuple[str, ...], held: tuple[str, ...] = ()) -> None:
        self.network = network
        own, inner = NetworkEquations(network, held), NetworkEquations(network, free)
        self.nodes = len(network.nodes)
        self.states = inner.states
        names, wanted = _names(own), _names(inner)
        self._width = len(names)
        take = np.array([names.index(n) if n in names else -1 for n in wanted])
        self._there, self._take = take >= 0, np.maximum(take, 0)
        self._give = np.array([wanted.index(n) for n in names])
        same = [d.element for d in own.delays] == [d.element for d in inner.delays]
        lines = delay_layout(own)
        self._lines, self._pushed = lines.rows, lines.pushed
        self.rows = self._lines if same else 0
        columns = [network.input_columns.index(d.column) for _, d in own.drives if d.dead_time]
        self._columns = np.array(columns, dtype=np.intp)
        times = [p for p in network.parameters.values() if p.name == "dead_time_s"]
        self._longest_s = max((p.upper if p.status == "tunable" else p.value for p in times), default=0.0)
        self._commands = COMMANDS * (1 + len(columns)) if columns else 0
        self.size = self._width + self._lines + self._commands

    @cached_property
    def fastest(self) -> float:
        """Return the spectral radius of the network, 1/s, with its own parameters and inputs at their upper ends."""
        network = self.network
        rhs = define_functions(python_source(network), f"<right side of {network.name}>")["rhs"]
        inputs = np.array([s.upper if np.isfinite(s.upper) else s.nominal for s in network.inputs.values()])
        at = np.full(len(NetworkEquations(network, network.ids).states), AT_C)
        rest = np.array(rhs(at, inputs, network.values))
        ones = np.eye(len(rest), len(at))
        slopes = np.column_stack([np.array(rhs(at + one, inputs, network.values)) - rest for one in ones])
        return float(np.abs(np.linalg.eigvals(slopes)).max()) if np.isfinite(slopes).all() else 0.0

    def split(self, state: Array) -> tuple[Array, Array | None, Array | None]:
        """Return start values (P, inner width), NaN for what is at rest, then delay lines and commands, or None each.

        Raises
        ------
        TwinFileError
            The states have another length.
        """
        if state.shape[1] not in (self.nodes, self.size):
            raise TwinFileError(
                f"a state of twin {self.network.name!r} has {self.nodes} temperatures, or {self.size} entries with "
                f"what it remembers; got {state.shape[1]}"
            )
        full = state.shape[1] == self.size
        known = state
        if not full and self._width > self.nodes:
            known = np.full((len(state), self._width), np.nan)
            known[:, : self.nodes] = state
        start = np.where(self._there, known[:, self._take], np.nan)
        at = self._width
        past = state[:, at : at + self.rows] if full and self.rows else None
        at += self._lines
        commands = state[0, at:] if full and self._commands else None
        return start, past, commands

    def pushed_equally(self, past: Array | None) -> bool:
        """Return True if the same volumes have been pushed through all delay lines (P, rows)."""
        return past is None or len(past) == 1 or not np.ptp(past[:, self._pushed], axis=0).any()

    def join(self, end: Array, lines: Array, commands: Array) -> Array:
        """Return full states (P, size) from a kernel's end values, its delay lines and the recent commands."""
        full = np.zeros((len(end), self.size))
        full[:, : self._width] = end[:, self._give]
        if self.rows:
            full[:, self._width : self._width + self._lines] = lines
        full[:, self._width + self._lines :] = commands
        return full

    def with_history(self, commands: Array | None, time: Array, inputs: Array) -> tuple[Array, Array]:
        """Return time and inputs with the remembered commands put before them."""
        if commands is None:
            return time, inputs
        rows = commands.reshape(COMMANDS, -1)
        rows = rows[np.isfinite(rows[:, 0])]
        if not len(rows):
            return time, inputs
        before = np.tile(inputs[0], (len(rows), 1))
        before[:, self._columns] = rows[:, 1:]
        return np.concatenate([time[0] + rows[:, 0], time]), np.vstack([before, inputs])

    def recent_commands(self, time: Array, inputs: Array) -> Array:
        """Return the latest values of the commands with a dead time, flat: their age (<= 0, s) and values.

        They are the changes, or means where more of those may still arrive than are remembered: a measured input
        changes with every sample.
        """
        if not self._commands:
            return np.empty(0)
        values = inputs[:, self._columns]
        change = np.concatenate([[True], (np.diff(values, axis=0) != 0.0).any(axis=1)])
        change[-1] = False
        begins, values = time[change], values[change]
        if len(begins) > COMMANDS and begins[-COMMANDS] > time[-1] - self._longest_s:
            begins, values = self._means(begins, values, float(time[-1]))
        begins, values = begins[-COMMANDS:], values[-COMMANDS:]
        rows = np.full((COMMANDS, 1 + len(self._columns)), np.nan)
        if len(begins):
            rows[-len(begins) :] = np.column_stack([begins - time[-1], values])
        return rows.ravel()

    def _means(self, begins: Array, values: Array, end: float) -> tuple[Array, Array]:
        """Return the beginnings of equal intervals up to `end`, and means of held commands in them.

        The intervals lie on one grid for all calls, so that means of means are not smeared further.
        """
        width = self._longest_s / (COMMANDS - 2)
        first = max(width * np.floor((end - self._longest_s) / width), begins[0])
        grid = width * np.arange(np.floor(first / width) + 1, np.ceil(end / width) + 1)
        # An edge that rounding has moved beside another one is the same.
        grid = grid[(grid > first + 1e-6 * width) & (grid < end - 1e-6 * width)]
        edges = np.concatenate([[first], grid, [end]])
        until = np.append(begins, end)
        sums = np.vstack([np.zeros(values.shape[1]), np.cumsum(values * np.diff(until)[:, None], axis=0)])
        at = np.stack([np.interp(edges, until, column) for column in sums.T], axis=1)
        return edges[:-1], np.diff(at, axis=0) / np.diff(edges)[:, None]


def _names(system: NetworkEquations) -> list[str]:
    driven = [f"{name}.arrived" for name, drive in system.drives if drive.lag]
    return [*system.states, *system.lags, *driven, *(f"{name}.{m.name}" for name, m in system.memories)]
