"""The station's minutes, compiled: control, hydraulics, cells, shared basin. One pass in the order of time.

Fill and air are at rest within a minute; film, flume, basin, header, drives and thermometers are first-order lags
that are solved exactly over it. Columns of the results are named by `OF_CELL` and `OF_STATION`.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from drivers.virtual.tower.physics.cell import M_W0, RECIRCULATION, RECIRCULATION_WIND, cell_step
from drivers.virtual.tower.physics.moist_air import CP_WATER, wet_bulb

Array = NDArray[Any]
OF_CELL = (
    "t_in",
    "t_out",
    "t_rtd",
    "t_basin",
    "m_w",
    "m_a",
    "valve",
    "command",
    "speed",
    "power",
    "fault",
    "on",
    "bypass",
    "evaporation",
    "wet_in",
)
OF_STATION = ("t_return", "t_supply", "header", "pump_power", "makeup", "blowdown", "level", "load")
NUMBERS = (
    "load_of_cell",
    "setpoint",
    "header_volume",
    "basin_volume",
    "cells_per_pump",
    "variable_speed",
    "bypass_share",
    "first_cells",
    "least_speed",
    "film_s",
    "flume_s",
    "makeup_C",
)
"""Numbers of a station: design heat of a cell kW, set-point degC, volumes m3, cells that a pump serves, 1 for pumps of
variable speed, hot share that an open bypass leads past the fill, cells of the first compartment, least fan speed, time
constants of film and flume at design flow s, temperature of the makeup degC."""
HIDDEN = ("recirculation", "direction", "leak", "leaking_cell", "sun", "neighbour")
"""Undeclared effects: exhaust that comes back per m/s of wind from a direction deg; hot share past the fill of one cell
(numbered from 0); heat of the sun kW per W/m2 and cell; exhaust of the neighbours at full speed."""
(
    LOAD_OF_CELL,
    SETPOINT,
    HEADER_VOLUME,
    BASIN_VOLUME,
    CELLS_PER_PUMP,
    VARIABLE_SPEED,
    BYPASS_SHARE,
    FIRST_CELLS,
    LEAST_SPEED,
    FILM_S,
    FLUME_S,
    MAKEUP_C,
) = range(len(NUMBERS))
(
    T_IN,
    T_OUT,
    T_RTD,
    T_BASIN,
    WATER,
    AIR,
    VALVE,
    COMMAND,
    SPEED,
    POWER,
    FAULT,
    ON,
    BYPASS,
    EVAPORATION,
    WET_IN,
) = range(len(OF_CELL))

DT = 60.0
RAMP = 0.25
"""Change of speed that a drive allows, share of full speed a minute."""
DEADBAND_K, START_K, STOP_K, BYPASS_K = 0.2, 0.3, 0.8, 2.0
GAIN, RESET = 0.12, 0.02
"""Gains of the fan control: speed per K, and per K and minute."""
HOLD_MIN = 90
"""Minutes between two decisions on the number of cells in service."""
FAN_HOLD_MIN = 8
BUSY, IDLE = 0.92, 0.82
"""Load of the cells in service over their design load at which one more starts; the same of the cells that remain, at
which one stops."""
LAG_BELOW, LEAD_ABOVE = 0.70, 0.80
"""Loads, over that of the cells in service, at which the lag pump stops and starts."""
SHUT_OFF, PUMP_DROP, LIFT, RISER = 1.30, 0.30, 0.45, 0.55
"""Heads, in those of design: pump at no flow, its fall at design flow, height, friction of the riser at design flow."""
HEAD_KPA, PUMP_IDLE, PUMP_WORK = 150.0, 0.07, 0.31
"""Head of design, kPa; power of a pump per kg/s of its design flow, kW: without flow, and with flow and head of
design."""
PIPE_LOSS_K = 0.02
RISER_S, STILL_FLUME_S, STANDING_S = 25.0, 5400.0, 36000.0
"""Time constants of riser and distribution, of a flume without flow, and of a header without flow."""
EXCHANGE_KG_S = 60.0
"""Between the compartments, by eddies; the net flow comes on top."""
CYCLES_HIGH, CYCLES_LOW = 4.0, 3.8
LEVEL_LOW, LEVEL_HIGH = 62.0, 66.0
MAKEUP_SHARE = 0.03
"""Makeup of an open valve over the design circulation: twice the evaporation at design load."""
BLOWDOWN_SHARE = 0.006
"""Blowdown of an open valve over the circulation: twice what four cycles take at half load."""
DRIFT_LOSS = 5e-5


@njit
def run(
    cells: Array,
    shares: Array,
    numbers: Array,
    hidden: Array,
    rtd_s: Array,
    weather: Array,
    states: Array,
    load: Array,
    outage: Array,
    trips: Array,
    test_speed: Array,
    test_flow: Array,
    lead: Array,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the results by minute of the cells (n, cells, columns) and of the station (n, columns), float32.

    `cells (c, .)` and `shares (c, 4, sectors)` as in `cell`; `rtd_s (c,)`; `weather (n, 6)`: dry bulb, ratio, kPa,
    m/s, deg, W/m2; `states (days, c, .)` at the beginning of each day, joined by lines; `load (n,)` kW; `outage
    (n,)`; `trips`, `test_speed`, `test_flow (n, c)`: fans tripped, and tests (NaN: none); `lead (n,)`: cell that
    starts first.
    """
    n, count = len(load), len(cells)
    sectors = shares.shape[2]
    out = np.zeros((n, count, 15), dtype=np.float32)
    station = np.zeros((n, 8), dtype=np.float32)
    start = numbers[SETPOINT]
    memory = np.zeros((count, 2 * sectors + 2))
    memory[:, :sectors] = start
    memory[:, sectors : 2 * sectors] = 0.02
    memory[:, 2 * sectors], memory[:, 2 * sectors + 1] = start, 0.018
    t_in, film, flume, rtd = (
        np.full(count, start + 5.0),
        np.full(count, start),
        np.full(count, start),
        np.full(count, start),
    )
    valve, speed, since_on, command = np.ones(count), np.full(count, 0.5), np.full(count, 999), np.full(count, 0.5)
    bypass = np.zeros(count)
    m_w = np.zeros(count)
    left_w = np.zeros(count)
    pool = np.array([start, start])
    t_return, level, cycles = start + 5.0, 64.0, 3.9
    filling, bleeding, open_bypass = False, False, False
    demand, before, fans, in_service = 0.5, 0.0, count, count
    held, fan_held, running_pumps, lagging = 0, 0, 1.0, False
    state = np.zeros(states.shape[2])
    for k in range(n):
        dry, ratio, p, wind, direction, sun = weather[k]
        supply = 0.5 * (pool[0] + pool[1])
        stopped = outage[k]
        # Cells in service.
        share = load[k] / (numbers[LOAD_OF_CELL] * max(in_service, 1))
        held += 1
        if held >= HOLD_MIN:
            if share > BUSY and in_service < count:
                in_service, held = in_service + 1, 0
            elif in_service > 1 and share * in_service / (in_service - 1) < IDLE:
                in_service, held = in_service - 1, 0
        # Fans on the temperature of the supply.
        error = supply - numbers[SETPOINT]
        fan_held += 1
        if abs(error) > DEADBAND_K:
            demand += GAIN * (error - before) + RESET * error
        demand = min(max(demand, numbers[LEAST_SPEED]), 1.0)
        before = error
        if fan_held >= FAN_HOLD_MIN:
            if demand > 0.95 and error > START_K and fans < in_service:
                fans, fan_held, demand = fans + 1, 0, 0.7
            elif demand <= numbers[LEAST_SPEED] + 1e-9 and error < -STOP_K and fans > 0:
                fans, fan_held = fans - 1, 0
            elif fans == 0 and error > START_K:
                fans, fan_held = 1, 0
        fans = min(fans, in_service)
        open_bypass = (fans == 0 and error < -BYPASS_K) or (open_bypass and error < -STOP_K)
        # Water.
        total_valve = 0.0
        for c in range(count):
            turn = (c - lead[k]) % count
            wanted = 1.0 if (turn < in_service or test_flow[k, c] == test_flow[k, c]) and not stopped else 0.0
            valve[c] += min(max(wanted - valve[c], -0.5), 0.5)
            total_valve += valve[c]
        lagging = share < LAG_BELOW or (lagging and share < LEAD_ABOVE)
        pumps = max(np.ceil(in_service / numbers[CELLS_PER_PUMP] - 0.6 * lagging), 1.0)
        running_pumps += min(max(pumps - running_pumps, -1.0), 1.0)
        pump_speed = 1.0 if numbers[VARIABLE_SPEED] < 0.5 else min(max(0.82 + 0.22 * share, 0.85), 1.02)
        per_pump = total_valve / (running_pumps * numbers[CELLS_PER_PUMP])
        square = (SHUT_OFF * pump_speed**2 - LIFT) / (RISER + PUMP_DROP * per_pump**2)
        rate = 0.0 if stopped else np.sqrt(max(square, 0.0))
        flow = 0.0
        for c in range(count):
            wanted_flow = cells[c, M_W0] * rate * valve[c]
            if test_flow[k, c] == test_flow[k, c]:
                wanted_flow = cells[c, M_W0] * test_flow[k, c] * min(valve[c], 1.0) * (rate > 0.0)
            m_w[c] += 0.8 * (wanted_flow - m_w[c])
            if m_w[c] < 0.02 * cells[c, M_W0]:
                m_w[c] = 0.0
            flow += m_w[c]
        # Process and return.
        heat = 0.0 if stopped else load[k]
        if flow > 1.0:
            target = supply + heat / (flow * CP_WATER * 1e-3)
            t_return += (target - t_return) * (1.0 - np.exp(-flow * DT / (numbers[HEADER_VOLUME] * 1e3)))
        else:
            t_return += (dry - t_return) * (1.0 - np.exp(-DT / STANDING_S))
        day = k / 1440.0
        d = min(int(day), len(states) - 2)
        part = day - d
        evaporated, in_first, in_second, first_flow, second_flow = 0.0, 0.0, 0.0, 0.0, 0.0
        blow = max(0.0, np.cos(np.deg2rad(direction - hidden[1])))
        # Exhaust and speeds of the minute before, so that the order of the cells does not matter.
        exit_t, exit_w, speeds_before = memory[:, 2 * sectors].copy(), memory[:, 2 * sectors + 1].copy(), speed.copy()
        for c in range(count):
            on = m_w[c] > 0.0
            since_on[c] = since_on[c] + 1 if on else 0
            turn = (c - lead[k]) % count
            asked = demand if turn < fans and since_on[c] > 3 and not stopped else 0.0
            if test_speed[k, c] == test_speed[k, c] and on:
                asked = test_speed[k, c]
            command[c] = asked
            if trips[k, c]:
                speed[c] *= 0.3
            else:
                speed[c] += min(max(asked - speed[c], -RAMP), RAMP)
            if speed[c] < 0.01:
                speed[c] = 0.0
            wanted = 1.0 if open_bypass and turn == 0 and on else 0.0
            bypass[c] += min(max(wanted - bypass[c], -0.5), 0.5)
            # Air that enters: ambient, own exhaust, and what the effects bring.
            own = cells[c, RECIRCULATION] + cells[c, RECIRCULATION_WIND] * wind + hidden[0] * blow * wind
            own = min(own, 0.35)
            t_air, w_air = dry + own * (exit_t[c] - dry), ratio + own * (exit_w[c] - ratio)
            if hidden[5] > 0.0 and count > 1:
                for other in range(count):
                    if other != c:
                        mixed = hidden[5] * speeds_before[other] / (count - 1)
                        t_air += mixed * (exit_t[other] - dry)
                        w_air += mixed * (exit_w[other] - ratio)
            if on:
                t_in[c] += (t_return - PIPE_LOSS_K - t_in[c]) * (1.0 - np.exp(-DT / RISER_S))
            for j in range(len(state)):
                state[j] = states[d, c, j] + part * (states[d + 1, c, j] - states[d, c, j])
            past = bypass[c] * numbers[BYPASS_SHARE]
            if c == int(hidden[3]):
                past += hidden[2]
            over = m_w[c] * (1.0 - past)
            t_fill, left, air, _, _, power, lost = cell_step(
                cells[c], state, shares[c], over, speed[c], t_in[c], t_air, w_air, p, wind, memory[c]
            )
            if on:
                load_share = m_w[c] / cells[c, M_W0]
                film[c] += (t_fill - film[c]) * (1.0 - np.exp(-DT / numbers[FILM_S] * max(load_share, 0.2) ** 0.4))
                arriving = left + past * m_w[c]
                mixed_t = (left * film[c] + past * m_w[c] * t_in[c]) / arriving
                mixed_t += hidden[4] * sun / (arriving * CP_WATER * 1e-3)
                flume[c] += (mixed_t - flume[c]) * (1.0 - np.exp(-DT / numbers[FLUME_S] * load_share))
                left_w[c] = arriving
            else:
                flume[c] += (pool[0 if c < numbers[FIRST_CELLS] else 1] - flume[c]) * (
                    1.0 - np.exp(-DT / STILL_FLUME_S)
                )
                left_w[c] = 0.0
                lost = 0.0
            rtd[c] += (flume[c] - rtd[c]) * (1.0 - np.exp(-DT / rtd_s[c]))
            evaporated += lost
            if c < numbers[FIRST_CELLS]:
                in_first += left_w[c] * flume[c]
                first_flow += left_w[c]
            else:
                in_second += left_w[c] * flume[c]
                second_flow += left_w[c]
            local = pool[0] if c < numbers[FIRST_CELLS] else pool[1]
            row = out[k, c]
            row[T_IN], row[T_OUT], row[T_RTD] = t_in[c], flume[c], rtd[c]
            row[T_BASIN] = 0.85 * local + 0.15 * flume[c] if on else local
            row[WATER], row[AIR], row[VALVE] = m_w[c], air, 100.0 * valve[c]
            row[COMMAND], row[SPEED], row[POWER] = 100.0 * asked, 100.0 * speed[c], power
            row[FAULT], row[ON], row[BYPASS], row[EVAPORATION] = trips[k, c], on, 100.0 * bypass[c], lost
            row[WET_IN] = wet_bulb(t_air, w_air, p)
        # Basin: two compartments, suction from both.
        makeup = 0.0
        if filling:
            makeup = MAKEUP_SHARE * cells[0, M_W0] * count
        blowdown = BLOWDOWN_SHARE * flow if bleeding and flow > 0.0 else 0.0
        mass = numbers[BASIN_VOLUME] * 500.0
        half = 0.5 * flow
        across = first_flow - half
        carried = pool[0] if across > 0.0 else pool[1]
        gain0 = in_first + makeup * numbers[MAKEUP_C] - (half + makeup) * pool[0] - across * carried
        gain0 += EXCHANGE_KG_S * (pool[1] - pool[0]) * (flow > 0.0)
        gain1 = in_second - half * pool[1] + across * carried + EXCHANGE_KG_S * (pool[0] - pool[1]) * (flow > 0.0)
        lost0, lost1 = half + across - first_flow, half - across - second_flow
        pool[0] += (gain0 + lost0 * pool[0]) * DT / mass
        pool[1] += (gain1 + lost1 * pool[1]) * DT / mass
        level += 100.0 * (makeup - blowdown - evaporated - DRIFT_LOSS * flow) * DT / (numbers[BASIN_VOLUME] * 1e3)
        filling = level < LEVEL_LOW or (filling and level < LEVEL_HIGH)
        water = numbers[BASIN_VOLUME] * 10.0 * level
        cycles += (
            (makeup - (blowdown + DRIFT_LOSS * flow) * cycles - (makeup - blowdown - evaporated) * cycles) * DT / water
        )
        bleeding = cycles > CYCLES_HIGH or (bleeding and cycles > CYCLES_LOW)
        through = flow / (cells[0, M_W0] * numbers[CELLS_PER_PUMP] * running_pumps)
        pressure = 0.0 if stopped else HEAD_KPA * (LIFT + RISER * rate * rate)
        pump_kw = 0.0
        if not stopped:
            head = SHUT_OFF * pump_speed**2 - PUMP_DROP * through * through
            pump_kw = (
                running_pumps * cells[0, M_W0] * numbers[CELLS_PER_PUMP] * (PUMP_IDLE + PUMP_WORK * through * head)
            )
        s = station[k]
        s[0], s[1], s[2], s[3] = t_return, supply, pressure, pump_kw
        s[4], s[5], s[6], s[7] = makeup, blowdown, level, heat
    return out, station
