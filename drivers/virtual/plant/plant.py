"""Plant of the virtual rig: set-points in, junction temperatures and read-backs out, one period at a time."""

import numpy as np

from drivers.virtual.plant import kernel as k
from drivers.virtual.plant.ambient import Room
from drivers.virtual.plant.effect_physics import EffectPhysics, neutral_inputs
from drivers.virtual.plant.effects import PlantEffect
from drivers.virtual.plant.geometry import CELLS, JUNCTION_LAG_S, Array, Cells, build_cells, section_cells
from drivers.virtual.plant.water import enthalpy_of, temperature_of


class Plant:
    """Coolant loop at rig time `time_s`; deterministic for a seed and a sequence of set-points.

    `junction` is (9,) in degC, the true temperatures of the thermocouples' junctions in the order of `CHANNELS`.
    """

    def __init__(
        self,
        *,
        seed: int = 0,
        period_s: float = 1.0,
        effects: tuple[PlantEffect, ...] = (),
        start_C: float | None = None,
        start_s: float = 0.0,
        cells: Cells | None = None,
    ) -> None:
        """Make a plant of `cells` (by default the built rig's) at rig time `start_s` in s and `start_C` in degC."""
        self.period_s = period_s
        self.steps = round(start_s / period_s)
        self._cells = build_cells() if cells is None else cells
        self._room = Room(seed, period_s)
        self._physics = EffectPhysics(effects, self._cells)
        self._lag = np.array(JUNCTION_LAG_S)
        self._substeps = max(1, int(np.ceil(period_s / k.SUBSTEP_S - 1e-9)))
        self._dt = period_s / self._substeps
        self._film = np.ones(self._cells.film_exponent.size)
        self.inputs: Array = np.zeros(k.INPUTS)
        neutral_inputs(self.inputs)
        for step in range(self.steps + 1):
            self.ambient_C = self._room.step(step * period_s)
        start = self.ambient_C if start_C is None else start_C
        self.enthalpy: Array = np.full(CELLS, enthalpy_of(start))
        self.solid: Array = np.full(CELLS, start)
        heater = section_cells("heater")
        self.element: Array = np.full(heater.stop - heater.start, start)
        self.junction: Array = np.full(len(JUNCTION_LAG_S), start)
        self.slow: Array = np.zeros(k.SLOW_STATES)
        self.slow[[k.BLOCK_C, k.HOTTEST]] = start
        physics = self._physics
        self._advance = k.Advance(
            self._cells,
            self._lag,
            self.inputs,
            physics.power_water,
            physics.power_solid,
            physics.loss,
            physics.loss_exponent,
            self.enthalpy,
            self.solid,
            self.element,
            self.junction,
            self.slow,
            self._film,
        )

    @property
    def time_s(self) -> float:
        """Rig time in s."""
        return self.steps * self.period_s

    @property
    def heater_power_W(self) -> float:
        """Electrical power at the heater's meter, W."""
        return float(self.slow[k.HEATER_W])

    @property
    def flow_L_per_min(self) -> float:
        """Flow at the pump, L/min."""
        return float(self.slow[k.FLOW])

    @property
    def pump_speed_pct(self) -> float:
        """Speed of the pump's shaft, %."""
        return 100.0 * float(self.slow[k.PUMP])

    @property
    def fan_speed_pct(self) -> float:
        """Speed of the fans, %."""
        return 100.0 * float(self.slow[k.FAN])

    @property
    def heater_water_C(self) -> float:
        """Temperature of the hottest water in the heater, at the thermostat's bulb, degC."""
        return float(self.slow[k.HOTTEST])

    def step(self, heater_W: float, pump_fraction: float, fan_fraction: float) -> None:
        """Advance one period with set-points in W and fractions of full speed."""
        inputs = self.inputs
        inputs[k.SET_HEATER_W] = heater_W
        inputs[k.SET_PUMP] = pump_fraction
        inputs[k.SET_FAN] = fan_fraction
        inputs[k.AMBIENT_C] = self.ambient_C
        if self._physics.effects:
            self._apply_effects()
        self._advance(self._substeps, self._dt)
        self.steps += 1
        self.ambient_C = self._room.step(self.steps * self.period_s)

    def _apply_effects(self) -> None:
        """Apply effects; count the heat of a body that joins the tank at its temperature, or leaves with its own."""
        slow, inputs = self.slow, self.inputs
        before = inputs[k.BLOCK_J_PER_K]
        self._physics.apply(self.time_s, inputs, slow, self.solid)
        after = inputs[k.BLOCK_J_PER_K]
        if after != before:
            slow[k.HEAT_OUT_J] += before * slow[k.BLOCK_C]
            slow[k.BLOCK_C] = temperature_of(self.enthalpy[-1])
            slow[k.HEAT_IN_J] += after * slow[k.BLOCK_C]

    def stored_J(self) -> float:
        """Return the heat, J, stored above 0 degC in water, solids, heater element and any body in the tank."""
        cells = self._cells
        return float(
            cells.water_kg @ self.enthalpy
            + cells.solid_J_per_K @ self.solid
            + k.ELEMENT_J_PER_K * self.element.mean()
            + self.inputs[k.BLOCK_J_PER_K] * self.slow[k.BLOCK_C]
        )

    def heat_in_J(self) -> float:
        """Return the heat, J, that entered since the start: heater and effects' sources."""
        return float(self.slow[k.HEAT_IN_J])

    def heat_out_J(self) -> float:
        """Return the heat, J, that left to the room since the start."""
        return float(self.slow[k.HEAT_OUT_J])
