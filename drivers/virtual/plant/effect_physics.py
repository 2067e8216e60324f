"""Effects as inputs of the plant's kernel: extra powers and losses per cell, gains and fractions."""

from collections.abc import Callable

import numpy as np

from drivers.virtual.plant import kernel as k
from drivers.virtual.plant.ambient import hour_of_day
from drivers.virtual.plant.effects import PlantEffect
from drivers.virtual.plant.geometry import (
    MAX_HEATER_W,
    MODULES,
    Array,
    Cells,
    section_cells,
)

_IN_SOLID = ("modules", "radiator", *MODULES)
"""Places at which heat enters the solid; elsewhere it enters the water (an immersed source)."""

EffectEnvelope = Callable[[float], float]


def _state_free(effect: PlantEffect) -> EffectEnvelope | None:
    """Return the size relative to `value` over rig time, for drivers that do not depend on the plant's state."""
    shape = effect.shape
    if effect.driver == "time_of_day":
        half = 0.5 * shape["width_h"]

        def daily(time_s: float) -> float:
            away = abs((hour_of_day(time_s) - shape["peak_hour"] + 12.0) % 24.0 - 12.0)
            return float(np.cos(0.5 * np.pi * away / half)) if away < half else 0.0

        return daily
    if effect.driver == "periodic":
        return lambda t: 1.0 if ((t - effect.onset_s) % shape["period_s"]) < shape["duty"] * shape["period_s"] else 0.0
    if effect.driver == "elapsed_time" and "tau_s" in shape:
        return lambda t: float(-np.expm1(-(t - effect.onset_s) / shape["tau_s"]))
    return None


class EffectPhysics:
    """Application of plant effects to the kernel's inputs once per period; does nothing while nothing changes."""

    def __init__(self, effects: tuple[PlantEffect, ...], cells: Cells) -> None:
        self.effects = tuple(effect for effect in effects if effect.kind != "sensor")
        size = cells.water_kg.size
        self.power_water, self.power_solid = np.zeros(size), np.zeros(size)
        self.loss, self.loss_exponent = np.zeros(size), np.ones(size)
        self._cells = cells
        self._shapes = [_state_free(effect) for effect in self.effects]
        self._tripped = [False] * len(self.effects)
        self._last: list[float] | None = None

    def apply(self, time_s: float, inputs: Array, slow: Array, solid: Array) -> None:
        """Write the effects of the period that starts at `time_s` into `inputs` and the per-cell arrays."""
        if not self.effects:
            return
        sizes = [self._size(number, time_s, slow, solid) for number in range(len(self.effects))]
        if sizes == self._last:
            return
        self._last = sizes
        self._neutral(inputs)
        for effect, size in zip(self.effects, sizes, strict=True):
            if size != 0.0 or effect.kind == "actuator":
                self._add(effect, size, inputs)

    def _neutral(self, inputs: Array) -> None:
        for array in (self.power_water, self.power_solid, self.loss):
            array[:] = 0.0
        self.loss_exponent[:] = 1.0
        neutral_inputs(inputs)

    def _size(self, number: int, time_s: float, slow: Array, solid: Array) -> float:
        """Return magnitude times envelope times driver at `time_s`, in the magnitude's unit."""
        effect = self.effects[number]
        size = effect.envelope(time_s) * effect.value
        if size == 0.0 and effect.magnitude != "gain":
            return 0.0
        shape = self._shapes[number]
        if shape is not None:
            return size * shape(time_s)
        if effect.kind == "heat_source":
            if effect.driver == "pump_speed":
                return size * float(slow[k.PUMP]) ** effect.shape["exponent"]
            if effect.driver == "fan_speed":
                return size * float(slow[k.FAN]) ** effect.shape["exponent"]
            if effect.driver == "heater_power":
                return size * float(slow[k.HEATER_W] / MAX_HEATER_W) ** effect.shape["exponent"]
            if effect.driver == "threshold":
                here = float(solid[section_cells(effect.where)].mean())
                edge = effect.shape["threshold_C"] - (effect.shape["hysteresis_K"] if self._tripped[number] else 0.0)
                self._tripped[number] = here > edge
                return size if self._tripped[number] else 0.0
        if effect.kind == "actuator":
            return 1.0 + effect.envelope(time_s) * (effect.value - 1.0)
        return size

    def _add(self, effect: PlantEffect, size: float, inputs: Array) -> None:
        if effect.kind == "heat_source":
            cells = section_cells(effect.where)
            target = self.power_solid if effect.where in _IN_SOLID else self.power_water
            target[cells] += size * self._shares(cells)
        elif effect.kind == "heat_loss":
            cells = section_cells(effect.where)
            self.loss[cells] += size * self._shares(cells)
            self.loss_exponent[cells] = effect.shape["exponent"]
        elif effect.magnitude == "exponent_change":
            inputs[k.UA_EXPONENT] += size
        elif effect.magnitude == "recirculated_fraction":
            inputs[k.RECIRCULATION] = size
        elif effect.magnitude == "bypass_fraction":
            cells = section_cells(effect.where)
            inputs[k.BYPASS], inputs[k.BYPASS_FIRST], inputs[k.BYPASS_LAST] = size, cells.start, cells.stop
        elif effect.kind == "thermal_mass":
            inputs[k.BLOCK_J_PER_K] = size
            inputs[k.BLOCK_W_PER_K] = effect.shape["conductance_W_per_K"]
        elif effect.kind == "actuator":
            gain = {"heater_power": k.HEATER_GAIN, "pump_speed": k.PUMP_GAIN, "fan_speed": k.FAN_GAIN}
            inputs[gain[effect.where]] *= size
        else:
            place = k.UA_FACTOR if effect.kind == "heat_rejection" else k.FLOW_FACTOR
            inputs[place] *= 1.0 - size

    def _shares(self, cells: slice) -> Array:
        """Return the shares of a section's heat in its cells: by water mass (equal but for the tank's zones)."""
        water = self._cells.water_kg[cells]
        return water / water.sum()


def neutral_inputs(inputs: Array) -> None:
    """Set the inputs of a healthy rig: gains of one, nothing bypassed, recirculated or immersed."""
    inputs[k.HEATER_GAIN :] = 0.0
    inputs[[k.HEATER_GAIN, k.PUMP_GAIN, k.FAN_GAIN, k.FLOW_FACTOR, k.UA_FACTOR]] = 1.0
