"""Free simulation of a twin with effects as real elements, each with its time course."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin.discovery.effects.probe import Probe
from twin.discovery.effects.shapes import Shape
from twin.discovery.effects.shared_kernels import injection
from twin.discovery.scoring.score_tests import block_edges
from twin.discovery.scoring.search import Entry
from twin.elements.candidates import Candidate
from twin.kernel import FEW_LANES, Kernel
from twin.network import Array, Network
from twin.segments import restarted_states, segment_rows

SETTLE_S, FIRST_ROWS, STATE_STEP_K = 900.0, 6, 1.0e-2
"""Readings at a segment's beginning, s, that determine its temperatures, those of a first guess, and the derivative's
step, K."""
FADED = (0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 4.0, 5.0, 7.0)
"""Times after which a decaying pulse gets a new constant value, in its time constants, until a thousandth is left."""
PIECE, READ_PIECE = 1.0, 0.5
"""Time for which a growing effect is held constant, in blocks of the record, whose means are what a fit compares. The
staircase of a reading error moves a block's mean by at most a sixteenth of the rise in a block, apart from rounding to
bins. A volume smooths that of heat, which may be twice as coarse."""


@dataclass(frozen=True)
class Model:
    """Network `network`: the `original` with the neutral elements of `entries`, and the kernel that simulates it.

    The network may hold other effects, which stay neutral.
    """

    original: Network
    network: Network
    entries: tuple[Entry, ...]
    kernel: Kernel

    @classmethod
    def of(cls, probe: Probe, entries: tuple[Entry, ...]) -> Model:
        """Return the model of these effects in a probe's network, with free tunables; most share a compiled kernel.

        Raises:
            TwinFileError: an element does not fit.
        """
        shared = probe.kernels.holding(tuple(e.candidate for e in entries))
        if shared is None:
            return cls.alone(probe, entries)
        return cls(probe.network, shared.network, entries, shared.kernel)

    @classmethod
    def alone(cls, probe: Probe, entries: tuple[Entry, ...]) -> Model:
        """Return the same with these effects and no others in it.

        Raises:
            TwinFileError: an element does not fit.
        """
        # In one order, so that a pair named the other way round is the same kernel.
        own = probe.kernels.of_these(tuple(sorted((e.candidate for e in entries), key=lambda c: c.id)))
        return cls(probe.network, own.network, entries, own.kernel)

    @cached_property
    def _here(self) -> np.ndarray:
        """Return the positions of the original network's parameters."""
        return self.network.index(self.original.ids)

    @cached_property
    def _masses(self) -> list[tuple[int, int, int, str]]:
        """Return the effects with a temperature of their own: effect, its index in a full state, its node, and the
        input of its initial temperature, if any.
        """
        names = self.kernel.states
        found = []
        for i, entry in enumerate(self.entries):
            for element in self.network.elements:
                own = [k for k, name in enumerate(names) if name.startswith(f"{element.name}.")]
                if element.name in entry.candidate.adds and own:
                    node = self.network.nodes.index(element.nodes()[0])
                    found.append((i, own[0], node, entry.candidate.begins))
        return found

    @cached_property
    def _shared(self) -> list[tuple[int, int]]:
        """Return the parameters that equal another one."""
        return [(self._places[p.id], self._places[p.same_as]) for p in self.network.parameters.values() if p.same_as]

    def parameters(self, values: Array, sizes: Array) -> Array:
        """Return full parameter vectors (P, p) of the larger network.

        Args:
            values: (P, p) of the original network. sizes: (P, e).
        """
        out = np.tile(self.network.values, (len(values), 1))
        out[:, self._here] = values
        slots = dict(self._injected)
        for j, entry in enumerate(self.entries):
            if j in slots:
                for node in entry.candidate.injects:
                    out[:, self._places[f"{injection(slots[j], node)}.gain"]] = sizes[:, j]
            elif not set(entry.candidate.adds) - {e.name for e in self.network.elements}:
                self._enter(entry.candidate, out, sizes[:, j])
        for k, other in self._shared:
            out[:, k] = out[:, other]
        return out

    @cached_property
    def _places(self) -> dict[str, int]:
        """Return the position of each parameter of the larger network."""
        return {name: i for i, name in enumerate(self.network.ids)}

    def _enter(self, candidate: Candidate, rows: Array, sizes: Array) -> None:
        """Enter a candidate's sizes (P,) into full parameter vectors (P, p), within the parameters' bounds."""
        for name, weight in candidate.changes.items():
            p, k = self.network.parameters[name], self._places[name]
            if candidate.inverse:
                value = np.where(sizes > weight / p.upper, weight / np.maximum(sizes, weight / p.upper), p.upper)
            else:
                value = rows[:, k] + weight * sizes
            rows[:, k] = np.clip(value, p.lower, p.upper)

    def run(
        self,
        time: Array,
        inputs: Array,
        state: Array,
        values: Array,
        sizes: Array,
        shapes: tuple[tuple[Shape, ...], ...] | None = None,
        begins: tuple[int, ...] = (0,),
    ) -> Array:
        """Return the readings (P, n, m), degC, of free runs.

        Args:
            state: (P, s * k), degC, at the first sample of each segment. values: (P, p) of the original network.
            sizes: (P, e). shapes: (P, e) time courses of the effects, by default those of the entries.
            begins: (s,) rows at which segments begin.
        """
        given, inputs = inputs, self.driven(time, inputs)
        since = time - time[0]
        each = shapes or tuple(tuple(e.shape for e in self.entries) for _ in range(len(values)))
        all_shapes = {s for row in each for s in row}
        read = any(e.candidate.kind == "sensor" for e in self.entries)
        block_s = float(since[-1]) / (len(block_edges(len(time))) - 1)
        cuts = np.union1d(_cuts(since, all_shapes, (READ_PIECE if read else PIECE) * block_s), begins)
        edges = np.append(since[cuts[:-1]], since[-1])
        edges[-1] = max(edges[-1], edges[-2] + 1e-3)
        course = {s: s.entered.block_means(edges) for s in all_shapes}
        sized = np.array([[course[s] for s in row] for row in each]).reshape(
            len(values), len(self.entries), len(cuts) - 1
        )
        there = np.ascontiguousarray(np.moveaxis(sized, 2, 0))
        full = self.parameters(np.tile(values, (len(there), 1)), np.concatenate(sizes * there))
        full = full.reshape(len(there), len(values), -1)
        comes = np.diff(there >= 0.5, axis=0, prepend=there[:1] >= 0.5) & (there >= 0.5)
        anew = {int(p) for effect, *_ in self._masses for p in np.flatnonzero(comes[:, :, effect].any(axis=1))}
        legs = [p for p, first in enumerate(cuts[:-1].tolist()) if p in anew or first in begins]
        readings = np.empty((len(values), len(time), len(self.network.sensors)))
        begun = state.reshape(len(state), len(begins), -1)
        for leg, then in itertools.pairwise([*legs, len(there)]):
            first, last = int(cuts[leg]), int(cuts[then])
            if first == 0:
                state = np.ascontiguousarray(begun[:, 0])
            elif first in begins:
                state = restarted_states(state, begun[:, begins.index(first)])
            for effect, mass, node, column in self._masses if first else ():
                # A mass that comes in now has had the time to be as warm as what it stands beside, or is cold. A little
                # of it is there before, where it comes in between two samples.
                new = (there[leg - 1, :, effect] < 0.5) & (there[leg, :, effect] >= 0.5)
                room = inputs[first, self.network.input_columns.index(column)] if column else None
                state[new, mass] = state[new, node] if room is None else room
            part = slice(first, last + 1)
            cut = (cuts[leg:then] - first).tolist()
            found, state = self.kernel.trace_pieces(full[leg:then], state, time[part], inputs[part], cut, FEW_LANES)
            readings[:, first:last] = found[:, : last - first]
        self.read(readings, time, given, sizes, sized, cuts)
        return readings

    @cached_property
    def _injected(self) -> tuple[tuple[int, int], ...]:
        """Return the effects that are open laws of heat in a shared kernel, and their slots there."""
        shared = injection(0, self.network.nodes[0]) in {e.name for e in self.network.elements}
        heats = [i for i, e in enumerate(self.entries) if e.candidate.injects] if shared else []
        return tuple((i, slot) for slot, i in enumerate(heats))

    def driven(self, time: Array, inputs: Array) -> Array:
        """Return inputs (n, c) with the values of open laws in their elements' columns."""
        more = self.network.input_columns[inputs.shape[1] :]
        if not more:
            return inputs
        slots = dict(self._injected)
        values: dict[str, Array] = {}
        for i, entry in enumerate(self.entries):
            c = entry.candidate
            if c.follows is None:
                continue
            course = c.follows(time, inputs)
            values[c.column] = course
            if i in slots:
                values |= {f"{injection(slots[i], node)}_W": weight * course for node, weight in c.injects.items()}
        nothing = np.zeros(len(inputs))
        return np.ascontiguousarray(np.column_stack([inputs, *(values.get(column, nothing) for column in more)]))

    def read(self, readings: Array, time: Array, inputs: Array, sizes: Array, course: Array, cuts: np.ndarray) -> None:
        """Add the reading errors of open laws in a shared kernel to the readings (P, n, m).

        Args:
            sizes: (P, e). course: (P, e, pieces), between `cuts`.
        """
        names = {e.name for e in self.network.elements}
        for i, entry in enumerate(self.entries):
            c = entry.candidate
            if not c.reads or c.follows is None or not names.isdisjoint(c.adds):
                continue
            amount = np.repeat(sizes[:, i, None] * course[:, i], np.diff(cuts), axis=1) * c.follows(time, inputs)
            for sensor, weight in c.reads.items():
                readings[:, :, self.original.sensor_names.index(sensor)] += weight * amount

    def begun(
        self,
        time: Array,
        inputs: Array,
        measured: Array,
        state: Array,
        values: Array,
        begins: tuple[int, ...],
    ) -> Array:
        """Return the state (s * k,), degC, at the beginnings of all segments of a record, of which a fit has the first
        ones.

        The state of a held-out segment follows from the readings of its first quarter of an hour, with fixed parameters
        and sizes, as at the record's beginning.

        Args:
            measured: (n, m) degC. state: (t * k,) of the first t segments. values: (p,) of the original network.
        """
        k, sizes = len(self.original.nodes), np.array([[e.size for e in self.entries]])
        if len(state) >= len(begins) * k:
            return state[: len(begins) * k]
        later = segment_rows(begins, len(time))[len(state) // k :]
        settling = [slice(r.start, int(np.searchsorted(time[r], time[r.start] + SETTLE_S)) + r.start) for r in later]
        guess = np.concatenate([self.original.initial_state(measured[r][:FIRST_ROWS]) for r in settling])
        rows = np.tile(np.concatenate([state, guess]), (1 + k, 1))
        rows[1:, len(state) :] += STATE_STEP_K * np.tile(np.eye(k), len(later))
        count = len(rows)
        readings = self.run(time, inputs, rows, np.tile(values, (count, 1)), np.tile(sizes, (count, 1)), begins=begins)
        for i, r in enumerate(settling):
            good = np.isfinite(measured[r])
            off = np.where(good, (measured[r] - readings[0, r]) / self.original.sigma, 0.0).ravel()
            slopes = np.moveaxis(readings[1:, r] - readings[0, r], 0, 2) / STATE_STEP_K
            slopes = np.where(good[..., None], slopes / self.original.sigma[:, None], 0.0).reshape(-1, k)
            step = np.linalg.solve(slopes.T @ slopes + np.eye(k), slopes.T @ off)
            guess[i * k : (i + 1) * k] += step
        return np.concatenate([state, guess])


def _cuts(since: Array, shapes: set[Shape], piece: float) -> np.ndarray:
    """Return the rows (c,) at which sizes change, and the end; a growing effect changes every `piece` s."""
    borders = {0.0}
    sudden: set[float] = set()
    for shape in shapes:
        borders.add(min(shape.onset_s, float(since[-1])))
        if shape.name == "transient":
            borders.add(min(shape.onset_s + shape.growth_s, float(since[-1])))
        if shape.name in ("step", "transient", "pulse"):
            sudden.add(shape.onset_s)
        if shape.name in ("transient", "pulse"):
            sudden.add(shape.onset_s + shape.growth_s)
        if shape.name == "periodic":
            first = shape.onset_s - shape.into_s
            turns = np.arange(first, since[-1], max(shape.growth_s, piece))
            borders.update([*turns[turns > 0.0].tolist(), *(turns + shape.duty * shape.growth_s).tolist()])
        if shape.name == "pulse":
            borders.update(min(shape.onset_s + shape.growth_s * f, float(since[-1])) for f in FADED)
        if shape.grows or shape.name == "pulse":
            borders.update(np.arange(piece * np.ceil(shape.onset_s / piece), since[-1], piece).tolist())
    # What begins or ends at once does so amid a sample, of which it has the share that it is there: the squares of a
    # fit are no staircase in its onset.
    amid = np.maximum(np.searchsorted(since, sorted(sudden)) - 1, 0)
    cuts = np.unique(np.concatenate([np.searchsorted(since, sorted(borders)), amid.astype(np.intp)]))
    return np.concatenate([cuts[cuts < len(since)], [len(since)]])
