"""FMU in the place of the virtual rig's plant: FMI 2.0 for co-simulation, run by FMPy.

An FMU is a program. It runs in the process of the plant, with the rights of its user.
"""

from __future__ import annotations

import shutil
import weakref
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drivers.virtual.plant.ambient import Room
from drivers.virtual.plant.geometry import CHANNELS, Array

DRIVEN = ("heater_power_W", "pump_speed_pct", "fan_speed_pct", "T_ambient_C")
"""Inputs that the rig gives to an FMU, by the name that they have unless another is given."""
FLOW = "flow_L_per_min"
"""Output that is the flow meter's reading, where the FMU has it; else the flow is proportional to the pump's speed."""
_MODULES = "T_modules_C"
"""Output for all six modules, where the FMU has one in place of six."""
_ZERO_CELSIUS_K = 273.15


class FmuPlantError(ValueError):
    """FMU that cannot be the plant of the virtual rig; the message is one plain sentence."""


@dataclass(frozen=True)
class FmuPorts:
    """References of an FMU's variables: of `DRIVEN` as far as it has them, of `CHANNELS`, and of the flow or None.

    `offsets` has, by reference, what is added to a temperature of the FMU to get degC: -273.15 for one in K, else 0.
    """

    guid: str
    identifier: str
    inputs: dict[str, int]
    channels: tuple[int, ...]
    flow: int | None
    offsets: dict[int, float]


def fmu_ports(path: Path, names: Mapping[str, str]) -> FmuPorts:
    """Return the variables of an FMU that the rig uses.

    Parameters
    ----------
    path
        The FMU.
    names
        Name of the rig (of `DRIVEN`, `CHANNELS` or `FLOW`) -> variable of the FMU, where the two differ.

    Raises
    ------
    FmuPlantError
        FMPy is not installed, the file is no FMU 2.0 for co-simulation, or a variable is missing or of another unit.
    """
    description = _described(path)
    known = [*DRIVEN, *CHANNELS, FLOW]
    for name in names:
        if name not in known:
            raise FmuPlantError(f"the virtual rig has no signal {name!r} for an FMU; it has {', '.join(known)}")
    by_name = {v.name: v for v in description.modelVariables}
    ports = _Ports(path, by_name, names)
    inputs = {name: ref for name in DRIVEN if (ref := ports.find(name, "input", name == DRIVEN[0])) is not None}
    channels = []
    for channel in CHANNELS:
        ref = ports.find(channel, "output", False)
        if ref is None and channel.startswith("T_pm") and channel not in names:
            ref = ports.find(_MODULES, "output", False)
        channels.append(ports.find(channel, "output", True) if ref is None else ref)
    return FmuPorts(
        description.guid,
        description.coSimulation.modelIdentifier,
        inputs,
        tuple(ref for ref in channels if ref is not None),
        ports.find(FLOW, "output", False),
        ports.offsets,
    )


def _described(path: Path) -> Any:
    try:
        import fmpy
    except ImportError:
        raise FmuPlantError(
            "an FMU as plant needs FMPy, which is not installed; install it with: pip install 'hil-rig[export]'"
        ) from None
    try:
        description = fmpy.read_model_description(str(path))
    except Exception as error:  # of many libraries: ZIP, XML, the checks of FMPy
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise FmuPlantError(f"{path} is no FMU that can be read ({reason})") from error
    if description.fmiVersion != "2.0" or description.coSimulation is None:
        raise FmuPlantError(f"{path} is an FMU of FMI {description.fmiVersion}; give one of FMI 2.0 for co-simulation")
    if fmpy.platform not in fmpy.supported_platforms(str(path)):
        raise FmuPlantError(
            f"{path} has no library for {fmpy.platform}; compile its sources with FMPy, or export it again on this "
            "machine"
        )
    return description


class _Ports:
    """Search of variables by name, with checks of causality, type and unit."""

    def __init__(self, path: Path, by_name: Mapping[str, Any], names: Mapping[str, str]) -> None:
        self.path, self.by_name, self.names = path, by_name, names
        self.offsets: dict[int, float] = {}

    def find(self, name: str, causality: str, needed: bool) -> int | None:
        """Return the reference of a variable, None for one that may be missing."""
        wanted = self.names.get(name, name)
        variable = self.by_name.get(wanted)
        if variable is None or variable.causality != causality:
            if not needed and name not in self.names:
                return None
            there = [n for n, v in self.by_name.items() if v.causality == causality]
            raise FmuPlantError(
                f"{self.path} has no {causality} {wanted!r} for {name}; name one of {', '.join(there) or 'none'} with "
                f"--fmu-variable {name}=VARIABLE"
            )
        if variable.type != "Real":
            raise FmuPlantError(f"{self.path}: {wanted} is of type {variable.type}; the rig takes real numbers")
        reference = int(variable.valueReference)
        if name.startswith("T_"):
            if variable.unit not in ("degC", "K", None, ""):
                raise FmuPlantError(f"{self.path}: {wanted} is in {variable.unit}; the rig takes degC or K")
            self.offsets[reference] = -_ZERO_CELSIUS_K if variable.unit == "K" else 0.0
        return reference


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

        from drivers.virtual.plant.kernel import NOMINAL_FLOW_L_PER_MIN  # only here: it loads the compiler

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
