"""Network to source text: one fused kernel over lanes, in three variants.

``cost``   squared, noise-weighted residuals summed per sensor: nothing is stored but the sums
``trace``  readings of every sensor at every sample, for plots, oracles and the live twin
``gram``   Gram matrix of lane differences: J'J and J'r of a least-squares fit without storing trajectories

The right side is A x + b plus whatever is not affine in the temperatures. A and b are computed when an input that
they use has changed; the innermost loop is left with sums of products. A linear network is integrated by the
Taylor series of its exact solution, any other by classical Runge-Kutta.

Layout: particles come in blocks of `lanes`. A block's state, parameters and coefficients live in one flat work
array, row r of lane l at ``W[r * LANES + l]``; the only inner loop runs over l and holds all stages, so that the
compiler turns it into vector instructions. The row offsets are literals, which is what lets it prove that rows do
not overlap. A coefficient that all lanes share is a plain scalar. A kernel for one particle has one lane.

Inputs are held from one sample to the next (zero-order hold). Each interval is cut into as many equal substeps
as keep  substep * (largest bound on a state's own rate)  below a limit, with the largest taken over the lanes of
the block: that keeps the error of a cooling loop below 1e-6 K, and every corner of the declared bounds stable.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Literal

from twin.affine import lane_free_call, names_in
from twin.assembly import System, python_source
from twin.delays import NEVER, SLOTS, delay_lines
from twin.integrators import NAME, PAIRS, Integrator, renamed
from twin.kernel_functions import ARRIVED, EXP, PIECES
from twin.network import Network

LANES = 32
FEW_LANES = 16
"""Of kernels that try a handful of hypotheses at a time, as a diagnosis does: a block costs as much half empty."""
MOST_STEPS = 1.0e6
"""Substeps in one sample interval, at most."""
OUTLINE_LINES = 60
_WORDS = {"for", "in", "range", "int", "max", "min", "exp", "log", "abs", "if", "else", "or"}
Mode = Literal["cost", "trace", "gram"]
MODES: tuple[Mode, ...] = ("cost", "trace", "gram")


def kernel_source(
    network: Network, mode: Mode, lane_ids: tuple[str, ...], lanes: int = LANES, alike: bool = True
) -> str:
    """Source of one kernel.

    Args:
        lane_ids: the parameters that may differ from particle to particle.
        alike: whether the water in delay lines has been pushed the same way in all lanes before the first sample.
    """
    return _Kernel(network, mode, lane_ids, lanes, alike).source()


class _Kernel:
    def __init__(self, network: Network, mode: Mode, lane_ids: tuple[str, ...], lanes: int, alike: bool) -> None:
        self.network, self.mode, self.lanes = network, mode, lanes
        self.system = s = System(network, lane_ids)
        self.k, self.m = len(s.states), len(s.readings)
        self.rows: dict[str, int] = {}
        self.functions: list[str] = []
        self.loops = 0
        self.table: dict[str, int] = {}
        self.parameters = {f"p{i}": row for row, i in enumerate(network.index(lane_ids))}
        for name in (*self.states(), *self.memories(), *self.parameters):
            self.row(name)
        for j in range(self.m if mode == "cost" else 0):
            self.row(f"sse{j}")
        for c in s.driven:
            self.row(f"u{c}")
        alike = lanes == 1 or (alike and self._pushed_alike())
        self.delays = delay_lines(s, self, alike) if s.delays else None
        self.integrator = Integrator(self)
        self._levels()

    def _pushed_alike(self) -> bool:
        """Whether no flow or volume of a delay differs between lanes."""
        s = self.system
        texts = [*s.flows, *(d.volume for d in s.delays)]
        return not any(s.behind(text) & self.rows.keys() for text in texts)

    def states(self) -> list[str]:
        return [f"x{j}" for j in range(self.k)]

    def memories(self) -> list[str]:
        """Lagged values, then commands on their way through a lag."""
        lags = [f"f{j}" for j in range(len(self.system.lags))]
        return lags + [f"z{j}" for j, (_, d) in enumerate(self.system.drives) if d.lag]

    def row(self, name: str) -> int:
        """Row of a quantity that differs between lanes."""
        return self.rows.setdefault(name, len(self.rows))

    def at(self, name: str) -> str:
        return f"W[{self.row(name) * self.lanes} + l]"

    def _levels(self) -> None:
        """Sort coefficients by what they depend on: lanes, inputs, the share of a pipe that is late."""
        s = self.system
        late = {d.late for d in s.delays}
        self.uses: dict[str, frozenset[int]] = {}
        self.late: set[str] = set(late)
        self.texts: dict[str, str] = {}
        for name, text in self._hoisted():
            self.texts[name] = text
            needed = names_in(text)
            inputs = {int(n[1:]) for n in needed if re.fullmatch(r"u\d+", n)}
            self.uses[name] = frozenset(inputs).union(*(self.uses.get(n, frozenset()) for n in needed))
            if needed & self.late:
                self.late.add(name)
            if needed & self.rows.keys():
                self.row(name)
        matrix = set(s.rates) | {t for form, _ in s.slopes for t in form.slopes.values()} | set(s.flows)
        matrix |= {f.constant for f in s.followers} | {d.volume for d in s.delays}
        named = set().union(*(names_in(t) for t in matrix))
        self.slow = frozenset().union(*(self.uses.get(n, frozenset()) for n in named))
        inputs = {int(n[1:]) for t in matrix for n in names_in(t) if re.fullmatch(r"u\d+", n)}
        self.slow |= inputs
        self.fast = frozenset().union(*self.uses.values()) - self.slow if self.uses else frozenset()

    def _hoisted(self) -> Iterator[tuple[str, str]]:
        """Coefficients, with the function calls in them that all lanes share as coefficients of their own."""
        count = 0
        for name, text in self.system.coefficients.items():
            while names_in(text) & self.rows.keys():
                shared = lane_free_call(text, self.rows.keys())
                if shared is None:
                    break
                yield f"shared_{count}", shared
                text = text.replace(shared, f"shared_{count}")
                count += 1
            yield name, text

    def coefficients(self, pick: str, late: bool, lane: bool) -> list[str]:
        """Assignments of one level: ``fixed``, ``slow`` or ``fast``; of lanes or of scalars."""
        out = []
        for name, text in self.texts.items():
            inputs = self.uses[name]
            level = "fixed" if not inputs else "slow" if inputs <= self.slow else "fast"
            if late and level == "fixed" and name in self.late:
                level = "slow"
            if level == pick and (name in self.late) == late and (name in self.rows) == lane:
                out.append(f"{name} = {text}")
                if lane:
                    out.append(f"{self.at(name)} = {name}")
        return out

    def loop(self, body: list[str], own: bool = True) -> list[str]:
        """A loop over lanes, with the lane rows that the body reads loaded into scalars first.

        With `own`, what the body assigns gets names that no other loop has: the compiler's time goes with the number
        of names that are assigned in more than one place.
        """
        if not body:
            return []
        known: set[str] = set()
        loads: list[str] = []
        for line in body:
            target, _, value = line.partition(" = ")
            for name in NAME.findall(value if value else line):
                if name in self.rows and name not in known:
                    known.add(name)
                    loads.append(f"{name} = {self.at(name)}")
            if value:
                known.add(target.strip())
        lines = [*loads, *body]
        if own:
            self.loops += 1
            names = {name: f"{name}_{self.loops}l" for name in known if name.isidentifier()}
            lines = [renamed(line, names) for line in lines]
        return [f"for l in range({self.lanes}):", *indent(lines)]

    def outlined(self, name: str, body: list[str], always: bool = False) -> list[str]:
        """A loop over lanes as a function of its own: compilers take more than twice as long for twice the text."""
        lines = self.loop(body, own=False)
        if len(lines) < OUTLINE_LINES and not always:
            return self.loop(body)
        return self.called(name, ["W"], ["f8[::1]"], lines)

    def called(self, name: str, arrays: list[str], types: list[str], lines: list[str]) -> list[str]:
        """A compiled function of arrays and of all the scalars that its lines need, and the call of it."""
        assigned = {"l", "i", "n", "np", *arrays, *(line.strip().partition(" = ")[0] for line in lines)}
        scalars = sorted({n for line in lines for n in NAME.findall(line)} - assigned - _WORDS)
        arguments = ", ".join([*arrays, *scalars])
        self.define(name, ", ".join([*types, *("f8" for _ in scalars)]), arguments, lines)
        return [f"{name}({arguments})"]

    def define(self, name: str, types: str, arguments: str, lines: list[str]) -> None:
        """A compiled function beside the kernel."""
        self.functions += [
            f"@nb.njit('void({types})', cache=True, fastmath=FAST, error_model='numpy')",
            f"def {name}({arguments}):",
            *indent(lines),
            "",
            "",
        ]

    # --- one interval ---------------------------------------------------------------------------------------

    def drive(self) -> list[str]:
        """What the elements see of the driven columns in this interval."""
        out: list[str] = []
        for k, (_, d) in enumerate(self.system.drives):
            c = self.network.input_columns.index(d.column)
            command = f"inputs[i, {c}]"
            body = [f"a{k} = {command}"]
            if d.dead_time:
                body = [f"a{k} = arrived(time, inputs, {c}, i, {d.dead_time})"]
            if d.lag:
                body += [
                    f"share = {d.lag} / max(time[i + 1] - time[i], 1e-12)",
                    "decay = exp(-1.0 / max(share, 1e-12))",
                    f"gone = z{k} - a{k}",
                    f"{self.at(f'z{k}')} = a{k} + gone * decay",
                    f"a{k} = a{k} + gone * share * (1.0 - decay)",
                ]
            body += [f"u{c} = {d.value}", f"{self.at(f'u{c}')} = u{c}"]
            out += self.loop(body)
        return out

    def changed(self, columns: frozenset[int]) -> str:
        s = self.system
        if any(d.dead_time or d.lag for _, d in s.drives if self.network.input_columns.index(d.column) in columns):
            return "True"
        return " or ".join(f"inputs[i, {c}] != inputs[i - 1, {c}]" for c in sorted(columns)) or "False"

    def refresh(self) -> list[str]:
        """Coefficients whose inputs have changed, the step, and what depends on the step."""
        s, lanes = self.system, self.lanes
        at = self.row("rate") * lanes
        # Most often one substep does for all lanes; counting those for which it does not is a vector operation,
        # finding the largest rate is not.
        body = self.coefficients("slow", late=False, lane=True)
        body += [f"rate = max({', '.join(['0.0', *dict.fromkeys(s.rates)])})", f"W[{at} + l] = rate"]
        body.append("fast += int(rate > limit)")
        slow = [*self.shared("slow"), "limit = STEP_LIMIT / max(dt, 1e-30)", "fast = 0"]
        if self.integrator.paired:
            slow += [f"limit{n} = {z!r} / max(dt, 1e-30)" for n, (z, _) in enumerate(PAIRS[:-1])]
            slow += [f"fast{n} = 0" for n in range(len(PAIRS) - 1)]
            body += [f"fast{n} += int(rate > limit{n})" for n in range(len(PAIRS) - 1)]
        slow += self.loop(body)
        if self.integrator.paired:
            slow += [f"pairs = {PAIRS[0][1]}"]
            slow += [f"if fast{n} > 0: pairs = {PAIRS[n + 1][1]}" for n in range(len(PAIRS) - 1)]
        slow += ["if fast > 0:", f"    for l in range({lanes}):", f"        limit = max(limit, W[{at} + l])"]
        stepwise = [
            # Beyond LONGEST / limit the inputs have been constant for so many time constants that more of
            # the same changes nothing; without the cut a gap of months would take minutes.
            "dt = min(dt, LONGEST / limit)",
            "steps = max(int(np.ceil(dt * limit * PER_STEP - 1e-9)), 1)",
            "h = dt / steps",
        ]
        on_step = self.integrator.refresh()
        if self.delays:
            on_step = [*self.delays.refresh(), *on_step]
        on_step += self.coefficients("slow", late=True, lane=False)
        on_step += self.outlined("renew_late", self.coefficients("slow", late=True, lane=True))
        fast = [*self.shared("fast"), *self.coefficients("fast", late=True, lane=False)]
        body = [x for late in (False, True) for x in self.coefficients("fast", late=late, lane=True)]
        fast += self.outlined("renew_offsets", body)
        new = f"i == first or abs(dt - known_dt) > 1e-9 * dt or {self.changed(self.slow)}"
        out = ["dt = time[i + 1] - time[i]", f"new = {new}", "if new:", "    known_dt = dt", *indent(slow), *stepwise]
        if on_step:
            out += ["if new or abs(h - known_h) > 1e-9 * h:", *indent(["known_h = h", *on_step])]
            out += ["    new = True"]
        if fast:
            out += [f"if new or {self.changed(self.fast)}:", *indent(fast)]
        return out

    def shared(self, level: str) -> list[str]:
        """Coefficients that all lanes share: looked up for a swarm, which would compute them in every block."""
        lines = self.coefficients(level, late=False, lane=False)
        names = [line.partition(" = ")[0] for line in lines]
        if self.lanes == 1:
            return lines
        return [f"{name} = S[i, {self.table.setdefault(name, len(self.table))}]" for name in names]

    def tabulate(self) -> list[str]:
        """Fill the table of the coefficients that all lanes share, sample by sample."""
        if not self.table:
            return []
        columns = {int(c) for name in self.table for c in self.uses[name]}
        again = " or ".join(f"inputs[i, {c}] != inputs[i - 1, {c}]" for c in sorted(columns))
        level = [line for pick in ("slow", "fast") for line in self.coefficients(pick, late=False, lane=False)]
        body = [f"u{c} = inputs[i, {c}]" for c in sorted(columns)] + level
        lines = [
            "for i in range(int(first), int(stop)):",
            f"    if i == first or {again}:",
            *indent(indent(body)),
            *[f"    S[i, {column}] = {name}" for name, column in self.table.items()],
        ]
        types = ["f8[:,::1]", "f8[:,::1]"]
        made = ["stop = n", f"S = np.empty((n, {len(self.table)}))"]
        return [*made, *self.called("tabulate", ["inputs", "S"], types, lines)]

    # --- samples --------------------------------------------------------------------------------------------

    def observe(self) -> list[str]:
        """Lines that compare the state at sample i with the measurement."""
        readings = self.system.readings
        lines = ["now = time[i]"] if any("now" in names_in(r) for r in readings) else []
        if self.mode == "trace":
            return lines + self.loop([f"Y[b, i, {j}, l] = {reading}" for j, reading in enumerate(readings)])
        lines += [f"w{j} = weight[i, {j}]" for j in range(self.m)]
        lines += [f"y{j} = y[i, {j}]" for j in range(self.m)]
        if self.mode == "cost":
            body = []
            for j, reading in enumerate(readings):
                body += [f"r{j} = ({reading} - y{j}) * w{j}", f"{self.at(f'sse{j}')} += r{j} * r{j}"]
            return lines + self.loop(body)
        n = self.lanes
        block = lines + self.loop([f"E[{j * n} + l] = {reading}" for j, reading in enumerate(readings)])
        for j in range(self.m):
            inner = [
                f"centre = E[{j * n}]",
                f"for l in range({n}):",
                f"    E[{j * n} + l] = (E[{j * n} + l] - centre) * w{j}",
                f"E[{j * n}] = (centre - y{j}) * w{j}",
                "for a in range(used):",
                f"    s = E[{j * n} + a]",
                f"    for l in range({n}):",
                f"        G[a * {n} + l] += s * E[{j * n} + l]",
                f"sse[b, {j}] += E[{j * n}] * E[{j * n}]",
            ]
            block += [f"if w{j} != 0.0:", *indent(inner)]
        return block

    def copied(self, row: int, count: int, place: str, store: bool) -> list[str]:
        """Rows of the work array from or to an array, as loops."""
        here = f"W[({row} + r) * {self.lanes} + l]"
        text = f"{place} = {here}" if store else f"{here} = {place}"
        return [f"for r in range({count}):", f"    for l in range({self.lanes}):", f"        {text}"] if count else []

    def block(self) -> list[str]:
        """One block of lanes from the first sample to the last."""
        s, n = self.system, self.lanes
        cost = self.mode == "cost"
        remembered = [*self.states(), *self.memories()]
        lines = self.copied(0, len(remembered), "start[b, r, l]", store=False)
        lines += self.copied(len(remembered), len(self.parameters), "lanes[b, r, l]", store=False)
        lagging = [self.network.input_columns.index(d.column) for _, d in s.drives if d.lag]
        rest = [*s.starts, *(f"inputs[first, {c}]" for c in lagging)]
        # Loops rather than lines, here and at the end: the compiler's time goes with the number of statements.
        body = []
        for name, at_rest in zip(remembered[len(self.network.nodes) :], rest, strict=True):
            body += [f"{name} = {name} if {name} == {name} else {at_rest}", f"{self.at(name)} = {name}"]
        lines += self.loop(body)
        if cost:
            lines += self.copied(self.row("sse0"), self.m, "0.0", store=False)
        lines += self.outlined("begin", self.coefficients("fixed", late=False, lane=True))
        lines += self.delays.enter() if self.delays else []
        lines += ["G[:] = 0.0"] if self.mode == "gram" else []
        # Before the substep: it gives the rows that the substep reads.
        refresh = self.refresh()
        inner = self.integrator.substep()
        if self.delays:
            inner = [*self.delays.look(), *inner, *self.delays.advance()]
        interval = [f"u{c} = inputs[i, {c}]" for c in range(len(self.network.input_columns)) if c not in s.driven]
        interval += [*self.observe(), "if i == n - 1:", "    break", *self.drive(), *refresh]
        interval += [*[f"h{i} = h / {i}.0" for i in range(2, 7)], "for step in range(steps):", *indent(inner)]
        lines += [
            "limit = 0.0",
            "known_dt, known_h = -1.0, -1.0",
            "for i in range(first, n):",
            *indent(interval),
        ]
        lines += self.copied(0, len(remembered), "end[b, r, l]", store=True)
        if cost:
            lines += self.copied(self.row("sse0"), self.m, "sse[b, r, l]", store=True)
        if self.delays:
            lines += self.delays.leave()
        if self.mode == "gram":
            lines += ["for a in range(used):", f"    for l in range({n}):", f"        gram[b, a, l] = G[a * {n} + l]"]
        return lines

    def source(self) -> str:
        s, n = self.system, self.lanes
        measured = "" if self.mode == "trace" else "y, weight, "
        used = "used, " if self.mode == "gram" else ""
        name, rows = ("piece", "first, n") if self.mode == "trace" else ("kernel", "first")
        out = {"cost": "sse", "trace": "Y", "gram": "gram, sse"}[self.mode]
        block = self.block()
        head = [f"W = np.zeros({len(self.rows) * n})"]
        if self.mode != "trace":
            head = ["n = time.shape[0]", *head]
        if self.mode == "gram":
            head += [f"E = np.empty({self.m * n})", f"G = np.empty({n * n})"]
        if self.delays:
            head += self.delays.head()
        fixed = [*self.coefficients("fixed", late=False, lane=False), *self.tabulate()]
        used_names = {name for line in (*fixed, *block) for name in NAME.findall(line)}
        wanted = [i for i in range(len(self.network.ids)) if f"p{i}" in used_names]
        head += [*(f"p{i} = base[{i}]" for i in wanted if f"p{i}" not in self.parameters), *fixed]
        jit = f"{_SIGNATURE[self.mode]!r}, cache=True, fastmath=FAST, nogil=True, error_model='numpy'"
        functions = EXP + (ARRIVED if any(d.dead_time for _, d in s.drives) else "")
        return "\n".join(
            [
                f'"""Generated: {self.mode} kernel of a network of {self.k} states. Changes here are lost."""',
                "",
                f"LANES = {n}",
                f"SLOTS = {SLOTS}",
                f"NEVER = {NEVER!r}",
                f"STEP_LIMIT = {self.integrator.limit!r}",
                f"PER_STEP = {1.0 / self.integrator.limit!r}",
                f"LONGEST = {MOST_STEPS * self.integrator.limit!r}",
                "",
                functions,
                self.delays.functions if self.delays else "",
                "",
                *self.functions,
                f"@nb.njit({jit})",
                f"def {name}(base, lanes, start, past, {rows}, time, inputs, {measured}{used}{out}, end, future):",
                *indent([*head, "for b in range(start.shape[0]):", *indent(block)]),
                "",
                PIECES if self.mode == "trace" else "",
            ]
        )


_HEAD = "f8[::1], f8[:,:,::1], f8[:,:,::1], f8[:,:,::1], i8, f8[::1], f8[:,::1]"
_SIGNATURE: dict[Mode, str] = {
    "cost": f"void({_HEAD}, f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,:,::1])",
    "trace": "void(f8[::1], f8[:,:,::1], f8[:,:,::1], f8[:,:,::1], i8, i8, f8[::1], f8[:,::1], "
    "f8[:,:,:,::1], f8[:,:,::1], f8[:,:,::1])",
    "gram": f"void({_HEAD}, f8[:,::1], f8[:,::1], i8, f8[:,:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1])",
}


def indent(lines: list[str]) -> list[str]:
    return ["    " + line for line in lines]


__all__ = ["LANES", "MODES", "Mode", "kernel_source", "python_source"]
