"""FMU in the place of the virtual rig's plant: FMI 2.0 for co-simulation, run by FMPy.

An FMU is a program. It runs in the process of the plant, with the rights of its user.
"""

from __future__ import annotations

import shutil
import weakref
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from drivers.virtual.fmu.ports import DRIVEN, FmuPlantError, fmu_ports
from drivers.virtual.plant import Array, Room


class FmuPlant:
    """Plant of the virtual rig whose temperatures come from an FMU.

    Heater, pump and fans follow their set-points at once. The room is that of the built-in plant.
    """

    def __init__(
        self, path: Path, names: Mapping[str, str], *, seed: int = 0, period_s: float = 1.0, start_s: float = 0.0
    ) -> None:
        """Load the FMU and initialise it at rig time `start_s` in s; raise FmuPlantError."""
        self._ports = ports = fmu_ports(path, names)
        self.period_s = period_s
        self.steps = round(start_s / period_s)
        self._room = Room(seed, period_s)
        for step in range(self.steps + 1):
            self.ambient_C = self._room.step(step * period_s)
        self.heater_power_W = self._pump = self._fan = 0.0
        self._path = path
        import fmpy

        from drivers.virtual.plant import NOMINAL_FLOW_L_PER_MIN  # only here: it loads the compiler

        self._full_flow = NOMINAL_FLOW_L_PER_MIN
        folder = fmpy.extract(str(path))
        weakref.finalize(self, shutil.rmtree, folder, True)
        self._slave = fmpy.fmi2.FMU2Slave(
            guid=ports.guid, unzipDirectory=folder, modelIdentifier=ports.identifier, instanceName="plant"
        )
        try:
            self._slave.instantiate()
            self._slave.setupExperiment(startTime=self.time_s)
            self._slave.enterInitializationMode()
            self._drive()
            self._slave.exitInitializationMode()
            self._observe()
        except Exception as error:  # FMPy raises plain exceptions, ctypes OSError
            raise FmuPlantError(f"{path} cannot be started ({error})") from error

    @property
    def time_s(self) -> float:
        """Rig time in s."""
        return self.steps * self.period_s

    @property
    def flow_L_per_min(self) -> float:
        """Flow at the pump, L/min."""
        return self._flow

    @property
    def pump_speed_pct(self) -> float:
        """Speed of the pump's shaft, %."""
        return 100.0 * self._pump

    @property
    def fan_speed_pct(self) -> float:
        """Speed of the fans, %."""
        return 100.0 * self._fan

    @property
    def heater_water_C(self) -> float:
        """Temperature at the thermostat's bulb, degC: that of the heater's thermocouple."""
        return float(self.junction[0])

    def step(self, heater_W: float, pump_fraction: float, fan_fraction: float) -> None:
        """Advance one period with set-points in W and fractions of full speed.

        Raises
        ------
        FmuPlantError
            The FMU reports an error, or a temperature is not finite.
        """
        self.heater_power_W, self._pump, self._fan = heater_W, pump_fraction, fan_fraction
        try:
            self._drive()
            self._slave.doStep(self.time_s, self.period_s)
            self.steps += 1
            self._observe()
        except Exception as error:
            raise FmuPlantError(f"{self._path} failed at {self.time_s:g} s ({error})") from error
        self.ambient_C = self._room.step(self.steps * self.period_s)

    def _drive(self) -> None:
        values = (self.heater_power_W, 100.0 * self._pump, 100.0 * self._fan, self.ambient_C)
        inputs, offsets = self._ports.inputs, self._ports.offsets
        given = {inputs[name]: value for name, value in zip(DRIVEN, values, strict=True) if name in inputs}
        self._slave.setReal(list(given), [value - offsets.get(ref, 0.0) for ref, value in given.items()])

    def _observe(self) -> None:
        references = self._ports.channels
        read = np.array(self._slave.getReal(list(references)), dtype=np.float64)
        self.junction: Array = read + np.array([self._ports.offsets[ref] for ref in references])
        if not np.isfinite(self.junction).all():
            raise FmuPlantError("a temperature is not finite")
        flow = None if self._ports.flow is None else self._slave.getReal([self._ports.flow])[0]
        self._flow = self._full_flow * self._pump if flow is None else float(flow)
