"""A twin: nodes and elements with their parameters, validated and frozen."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.column_names import column_hint
from twin.elements import Element, Parameter
from twin.elements.base import STAMP as STAMP
from twin.elements.meter import USUAL_K, Meter
from twin.elements.node import Node
from twin.elements.sensor import Sensor

Array = NDArray[np.float64]


class TwinFileError(ValueError):
    """A twin file or a change to a twin that cannot be used; the message is one plain sentence."""


@dataclass(frozen=True)
class InputSpec:
    """A driver column: its value until the first good sample, and the range for which it is declared."""

    column: str
    nominal: float
    lower: float
    upper: float
    unit: str = ""
    source: str = ""


@dataclass(frozen=True)
class TunableSet:
    """A named vector of tunables, with the swarm's normalised units where the file gives them.

    physical value = scale * normalised position. ``initial`` is the range of normalised positions in which a
    swarm starts, ``bounds`` the box in normalised units.
    """

    name: str
    members: tuple[str, ...]
    scale: tuple[float, ...]
    initial: tuple[tuple[float, float], ...]
    bounds: tuple[float, float] | None = None
    source: str = ""


@dataclass(frozen=True)
class WindowRules:
    """Thresholds that decide when a window is complete and of which kind it is (see docs/decisions/0003)."""

    window_s: float = 600.0
    first_s: float = 60.0
    calibrated_K: float = 0.1
    large_K: float = 0.5


@dataclass(frozen=True)
class Revision:
    """The origin of a twin file, and its evidence.

    Attributes
    ----------
    number
        Counts up within a family of files; 0 for a twin without a parent.
    parent, parent_file
        SHA-256 of the text of the parent's file, "" without one; it alone identifies the parent. The second is the name
        that the file had, for messages.
    window_s, held_out_s
        The fitted segment of the record, and the segment, never fitted, to which the errors belong.
    error_before_K, error_after_K, error_fitted_K
        Sensor -> RMSE of a free run in K: over the held-out segment before and after, and over the fitted segment.
    record, record_file
        SHA-256 of the file with the healthy record, "" without one, and its name beside the twin file.
    effects
        What was added or altered, one phrase each.
    evidence
        The reason, in one sentence.
    checksum
        SHA-256 of the file's text without this line; `twin.twinfile.save` enters it.
    """

    number: int = 0
    parent: str = ""
    made_by: str = ""
    window_s: tuple[float, float] | None = None
    error_before_K: Mapping[str, float] = field(default_factory=dict)
    error_after_K: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    held_out_s: tuple[float, float] | None = None
    effects: tuple[str, ...] = ()
    evidence: str = ""
    parent_file: str = ""
    error_fitted_K: Mapping[str, float] = field(default_factory=dict)
    record: str = ""
    record_file: str = ""
    checksum: str = field(default="", compare=False)


@dataclass(frozen=True)
class Network:
    """A validated thermal network; `load` or `parse` of `twin.twinfile` build it, nothing else.

    Attributes
    ----------
    elements
        Every element, nodes first, in file order.
    parameters
        Id ("element.parameter") -> Parameter, in element order.
    inputs
        Input column -> InputSpec.
    sets
        Name -> TunableSet.
    digest
        SHA-256 of the file's text, "" for a network that was not read from a file.
    """

    name: str
    title: str
    elements: tuple[Element, ...]
    parameters: Mapping[str, Parameter]
    inputs: Mapping[str, InputSpec]
    sets: Mapping[str, TunableSet]
    rules: WindowRules = WindowRules()
    revision: Revision = Revision()
    digest: str = ""

    @cached_property
    def nodes(self) -> tuple[str, ...]:
        """Return the node names; the order of every state vector."""
        return tuple(e.name for e in self.elements if isinstance(e, Node))

    @cached_property
    def sensors(self) -> tuple[Sensor, ...]:
        """Return the thermometers, in file order."""
        return tuple(e for e in self.elements if isinstance(e, Sensor))

    @cached_property
    def instruments(self) -> tuple[Sensor | Meter, ...]:
        """Return thermometers and meters, in file order: the columns of every measured array."""
        return tuple(e for e in self.elements if isinstance(e, Sensor | Meter))

    @cached_property
    def meters(self) -> tuple[Meter, ...]:
        """Return the meters, in file order."""
        return tuple(e for e in self.instruments if isinstance(e, Meter))

    @cached_property
    def sensor_names(self) -> tuple[str, ...]:
        """Return the names of thermometers and meters; the order of every measured array."""
        return tuple(s.name for s in self.instruments)

    @cached_property
    def input_columns(self) -> tuple[str, ...]:
        """Return the input columns; the order of every input array."""
        return tuple(self.inputs)

    @cached_property
    def room(self) -> str:
        """Return the input column that most elements name as ambient, else the first T_amb..., or "".

        A conductance leads to a medium of any kind, such as cooling water. It names the room where nothing else does.
        """
        named = [(e.kind == "law_conductance", str(getattr(e, "ambient", ""))) for e in self.elements]
        most = sorted(Counter(named).items(), key=lambda each: (each[0][0], -each[1]))
        known = [column for (_, column), _ in most if column in self.inputs]
        return next((c for c in (*known, *self.inputs) if c in known or c.startswith("T_amb")), "")

    @cached_property
    def recorded_inputs(self) -> tuple[str, ...]:
        """Return the input columns that a record must have: all but the stamps, which the kernels fill."""
        return tuple(c for c in self.inputs if c != STAMP)

    @cached_property
    def sensor_columns(self) -> Mapping[str, tuple[str, ...]]:
        """Return, per thermometer and meter, the measured columns that it averages."""
        return MappingProxyType({s.name: s.measured for s in self.instruments})

    @cached_property
    def sigma(self) -> Array:
        """Return the noise of each reading (m,), K or its own unit: one instrument's over the root of their number."""
        return np.array([self.parameters[f"{s.name}.sigma"].value / np.sqrt(len(s.measured)) for s in self.instruments])

    @cached_property
    def kelvin_per_unit(self) -> Array:
        """Return the weight (m,) of a reading's unit where errors are stated as one number in K: 1 for a thermometer.

        One sigma of a meter counts as much as one sigma of a usual thermometer.
        """
        return np.array(
            [
                USUAL_K / self.parameters[f"{s.name}.sigma"].value if isinstance(s, Meter) else 1.0
                for s in self.instruments
            ]
        )

    @cached_property
    def ids(self) -> tuple[str, ...]:
        """Return the parameter ids; the order of every full parameter vector."""
        return tuple(self.parameters)

    @cached_property
    def values(self) -> Array:
        """Return the full parameter vector (p,) in the parameters' own units."""
        values = np.array([p.value for p in self.parameters.values()])
        values.flags.writeable = False
        return values

    @cached_property
    def nominal_inputs(self) -> Array:
        """Return the nominal value of each input (c,), in its own unit."""
        return np.array([spec.nominal for spec in self.inputs.values()])

    def index(self, ids: Iterable[str]) -> NDArray[np.intp]:
        """Return the positions of parameter ids in the full vector.

        Raises
        ------
        TwinFileError
            An id is unknown.
        """
        where = {name: k for k, name in enumerate(self.ids)}
        wanted = list(ids)
        for name in wanted:
            if name not in where:
                raise TwinFileError(f"twin {self.name!r} has no parameter {name!r}{did_you_mean(name, where)}")
        return np.array([where[name] for name in wanted], dtype=np.intp)

    def tunables(self, which: str | Iterable[str] | None = None) -> tuple[str, ...]:
        """Return the parameter ids of a named set, of a list of ids, or (None) all of status tunable.

        Raises
        ------
        TwinFileError
            There is no such set or parameter.
        """
        if which is None:
            return tuple(p.id for p in self.parameters.values() if p.status == "tunable")
        if isinstance(which, str):
            if which not in self.sets:
                known = ", ".join(self.sets) or "none"
                raise TwinFileError(f"twin {self.name!r} has no set of tunables {which!r}; it has: {known}")
            return self.sets[which].members
        ids = tuple(which)
        self.index(ids)
        return ids

    def bounds(self, ids: Iterable[str]) -> tuple[Array, Array]:
        """Return lower and upper physical bounds of the named parameters, each (k,)."""
        chosen = [self.parameters[name] for name in ids]
        return np.array([p.lower for p in chosen]), np.array([p.upper for p in chosen])

    def with_values(self, values: Mapping[str, float], revision: Revision | None = None) -> Network:
        """Return the same network with other parameter values; this one stays unchanged.

        Parameters
        ----------
        values
            Parameter id -> value in the parameter's unit.
        revision
            Origin of the new values; the present revision by default.

        Raises
        ------
        TwinFileError
            An id is unknown, or a value is not finite or out of bounds.
        """
        self.index(values)
        changed = dict(self.parameters)
        for name, value in values.items():
            p = changed[name]
            if not p.lower <= value <= p.upper:
                raise TwinFileError(
                    f"{name} = {value:g} {p.unit} is outside [{p.lower:g}, {p.upper:g}] of twin {self.name!r}"
                )
            if p.same_as:
                raise TwinFileError(f"{name} of twin {self.name!r} is the same as {p.same_as}; change that one")
            changed[name] = replace(p, value=float(value))
        for p in self.parameters.values():
            if p.same_as:
                changed[p.id] = replace(p, value=changed[p.same_as].value)
        return replace(self, parameters=MappingProxyType(changed), revision=revision or self.revision, digest="")

    def select(self, columns: Mapping[str, ArrayLike]) -> tuple[Array, Array]:
        """Select inputs (N, c) and measured (N, m) from a record's columns.

        A sensor of several thermometers is the mean of those that are finite at that sample (`mean_of_sensors`).
        NaN and infinite values become NaN: the simulation holds the last good input, the fit masks the measurement. A
        sensor without a column (`unread`) is NaN throughout. The column of stamps (`STAMP`) may be absent: the kernels
        fill it.

        Parameters
        ----------
        columns
            Column name -> values (N,), temperatures in degC.

        Raises
        ------
        TwinFileError
            An input column is missing, more than half of the sensors are, or columns differ in length.
        """
        missing = [c for c in self.recorded_inputs if c not in columns]
        unread = self.unread(columns)
        if missing or 2 * len(unread) > len(self.instruments):
            missing += unread
            wanted = {*self.input_columns, *(c for s in self.instruments for c in s.measured)}
            others = [c for c in columns if c not in wanted]
            hints = [f"for {c}, {text}" for c in missing if (text := column_hint(c, others))]
            raise TwinFileError(
                f"the record lacks {', '.join(missing)}, which twin {self.name!r} needs; "
                + ("; ".join(hints) or "rename the columns of the record or the keys of the twin file")
            )
        taken: dict[str, Array] = {}
        for c in (*self.input_columns, *(c for s in self.instruments for c in s.measured)):
            if c in columns:
                taken[c] = np.asarray(columns[c], dtype=np.float64)
        if len({a.shape for a in taken.values()}) > 1:
            lengths = ", ".join(f"{c}: {a.size}" for c, a in taken.items())
            raise TwinFileError(f"the columns of the record differ in length ({lengths})")
        no_stamps = np.full(next(iter(taken.values())).size, np.nan)
        inputs = _finite(np.column_stack([taken.get(c, no_stamps) for c in self.input_columns]))
        measured = np.full((len(inputs), len(self.instruments)), np.nan)
        for j, sensor in enumerate(self.instruments):
            if read := [taken[c] for c in sensor.measured if c in taken]:
                measured[:, j] = mean_of_sensors(_finite(np.column_stack(read)))
        return inputs, measured

    def unread(self, columns: Iterable[str]) -> tuple[str, ...]:
        """Return the columns of the sensors for which a record with these columns has no thermometer."""
        there = set(columns)
        return tuple(c for s in self.instruments if there.isdisjoint(s.measured) for c in s.measured)

    def initial_state(self, measured: ArrayLike) -> Array:
        """Return the state (k,) at the first sample: the mean of each node's finite readings in the rows of `measured`.

        A node without a finite reading gets the mean of the others. Without any reading it gets the nominal room
        temperature (20 degC where the twin has no such input).

        Parameters
        ----------
        measured
            (n, m) or (m,), degC; a few rows at the start of a record.
        """
        rows = np.atleast_2d(np.asarray(measured, dtype=np.float64))
        per_sensor = _mean_of_finite(_finite(rows).T)
        state = np.full(len(self.nodes), np.nan)
        for j, sensor in enumerate(self.instruments):
            if isinstance(sensor, Meter):
                continue
            k = self.nodes.index(sensor.node)
            if np.isfinite(per_sensor[j]) and np.isnan(state[k]):
                state[k] = per_sensor[j]
        known = state[np.isfinite(state)]
        fallback = known.mean() if known.size else self._room()
        return np.where(np.isfinite(state), state, fallback)

    def _room(self) -> float:
        return self.inputs[self.room].nominal if self.room else 20.0


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return "; did you mean 'x'?" for the nearest known word, or an empty string."""
    import difflib

    near = difflib.get_close_matches(word, list(known), n=1, cutoff=0.6)
    return f"; did you mean {near[0]!r}?" if near else ""


def digest(text: str) -> str:
    """Return the SHA-256 of a twin file's text, hexadecimal."""
    return hashlib.sha256(text.encode()).hexdigest()


def _finite(a: Array) -> Array:
    return np.where(np.isfinite(a), a, np.nan)


def _mean_of_finite(a: Array) -> Array:
    """Return row means over finite entries, NaN for a row without any (np.nanmean warns there)."""
    good = np.isfinite(a)
    count = good.sum(axis=1)
    total = np.where(good, a, 0.0).sum(axis=1)
    mean: Array = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return mean


def mean_of_sensors(each: Array) -> Array:
    """Return means (N,) of thermometers (N, c) in one place, NaN where none is finite.

    The mean does not jump where one thermometer drops out: each is first corrected by its usual difference to the mean
    of all. That is the median over the samples in which all are finite, since one that is about to fail may read
    anything.
    """
    whole = np.isfinite(each).all(axis=1)
    if whole.all() or not whole.any():
        return _mean_of_finite(each)
    return _mean_of_finite(each - np.median(each[whole] - each[whole].mean(axis=1, keepdims=True), axis=0))


def frozen_mapping(items: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a read-only copy of a mapping."""
    return MappingProxyType(dict(items))
