"""Twin file from a rig's data sheet.

Volumes become capacitances. Those of pipes go into the template's pipes (`pipe_heater_to_modules` and so on) or, where
it has none, into the volumes downstream of them. The flow and the thermocouples' noise are taken over. All other
parameters keep the value of the shipped loop until `commission` fits them.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from twin.elements.flow import WATER_DENSITY
from twin.network import Network, Revision, TwinFileError, did_you_mean
from twin.regular_file import read_regular
from twin.twinfile.toml_text import load

WATER_CP = 4180.0
"""J/(kg K) at 30 degC (IAPWS-95)."""
_PIPES = ("heater_to_modules", "modules_to_radiator", "radiator_to_tank", "tank_to_heater")
_SOLID = {"heater": 900.0, "modules": 1250.0, "radiator": 350.0, "tank": 0.0}
"""J/K of metal in the shipped loop's volumes: its capacitances without the water."""


@dataclass(frozen=True)
class DataSheet:
    """The entries of a data sheet that a loop twin uses; the others are ignored."""

    flow_L_per_min: float
    tank_L: float
    heater_L: float
    pipes_L: Mapping[str, float]
    sigma_K: float
    rated_W: float | None = None


def from_datasheet(path: str | Path, template: str | Path | None = None) -> Network:
    """Build the loop twin of the rig whose data sheet (JSON) lies at `path`; save it with `twin.twinfile.save`.

    Parameters
    ----------
    path
        Path of the data sheet.
    template
        Twin file to fill in, the shipped ``profiles/twins/loop.toml`` by default.

    Raises
    ------
    TwinFileError
        The sheet is unreadable, an entry is missing or impossible, or the template is not a loop.
    """
    path = Path(path)
    try:
        data = json.loads(read_regular(path))
    except OSError as error:
        raise TwinFileError(f"{path}: cannot be read ({error.strerror}); give the path of a data sheet") from None
    except (ValueError, RecursionError) as error:
        raise TwinFileError(f"{path}: is not valid JSON: {error}; give the rig's data sheet") from None
    if not isinstance(data, dict):
        raise TwinFileError(f"{path}: must be a JSON object of the rig's data")
    sheet = read_data_sheet(data, str(path))
    base = load(template or Path(__file__).resolve().parents[2] / "profiles" / "twins" / "loop.toml")
    name = f"rig_{data['rig']}" if isinstance(data.get("rig"), str) else path.parent.name or "rig"
    return apply_data_sheet(base, sheet, name=name, source=path.name)


def read_data_sheet(data: Mapping[str, Any], file: str = "data sheet") -> DataSheet:
    """Check the entries of a data sheet.

    Raises
    ------
    TwinFileError
        An entry is missing, not a number, or not positive.
    """

    def number(table: Mapping[str, Any], key: str) -> float:
        if key not in table:
            raise TwinFileError(f"{file}: {key} is missing{did_you_mean(key, table)}")
        value = table[key]
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value <= sys.float_info.max:
            raise TwinFileError(f"{file}: {key} must be a positive number, not {value!r}")
        return float(value)

    pipes = data.get("pipe_volumes_L", {})
    if not isinstance(pipes, Mapping):
        raise TwinFileError(f"{file}: pipe_volumes_L must be a table of volumes in L")
    law = data.get("flow_is", "proportional to pump speed")
    if law != "proportional to pump speed":
        raise TwinFileError(f"{file}: flow_is {law!r} is not a pump law of this twin: 'proportional to pump speed'")
    return DataSheet(
        flow_L_per_min=number(data, "nominal_flow_L_per_min_at_pump_100pct"),
        tank_L=number(data, "tank_volume_L"),
        heater_L=number(data, "heater_water_volume_L"),
        pipes_L={name: number(pipes, name) for name in _PIPES if name in pipes},
        sigma_K=number(data, "thermocouple_sigma_K"),
        rated_W=number(data, "heater_rated_W") if "heater_rated_W" in data else None,
    )


def apply_data_sheet(base: Network, sheet: DataSheet, name: str = "rig", source: str = "data sheet") -> Network:
    """Return the loop `base` with the volumes, flow and noise of a data sheet.

    Raises
    ------
    TwinFileError
        `base` is not a loop of heater, modules, radiator and tank.
    """
    if all(f"pipe_{p}.volume" in base.parameters for p in _PIPES):
        values = {f"pipe_{p}.volume": sheet.pipes_L.get(p, 0.0) for p in _PIPES}
        values |= {
            "heater.capacitance": sheet.heater_L * WATER_DENSITY * WATER_CP,
            "tank.capacitance": sheet.tank_L * WATER_DENSITY * WATER_CP,
        }
    else:
        pipe = {p: sheet.pipes_L.get(p, 0.0) for p in _PIPES}
        water_L = {
            "heater": sheet.heater_L + pipe["tank_to_heater"],
            "modules": pipe["heater_to_modules"],
            "radiator": pipe["modules_to_radiator"],
            "tank": sheet.tank_L + pipe["radiator_to_tank"],
        }
        values = {f"{n}.capacitance": v * WATER_DENSITY * WATER_CP + _SOLID[n] for n, v in water_L.items()}
    values["circuit.nominal"] = sheet.flow_L_per_min
    values |= {f"{s.name}.sigma": sheet.sigma_K for s in base.sensors}
    base.index(values)
    parameters = dict(base.parameters)
    for key, value in values.items():
        p = parameters[key]
        low, high = min(p.lower, value / 10.0), max(p.upper, value * 10.0)
        kind_low, kind_high = _limits(base, key)
        parameters[key] = replace(
            p, value=value, lower=max(low, kind_low), upper=min(high, kind_high), source=f"{source}: {key}"
        )
    inputs = dict(base.inputs)
    if sheet.rated_W is not None and "heater_power_W" in inputs:
        spec = inputs["heater_power_W"]
        inputs["heater_power_W"] = replace(
            spec, upper=sheet.rated_W, nominal=min(spec.nominal, sheet.rated_W), source=f"{source}: heater_rated_W"
        )
    return replace(
        base,
        name=name,
        title=f"{base.title}, volumes and flow from {source}",
        parameters=MappingProxyType(parameters),
        inputs=MappingProxyType(inputs),
        revision=Revision(),
        digest="",
    )


def _limits(network: Network, key: str) -> tuple[float, float]:
    """Return the bounds that the kind of a parameter's element sets."""
    element, name = key.split(".")
    for e in network.elements:
        if e.name == element:
            for spec in e.parameter_specs():
                if spec.name == name:
                    return spec.lower, spec.upper
    return -math.inf, math.inf
