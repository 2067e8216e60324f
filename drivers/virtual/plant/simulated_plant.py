"""Interface of a plant of the virtual rig: the built-in physics, or an FMU in its place."""

from __future__ import annotations

from typing import Protocol

from drivers.virtual.plant.geometry import Array


class SimulatedPlant(Protocol):
    """Coolant loop that advances one period at a time; `junction` is (9,) in degC, in the order of `CHANNELS`."""

    steps: int
    ambient_C: float
    junction: Array

    @property
    def time_s(self) -> float:
        """Rig time in s."""

    @property
    def heater_power_W(self) -> float:
        """Electrical power at the heater's meter, W."""

    @property
    def flow_L_per_min(self) -> float:
        """Flow at the pump, L/min."""

    @property
    def pump_speed_pct(self) -> float:
        """Speed of the pump's shaft, %."""

    @property
    def fan_speed_pct(self) -> float:
        """Speed of the fans, %."""

    @property
    def heater_water_C(self) -> float:
        """Temperature at the thermostat's bulb, degC."""

    def step(self, heater_W: float, pump_fraction: float, fan_fraction: float) -> None:
        """Advance one period with set-points in W and fractions of full speed."""
