"""One system of states, coefficients and affine rates, assembled from a network's elements; all of it text.

Identifiers in the text are those of `twin.elements.symbols`.
"""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

from twin.elements import Fragment, Names
from twin.elements.fragments import InputDrive, SampleMemory
from twin.elements.symbols import Stream, Symbols
from twin.network.affine import (
    ONE,
    ZERO,
    AffineForm,
    NotAffineError,
    add,
    affine_form,
    multiply,
    names_in,
    parse_expression,
)
from twin.network.model import Network

FEW_STATES = 5
"""Number of states above which shared intermediate results keep a name of their own. Written out, a chain of volumes
that hand on water has as many products as a full matrix.
"""


@dataclass(frozen=True)
class DelayLine:
    """A transport delay: its index among those of the same flow, and its expressions."""

    element: str
    line: int
    late: str
    water: str
    volume: str
    start: str


@dataclass(frozen=True)
class FirstOrderLag:
    """A first-order lag: the affine form that it follows, and its time constant."""

    name: str
    of: AffineForm
    constant: str


class NetworkEquations:
    """The equations of a network in which the parameters `free` may vary.

    Attributes
    ----------
    states
        Names of the integrated states, nodes first.
    lags, drives, delays
        The other memory of the elements.
    coefficients
        Name -> expression free of temperatures, each after those that it needs.
    locals_
        Name -> expression of temperatures, in the same order.
    chain
        Name -> affine form, in order, of locals to which forms refer by name.
    slopes
        Per state the affine form of its rate, and the text of the remainder.
    """

    def __init__(self, network: Network, free: tuple[str, ...]) -> None:
        self.network = network
        self._named: dict[str, str] = {}
        parameters = {p.id: network.ids.index(p.same_as or p.id) for p in network.parameters.values()}
        self._symbols = symbols = Symbols(parameters, network.input_columns, network.nodes)
        streams = feeding_streams(network)
        parts: list[tuple[str, Fragment]] = []
        own: dict[str, dict[str, float]] = {e.name: {} for e in network.elements}
        for p in network.parameters.values():
            if p.value in (0.0, 1.0) and p.element in own and _stays(network, p.same_as or p.id, free):
                own[p.element][p.id[len(p.element) + 1 :]] = p.value
        changes: dict[str, tuple[str, ...]] = {}
        for e in network.elements:
            if target := e.changes():
                text = e.change(Names(e.name, own[e.name], streams, symbols))
                changes[target] = (*changes.get(target, ()), *((text,) if text else ()))
        for e in network.elements:
            fragment = e.emit(Names(e.name, own[e.name], streams, symbols, changes))
            symbols.settle(fragment.remembered(e.name))
            parts.append((e.name, fragment))
        self.parts = tuple(parts)
        self.states = tuple(symbols.names["x"])
        self.lags = tuple(symbols.names["f"])
        self.drives: tuple[tuple[str, InputDrive], ...] = tuple((name, f.drive) for name, f in parts if f.drive)
        self.driven = {network.input_columns.index(d.column) for _, d in self.drives}
        self.memories: tuple[tuple[str, SampleMemory], ...] = tuple((name, m) for name, f in parts for m in f.memories)

    def stored(self, element: str, memory: SampleMemory) -> tuple[str, str]:
        """Return the identifiers of a memory's value and of the number that it stores."""
        return self._symbols.local(element, memory.name), self._symbols.local(element, f"{memory.name}_before")

    @cached_property
    def delays(self) -> tuple[DelayLine, ...]:
        """Return the delays, in the order of the elements."""
        lines = []
        flows = self.flows
        for name, f in self.parts:
            if f.delay:
                d = f.delay
                late = self._symbols.local(name, "late")
                line = flows.index(d.flow)
                lines.append(DelayLine(name, line, late, d.water, d.volume, d.start))
        return tuple(lines)

    @cached_property
    def flows(self) -> tuple[str, ...]:
        """Return the names of the flows, L/s, that push water through delays."""
        return tuple(dict.fromkeys(f.delay.flow for _, f in self.parts if f.delay))

    @cached_property
    def own_coefficients(self) -> dict[str, str]:
        """Return the elements' own coefficients and the reciprocal capacitances, before affine forms are taken
        apart.
        """
        found = {name: value for _, f in self.parts for name, value in (*f.uniform, *f.sample)}
        for j, node in enumerate(self.network.nodes):
            found[f"c{j}"] = f"1.0 / {self._symbols.parameter(f'{node}.capacitance')}"
        return found

    @cached_property
    def coefficients(self) -> dict[str, str]:
        """Return all coefficients, each after those that it needs."""
        for part in (self.chain, self.slopes, self.lag_terms, self.inlet_forms):
            assert part is not None  # each names coefficients of its own
        return in_order({**self.own_coefficients, **self._named})

    @cached_property
    def locals_(self) -> dict[str, str]:
        """Return the elements' expressions of temperatures, each after those that it needs."""
        return in_order({name: value for _, f in self.parts for name, value in f.stage})

    @cached_property
    def variables(self) -> frozenset[str]:
        """Return the names that stand for temperatures: states and outlets of delays."""
        count = len(self._symbols.names["D"])
        return frozenset((*(f"x{j}" for j in range(len(self.states))), *(f"D{k}" for k in range(count))))

    @cached_property
    def chain(self) -> dict[str, AffineForm]:
        """Return the affine locals that keep a name of their own."""
        return self._forms[2]

    @cached_property
    def _forms(self) -> tuple[dict[str, AffineForm], dict[str, str], dict[str, AffineForm]]:
        """Return the affine locals, the others, and the affine ones that keep a name of their own."""
        forms: dict[str, AffineForm] = {}
        others: dict[str, str] = {}
        chain: dict[str, AffineForm] = {}
        used = self._uses() if len(self.states) > FEW_STATES else Counter[str]()
        for name, value in self.locals_.items():
            try:
                if names_in(value) & others.keys():
                    raise NotAffineError(name)
                form = self._name_terms(affine_form(value, self.variables | chain.keys(), forms))
            except NotAffineError:
                others[name] = value
                continue
            if used[name] > 1 and len(form.slopes) > 1:
                chain[name] = form
            else:
                forms[name] = form
        return forms, others, chain

    def _uses(self) -> Counter[str]:
        """Count how often each name stands in an expression of temperatures."""
        texts = [*self.locals_.values(), *(h for _, f in self.parts for h in f.heat.values())]
        texts += [s.rate for _, f in self.parts for s in f.states] + [d.water for d in self.delays]
        found: Counter[str] = Counter()
        for text in texts:
            for node in ast.walk(parse_expression(text)):
                if isinstance(node, ast.Name):
                    found[node.id] += 1
        return found

    def form(self, text: str) -> AffineForm:
        """Return the affine form of an expression.

        Raises
        ------
        NotAffineError
            The expression has none.
        """
        forms, others, chain = self._forms
        if names_in(text) & others.keys():
            raise NotAffineError(text)
        return affine_form(text, self.variables | chain.keys(), forms)

    def _name_terms(self, form: AffineForm) -> AffineForm:
        """Return the form with a name for every coefficient that is more than a name, so that texts stay short."""
        return AffineForm({v: self._short(t) for v, t in form.slopes.items()}, self._short(form.offset))

    def _short(self, text: str) -> str:
        if re.fullmatch(r"-?[\w.]+", text):
            return text
        for name, known in self._named.items():
            if known == text:
                return name
        name = f"k{len(self._named)}"
        self._named[name] = text
        return name

    @cached_property
    def slopes(self) -> tuple[tuple[AffineForm, str], ...]:
        """Return the affine form of each state's rate, K/s, and the remainder that is not affine, W or K/s."""
        rows = []
        for j, node in enumerate(self.network.nodes):
            form, rest = self._sum([f.heat[node] for _, f in self.parts if node in f.heat])
            rows.append((form.scaled(f"c{j}"), multiply(rest, f"c{j}")))
        for _, f in self.parts:
            rows += [self._sum([s.rate]) for s in f.states]
        return tuple((self._name_terms(form), rest) for form, rest in rows)

    def _sum(self, terms: Iterable[str]) -> tuple[AffineForm, str]:
        form, rest = AffineForm(), ZERO
        for term in terms:
            try:
                form = form + self.form(term)
            except NotAffineError:
                rest = add(rest, f"({term})")
        return form, rest

    @cached_property
    def nonaffine_locals(self) -> dict[str, str]:
        """Return the locals, in order, that the non-affine remainders need."""
        wanted = set().union(*(names_in(rest) for _, rest in self.slopes))
        kept: dict[str, str] = {}
        for name, value in reversed(self.locals_.items()):
            if name in wanted:
                kept[name] = value
                wanted |= names_in(value)
        return dict(reversed(kept.items()))

    @cached_property
    def linear(self) -> bool:
        """Return True if every rate is affine in the temperatures."""
        return all(rest == ZERO for _, rest in self.slopes)

    @cached_property
    def rates(self) -> tuple[str, ...]:
        """Return bounds on each state's own rate, 1/s: the coefficient of an affine row, else the elements' declared
        bound.
        """
        speeds = [s.speed for _, f in self.parts for s in f.states]
        late = {d.late for d in self.delays}
        rows = []
        for j, (form, rest) in enumerate(self.slopes):
            own = form.slopes.get(f"x{j}", ZERO)
            if rest == ZERO and not self.chain and not late & self.dependencies(own):
                rows.append(multiply(own, "-1.0"))
            elif j < len(self.network.nodes):
                node = self.network.nodes[j]
                found = [f"({f.conductance[node]})" for _, f in self.parts if node in f.conductance]
                rows.append(f"({' + '.join(found) or ZERO}) * c{j}")
            else:
                rows.append(speeds[j - len(self.network.nodes)])
        return tuple(rows)

    @cached_property
    def norm(self) -> tuple[tuple[tuple[str, str], ...], tuple[str, ...]]:
        """Return names with expressions, in order, and in these the sum of each state's absolute rates, 1/s, by all
        states.

        The largest sum bounds the spectral radius (maximum norm; Horn and Johnson, Matrix Analysis, sec. 5.6). What is
        not affine counts with the elements' declared bounds, for the state itself and for another one.
        """
        share = {name: f"sum_of_{name}" for name in self.chain}

        def total(form: AffineForm) -> str:
            terms = (multiply(share.get(v, ONE), f"abs({text})") for v, text in form.slopes.items())
            return " + ".join(terms) or ZERO

        steps = tuple((share[name], total(form)) for name, form in self.chain.items())
        rows = []
        for j, (form, rest) in enumerate(self.slopes):
            text = total(form)
            if rest != ZERO:
                text = f"{text} + 2.0 * ({self.rest_bound(j)})"
            rows.append(text)
        return steps, tuple(dict.fromkeys(rows))

    def rest_bound(self, j: int) -> str:
        """Return the declared bound on the dependence of what is not affine in state j's rate on the state, 1/s."""
        if j >= len(self.network.nodes):
            return self.rates[j]
        node = self.network.nodes[j]
        found = []
        for _, f in self.parts:
            if node in f.heat and node in f.conductance:
                try:
                    self.form(f.heat[node])
                except NotAffineError:
                    found.append(f"({f.conductance[node]})")
        # An element that declares no bound counts with the node's whole bound.
        return f"({' + '.join(found)}) * c{j}" if found else self.rates[j]

    def dependencies(self, text: str) -> set[str]:
        """Return the names on which an expression depends, through coefficients too."""
        found: set[str] = set()
        queue = [text]
        while queue:
            for name in names_in(queue.pop()) - found:
                found.add(name)
                if name in self.coefficients:
                    queue.append(self.coefficients[name])
        return found

    @cached_property
    def readings(self) -> tuple[str, ...]:
        """Return each sensor's reading, in the network's order."""
        return tuple(f.observe for _, f in self.parts if f.observe is not None)

    @cached_property
    def metering(self) -> dict[str, str]:
        """Return all that the meters' readings need beside states, inputs and parameters: name -> expression, each
        after those that it needs.
        """
        exports = {(name, quantity): e for name, f in self.parts for quantity, e in f.exports.items()}
        metered: dict[str, str] = {}
        for m in (f.metered for _, f in self.parts if f.metered):
            e = exports[m.element, m.quantity]
            metered |= dict(e.steps)
            metered[m.name] = f"{m.factors[e.unit]!r} * ({e.value})"
        known = {**self.own_coefficients, **self.locals_, **metered} if metered else {}
        wanted = [name for name in metered if any(name in names_in(r) for r in self.readings)]
        kept: set[str] = set()
        while wanted:
            name = wanted.pop()
            if name not in kept:
                kept.add(name)
                wanted += names_in(known[name]) & known.keys()
        return {name: value for name, value in in_order(known).items() if name in kept}

    @cached_property
    def lag_terms(self) -> tuple[FirstOrderLag, ...]:
        """Return the lags with the affine forms that they follow."""
        return tuple(
            FirstOrderLag(f"{name}.{lag.name}", self._name_terms(self.form(lag.of)), lag.constant)
            for name, f in self.parts
            for lag in f.lags
        )

    @cached_property
    def inlet_forms(self) -> tuple[AffineForm, ...]:
        """Return the affine form of the water that enters each delay."""
        return tuple(self._name_terms(self.form(d.water)) for d in self.delays)

    @cached_property
    def rest_values(self) -> tuple[str, ...]:
        """Return the values at rest, in node temperatures and inputs: of the states after the nodes, of the lags."""
        states = [s.start for _, f in self.parts for s in f.states]
        return (*states, *(lag.of for _, f in self.parts for lag in f.lags))


def _stays(network: Network, name: str, free: tuple[str, ...]) -> bool:
    return network.parameters[name].status == "fixed" and name not in free


def feeding_streams(network: Network) -> Mapping[str, Stream]:
    """Return, per node, the flow that feeds it, the node before it and the pipe between."""
    pipes = {e.to: e.name for e in network.elements if e.kind == "pipe"}  # type: ignore[attr-defined]
    return {
        node: Stream(e.name, before, pipes.get(node, ""))
        for e in network.elements
        for node, before in e.feeds().items()
    }


def in_order(expressions: Mapping[str, str]) -> dict[str, str]:
    """Return the expressions in an order in which each stands after those that it needs."""
    needs = {name: names_in(value) & expressions.keys() for name, value in expressions.items()}
    done: dict[str, str] = {}
    while len(done) < len(expressions):
        ready = [name for name in expressions if name not in done and needs[name] <= done.keys()]
        if not ready:
            raise ValueError(f"expressions need one another: {', '.join(sorted(expressions.keys() - done.keys()))}")
        for name in ready:
            done[name] = expressions[name]
    return done
