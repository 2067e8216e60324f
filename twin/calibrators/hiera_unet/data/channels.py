"""Channel tables: inputs of the network for each kind of rig.

A channel names a formula and its arguments; `signals` defines the formulas. All values are dimensionless: temperatures
over the twin's own temperature rise, powers over the rated one, residuals over the thermometers' noise on a signed
logarithmic scale. A second kind of rig is a second table here, not another program.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from twin.elements.flow import Flow
from twin.network import Network, TwinFileError

Role = Literal["u", "y", "r", "q", "e"]
"""Role of a channel: inputs and their simulated consequences; readings; residuals; quality; events."""
Kind = Literal["level", "log", "flag"]
ROLES: tuple[Role, ...] = ("u", "y", "r", "q", "e")


@dataclass(frozen=True)
class RigChannel:
    """One column of the network's input.

    Attributes:
        group: channels of a group are embedded together. unit: of the quantity before normalisation. kind: `log` for a
            signed logarithmic scale. tolerance: a small change, in the channel's own scale.
        formula, of: signal and its arguments (`signals`).
    """

    name: str
    group: str
    unit: str
    kind: Kind
    role: Role
    tolerance: float
    formula: str
    of: tuple[str, ...] = ()


@dataclass(frozen=True)
class ChannelTable:
    """Channels in the order of their groups. `figures`: names of the rig's own numbers among the static tokens."""

    name: str
    channels: tuple[RigChannel, ...]
    figures: tuple[tuple[str, ...], ...] = ()
    extra: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.channels)

    @cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(c.name for c in self.channels)

    @cached_property
    def groups(self) -> dict[str, int]:
        """Return group -> number of channels, in order."""
        sizes: dict[str, int] = {}
        for channel in self.channels:
            sizes[channel.group] = sizes.get(channel.group, 0) + 1
        return sizes

    def indices(self, *roles: Role) -> np.ndarray:
        """Return the positions of the channels of these roles."""
        return np.array([k for k, c in enumerate(self.channels) if c.role in roles], dtype=np.intp)

    @cached_property
    def digest(self) -> str:
        """Return the SHA-256 of the table, which identifies the table that a network was trained with."""
        return hashlib.sha256(json.dumps(asdict(self), sort_keys=True).encode()).hexdigest()


def loop(network: Network) -> ChannelTable:
    """Return the coolant loop's table, for a twin of one closed path with a heater, a pump and fans.

    Raises:
        TwinFileError: the twin is not such a loop.
    """
    columns = network.input_columns
    heater, pump, fan, room = (_one(network, columns, start) for start in ("heater", "pump", "fan", "T_amb"))
    flow = next((e for e in network.elements if isinstance(e, Flow)), None)
    if flow is None:
        raise TwinFileError(f"twin {network.name!r} has no flow path, so the loop's channel table does not fit it")
    sensors = network.sensor_names
    read = {s.node: s.name for s in reversed(network.sensors)}
    path = [read[node] for node in flow.path if node in read]
    found: list[RigChannel] = []

    def add(group: str, role: Role, unit: str, kind: Kind, tolerance: float, formula: str, *of: str) -> None:
        found.append(RigChannel("_".join((formula, *of)), group, unit, kind, role, tolerance, formula, of))

    add("ambient", "u", "K", "level", 0.02, "level", room)
    add("ambient", "u", "K", "level", 0.02, "quick", room, "300")
    add("ambient", "u", "K", "level", 0.02, "quick", room, "3600")
    add("ambient", "q", "s", "log", 0.1, "stale", room)
    for column, slow in ((pump, "600"), (fan, "600")):
        add("hydraulic", "u", "%", "level", 0.01, "level", column)
        add("hydraulic", "u", "%", "level", 0.01, "quick", column, slow)
    add("hydraulic", "u", "L/min", "level", 0.01, "measured", "flow_L_per_min")
    add("hydraulic", "u", "L/min", "log", 0.1, "flow_gap", "flow_L_per_min", flow.name)
    for sensor in sensors:
        add("thermal", "y", "K", "level", 0.02, "reading", sensor)
    for sensor in sensors:
        add("thermal", "y", "K", "log", 0.1, "rate", sensor)
    for before, after in zip((path[-1], *path[:-1]), path, strict=True):
        add("thermal", "y", "K", "level", 0.02, "drop", before, after)
    for sensor in sensors:
        add("thermal", "u", "K", "level", 0.02, "base", sensor)
    for sensor in sensors:
        add("thermal", "r", "K", "log", 0.1, "residual", sensor)
    for sensor in sensors:
        add("thermal", "r", "K", "log", 0.1, "fitted", sensor)
    add("electrical", "u", "W", "level", 0.01, "level", heater)
    for slow in ("120", "600", "3600"):
        add("electrical", "u", "W", "level", 0.01, "quick", heater, slow)
    for node in network.nodes:
        add("electrical", "r", "W", "log", 0.1, "balance", node)
    add("electrical", "r", "W", "log", 0.1, "balance", "all")
    for sensor in sensors:
        add("quality", "q", "s", "log", 0.1, "stale", sensor)
    for sensor in sensors:
        add("quality", "q", "s", "log", 0.1, "flat", sensor)
    for several in network.sensors:
        if len(several.measured) > 1:
            add("quality", "q", "K", "log", 0.1, "spread", several.name)
    for column in (heater, pump, fan):
        add("event", "e", "", "log", 0.1, "step", column)
        add("event", "e", "s", "log", 0.1, "since", column)
    add("event", "e", "s", "log", 0.1, "age")
    figures = (
        ("power_over_flow",),
        ("rejection_over_flow",),
        *(("time_constant", node) for node in network.nodes),
        ("loss_over_flow",),
    )
    return ChannelTable("loop", tuple(found), figures, ("flow_L_per_min",))


TABLES: dict[str, Callable[[Network], ChannelTable]] = {"loop": loop}
"""Kind of rig -> its table."""


def table(network: Network) -> ChannelTable:
    """Return the first table that fits a twin.

    Raises:
        TwinFileError: none does; the message gives the reason of the last one.
    """
    why = ""
    for make in TABLES.values():
        try:
            return make(network)
        except TwinFileError as error:
            why = str(error)
    raise TwinFileError(why)


def _one(network: Network, columns: tuple[str, ...], start: str) -> str:
    found = [c for c in columns if c.startswith(start)]
    if not found:
        raise TwinFileError(
            f"twin {network.name!r} has no input that begins with {start!r}; the loop's channel table does not fit it"
        )
    return found[0]
