"""Network to source text: one fused kernel over lanes, in three variants.

``cost``   squared, noise-weighted residuals summed per sensor: nothing is stored but the sums
``trace``  readings of every sensor at every sample, for plots, oracles and the live twin
``gram``   Gram matrix of lane differences: J'J and J'r of a least-squares fit without storing trajectories

A linear network is integrated by the Taylor series of its exact solution, any other by classical Runge-Kutta.

Layout: particles come in blocks of LANES. A block's state, parameters and per-interval coefficients live in one
flat work array, row r of lane l at ``W[r * LANES + l]``; the only inner loop runs over l and holds all
stages, so that the compiler turns it into vector instructions. The row offsets are literals, which is what
lets it prove that rows do not overlap.

Inputs are held from one sample to the next (zero-order hold). Each interval is cut into as many equal substeps
as keep  substep * (largest conductance at a node / its capacitance)  below STEP_LIMIT, with the largest taken
over the lanes of the block: that keeps the error of a cooling loop below 1e-6 K, and every corner of the
declared bounds stable.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

from twin.elements import Fragment, Names
from twin.network import Network

LANES = 32
ORDER = 5
"""Order of the Taylor series for linear networks."""
STEP_LIMIT = 0.2
MOST_STEPS = 1.0e6
"""Substeps in one sample interval, at most."""
Mode = Literal["cost", "trace", "gram"]
MODES: tuple[Mode, ...] = ("cost", "trace", "gram")

_TOKEN = re.compile(r"<([PTUL]):([^>]+)>")

_EXP = '''
def exp(x):
    """exp(x) by halving, a Taylor polynomial and squaring: no call, so the lane loop stays vectorised."""
    y = min(max(x, -60.0), 60.0) * 0.00390625
    y = 1.0 + y * (1.0 + y * (0.5 + y * (1.0 / 6.0 + y * (1.0 / 24.0 + y * (1.0 / 120.0 + y / 720.0)))))
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    return y * y
'''


@dataclass(frozen=True)
class Fragments:
    """Fragments of a network's elements and what the kernel needs to know about them."""

    network: Network
    parts: tuple[tuple[str, Fragment], ...]

    @classmethod
    def of(cls, network: Network, free: tuple[str, ...] | None = None) -> Fragments:
        """Emit every element. With `free` given, fixed parameters at exactly 0 or 1 outside it are folded."""
        folded: dict[str, float] = {}
        if free is not None:
            folded = {
                p.id: p.value
                for p in network.parameters.values()
                if p.status == "fixed" and p.value in (0.0, 1.0) and p.id not in free
            }
        parts = []
        for e in network.elements:
            own = {name[len(e.name) + 1 :]: v for name, v in folded.items() if name.startswith(f"{e.name}.")}
            parts.append((e.name, e.emit(Names(e.name, own))))
        return cls(network, tuple(parts))

    def heat(self, node: str) -> str:
        """Sum of the heat flows into a node, W."""
        return " + ".join(f"({f.heat[node]})" for _, f in self.parts if node in f.heat) or "0.0"

    def rate(self, node: str) -> str:
        """Bound on the node's own rate times its capacitance, W/K."""
        found = [f"({f.conductance[node]})" for _, f in self.parts if node in f.conductance]
        return " + ".join(found) or "0.0"

    def readings(self) -> list[str]:
        """Expression of each sensor's reading, in the network's order."""
        return [f.observe for _, f in self.parts if f.observe is not None]

    def slow_inputs(self) -> list[str]:
        """Input columns that `uniform` and `sample` expressions use: a change recomputes them."""
        used: set[str] = set()
        for _, f in self.parts:
            for _, text in (*f.uniform, *f.sample):
                used.update(name for sort, name in _TOKEN.findall(text) if sort == "U")
        return [c for c in self.network.input_columns if c in used]


def python_source(network: Network) -> str:
    """Source of ``rhs(T, u, p) -> list of dT/dt`` in plain Python: the reference for tests and oracles."""
    parts = Fragments.of(network)
    text = _Text(network, lambda k: f"p[{k}]", lambda k: f"T[{k}]")
    lines = ["from math import exp, log", "", "", "def rhs(T, u, p):"]
    for level in ("uniform", "sample", "stage"):
        for _, f in parts.parts:
            lines += [f"    {text(name)} = {text(value)}" for name, value in getattr(f, level)]
    rows = [f"({text(parts.heat(node))}) / {text(f'<P:{node}.capacitance>')}" for node in network.nodes]
    lines.append(f"    return [{', '.join(rows)}]")
    return "\n".join(lines) + "\n"


def kernel_source(network: Network, mode: Mode, lane_ids: tuple[str, ...]) -> str:
    """Source of one kernel. `lane_ids` are the parameters that may differ from particle to particle."""
    return _Kernel(network, mode, lane_ids).source()


class _Text:
    """Replaces the placeholders of `Names` by the variables of one target."""

    def __init__(self, network: Network, parameter: object, temperature: object, suffix: str = "") -> None:
        self.parameters = {name: k for k, name in enumerate(network.ids)}
        self.nodes = {name: k for k, name in enumerate(network.nodes)}
        self.inputs = {name: k for k, name in enumerate(network.input_columns)}
        self.parameter, self.temperature, self.suffix = parameter, temperature, suffix
        self.staged: set[str] = set()

    def __call__(self, text: str) -> str:
        return _TOKEN.sub(self._one, text)

    def _one(self, match: re.Match[str]) -> str:
        sort, name = match.groups()
        if sort == "P":
            return str(self.parameter(self.parameters[name]))  # type: ignore[operator]
        if sort == "T":
            return str(self.temperature(self.nodes[name]))  # type: ignore[operator]
        if sort == "U":
            return f"u[{self.inputs[name]}]" if not self.suffix else f"u{self.inputs[name]}"
        local = "L_" + name.replace(".", "_")
        return local + (self.suffix if name in self.staged else "")


class _Kernel:
    def __init__(self, network: Network, mode: Mode, lane_ids: tuple[str, ...]) -> None:
        self.network, self.mode = network, mode
        self.parts = Fragments.of(network, lane_ids)
        self.k, self.m = len(network.nodes), len(self.parts.readings())
        self.lane = {int(i): row for row, i in enumerate(network.index(lane_ids))}
        rows = self.k
        self.parameter_row = {i: rows + row for i, row in self.lane.items()}
        rows += len(self.lane)
        self.sample_names = [name for _, f in self.parts.parts for name, _ in f.sample]
        self.sample_row = {name[3:-1]: rows + r for r, name in enumerate(self.sample_names)}
        rows += len(self.sample_names)
        self.capacity_row = rows
        rows += self.k
        self.sum_row = rows
        rows += self.m
        self.rows = rows
        self.staged = {name[3:-1] for _, f in self.parts.parts for name, _ in f.stage}

    def text(self, stage: str) -> _Text:
        text = _Text(self.network, self._parameter, lambda k: f"x{k}{stage}", stage or "_")
        text.staged = self.staged
        return text

    def _parameter(self, k: int) -> str:
        return f"p{k}"

    def at(self, row: int) -> str:
        return f"W[{row * LANES} + l]"

    def loads(self, body: str) -> list[str]:
        """Lane rows that `body` reads, brought into scalars first."""
        lines = []
        for k, row in self.parameter_row.items():
            if re.search(rf"\bp{k}\b", body):
                lines.append(f"p{k} = {self.at(row)}")
        for name, row in self.sample_row.items():
            local = "L_" + name.replace(".", "_")
            if re.search(rf"\b{local}\b", body):
                lines.append(f"{local} = {self.at(row)}")
        return lines

    def prelude(self) -> list[str]:
        """Body of the lane loop that refreshes per-interval coefficients and the largest rate."""
        text = self.text("")
        lines: list[str] = []
        for _, f in self.parts.parts:
            for name, value in f.sample:
                local = text(name)
                lines += [f"{local} = {text(value)}", f"{self.at(self.sample_row[name[3:-1]])} = {local}"]
        lines.append("rate = 0.0")
        for j, node in enumerate(self.network.nodes):
            lines += [
                f"c{j} = 1.0 / {text(f'<P:{node}.capacitance>')}",
                f"{self.at(self.capacity_row + j)} = c{j}",
                f"rate = max(rate, ({text(self.parts.rate(node))}) * c{j})",
            ]
        lines.append("R[l] = rate")
        body = "\n".join(lines)
        names = {text(name) for name in self.sample_names}
        return [line for line in self.loads(body) if line.split(" = ")[0] not in names] + lines

    def stages(self) -> list[str]:
        """One substep in scalars of one lane; the new state ends in the state rows."""
        lines = self.horner() if all(e.linear for e in self.network.elements) else self.runge_kutta()
        body = "\n".join(lines)
        loaded = [f"x{j} = {self.at(j)}" for j in range(self.k)]
        loaded += [f"c{j} = {self.at(self.capacity_row + j)}" for j in range(self.k)]
        return loaded + self.loads(body) + lines

    def slopes(self, stage: str) -> list[str]:
        """dT/dt of every node at the temperatures x0, x1, .. of a stage, as k0, k1, .. of that stage."""
        text = self.text(stage)
        lines = [f"{text(name)} = {text(value)}" for _, f in self.parts.parts for name, value in f.stage]
        for j, node in enumerate(self.network.nodes):
            lines.append(f"k{j}{stage} = ({text(self.parts.heat(node))}) * c{j}")
        return lines

    def horner(self) -> list[str]:
        """Taylor series of the exact solution, for a right side that is affine and constant in the step.

        x_i = x + h/(s + 1 - i) f(x_(i-1)), i = 1 .. s: of order s, as Horner's scheme of exp.
        """
        k = range(self.k)
        lines = [f"x{j}a = x{j}" for j in k]
        for i in range(ORDER):
            here, then = "abcdefghijkl"[i], "abcdefghijkl"[i + 1]
            lines += self.slopes(here)
            share = "h" if i == ORDER - 1 else f"h{ORDER - i}"
            lines += [f"x{j}{then} = x{j} + {share} * k{j}{here}" for j in k]
        return lines + [f"{self.at(j)} = x{j}{then}" for j in k]

    def runge_kutta(self) -> list[str]:
        """Classical fourth order."""
        k = range(self.k)
        lines = [f"x{j}a = x{j}" for j in k] + self.slopes("a")
        for last, here, share in (("a", "b", "h2"), ("b", "c", "h2"), ("c", "d", "h")):
            lines += [f"x{j}{here} = x{j} + {share} * k{j}{last}" for j in k] + self.slopes(here)
        return lines + [f"{self.at(j)} = x{j} + h6 * (k{j}a + 2.0 * (k{j}b + k{j}c) + k{j}d)" for j in k]

    def observe(self, i: str) -> list[str]:
        """Lines that compare the state at sample `i` with the measurement."""
        text = self.text("")
        readings = [text(reading) for reading in self.parts.readings()]
        body = "\n".join(readings)
        head = [f"x{j} = {self.at(j)}" for j in range(self.k) if re.search(rf"\bx{j}\b", body)]
        head += self.loads(body)
        lines: list[str] = []
        if self.mode == "trace":
            lines = [f"Y[b, {i}, {j}, l] = {reading}" for j, reading in enumerate(readings)]
            return _lanes(head + lines)
        weights = [f"w{j} = weight[{i}, {j}]" for j in range(self.m)]
        if self.mode == "cost":
            for j, reading in enumerate(readings):
                lines += [f"r{j} = (({reading}) - y[{i}, {j}]) * w{j}"]
                lines += [f"{self.at(self.sum_row + j)} += r{j} * r{j}"]
            return weights + _lanes(head + lines)
        lines = [f"E[{j * LANES} + l] = {reading}" for j, reading in enumerate(readings)]
        block = weights + _lanes(head + lines)
        for j in range(self.m):
            inner = [
                f"centre = E[{j * LANES}]",
                "for l in range(LANES):",
                f"    E[{j * LANES} + l] = (E[{j * LANES} + l] - centre) * w{j}",
                f"E[{j * LANES}] = (centre - y[{i}, {j}]) * w{j}",
                "for a in range(used):",
                f"    s = E[{j * LANES} + a]",
                "    for l in range(LANES):",
                f"        G[a * LANES + l] += s * E[{j * LANES} + l]",
                f"sse[b, {j}] += E[{j * LANES}] * E[{j * LANES}]",
            ]
            block += [f"if w{j} != 0.0:", *_indent(inner)]
        return block

    def refresh(self) -> list[str]:
        """Per-interval coefficients and the largest rate, when an input they use has changed."""
        n = self.network
        text = self.text("")
        columns = [n.input_columns.index(c) for c in self.parts.slow_inputs()]
        changed = " or ".join(f"u{c} != inputs[i - 1, {c}]" for c in columns) or "False"
        uniform = [f"{text(name)} = {text(value)}" for _, f in self.parts.parts for name, value in f.uniform]
        largest = ["limit = 0.0", *_lanes(["limit = max(limit, R[l])"])]
        return [f"if i == 0 or {changed}:", *_indent([*uniform, *_lanes(self.prelude()), *largest])]

    def block(self) -> list[str]:
        """One block of lanes from the first sample to the last."""
        gram, cost = self.mode == "gram", self.mode == "cost"
        enter = [f"{self.at(j)} = start[b, {j}, l]" for j in range(self.k)]
        enter += [f"{self.at(row)} = lanes[b, {r}, l]" for r, row in enumerate(self.parameter_row.values())]
        enter += [f"{self.at(self.sum_row + j)} = 0.0" for j in range(self.m)]
        leave = [f"end[b, {j}, l] = {self.at(j)}" for j in range(self.k)]
        if cost:
            leave += [f"sse[b, {j}, l] = {self.at(self.sum_row + j)}" for j in range(self.m)]
        interval = [f"u{c} = inputs[i, {c}]" for c in range(len(self.network.input_columns))]
        interval += self.refresh()
        interval += self.observe("i")
        interval += [
            # Beyond LONGEST / limit the inputs have been constant for so many time constants that more of
            # the same changes nothing; without the cut a gap of months would take minutes.
            "dt = min(time[i + 1] - time[i], LONGEST / max(limit, 1e-30))",
            "steps = int(dt * limit * PER_STEP) + 1",
            "h = dt / steps",
            *[f"h{i} = h / {i}.0" for i in range(2, 9)],
            "for step in range(steps):",
            *_indent(_lanes(self.stages())),
        ]
        lines = _lanes(enter)
        lines += ["G[:] = 0.0"] if gram else []
        lines += ["limit = 0.0", "for i in range(n - 1):", *_indent(interval)]
        lines += [*self.observe("n - 1"), *_lanes(leave)]
        if gram:
            lines += ["for a in range(used):", *_indent(_lanes(["gram[b, a, l] = G[a * LANES + l]"]))]
        return lines

    def source(self) -> str:
        measured = "" if self.mode == "trace" else "y, weight, "
        used = "used, " if self.mode == "gram" else ""
        out = {"cost": "sse", "trace": "Y", "gram": "gram, sse"}[self.mode]
        head = ["n = time.shape[0]", f"W = np.empty({self.rows * LANES})", "R = np.empty(LANES)"]
        if self.mode == "gram":
            head += [f"E = np.empty({self.m * LANES})", "G = np.empty(LANES * LANES)"]
        head += [f"p{i} = base[{i}]" for i in range(len(self.network.ids)) if i not in self.lane]
        jit = f"{_SIGNATURE[self.mode]!r}, cache=True, fastmath=FAST, nogil=True, error_model='numpy'"
        return "\n".join(
            [
                f'"""Generated: {self.mode} kernel of a network of {self.k} nodes. Changes here are lost."""',
                "",
                "from math import log",
                "",
                "import numba as nb",
                "import numpy as np",
                "",
                f"LANES = {LANES}",
                f"PER_STEP = {1.0 / STEP_LIMIT!r}",
                f"LONGEST = {MOST_STEPS * STEP_LIMIT!r}",
                "FAST = {'contract', 'nsz', 'arcp'}",
                "",
                "",
                "@nb.njit(inline='always')",
                _EXP.strip(),
                "",
                "",
                f"@nb.njit({jit})",
                f"def kernel(base, lanes, start, time, inputs, {measured}{used}{out}, end):",
                *_indent([*head, "for b in range(start.shape[0]):", *_indent(self.block())]),
                "",
            ]
        )


_SIGNATURE: dict[Mode, str] = {
    "cost": "void(f8[::1], f8[:,:,::1], f8[:,:,::1], f8[::1], f8[:,::1], f8[:,::1], f8[:,::1],"
    " f8[:,:,::1], f8[:,:,::1])",
    "trace": "void(f8[::1], f8[:,:,::1], f8[:,:,::1], f8[::1], f8[:,::1], f8[:,:,:,::1], f8[:,:,::1])",
    "gram": "void(f8[::1], f8[:,:,::1], f8[:,:,::1], f8[::1], f8[:,::1], f8[:,::1], f8[:,::1],"
    " i8, f8[:,:,::1], f8[:,::1], f8[:,:,::1])",
}


def _lanes(lines: list[str]) -> list[str]:
    return ["for l in range(LANES):", *_indent(lines)]


def _indent(lines: list[str]) -> list[str]:
    return ["    " + line for line in lines]
