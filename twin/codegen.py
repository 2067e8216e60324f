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

from twin.affine import ZERO, Form, names_in, plus, shared_call, times
from twin.assembly import System, python_source
from twin.delays import DELAY_FUNCTIONS, SLOTS, delay_lines
from twin.network import Network

LANES = 32
ORDER = 5
"""Order of the Taylor series for linear networks."""
STEP_LIMIT = 0.2
FEW = 5
"""Networks of more states than this are stiffer: one step of a higher order costs less than several."""
HIGH_ORDER, HIGH_ORDER_LIMIT = 8, 0.55
MOST_STEPS = 1.0e6
"""Substeps in one sample interval, at most."""
OUTLINE_LINES = 60
_NAME = re.compile(r"(?<![\w.])[A-Za-z_]\w*")  # not the e of 1.0e-5
_WORDS = {"for", "in", "range", "max", "min", "exp", "log", "abs", "if", "else"}
Mode = Literal["cost", "trace", "gram"]
MODES: tuple[Mode, ...] = ("cost", "trace", "gram")

_FUNCTIONS = '''
@nb.njit(inline='always')
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
_ARRIVED = '''
@nb.njit('f8(f8[::1], f8[:,::1], i8, i8, f8)', cache=True, error_model='numpy')
def arrived(time, inputs, column, i, dead):
    """Mean of a held input over interval i, `dead` seconds ago; before the first sample it was as then."""
    first, last = time[i] - dead, time[i + 1] - dead
    low, high = 0, i
    while low < high:
        middle = (low + high + 1) // 2
        if time[middle] <= first:
            low = middle
        else:
            high = middle - 1
    if last <= first:
        return inputs[low, column]
    total, at = 0.0, first
    while low < i and time[low + 1] < last:
        total += inputs[low, column] * max(time[low + 1] - at, 0.0)
        at = max(time[low + 1], at)
        low += 1
    return (total + inputs[low, column] * (last - at)) / (last - first)
'''


def kernel_source(network: Network, mode: Mode, lane_ids: tuple[str, ...], lanes: int = LANES) -> str:
    """Source of one kernel. `lane_ids` are the parameters that may differ from particle to particle."""
    return _Kernel(network, mode, lane_ids, lanes).source()


class _Kernel:
    def __init__(self, network: Network, mode: Mode, lane_ids: tuple[str, ...], lanes: int) -> None:
        self.network, self.mode, self.lanes = network, mode, lanes
        self.system = s = System(network, lane_ids)
        self.k, self.m = len(s.states), len(s.readings)
        self.rows: dict[str, int] = {}
        self.functions: list[str] = []
        self.table: dict[str, int] = {}
        self.parameters = {f"p{i}": row for row, i in enumerate(network.index(lane_ids))}
        for name in (*self.states(), *self.memories(), *self.parameters):
            self.row(name)
        self.constants = list(dict.fromkeys(f.constant for f in s.followers))
        self.order = ORDER if self.k <= FEW else HIGH_ORDER
        self.step_limit = STEP_LIMIT if self.order == ORDER or not s.linear else HIGH_ORDER_LIMIT
        self.delays = delay_lines(s, self) if s.delays else None
        self._levels()

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
        for name in late:
            self.row(name)
        for c in s.driven:
            self.row(f"u{c}")
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
                shared = shared_call(text, self.rows.keys())
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

    def loop(self, body: list[str]) -> list[str]:
        """A loop over lanes, with the lane rows that the body reads loaded into scalars first."""
        if not body:
            return []
        known: set[str] = set()
        loads: list[str] = []
        for line in body:
            target, _, value = line.partition(" = ")
            for name in _NAME.findall(value if value else line):
                if name in self.rows and name not in known:
                    known.add(name)
                    loads.append(f"{name} = {self.at(name)}")
            known.add(target.strip())
        return [f"for l in range({self.lanes}):", *indent([*loads, *body])]

    def outlined(self, name: str, body: list[str]) -> list[str]:
        """A loop over lanes as a function of its own: compilers take more than twice as long for twice the text."""
        lines = self.loop(body)
        if len(lines) < OUTLINE_LINES:
            return lines
        assigned = {"l", "W", *(line.strip().partition(" = ")[0] for line in lines)}
        scalars = sorted({n for line in lines for n in _NAME.findall(line)} - assigned - _WORDS)
        self.define(name, f"f8[::1]{', f8' * len(scalars)}", ", ".join(["W", *scalars]), lines)
        return [f"{name}({', '.join(['W', *scalars])})"]

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
                body = [f"a{k} = arrived(time, inputs, {c}, i, {self.system.text(d.dead_time)})"]
            if d.lag:
                body += [
                    f"share = {self.system.text(d.lag)} / max(time[i + 1] - time[i], 1e-12)",
                    "decay = exp(-1.0 / max(share, 1e-12))",
                    f"gone = z{k} - a{k}",
                    f"{self.at(f'z{k}')} = a{k} + gone * decay",
                    f"a{k} = a{k} + gone * share * (1.0 - decay)",
                ]
            body += [f"u{c} = {self.system.text(d.value)}", f"{self.at(f'u{c}')} = u{c}"]
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
        rates = [*(f"rate = max(rate, {r})" for r in dict.fromkeys(s.rates)), f"W[{at} + l] = rate"]
        body = ["rate = 0.0", *self.coefficients("slow", late=False, lane=True), *rates, "fast += int(rate > limit)"]
        slow = [*self.shared("slow"), "limit = STEP_LIMIT / max(dt, 1e-30)", "fast = 0", *self.loop(body)]
        slow += ["if fast > 0:", f"    for l in range({lanes}):", f"        limit = max(limit, W[{at} + l])"]
        stepwise = [
            # Beyond LONGEST / limit the inputs have been constant for so many time constants that more of
            # the same changes nothing; without the cut a gap of months would take minutes.
            "dt = min(dt, LONGEST / limit)",
            "steps = max(int(np.ceil(dt * limit * PER_STEP - 1e-9)), 1)",
            "h = dt / steps",
        ]
        on_step = self.followers_refresh()
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
            out += ["if new or abs(h - known_h) > 1e-9 * h:", *indent(["known_h = h", "fresh = True", *on_step])]
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
        return [
            f"S = np.empty((n, {len(self.table)}))",
            "for i in range(n):",
            f"    if i == 0 or {again}:",
            *indent(indent(body)),
            *[f"    S[i, {column}] = {name}" for name, column in self.table.items()],
        ]

    def followers_refresh(self) -> list[str]:
        body: list[str] = []
        for g, constant in enumerate(self.constants):
            for name in (f"ratio{g}", f"decay{g}"):
                self.row(name)
            body += [
                f"ratio{g} = ({constant}) / max(h, 1e-12)",
                f"{self.at(f'ratio{g}')} = ratio{g}",
                f"{self.at(f'decay{g}')} = exp(-1.0 / max(ratio{g}, 1e-12))",
            ]
        return self.loop(body)

    # --- one substep ----------------------------------------------------------------------------------------

    def slopes(self, y: list[str], outlets: str, stage: str) -> list[str]:
        """Rates k0, k1, .. of a stage at temperatures `y`, with delay outlets named `outlets` + index."""
        names = {f"x{j}": y[j] for j in range(self.k)}
        names |= {f"D{p}": f"{outlets}{p}" for p in range(len(self.system.delays))}
        staged = {name: f"{name}_{stage}" for name in self.system.curved}
        lines = [f"{staged[n]} = {renamed(t, {**names, **staged})}" for n, t in self.system.curved.items()]
        for j, (form, rest) in enumerate(self.system.slopes):
            text = renamed(ordered(form), names)
            if rest != ZERO:
                text = plus(text, renamed(rest, {**names, **staged}))
            lines.append(f"k{j}{stage} = {text}")
        return lines

    def substep(self) -> list[str]:
        """Body of the lane loop of one substep."""
        k = range(self.k)
        if not self.system.linear:
            lines = self.runge_kutta()
        elif self.delays:
            lines = self.taylor()
        else:
            lines = self.horner()
        new = {f"x{j}": f"n{j}" for j in k} | {f"D{p}": f"De{p}" for p in range(len(self.system.delays))}
        for j, f in enumerate(self.system.followers):
            first = renamed(ordered(Form(f.of.slopes)), {f"x{i}": f"e{i}" for i in k} | self.starts_of_delays("Da"))
            here = self.starts_of_delays("Ds")
            g = self.constants.index(f.constant)
            lines += [
                f"t0 = {renamed(ordered(f.of), here)}",
                f"t1 = {renamed(ordered(f.of), new)}",
                f"t2 = {first}",
                "bend = 2.0 * (t1 - t0 - t2)",
                f"slope = t2 + bend - ratio{g} * bend",
                f"f{j} = t1 - ratio{g} * slope + decay{g} * (f{j} - t0 + ratio{g} * (t2 - ratio{g} * bend))",
                f"{self.at(f'f{j}')} = f{j}",
            ]
        if self.delays:
            lines += self.delays.water(new)
        return lines + [f"{self.at(f'x{j}')} = n{j}" for j in k]

    def starts_of_delays(self, letter: str) -> dict[str, str]:
        return {f"D{p}": f"{letter}{p}" for p in range(len(self.system.delays))}

    def horner(self) -> list[str]:
        """Taylor series of the exact solution, for a right side that is affine and constant in the step.

        x_i = x + h/(s + 1 - i) f(x_(i-1)), i = 1 .. s: of order s, as Horner's scheme of exp.
        """
        k, y, lines = range(self.k), self.states(), list[str]()
        for i in range(self.order, 0, -1):
            last = i == 1
            lines += self.slopes(y, "D", f"s{i}")
            if i == self.order and self.system.followers:
                lines += [f"e{j} = h * k{j}s{i}" for j in k]
            y = [f"n{j}" if last else f"y{j}s{i}" for j in k]
            lines += [f"{y[j]} = x{j} + {'h' if last else f'h{i}'} * k{j}s{i}" for j in k]
        return lines

    def taylor(self) -> list[str]:
        """The same with delayed water that comes in as a quadratic in time, Ds + Da r + Db r^2 at the share r.

        e_i = h/i (A e_(i-1) + F_(i-1)) with F_0 = b + E Ds, F_1 = E Da, F_2 = E Db; x + e_1 + e_2 + ..
        """
        assert self.delays is not None
        k, lines = range(self.k), self.delays.polynomials()
        y, outlets, total = self.states(), "Ds", self.states()
        for i in range(1, self.order + 1):
            names = {f"x{j}": y[j] for j in k} | self.starts_of_delays(outlets)
            for j, (form, _) in enumerate(self.system.slopes):
                slopes = {v: t for v, t in form.slopes.items() if outlets or v.startswith("x")}
                text = renamed(ordered(Form(slopes, form.offset if i == 1 else ZERO)), names)
                lines.append(f"{'e' if i == 1 else f'e{i}_'}{j} = {'h' if i == 1 else f'h{i}'} * ({text})")
            y = [f"e{j}" if i == 1 else f"e{i}_{j}" for j in k]
            total = [f"{total[j]} + {y[j]}" for j in k]
            outlets = {1: "Da", 2: "Db"}.get(i, "")
        return lines + [f"n{j} = {total[j]}" for j in k]

    def runge_kutta(self) -> list[str]:
        """Classical fourth order."""
        k, x = range(self.k), self.states()
        lines = self.delays.polynomials() if self.delays else []
        lines += self.slopes(x, "Ds", "a")
        stages = (("a", "b", "h2", "Dm"), ("b", "c", "h2", "Dm"), ("c", "d", "h", "De"))
        for last, here, share, outlets in stages:
            lines += [f"y{j}{here} = x{j} + {share} * k{j}{last}" for j in k]
            lines += self.slopes([f"y{j}{here}" for j in k], outlets, here)
        lines += [f"n{j} = x{j} + h6 * (k{j}a + 2.0 * (k{j}b + k{j}c) + k{j}d)" for j in k]
        return lines + [f"e{j} = h * k{j}a" for j in k] if self.system.followers or self.delays else lines

    # --- samples --------------------------------------------------------------------------------------------

    def observe(self, i: str) -> list[str]:
        """Lines that compare the state at sample `i` with the measurement."""
        readings = self.system.readings
        lines = [f"now = time[{i}]"] if any("now" in names_in(r) for r in readings) else []
        if self.mode == "trace":
            return lines + self.loop([f"Y[b, {i}, {j}, l] = {reading}" for j, reading in enumerate(readings)])
        lines += [f"w{j} = weight[{i}, {j}]" for j in range(self.m)]
        lines += [f"y{j} = y[{i}, {j}]" for j in range(self.m)]
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

    def block(self) -> list[str]:
        """One block of lanes from the first sample to the last."""
        s, n = self.system, self.lanes
        cost = self.mode == "cost"
        remembered = [*self.states(), *self.memories()]
        enter = [f"{self.at(p)} = lanes[b, {r}, l]" for p, r in self.parameters.items()]
        body = [f"x{j} = start[b, {j}, l]" for j in range(len(self.network.nodes))]
        rest = [
            *s.starts,
            *(f"inputs[first, {self.network.input_columns.index(d.column)}]" for _, d in s.drives if d.lag),
        ]
        for row, (name, at_rest) in enumerate(
            zip(remembered[len(self.network.nodes) :], rest, strict=True), start=len(self.network.nodes)
        ):
            body += [f"{name} = start[b, {row}, l]", f"{name} = {name} if {name} == {name} else {at_rest}"]
        for name in remembered:
            body.append(f"W[{self.row(name) * n} + l] = {name}")
        if cost:
            enter += [f"{self.at(f'sse{j}')} = 0.0" for j in range(self.m)]
        lines = [f"for l in range({n}):", *indent(enter), *self.loop(body)] if enter else self.loop(body)
        lines += self.outlined("begin", self.coefficients("fixed", late=False, lane=True))
        lines += self.delays.enter() if self.delays else []
        lines += ["G[:] = 0.0"] if self.mode == "gram" else []
        # Before the substep: it gives the rows that the substep reads.
        refresh = self.refresh()
        inner = self.outlined("advance", self.substep())
        if self.delays:
            inner = [*self.delays.look(), *inner, *self.delays.advance()]
        interval = [f"u{c} = inputs[i, {c}]" for c in range(len(self.network.input_columns)) if c not in s.driven]
        interval += [*self.observe("i"), *self.drive(), *refresh]
        interval += [*[f"h{i} = h / {i}.0" for i in range(2, 9)], "for step in range(steps):", *indent(inner)]
        lines += [
            "limit = 0.0",
            "known_dt, known_h, fresh = -1.0, -1.0, True",
            "for i in range(first, n - 1):",
            *indent(interval),
        ]
        lines += self.observe("n - 1")
        leave = [f"end[b, {j}, l] = W[{self.row(name) * n} + l]" for j, name in enumerate(remembered)]
        if cost:
            leave += [f"sse[b, {j}, l] = {self.at(f'sse{j}')}" for j in range(self.m)]
        lines += [f"for l in range({n}):", *indent(leave)]
        if self.delays:
            lines += self.delays.leave()
        if self.mode == "gram":
            lines += ["for a in range(used):", f"    for l in range({n}):", f"        gram[b, a, l] = G[a * {n} + l]"]
        return lines

    def source(self) -> str:
        s, n = self.system, self.lanes
        measured = "" if self.mode == "trace" else "y, weight, "
        used = "used, " if self.mode == "gram" else ""
        out = {"cost": "sse", "trace": "Y", "gram": "gram, sse"}[self.mode]
        block = self.block()
        head = ["n = time.shape[0]", f"W = np.empty({len(self.rows) * n})"]
        if self.mode == "gram":
            head += [f"E = np.empty({self.m * n})", f"G = np.empty({n * n})"]
        if self.delays:
            head += self.delays.head()
        head += [f"p{i} = base[{i}]" for i in range(len(self.network.ids)) if f"p{i}" not in self.parameters]
        head += [*self.coefficients("fixed", late=False, lane=False), *self.tabulate()]
        jit = f"{_SIGNATURE[self.mode]!r}, cache=True, fastmath=FAST, nogil=True, error_model='numpy'"
        functions = _FUNCTIONS + (_ARRIVED if any(d.dead_time for _, d in s.drives) else "")
        return "\n".join(
            [
                f'"""Generated: {self.mode} kernel of a network of {self.k} states. Changes here are lost."""',
                "",
                "from math import log",
                "",
                "import numba as nb",
                "import numpy as np",
                "",
                f"LANES = {n}",
                f"SLOTS = {SLOTS}",
                f"STEP_LIMIT = {self.step_limit!r}",
                f"PER_STEP = {1.0 / self.step_limit!r}",
                f"LONGEST = {MOST_STEPS * self.step_limit!r}",
                "FAST = {'contract', 'nsz', 'arcp'}",
                "",
                functions,
                DELAY_FUNCTIONS if self.delays else "",
                "",
                *self.functions,
                f"@nb.njit({jit})",
                f"def kernel(base, lanes, start, past, first, time, inputs, {measured}{used}{out}, end, future):",
                *indent([*head, "for b in range(start.shape[0]):", *indent(block)]),
                "",
            ]
        )


_HEAD = "f8[::1], f8[:,:,::1], f8[:,:,::1], f8[:,:,::1], i8, f8[::1], f8[:,::1]"
_SIGNATURE: dict[Mode, str] = {
    "cost": f"void({_HEAD}, f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,:,::1])",
    "trace": f"void({_HEAD}, f8[:,:,:,::1], f8[:,:,::1], f8[:,:,::1])",
    "gram": f"void({_HEAD}, f8[:,::1], f8[:,::1], i8, f8[:,:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1])",
}


def ordered(form: Form) -> str:
    """Text of a form as a chain of multiply-adds."""
    total = form.offset
    for name, slope in form.slopes.items():
        total = plus(total, times(slope, name))
    return total


def renamed(text: str, names: dict[str, str]) -> str:
    """The expression with whole names replaced."""
    return _NAME.sub(lambda m: names.get(m.group(), m.group()), text)


def indent(lines: list[str]) -> list[str]:
    return ["    " + line for line in lines]


__all__ = ["LANES", "MODES", "Mode", "kernel_source", "python_source"]
