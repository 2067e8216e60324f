"""Variables of an FMU that the virtual rig uses, found by name and checked: causality, type and unit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.virtual.plant import CHANNELS

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
