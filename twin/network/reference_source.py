"""Equations of a network as plain Python source: the reference for tests, simulations and steady states.

The elements' formulas stand in it as they are, nothing taken apart or fused, unlike in a kernel.
`twin.kernel.generated_code.define_functions` runs it.
"""

from __future__ import annotations

import re

from twin.network.affine import ZERO
from twin.network.assembly import NetworkEquations, in_order
from twin.network.model import Network


def python_source(network: Network) -> str:
    """Return the source of ``rhs(T, u, p) -> list of dT/dt`` in plain Python: the reference for tests and simulations.

    It calls ``exp`` and ``log``.

    T holds the node temperatures and the states of elements. The function sees only the present: no dead time, no lag
    of an actuator, and pipes without delay. Any parameter may differ from the network's, except those of elements with
    states, which are left out while they are neutral.
    """
    remembering = {name for name, f in NetworkEquations(network, network.ids).parts if f.states}
    system = NetworkEquations(network, tuple(p.id for p in network.parameters.values() if p.element not in remembering))
    body: list[str] = []
    for varies in (False, True):  # a memory follows what elements see, and a drive that varies may need a memory
        for k, (_, drive) in enumerate(system.drives):
            if drive.varies == varies:
                column = network.input_columns.index(drive.column)
                body += [f"a{k} = u{column}", f"u{column} = {drive.value}"]
        if not varies:
            body += _without_past(system)
    body += [f"{line.late} = 0.0" for line in system.delays]
    body += [f"D{k} = 0.0" for k in range(len(system.delays))]
    return _function("rhs(T, u, p)", [*body, *_locals(system)], f"[{', '.join(_plain_rates(system))}]")


def _without_past(system: NetworkEquations) -> list[str]:
    """Return the assignments of the memories for one instant: each stores its start."""
    lines = ["span = 1.0"] if system.memories else []
    for name, memory in system.memories:
        value, before = system.stored(name, memory)
        lines += [f"{before} = {memory.start}", f"{value} = {memory.value}"]
    return lines


def stateful_source(system: NetworkEquations) -> str:
    """Return plain Python source of a network with pipes and lags at one instant, from the elements' formulas alone.

    ``now(T, D, u, p)``, with states T and outlets of delays D, returns dT/dt, the water that enters each delay and the
    input of each lag. ``pushed(u, p)`` returns each delay's flow, L/s, and volume, L, and each lag's time constant, s.
    ``read(T, F, u, p, now)`` returns the readings, with F the lagged values.
    """
    entering = [f.delay.water for _, f in system.parts if f.delay]
    followed = [lag.of for _, f in system.parts for lag in f.lags]
    late = [f"{line.late} = 1.0" for line in system.delays]
    results = ", ".join(f"[{', '.join(texts)}]" for texts in (_plain_rates(system), entering, followed))
    pushes = [[system.flows[d.line] for d in system.delays], [d.volume for d in system.delays]]
    pushes.append([f.constant for f in system.lag_terms])
    pushed = ", ".join(f"[{', '.join(texts)}]" for texts in pushes)
    needed = set().union(*(system.dependencies(t) for texts in pushes for t in texts)) if any(pushes) else set()
    steps = [f"{name} = {value}" for name, value in system.coefficients.items() if name in needed]
    return "\n".join(
        [
            _function("now(T, D, u, p)", [*late, *_locals(system)], f"({results})"),
            _function("pushed(u, p)", steps, f"({pushed})"),
            _function(
                "read(T, F, u, p, now)",
                [f"{name} = {value}" for name, value in system.metering.items()],
                f"[{', '.join(system.readings)}]",
            ),
        ]
    )


def _locals(system: NetworkEquations) -> list[str]:
    """Return the assignments of coefficients and local names, each after those that it needs."""
    steps = in_order({**system.own_coefficients, **system.locals_})
    return [f"{name} = {value}" for name, value in steps.items()]


def _plain_rates(system: NetworkEquations) -> list[str]:
    """Return the rates of all states as the elements write them, nothing taken apart."""
    rows = []
    for j, node in enumerate(system.network.nodes):
        heat = " + ".join(f"({f.heat[node]})" for _, f in system.parts if node in f.heat) or ZERO
        rows.append(f"({heat}) * c{j}")
    return rows + [s.rate for _, f in system.parts for s in f.states]


def _function(signature: str, body: list[str], result: str) -> str:
    """Return a function of vectors whose text uses entries by name: x3 of T, f1 of F, D0 of D, u2 of u, p7 of p."""
    head = [f"def {signature}:"]
    used = "\n".join([*body, result])
    for letter, vector in (("x", "T"), ("f", "F"), ("D", "D"), ("u", "u"), ("p", "p")):
        if re.search(rf"\b{vector}\b", signature):
            wanted = sorted({int(k) for k in re.findall(rf"\b{letter}(\d+)\b", used)})
            head += [f"    {letter}{k} = {vector}[{k}]" for k in wanted]
    return "\n".join([*head, *(f"    {line}" for line in body), f"    return {result}", ""])
