"""Twin of a cell as a network of elements: its file is a twin file like any other, so revisions and diagnosis work on
it."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import replace
from typing import Any

from twin.network import Network, Revision, TwinFileError
from twin.tower.cell import Design
from twin.twinfile import from_tables

BOUNDS = {"fill": 0.25, "air": 0.18, "uniformity": 0.15, "bias": 1.0}
"""Deviations from the clean cell that a calibration may find: shares, and K for the outlet thermometer's bias."""
IDS = {"fill": "cell.fill", "air": "cell.air", "uniformity": "cell.uniformity", "bias": "outlet.bias_K"}
"""Parameter of the twin file by deviation."""
FLUME_S = 60.0
"""Seconds of design flow that an outlet flume holds; only transients depend on it."""
RTD_LAG_S = 40.0
"""Time constant of a resistance thermometer in a thermowell in flowing water, 20 to 60 s."""
_INPUTS = (
    ("t_in_C", 35.0, -5.0, 80.0, "degC"),
    ("m_w_kg_s", None, 0.0, None, "kg/s"),
    ("fan_speed_pct", 100.0, 0.0, 120.0, "%"),
    ("dry_C", 25.0, -40.0, 60.0, "degC"),
    ("wet_C", 18.0, -40.0, 45.0, "degC"),
    ("pressure_kPa", 101.3, 60.0, 110.0, "kPa"),
    ("bypass_pct", 0.0, -5.0, 105.0, "%"),
)


def cell_network(
    cell: int,
    station: str,
    design: Design,
    bypass_share: float,
    error_K: float,
    sd: tuple[float, float],
    revision: Revision,
    pressure_kPa: float = 101.3,
) -> Network:
    """Return the twin of a clean cell.

    Parameters
    ----------
    cell, station
        Number and name.
    bypass_share
        Of the water that an open bypass lets past.
    error_K
        RMSE of the fit.
    sd
        Of the Merkel number's logarithm and of the exponent.
    revision
        Origin and evidence.
    pressure_kPa
        Of the site.
    """
    inputs: dict[str, Any] = {}
    for name, nominal, low, high, unit in _INPUTS:
        flow = name == "m_w_kg_s"
        inputs[name] = {
            "nominal": design.m_w0 if flow else pressure_kPa if name == "pressure_kPa" else nominal,
            "lower": low,
            "upper": 3.0 * design.m_w0 if flow else high,
            "unit": unit,
        }
    fitted, sheet = "fitted to the test points", "datasheet"
    element: dict[str, Any] = {
        "kind": "tower_cell",
        "node": "flume",
        "inlet": "t_in_C",
        "water": "m_w_kg_s",
        "fan": "fan_speed_pct",
        "dry": "dry_C",
        "wet": "wet_C",
        "pressure": "pressure_kPa",
        "bypass": "bypass_pct",
        "water_flow": _fixed(design.m_w0, sheet),
        "air_flow": _fixed(design.m_a0, fitted),
        "density": _fixed(design.density, fitted),
        "merkel": _fixed(design.merkel, fitted),
        "exponent": _fixed(design.exponent, fitted),
        "fan_power": _fixed(design.power, fitted),
        "fan_idle": _fixed(design.idle, fitted),
        "kappa": _fixed(design.kappa, "prior mean of a record; no test point shows it"),
        "evaporation": _fixed(design.evaporation, fitted),
        "bypass_share": _fixed(bypass_share, sheet),
        "merkel_sd": _fixed(min(max(sd[0], 1e-3), 0.5), fitted),
        "exponent_sd": _fixed(min(max(sd[1], 1e-3), 0.5), fitted),
        "error_K": _fixed(max(error_K, 0.001), "RMSE at the test points"),
    }
    for name in ("fill", "air", "uniformity"):
        bound = BOUNDS[name]
        element[name] = {
            "value": 1.0,
            "lower": 1.0 - bound,
            "upper": 1.0 + bound,
            "status": "tunable",
            "source": "clean cell; bounds of a deviation",
        }
    bias = {
        "value": 0.0,
        "lower": -BOUNDS["bias"],
        "upper": BOUNDS["bias"],
        "status": "tunable",
        "source": "thermometer in calibration",
    }
    tables = {
        "format": 1,
        "name": f"{_plain(station)}cell{cell}",
        "title": f"Cell {cell}{f' of station {station}' if station else ''}",
        "inputs": inputs,
        "elements": {
            "flume": {"kind": "node", "capacitance": _fixed(design.m_w0 * FLUME_S * 4186.0, "a minute of design flow")},
            "cell": element,
            "outlet": {
                "kind": "sensor",
                "node": "flume",
                "columns": ["t_out_C"],
                "sigma": _fixed(0.1, "class A thermometer"),
                "lag_s": _fixed(RTD_LAG_S, "thermowell"),
                "bias_K": bias,
            },
        },
        "sets": {"calibrate": {"members": list(IDS.values())}},
    }
    return replace(from_tables(tables, f"twin of cell {cell}"), revision=revision)


def cell_of(network: Network) -> int:
    """Return the number of the cell of a twin.

    Raises
    ------
    TwinFileError
        It is the twin of no tower cell.
    """
    found = re.search(r"cell(\d+)$", network.name)
    if found is None or "cell.merkel" not in network.ids:
        raise TwinFileError(f"{network.name}: is no twin of a tower cell; make one with hil tower commission")
    return int(found[1])


def design_of(network: Network) -> Design:
    """Return the clean cell of a twin."""
    v = {
        name: value_of(network, f"cell.{name}")
        for name in (
            "water_flow",
            "air_flow",
            "merkel",
            "exponent",
            "fan_power",
            "density",
            "kappa",
            "evaporation",
            "fan_idle",
        )
    }
    return Design(
        v["water_flow"],
        v["air_flow"],
        v["merkel"],
        v["exponent"],
        v["fan_power"],
        v["density"],
        v["kappa"],
        evaporation=v["evaporation"],
        idle=v["fan_idle"],
    )


def value_of(network: Network, name: str) -> float:
    """Return the value of a parameter by its id."""
    return float(network.values[network.ids.index(name)])


def site_pressure_of(network: Network) -> float:
    """Return the air pressure of the site by a twin's file, kPa."""
    return float(network.inputs["pressure_kPa"].nominal)


def _fixed(value: float, source: str) -> dict[str, Any]:
    return {"value": float(f"{value:.7g}"), "status": "fixed", "source": source}


def station_of_twin(network: Network) -> str:
    """Return the station that a twin's title names as `cell_network` writes it, "" where it names none."""
    found = re.fullmatch(r"Cell \d+ of station (.+)", network.title)
    return found[1] if found else ""


def _plain(station: str) -> str:
    plain = unicodedata.normalize("NFKD", station.replace("ß", "ss"))
    plain = "".join(letter for letter in plain if not unicodedata.combining(letter))
    text = re.sub(r"[^A-Za-z0-9]+", "_", plain).strip("_").lower()
    return f"{text}_" if text else ""
