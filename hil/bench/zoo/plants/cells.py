"""Finite-volume model of a plant: cells with an enthalpy, streams between them, links that conduct heat.

    dH_i/dt = sum of streams m (h(T_from) - h(T_i)) + sum of links + heat
    h(T)    = cp (T + a T^2 / 2)                  a: growth of the specific heat with temperature, 1/K

Each cell holds its water, so that streams balance in every cell. The state is the enthalpy, so that energy is conserved
to rounding. Time steps are Heun's, short against the shortest residence time.

Source: upwind finite volumes (Patankar, Numerical Heat Transfer and Fluid Flow, 1980, sec. 5.2).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ROOM = -1
"""Index of the room among the ends of a link."""
HEAT, FLOW, LINK, GATE, TRANSFER = range(5)
"""Targets of a modifier: heat into a cell, flow of a loop, conductance of a group of links, share of a bypass, heat
from one cell into another."""
ALWAYS, LATCH, LINEAR, POWER, EVAPORATION, ABOVE = range(6)
"""Laws by which a modifier follows temperatures."""
LAYER_BOOST = 20.0
"""Growth of the exchange between two layers where the lower one is the warmer: buoyancy mixes them."""
STABLE = 1.0
"""Largest step as a share of the shortest time constant; Heun's method is stable up to 2."""


@dataclass(frozen=True)
class CellNetwork:
    """Arrays of a plant.

    Attributes
    ----------
    capacity, curvature
        (n,) J/K at 0 degC, and growth of the specific heat, 1/K.
    stream_loop, stream_from, stream_to, stream_share, stream_gate, stream_skips
        (s,) loop, ends, share of the loop's flow, gate (-1 none), 1 for water that takes the bypass.
    link_a, link_b, link_G, link_group
        (l,) ends (`ROOM` for the room), conductance in W/K, group.
    link_flow, link_flow_exponent
        Loop that a link's film follows (-1 none), with its exponent.
    link_fan_exponent, link_warmth, link_natural, link_layer
        Exponent of the fan (0 none), growth with mean temperature in 1/K, 1 for natural convection (heat grows with
        the difference to the power 1.25), and 1 for a link between layers, from the upper to the lower one.
    loop_kg_s, loop_cp, loop_pump_cell, loop_pump_exponent, loop_density, loop_viscosity
        (q,) mass flow at full speed, J/(kg K), cell at the pump, exponent of the speed, fall of the density and growth
        of the flow in 1/K.
    gate
        (g,) share of each bypass in the healthy plant.
    heat_cell, heat_column, heat_share
        (k,) cells that are heated, by which heat column, and share.
    """

    capacity: Array
    curvature: Array
    stream_loop: Index
    stream_from: Index
    stream_to: Index
    stream_share: Array
    stream_gate: Index
    stream_skips: Index
    link_a: Index
    link_b: Index
    link_G: Array
    link_group: Index
    link_flow: Index
    link_flow_exponent: Array
    link_fan_exponent: Array
    link_warmth: Array
    link_natural: Index
    link_layer: Index
    loop_kg_s: Array
    loop_cp: Array
    loop_pump_cell: Index
    loop_pump_exponent: Array
    loop_density: Array
    loop_viscosity: Array
    gate: Array
    heat_cell: Index
    heat_column: Index
    heat_share: Array
    groups: int

    def arrays(self) -> tuple[NDArray[np.generic], ...]:
        """Return all arrays in the order of the integrator."""
        names = [name for name in self.__dataclass_fields__ if name != "groups"]
        return tuple(getattr(self, name) for name in names)

    def step_s(self) -> float:
        """Return a stable time step at full flow, s."""
        rate = np.zeros(len(self.capacity))
        kg_s = self.loop_kg_s[self.stream_loop] * self.stream_share
        # The flow of a bypass may be the whole of it.
        np.add.at(rate, self.stream_to, 1.5 * kg_s * self.loop_cp[self.stream_loop])
        for end in (self.link_a, self.link_b):
            inside = end != ROOM
            boost = np.where(self.link_layer == 1, LAYER_BOOST, 2.0)
            np.add.at(rate, end[inside], (boost * self.link_G)[inside])
        return float(STABLE / (rate / self.capacity).max())

    def imbalance(self, gate: Array) -> float:
        """Return the largest net inflow of a cell with these bypasses, as a share of a loop's flow."""
        net = np.zeros((len(self.loop_kg_s), len(self.capacity)))
        share = self.stream_share.copy()
        has = self.stream_gate >= 0
        beta = gate[self.stream_gate[has]]
        share[has] *= np.where(self.stream_skips[has] == 1, beta, 1.0 - beta)
        np.add.at(net, (self.stream_loop, self.stream_to), share)
        np.subtract.at(net, (self.stream_loop, self.stream_from), share)
        return float(np.abs(net).max())


@dataclass(frozen=True)
class Modifier:
    """A disturbance of a plant while it runs.

    Attributes
    ----------
    target, index, index2
        Target (`HEAT` ...), its cell, loop, group or gate; `index2` gives off what a `TRANSFER` brings.
    amplitude
        (n,) strength in each sample interval: W, or a share; times the law.
    law, sense, other
        Law, the cell that it reads, and the cell it compares with (`ROOM`).
    p0, p1
        Latch: on above p0, off below p1. Linear: T - p0. Power: exponent p0. Above: T - p0, at least 0.
    """

    target: int
    index: int
    amplitude: Array
    law: int = ALWAYS
    sense: int = 0
    other: int = ROOM
    p0: float = 0.0
    p1: float = 0.0
    index2: int = 0


@dataclass(frozen=True)
class Drive:
    """Inputs of a plant in each sample interval, all (n,) or (n, k).

    `pump` (n, loops) and `fan` are shares of full speed, `heat` (n, columns) W, `room` degC, `humidity` a share;
    `flow_noise` and `fan_noise` are factors.
    """

    pump: Array
    fan: Array
    heat: Array
    room: Array
    humidity: Array
    flow_noise: Array
    fan_noise: Array


@dataclass(frozen=True)
class Motion:
    """Temperatures (n, cells) degC at the samples, and the energies in J: stored, put in, lost to the room."""

    temperature: Array
    stored: float
    put_in: float
    lost: float


def simulate(
    network: CellNetwork, drive: Drive, period_s: float, start: Array, modifiers: tuple[Modifier, ...] = ()
) -> Motion:
    """Integrate a plant from temperatures `start` (n,) degC; inputs are held over each interval of `period_s`."""
    rows = len(drive.room)
    substeps = max(int(np.ceil(period_s / network.step_s())), 1)
    amplitudes = np.zeros((max(len(modifiers), 1), rows))
    whole = np.zeros((max(len(modifiers), 1), 6), dtype=np.int64)
    limits = np.zeros((max(len(modifiers), 1), 2))
    for k, m in enumerate(modifiers):
        amplitudes[k] = m.amplitude
        whole[k] = (m.target, m.index, m.index2, m.law, m.sense, m.other)
        limits[k] = (m.p0, m.p1)
    trace = np.empty((rows, len(start)), dtype=np.float64)
    inputs = (drive.pump, drive.fan, drive.heat, drive.room, drive.humidity, drive.flow_noise, drive.fan_noise)
    kernel: Any = _integrate
    stored, put_in, lost = kernel(
        *network.arrays(),
        network.groups,
        *inputs,
        period_s,
        substeps,
        start,
        len(modifiers),
        amplitudes,
        whole,
        limits,
        trace,
    )
    return Motion(trace, stored, put_in, lost)


@numba.njit(cache=True)
def _pressure(celsius: float) -> float:
    """Return the saturation pressure of water, Pa. Alduchov and Eskridge, J. Appl. Meteor. 35 (1996) 601, eq. 21."""
    return 610.94 * np.exp(17.625 * celsius / (celsius + 243.04))


@numba.njit(cache=True)
def _integrate(
    capacity: Any,
    curvature: Any,
    s_loop: Any,
    s_from: Any,
    s_to: Any,
    s_share: Any,
    s_gate: Any,
    s_skips: Any,
    l_a: Any,
    l_b: Any,
    l_G: Any,
    l_group: Any,
    l_flow: Any,
    l_flow_exp: Any,
    l_fan_exp: Any,
    l_warmth: Any,
    l_natural: Any,
    l_layer: Any,
    q_kg: Any,
    q_cp: Any,
    q_cell: Any,
    q_exp: Any,
    q_density: Any,
    q_viscosity: Any,
    gate0: Any,
    h_cell: Any,
    h_column: Any,
    h_share: Any,
    groups: Any,
    pump: Any,
    fan: Any,
    heat: Any,
    room: Any,
    humidity: Any,
    flow_noise: Any,
    fan_noise: Any,
    period: Any,
    substeps: Any,
    start: Any,
    count: Any,
    amplitudes: Any,
    whole: Any,
    limits: Any,
    trace: Any,
) -> tuple[float, float, float]:
    n, rows = len(capacity), len(room)
    dt = period / substeps
    t = start.copy()
    enthalpy = capacity * (t + 0.5 * curvature * t * t)
    before, now = enthalpy.sum(), enthalpy.copy()
    rate = np.zeros((2, n))
    kg, pumped = np.zeros(len(q_kg)), np.zeros(len(q_kg))
    gate, factor = gate0.copy(), np.ones(groups)
    on = np.zeros(max(count, 1), dtype=np.int64)
    film, air = np.ones(len(l_G)), np.ones(len(l_G))
    put_in, lost = 0.0, 0.0
    for row in range(rows):
        trace[row] = t
        if row == rows - 1:
            break
        for k in range(len(l_G)):
            film[k], air[k] = 1.0, 1.0
            if l_flow[k] >= 0:
                film[k] = max(pump[row, l_flow[k]], 0.02) ** l_flow_exp[k]
            if l_fan_exp[k] > 0.0:
                air[k] = (0.04 + max(fan[row], 0.0) ** l_fan_exp[k]) * fan_noise[row]
        for q in range(len(q_kg)):
            pumped[q] = q_kg[q] * max(pump[row, q], 0.0) ** q_exp[q] * flow_noise[row]
        for _ in range(substeps):
            now[:] = enthalpy
            for stage in range(2):
                d = rate[stage]
                d[:] = 0.0
                gained, gone = 0.0, 0.0
                factor[:] = 1.0
                gate[:] = gate0
                for q in range(len(q_kg)):
                    warm = t[q_cell[q]] - 25.0
                    kg[q] = pumped[q] * (1.0 - q_density[q] * warm) * (1.0 + q_viscosity[q] * warm)
                for k in range(count):
                    target, index, index2, law, sense, other = whole[k]
                    at = t[sense]
                    strength = amplitudes[k, row]
                    if law == 1:
                        if stage == 0:
                            if at > limits[k, 0]:
                                on[k] = 1
                            elif at < limits[k, 1]:
                                on[k] = 0
                        strength *= on[k]
                    elif law == 2:
                        strength *= at - limits[k, 0]
                    elif law == 3:
                        gap = at - (room[row] if other < 0 else t[other])
                        strength *= np.sign(gap) * abs(gap) ** limits[k, 0]
                    elif law == 4:
                        strength *= _pressure(at) - humidity[row] * _pressure(room[row])
                    elif law == 5:
                        strength *= max(at - limits[k, 0], 0.0)
                    if target == 0:
                        d[index] += strength
                        gained += strength
                    elif target == 1:
                        kg[index] *= max(1.0 + strength, 0.05)
                    elif target == 2:
                        factor[index] *= max(1.0 + strength, 0.0)
                    elif target == 3:
                        gate[index] = min(max(gate[index] + strength, 0.0), 0.95)
                    else:
                        d[index] += strength
                        d[index2] -= strength
                for k in range(len(h_cell)):
                    power = heat[row, h_column[k]] * h_share[k]
                    d[h_cell[k]] += power
                    gained += power
                for k in range(len(s_from)):
                    share = s_share[k]
                    if s_gate[k] >= 0:
                        beta = gate[s_gate[k]]
                        share *= beta if s_skips[k] == 1 else 1.0 - beta
                    a, b, q = s_from[k], s_to[k], s_loop[k]
                    # Both ends of a stream hold the same fluid.
                    c, e = q_cp[q], curvature[b]
                    d[b] += kg[q] * share * c * (t[a] + 0.5 * e * t[a] * t[a] - t[b] - 0.5 * e * t[b] * t[b])
                for k in range(len(l_G)):
                    a, b = l_a[k], l_b[k]
                    far = room[row] if b < 0 else t[b]
                    gap = t[a] - far
                    g = l_G[k] * film[k] * air[k] * factor[l_group[k]]
                    if l_warmth[k] != 0.0:
                        g *= max(1.0 + l_warmth[k] * (0.5 * (t[a] + far) - 25.0), 0.1)
                    if l_natural[k] == 1:
                        g *= np.sqrt(np.sqrt(abs(gap) / 20.0))
                    if l_layer[k] == 1 and gap < 0.0:
                        g *= LAYER_BOOST
                    flow = g * gap
                    d[a] -= flow
                    if b < 0:
                        gone += flow
                    else:
                        d[b] += flow
                put_in += 0.5 * dt * gained
                lost += 0.5 * dt * gone
                for i in range(n):
                    if stage == 0:
                        enthalpy[i] = now[i] + dt * d[i]
                    else:
                        enthalpy[i] = now[i] + 0.5 * dt * (rate[0, i] + d[i])
                    h = enthalpy[i] / capacity[i]
                    c = curvature[i]
                    t[i] = h if c == 0.0 else (np.sqrt(1.0 + 2.0 * c * h) - 1.0) / c
    return enthalpy.sum() - before, put_in, lost
