"""Compiled physics of the plant: explicit finite volumes on the ring of water cells, fixed substep.

Advection is first-order upwind with the enthalpy as carried quantity, so the scheme conserves energy to rounding;
its numerical diffusion at 0.1 s and 25 mL cells stands in for the axial dispersion of a real hose (a step arrives
smeared by about 1 s after 16 cells). All conductances are far below the explicit limit at 0.1 s.
"""

import ctypes
import functools
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np

from drivers.virtual.plant import geometry, water
from drivers.virtual.plant.geometry import MAX_HEATER_W, Array, Cells
from drivers.virtual.plant.machine_code import compiled_kernel, machine_code
from drivers.virtual.plant.water import density_of, temperature_of, viscosity_of

SUBSTEP_S = 0.1

TANK_JET_MIXING = 9.0
"""Water exchanged between the zones per unit of return flow."""
TANK_FLOOR_MIXING = 0.004
"""kg/s exchanged without any flow."""
TANK_OVERTURN_MIXING = 0.4
"""kg/s exchanged when the lower zone is the warmer one."""
LID_LOSS = 0.55
"""W/K at 10 K above the room; free convection, grows with dT ** 0.25."""

ELEMENT_J_PER_K = 260.0
ELEMENT_FILM = 48.0
ELEMENT_FILM_FLOOR = 9.0
ELEMENT_FILM_EXPONENT = 0.45
"""The electric element, spread over the heater's cells."""
HEATER_LAG_S = 1.8
HEATER_DROOP = 0.004
"""Relative loss of power at 1000 W: the element's resistance rises."""

NOMINAL_FLOW_L_PER_MIN = 3.785
PUMP_LAG_S = 1.4
FAN_LAG_S = 2.6
VISCOSITY_EXPONENT = 0.04
VISCOSITY_REFERENCE = 0.72e-3
"""Pa s at which the pump delivers its nominal flow (35 degC)."""
MAX_FLOW_L_PER_MIN = 8.0
"""Beyond this a 25 mL cell would be swept out in less than two 0.1 s substeps."""

AIR_W_PER_K = 104.0
"""Heat capacity rate of the air at 100 % fan speed; proportional to the speed."""
AIR_FLOOR_W_PER_K = 7.0
FIN_UA_W_PER_K = 115.0
"""Fin side at 100 % fan speed."""
FIN_UA_EXPONENT = 0.62
FIN_UA_FLOOR_W_PER_K = 5.0

# Places in the vector of slow states.
HEATER_W, PUMP, FAN, BLOCK_C, HEAT_IN_J, HEAT_OUT_J, FLOW, HOTTEST = range(8)
SLOW_STATES = 8

# Places in the vector of inputs: set-points (fractions but for the heater), room, and inputs that effects change.
(
    SET_HEATER_W,
    SET_PUMP,
    SET_FAN,
    AMBIENT_C,
    HEATER_GAIN,
    PUMP_GAIN,
    FAN_GAIN,
    FLOW_FACTOR,
    BYPASS,
    BYPASS_FIRST,
    BYPASS_LAST,
    UA_FACTOR,
    UA_EXPONENT,
    RECIRCULATION,
    BLOCK_J_PER_K,
    BLOCK_W_PER_K,
) = range(16)
INPUTS = 16

_HEATER, _MODULES, _RADIATOR, _TANK = 1, 3, 5, 7
_WHOLE_NUMBERS = (5, 7)
"""Arrays of integers among those of `Advance`: sections of the cells, and first cells of the sections."""


@compiled_kernel
def _advance(
    cells: Cells,
    lag: Array,
    inputs: Array,
    power_water: Array,
    power_solid: Array,
    loss: Array,
    loss_exponent: Array,
    enthalpy: Array,
    solid: Array,
    element: Array,
    junction: Array,
    slow: Array,
    film: Array,
    substeps: int,
    dt: float,
) -> None:
    """Advance the plant by `substeps` of `dt` seconds in place.

    enthalpy (CELLS,) J/kg; solid (CELLS,) degC; element (heater cells,) degC; junction (9,) degC;
    slow (SLOW_STATES,); power_* (CELLS,) W and loss (CELLS,) W/K with loss_exponent (CELLS,) come from effects;
    film (sections,) is scratch; lag (9,) s.
    """
    n = enthalpy.size
    ambient = inputs[AMBIENT_C]
    pump_share = 1.0 - np.exp(-dt / PUMP_LAG_S)
    fan_share = 1.0 - np.exp(-dt / FAN_LAG_S)
    heater_share = 1.0 - np.exp(-dt / HEATER_LAG_S)
    bypass = inputs[BYPASS]
    bypass_first, bypass_last = int(inputs[BYPASS_FIRST]), int(inputs[BYPASS_LAST])
    heater0 = cells.first_cell[_HEATER]
    radiator0 = cells.first_cell[_RADIATOR]
    radiator_n = cells.first_cell[_RADIATOR + 1] - radiator0
    upper, lower = n - 2, n - 1
    recirculation = inputs[RECIRCULATION]

    for _ in range(substeps):
        target_w = inputs[SET_HEATER_W] * (1.0 - HEATER_DROOP * inputs[SET_HEATER_W] / MAX_HEATER_W)
        slow[HEATER_W] += heater_share * (target_w - slow[HEATER_W])
        slow[PUMP] += pump_share * (inputs[SET_PUMP] - slow[PUMP])
        slow[FAN] += fan_share * (inputs[SET_FAN] * inputs[FAN_GAIN] - slow[FAN])

        t_lower = temperature_of(enthalpy[lower])
        viscosity = (VISCOSITY_REFERENCE / viscosity_of(t_lower)) ** VISCOSITY_EXPONENT
        litres = NOMINAL_FLOW_L_PER_MIN * slow[PUMP] * inputs[PUMP_GAIN] * inputs[FLOW_FACTOR] * viscosity
        litres = min(max(litres, 0.0), MAX_FLOW_L_PER_MIN)
        slow[FLOW] = litres
        ratio = litres / NOMINAL_FLOW_L_PER_MIN
        flow = litres / 60000.0 * density_of(t_lower)

        for k in range(film.size):
            film[k] = ratio ** cells.film_exponent[k] if cells.film_exponent[k] > 0.0 else 1.0

        air_in, fin_air = _air_side(inputs, slow[FAN], ambient, recirculation, solid, radiator0, radiator_n)

        heat_in = slow[HEATER_W] * inputs[HEATER_GAIN]
        heat_out = 0.0
        element_film = max(ELEMENT_FILM * ratio**ELEMENT_FILM_EXPONENT, ELEMENT_FILM_FLOOR)
        element_film /= element.size
        to_element = heat_in / element.size

        t_upper = temperature_of(enthalpy[upper])
        mixing = TANK_JET_MIXING * flow + TANK_FLOOR_MIXING
        if t_lower > t_upper:
            mixing += TANK_OVERTURN_MIXING
        exchanged = mixing * (enthalpy[upper] - enthalpy[lower])
        lid_dt = t_upper - ambient
        lid = LID_LOSS * (abs(lid_dt) * 0.1) ** 0.25 * lid_dt
        to_block = inputs[BLOCK_W_PER_K] * (t_lower - slow[BLOCK_C])
        if inputs[BLOCK_J_PER_K] > 0.0:
            slow[BLOCK_C] += dt * to_block / inputs[BLOCK_J_PER_K]

        # From the last cell to the first, so that each still sees its neighbour's old enthalpy.
        feed = enthalpy[lower]
        for i in range(n - 1, -1, -1):
            k = cells.section[i]
            t = temperature_of(enthalpy[i])
            s = solid[i]
            from_solid = max(cells.film[i] * film[k], cells.film_floor[i]) * (s - t)
            into_water = from_solid + power_water[i]
            into_solid = power_solid[i] - from_solid
            heat_in += power_water[i] + power_solid[i]

            lost = cells.outer[i] * (s - ambient)
            if loss[i] != 0.0:
                extra = loss[i] * (s - ambient)
                if loss_exponent[i] != 1.0:
                    extra *= (abs(s - ambient) * 0.1) ** (loss_exponent[i] - 1.0)
                lost += extra
            if k == _HEATER:
                wire = element[i - heater0]
                released = element_film * (wire - t)
                into_water += released
                element[i - heater0] = wire + dt * (to_element - released) * element.size / ELEMENT_J_PER_K
            elif k == _RADIATOR:
                lost += fin_air * (s - air_in)
            elif i == upper:
                into_water -= exchanged + lid
                heat_out += lid
            elif i == lower:
                into_water += exchanged - to_block
            heat_out += lost
            solid[i] = s + dt * (into_solid - lost) / cells.solid_J_per_K[i]

            here = flow
            inlet = feed if i == 0 else enthalpy[i - 1]
            if bypass > 0.0:
                if bypass_first <= i < bypass_last:
                    here = flow * (1.0 - bypass)
                elif i == bypass_last:
                    inlet += bypass * (enthalpy[bypass_first - 1] - inlet)
            enthalpy[i] += dt * (here * (inlet - enthalpy[i]) + into_water) / cells.water_kg[i]

        slow[HEAT_IN_J] += heat_in * dt
        slow[HEAT_OUT_J] += heat_out * dt

        modules0 = cells.first_cell[_MODULES]
        for c in range(junction.size):
            if c == 0:
                true = temperature_of(enthalpy[heater0 + element.size - 1])
            elif c == 7:
                true = temperature_of(enthalpy[radiator0 + radiator_n - 1])
            elif c == 8:
                true = temperature_of(enthalpy[lower])
            else:
                true = solid[modules0 + c - 1]
            junction[c] += (true - junction[c]) * dt / (lag[c] + dt)

    hottest = temperature_of(enthalpy[heater0])
    for i in range(heater0 + 1, heater0 + element.size):
        hottest = max(hottest, temperature_of(enthalpy[i]))
    slow[HOTTEST] = hottest


def _air_side(
    inputs: Array, fan: float, ambient: float, recirculation: float, solid: Array, first: int, count: int
) -> tuple[float, float]:
    """Return the temperature in degC of the air entering the radiator, and W/K from one cell's fins to that air.

    Each cell takes an equal slice of the air (cross flow): effectiveness 1 - exp(-NTU) against its fin block.
    Recirculated exhaust warms the inlet: with T_in = ambient + k Q and Q = sum(G (fin - T_in)), solved for Q.
    """
    air = AIR_W_PER_K * fan + AIR_FLOOR_W_PER_K
    forced = FIN_UA_W_PER_K * fan ** (FIN_UA_EXPONENT + inputs[UA_EXPONENT])
    ua = (forced**3 + FIN_UA_FLOOR_W_PER_K**3) ** (1.0 / 3.0) * inputs[UA_FACTOR]
    one = air / count * (1.0 - np.exp(-ua / air))
    if recirculation <= 0.0:
        return ambient, one
    excess = 0.0
    for i in range(first, first + count):
        excess += solid[i] - ambient
    k = recirculation / (1.0 - recirculation) / air
    rejected = one * excess / (1.0 + k * one * count)
    return ambient + k * rejected, one


class Advance:
    """Advance of a plant's arrays in place, as machine code; the arrays are the arguments of `_advance`, in order.

    Raises TypeError for an array of another size or kind: the machine code would write beside it.
    """

    def __init__(self, cells: Cells, lag: Array, *arrays: Array) -> None:
        # Kept alive, since the machine code has their addresses alone.
        self._arrays = (*map(np.ascontiguousarray, cells), np.ascontiguousarray(lag), *arrays)
        n, sections, heater, channels = cells.water_kg.size, cells.film_exponent.size, arrays[-4].size, lag.size
        sizes = [n] * 6 + [sections] * 2 + [channels, INPUTS] + [n] * 6 + [heater, channels, SLOW_STATES, sections]
        for k, (array, size) in enumerate(zip(self._arrays, sizes, strict=True)):
            kind = np.int64 if k in _WHOLE_NUMBERS else np.float64
            if array.shape != (size,) or array.dtype != kind or not array.flags.c_contiguous:
                raise TypeError(f"array {k} of the plant is {array.dtype} {array.shape}, not {kind.__name__} ({size},)")
        self._addresses = np.array([array.ctypes.data for array in self._arrays], dtype=np.uintp)
        self._sizes = np.array([n, sections, heater, channels], dtype=np.int64)
        self._unused = np.zeros(2, dtype=np.uintp)  # result and error of numba's calling convention
        result, table = self._unused.ctypes.data, self._addresses.ctypes.data
        self._at = (result, result + self._unused.itemsize, table, table, self._sizes.ctypes.data)
        self._code = _machine_code()

    def __call__(self, substeps: int, dt: float) -> None:
        """Advance by `substeps` of `dt` seconds."""
        self._code(*self._at, substeps, dt)


@functools.cache
def _machine_code() -> Callable[..., int]:
    table = ctypes.c_void_p
    return machine_code(
        "plant_advance",
        _compiled,
        [Path(str(module)) for module in (__file__, water.__file__, geometry.__file__)],
        (table, table, table, ctypes.c_int64, ctypes.c_double),
    )


def _compiled() -> tuple[str, str]:
    """Compile `_advance` with all that it calls; return its LLVM code and its name there."""
    import numba
    from numba import carray, types

    njit: Any = numba.njit  # its annotations lack the options that keep Python's interface out

    def jit(function: Any, inline: bool = False, **names: Any) -> Any:
        own = FunctionType(function.__code__, {**function.__globals__, **names}, function.__name__)
        return njit(own, error_model="numpy", forceinline=inline)

    named = {function.__name__: jit(function) for function in (temperature_of, density_of, viscosity_of, _air_side)}
    advance = jit(_advance, True, **named)

    def entry(doubles: Any, integers: Any, sizes: Any, substeps: int, dt: float) -> None:
        """Call `_advance` with the arrays at addresses: `doubles` and `integers` are the same table of them."""
        n, sections, heater, channels = sizes[0], sizes[1], sizes[2], sizes[3]
        cells = Cells(
            carray(doubles[0], n),
            carray(doubles[1], n),
            carray(doubles[2], n),
            carray(doubles[3], n),
            carray(doubles[4], n),
            carray(integers[5], n),
            carray(doubles[6], sections),
            carray(integers[7], sections),
        )
        advance(
            cells,
            carray(doubles[8], channels),
            carray(doubles[9], INPUTS),
            carray(doubles[10], n),
            carray(doubles[11], n),
            carray(doubles[12], n),
            carray(doubles[13], n),
            carray(doubles[14], n),
            carray(doubles[15], n),
            carray(doubles[16], heater),
            carray(doubles[17], channels),
            carray(doubles[18], SLOW_STATES),
            carray(doubles[19], sections),
            substeps,
            dt,
        )

    table = types.CPointer(types.CPointer(types.float64)), types.CPointer(types.CPointer(types.int64))
    signature = types.void(*table, types.CPointer(types.int64), types.int64, types.float64)
    found = njit(signature, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)(entry)
    (kind,) = found.signatures
    return found.inspect_llvm(kind), found.overloads[kind].fndesc.llvm_func_name
