"""Sensor faults of the virtual rig's readings: bias, drift, extra lag, stuck value, jumps, open circuit."""

import math
from collections.abc import Sequence

from drivers.virtual.plant.effects import PlantEffect


class SensorFaults:
    """Application of the sensor effects that concern `columns`, in place, once per period."""

    def __init__(self, effects: tuple[PlantEffect, ...], columns: Sequence[str]) -> None:
        self._entries = [
            (columns.index(effect.where), effect)
            for effect in effects
            if effect.kind == "sensor" and effect.where in columns
        ]
        self._memory: list[float | None] = [None] * len(self._entries)
        self._last_s = 0.0
        self.any = bool(self._entries)

    def lag(self, time_s: float, values: list[float]) -> None:
        """Delay the true values (first-order lag), before noise is added."""
        step = time_s - self._last_s
        self._last_s = time_s
        for number, (channel, effect) in enumerate(self._entries):
            if effect.magnitude == "lag_s" and effect.value > 0.0:
                before = self._memory[number]
                if effect.envelope(time_s) == 0.0 or before is None:
                    self._memory[number] = values[channel]
                else:
                    values[channel] += (before - values[channel]) * math.exp(-step / effect.value)
                    self._memory[number] = values[channel]

    def distort(self, time_s: float, values: list[float]) -> int:
        """Distort the readings in place; return a bit mask of open channels."""
        open_channels = 0
        for number, (channel, effect) in enumerate(self._entries):
            size = effect.envelope(time_s)
            if size == 0.0:
                self._memory[number] = None if effect.magnitude == "stuck" else self._memory[number]
            elif effect.magnitude == "bias":
                values[channel] += size * effect.value
            elif effect.magnitude == "drift_per_h":
                values[channel] += size * effect.value * (time_s - effect.onset_s) / 3600.0
            elif effect.magnitude == "jump_K":
                phase = (time_s - effect.onset_s) / effect.shape["period_s"] % 1.0
                values[channel] += size * effect.value if phase < effect.shape["duty"] else 0.0
            elif effect.magnitude == "stuck":
                held = self._memory[number]
                if held is None:
                    self._memory[number] = values[channel]
                else:
                    values[channel] = held
            elif effect.magnitude == "open_circuit":
                open_channels |= 1 << channel
        return open_channels
