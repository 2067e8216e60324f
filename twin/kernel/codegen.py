"""Generator of kernels: from a network to one fused loop over lanes, as source text, in two variants.

``cost``   squared, noise-weighted residuals summed per sensor: nothing is stored but the sums
``trace``  readings of every sensor at every sample

The right-hand side is A x + b plus the part that is not affine in the temperatures. A and b are computed when an input
that they use has changed; the innermost loop is left with sums of products. A linear network is integrated by the
Taylor series of its exact solution, any other by classical Runge-Kutta.

Layout: particles come in blocks of `lanes`. A block's state, parameters and coefficients live in one flat work
array, row r of lane l at ``W[r * LANES + l]``. The only inner loop runs over l and holds all stages, so the compiler
turns it into vector instructions. The row offsets are literals, from which it proves that rows do not overlap. A
coefficient that all lanes share is a plain scalar. A kernel for one particle has one lane.

Inputs are held from one sample to the next (zero-order hold). Each interval is cut into equal substeps such that
substep * (largest bound on a state's own rate) stays below a limit; the largest is taken over the lanes of the block.
This keeps the error of a cooling loop below 1e-6 K, and every corner of the declared bounds stable.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Literal

from twin.kernel.delays import NEVER, SLOTS, delay_lines
from twin.kernel.functions import ARRIVED, EXP, LOG, PIECES, SUBSTEPS
from twin.kernel.integrators import DECAYED, MOST_STEPS, PAIRS, Integrator, LinearlyImplicit
from twin.kernel.source_text import NAME, KernelText, indent, renamed
from twin.network import Network
from twin.network.affine import lane_free_call, names_in
from twin.network.assembly import NetworkEquations

LANES = 32
"""Particles in a block of a swarm's kernel."""
FEW_LANES = 16
"""Particles in a block of kernels that try few hypotheses at a time, as a diagnosis does: a half-empty block costs as
much as a full one.
"""
INSTANT = "1.0e-3"
"""Interval, s, over which the mean of a memory is its value at an instant, and rounding leaves eleven digits."""
ALWAYS = -1
"""Index, beside those of input columns, of all that changes from sample to sample: the memories of samples."""
Mode = Literal["cost", "trace"]
MODES: tuple[Mode, ...] = ("cost", "trace")


def kernel_source(
    network: Network,
    mode: Mode,
    lane_ids: tuple[str, ...],
    lanes: int = LANES,
    same_flow: bool = True,
    stiff: bool = False,
) -> str:
    """Return the source of one kernel.

    Parameters
    ----------
    network
        The network to simulate.
    mode
        ``cost`` or ``trace``.
    lane_ids
        Ids of the parameters that may differ from particle to particle.
    lanes
        Particles in a block.
    same_flow
        True if the same volume has been pushed through the delay lines of all lanes before the first sample.
    stiff
        True integrates by the linearly implicit method, whose substeps do not grow with the fastest rate.
    """
    return KernelGenerator(network, mode, lane_ids, lanes, same_flow, stiff).source()


class KernelGenerator:
    """Generator of one kernel: sorts coefficients by what they depend on and writes the loops over samples and
    substeps.
    """

    def __init__(
        self, network: Network, mode: Mode, lane_ids: tuple[str, ...], lanes: int, same_flow: bool, stiff: bool = False
    ) -> None:
        self.network, self.mode, self.lanes = network, mode, lanes
        self.system = s = NetworkEquations(network, lane_ids)
        self.k, self.m = len(s.states), len(s.readings)
        self.text = KernelText(lanes)
        self.of_lanes: set[str] = set()
        self.table: dict[str, int] = {}
        self.parameters = {f"p{i}": row for row, i in enumerate(network.index(lane_ids))}
        for name in (*self.states(), *self.memories(), *self.parameters):
            self.text.row(name)
        for j in range(self.m if mode == "cost" else 0):
            self.text.row(f"sse{j}")
        for c in s.driven:
            self.text.row(f"u{c}")
        for name, memory in s.memories:
            self.text.row(s.stored(name, memory)[0])
        same_flow = lanes == 1 or (same_flow and self._pushed_equally())
        self.delays = delay_lines(s, self.text, same_flow) if s.delays else None
        self.integrator = (LinearlyImplicit if stiff else Integrator)(s, self.text, self.delays)
        self._levels()

    def _pushed_equally(self) -> bool:
        """Return True if no flow or volume of a delay differs between lanes."""
        s = self.system
        texts = [*s.flows, *(d.volume for d in s.delays)]
        return not any(s.dependencies(text) & self.text.rows.keys() for text in texts)

    def states(self) -> list[str]:
        """Return the names of the integrated states."""
        return [f"x{j}" for j in range(self.k)]

    def memories(self) -> list[str]:
        """Return the names of lagged values, of commands on their way through a lag, and of stored numbers."""
        s = self.system
        lags = [f"f{j}" for j in range(len(s.lags))] + [f"z{j}" for j, (_, d) in enumerate(s.drives) if d.lag]
        return lags + [s.stored(name, memory)[1] for name, memory in s.memories]

    def _levels(self) -> None:
        """Sort coefficients by their dependencies: lanes, inputs, the delayed share of a pipe."""
        s = self.system
        late = {d.late for d in s.delays}
        self.uses: dict[str, frozenset[int]] = {}
        self.late: set[str] = set(late)
        self.expressions: dict[str, str] = {}
        renewed = {s.stored(name, memory)[0] for name, memory in s.memories}
        for name, text in self._hoisted():
            self.expressions[name] = text
            needed = names_in(text)
            inputs = {int(n[1:]) for n in needed if re.fullmatch(r"u\d+", n)}
            inputs |= {ALWAYS} if needed & renewed else set()
            self.uses[name] = frozenset(inputs).union(*(self.uses.get(n, frozenset()) for n in needed))
            if needed & self.late:
                self.late.add(name)
            if needed & self.text.rows.keys():
                self.text.row(name)
        matrix = set(s.rates) | {t for form, _ in s.slopes for t in form.slopes.values()} | set(s.flows)
        matrix |= {f.constant for f in s.lag_terms} | {d.volume for d in s.delays}
        named = set().union(*(names_in(t) for t in matrix))
        self.slow = frozenset().union(*(self.uses.get(n, frozenset()) for n in named))
        inputs = {int(n[1:]) for t in matrix for n in names_in(t) if re.fullmatch(r"u\d+", n)}
        self.slow |= inputs | ({ALWAYS} if any(names_in(t) & renewed for t in matrix) else set())
        self.fast = frozenset().union(*self.uses.values()) - self.slow if self.uses else frozenset()

    def _hoisted(self) -> Iterator[tuple[str, str]]:
        """Yield coefficients; function calls in them that all lanes share become coefficients of their own."""
        count = 0
        for name, text in self.system.coefficients.items():
            while names_in(text) & self.text.rows.keys():
                shared = lane_free_call(text, self.text.rows.keys())
                if shared is None:
                    break
                yield f"shared_{count}", shared
                text = text.replace(shared, f"shared_{count}")
                count += 1
            yield name, text

    def coefficients(self, pick: str, late: bool, lane: bool) -> list[str]:
        """Return the assignments of one level, ``fixed``, ``slow`` or ``fast``, of lanes or of scalars."""
        out = []
        for name, text in self.expressions.items():
            inputs = self.uses[name]
            level = "fixed" if not inputs else "slow" if inputs <= self.slow else "fast"
            if late and level == "fixed" and name in self.late:
                level = "slow"
            if level == pick and (name in self.late) == late and (name in self.text.rows) == lane:
                out.append(f"{name} = {text}")
                if lane:
                    out.append(f"{self.text.at(name)} = {name}")
        return out

    def drive(self, varies: bool) -> list[str]:
        """Return the lines that turn driven input columns into the values that the elements see in this interval."""
        out: list[str] = []
        varying = [self.network.input_columns.index(d.column) for _, d in self.system.drives if d.varies]
        for k, (_, d) in enumerate(self.system.drives):
            if d.varies != varies:
                continue
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
                    f"{self.text.at(f'z{k}')} = a{k} + gone * decay",
                    f"a{k} = a{k} + gone * share * (1.0 - decay)",
                ]
            # Of other inputs that vary too, the recorded value: the order of the elements must not count.
            others = {f"u{k}": f"inputs[i, {k}]" for k in varying if k != c}
            body += [f"u{c} = {renamed(d.value, others)}", f"{self.text.at(f'u{c}')} = u{c}"]
            out += self.text.loop(body)
        return out

    def renew(self) -> list[str]:
        """Return the lines that renew the memories of samples, after the drives that they follow."""
        s = self.system
        out = ["span = time[i + 1] - time[i]"] if s.memories else []
        columns = [self.network.input_columns.index(d.column) for _, d in s.drives if d.varies]
        recorded = {f"u{c}": f"inputs[i, {c}]" for c in columns}
        for name, memory in s.memories:
            value, before = s.stored(name, memory)
            body = [f"{value} = {renamed(memory.value, recorded)}", f"{self.text.at(value)} = {value}"]
            out += self.text.loop([*body, f"{self.text.at(before)} = {renamed(memory.after, recorded)}"])
        return out

    def changed(self, columns: frozenset[int]) -> str:
        """Return the condition that one of some input columns has changed since the last sample."""
        s = self.system
        if ALWAYS in columns:
            return "True"
        if any(
            d.dead_time or d.lag or d.varies
            for _, d in s.drives
            if self.network.input_columns.index(d.column) in columns
        ):
            return "True"
        return " or ".join(f"inputs[i, {c}] != inputs[i - 1, {c}]" for c in sorted(columns)) or "False"

    def refresh(self) -> list[str]:
        """Return the lines that renew coefficients whose inputs have changed, the step, and all that depends on the
        step.
        """
        s, lanes = self.system, self.lanes
        at = self.text.row("rate") * lanes
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
        slow += self.text.loop(body)
        if self.integrator.paired:
            slow += [f"pairs = {PAIRS[0][1]}"]
            slow += [f"if fast{n} > 0: pairs = {PAIRS[n + 1][1]}" for n in range(len(PAIRS) - 1)]
        if self.integrator.bounds is not None:
            norm = self.text.row("norm") * lanes
            steps, sums = self.integrator.bounds
            body = [f"{name} = {text}" for name, text in steps]
            body += [f"norm = max({', '.join(['0.0', *sums])})", f"W[{norm} + l] = norm"]
            slow += ["norm_of_all = 0.0", "if fast > 0:", *indent(self.text.loop(body))]
            slow += [f"    for l in range({lanes}):", f"        norm_of_all = max(norm_of_all, W[{norm} + l])"]
        slow += ["if fast > 0:", f"    for l in range({lanes}):", f"        limit = max(limit, W[{at} + l])"]
        stepwise = [
            *self.integrator.cut,
            f"steps = max(int(np.ceil({self.integrator.steps} - 1e-9)), 1)",
            "h = dt / steps",
        ]
        on_step = self.integrator.refresh()
        if self.delays:
            on_step = [*self.delays.refresh(), *on_step]
        on_step += self.coefficients("slow", late=True, lane=False)
        on_step += self.text.outlined("renew_late", self.coefficients("slow", late=True, lane=True))
        on_step += self.integrator.factorise()
        fast = [*self.shared("fast"), *self.coefficients("fast", late=True, lane=False)]
        body = [x for late in (False, True) for x in self.coefficients("fast", late=late, lane=True)]
        fast += self.text.outlined("renew_offsets", body)
        new = f"i == first or abs(dt - known_dt) > 1e-9 * dt or {self.changed(self.slow)}"
        out = ["dt = time[i + 1] - time[i]", f"new = {new}", "if new:", "    known_dt = dt", *indent(slow), *stepwise]
        if on_step:
            out += ["if new or abs(h - known_h) > 1e-9 * h:", *indent(["known_h = h", *on_step])]
            out += ["    new = True"]
        if fast:
            out += [f"if new or {self.changed(self.fast)}:", *indent(fast)]
        return out

    def shared(self, level: str) -> list[str]:
        """Return the coefficients that all lanes share; a swarm looks them up instead of computing them in every
        block.
        """
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
        return [*made, *self.text.called("tabulate", ["inputs", "S"], types, lines)]

    def observe(self) -> list[str]:
        """Return the lines that compare the state at sample i with the measurement, or store the readings."""
        # A reading follows the recorded input: what elements see of it is known from its interval on.
        recorded = {f"u{c}": f"inputs[i, {c}]" for c in self.system.driven}
        readings = [renamed(text, recorded) for text in self.system.readings]
        lines = ["now = time[i]"] if any("now" in names_in(r) for r in readings) else []
        shared, body, names = self.metering()
        lines += shared
        readings = [renamed(reading, names) for reading in readings]
        if self.mode == "trace":
            return lines + self.text.loop(body + [f"Y[b, i, {j}, l] = {r}" for j, r in enumerate(readings)])
        lines += [f"w{j} = weight[i, {j}]" for j in range(self.m)]
        lines += [f"y{j} = y[i, {j}]" for j in range(self.m)]
        for j, reading in enumerate(readings):
            body += [f"r{j} = ({reading} - y{j}) * w{j}", f"{self.text.at(f'sse{j}')} += r{j} * r{j}"]
        return lines + self.text.loop(body)

    def metering(self) -> tuple[list[str], list[str], dict[str, str]]:
        """Return what the meters' readings need at sample i: lines of scalars, lines of lanes, and the names in them.

        The coefficients of the integrator are those of the interval before, so they are computed anew under names of
        their own, with the inputs of the sample.
        """
        s = self.system
        steps = {**self._remembered_now(), **s.metering}
        used = set().union(*(names_in(text) for text in steps.values())) if steps else set()
        read: dict[str, str] = {}
        for c in sorted(int(name[1:]) for name in used if re.fullmatch(r"u\d+", name)):
            drive = next(
                ((k, d) for k, (_, d) in enumerate(s.drives) if self.network.input_columns[c] == d.column), None
            )
            if drive is None:
                read[f"u{c}"] = f"inputs[i, {c}]"
                continue
            k, d = drive
            now = f"arrived(time, inputs, {c}, i, {d.dead_time})" if d.dead_time else f"inputs[i, {c}]"
            read |= {f"a{k}": f"z{k}" if d.lag else now, f"u{c}": d.value}
        steps = {**read, **steps}
        names = {name: f"m_{name}" for name in steps}
        shared, body = [], []
        apart = set(self.text.rows)
        for name, text in steps.items():
            needed = set(NAME.findall(text))
            line = f"{names[name]} = {renamed(text, names)}"
            if needed & (apart - names.keys()) or needed & self.of_lanes:
                self.of_lanes.add(name)
                body.append(line)
            else:
                shared.append(line)
        return shared, body, names

    def _remembered_now(self) -> dict[str, str]:
        """Return the values of the memories that meters need, at the instant of a sample: name -> expression.

        Those in the work array are means over the interval before, of another block of lanes at the first sample.
        """
        s, found = self.system, {}
        columns = [self.network.input_columns.index(d.column) for _, d in s.drives if d.varies]
        now = {f"u{c}": f"inputs[i, {c}]" for c in columns} | {"span": INSTANT}
        needed = set().union(*(names_in(text) for text in s.metering.values())) if s.metering else set()
        for name, memory in s.memories:
            value, _ = s.stored(name, memory)
            if value in needed:
                found[value] = renamed(memory.value, now)
        return found

    def copied(self, row: int, count: int, place: str, store: bool) -> list[str]:
        """Return loops that copy rows of the work array from or to an array."""
        here = f"W[({row} + r) * {self.lanes} + l]"
        text = f"{place} = {here}" if store else f"{here} = {place}"
        return [f"for r in range({count}):", f"    for l in range({self.lanes}):", f"        {text}"] if count else []

    def block(self) -> list[str]:
        """Return the lines of one block of lanes from the first sample to the last."""
        s = self.system
        cost = self.mode == "cost"
        remembered = [*self.states(), *self.memories()]
        lines = self.copied(0, len(remembered), "start[b, r, l]", store=False)
        lines += self.copied(len(remembered), len(self.parameters), "lanes[b, r, l]", store=False)
        lagging = [self.network.input_columns.index(d.column) for _, d in s.drives if d.lag]
        rest = [*s.rest_values, *(f"inputs[first, {c}]" for c in lagging), *(m.start for _, m in s.memories)]
        held = {f"u{c}": f"inputs[first, {c}]" for c in range(len(self.network.input_columns))}
        rest = [renamed(text, held) for text in rest]
        # Loops rather than lines, here and at the end: the compiler's time goes with the number of statements.
        body = []
        for name, at_rest in zip(remembered[len(self.network.nodes) :], rest, strict=True):
            body += [f"{name} = {name} if {name} == {name} else {at_rest}", f"{self.text.at(name)} = {name}"]
        lines += self.text.loop(body)
        if cost:
            lines += self.copied(self.text.row("sse0"), self.m, "0.0", store=False)
        lines += self.text.outlined("begin", self.coefficients("fixed", late=False, lane=True))
        lines += self.delays.enter() if self.delays else []
        # Before the substep: it gives the rows that the substep reads.
        refresh = self.refresh()
        inner = self.integrator.substep()
        if self.delays:
            inner = [*self.delays.look(), *inner, *self.delays.advance()]
        interval = [f"u{c} = inputs[i, {c}]" for c in range(len(self.network.input_columns)) if c not in s.driven]
        interval += [*self.observe(), "if i == n - 1:", "    break", *self.drive(varies=False), *self.renew()]
        interval += [*self.drive(varies=True), *refresh]
        interval += [*[f"h{i} = h / {i}.0" for i in range(2, 7)], "for step in range(steps):", *indent(inner)]
        lines += [
            "limit = 0.0",
            "known_dt, known_h = -1.0, -1.0",
            "for i in range(first, n):",
            *indent(interval),
        ]
        lines += self.copied(0, len(remembered), "end[b, r, l]", store=True)
        if cost:
            lines += self.copied(self.text.row("sse0"), self.m, "sse[b, r, l]", store=True)
        if self.delays:
            lines += self.delays.leave()
        return lines

    def source(self) -> str:
        """Return the source text of the module."""
        s, n = self.system, self.lanes
        measured = "" if self.mode == "trace" else "y, weight, "
        name, rows = ("piece", "first, n") if self.mode == "trace" else ("kernel", "first")
        out = {"cost": "sse", "trace": "Y"}[self.mode]
        block = self.block()
        head = [f"W = np.zeros({len(self.text.rows) * n})"]
        if self.mode != "trace":
            head = ["n = time.shape[0]", *head]
        if self.delays:
            head += self.delays.head()
        fixed = [*self.coefficients("fixed", late=False, lane=False), *self.tabulate()]
        used_names = {name for line in (*fixed, *block) for name in NAME.findall(line)}
        wanted = [i for i in range(len(self.network.ids)) if f"p{i}" in used_names]
        head += [*(f"p{i} = base[{i}]" for i in wanted if f"p{i}" not in self.parameters), *fixed]
        functions = EXP + LOG + SUBSTEPS + (ARRIVED if any(d.dead_time for _, d in s.drives) else "")
        return "\n".join(
            [
                f'"""Generated: {self.mode} kernel of a network of {self.k} states. Changes here are lost."""',
                "",
                f"LANES = {n}",
                f"SLOTS = {SLOTS}",
                f"NEVER = {NEVER!r}",
                f"STEP_LIMIT = {self.integrator.limit!r}",
                f"PER_STEP = {1.0 / self.integrator.limit!r}",
                f"PER_STABLE = {1.0 / self.integrator.stable!r}",
                f"DECAYED = {DECAYED!r}",
                f"LONGEST = {MOST_STEPS * self.integrator.limit!r}",
                "",
                functions,
                self.delays.functions if self.delays else "",
                "",
                *self.text.functions,
                f"@typed({_SIGNATURE[self.mode]!r})",
                f"def {name}(base, lanes, start, past, {rows}, time, inputs, {measured}{out}, end, future):",
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
}


__all__ = ["FEW_LANES", "LANES", "MODES", "Mode", "kernel_source"]
