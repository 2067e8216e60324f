"""Lumped twin from the data sheet of a plant of the zoo, and its commissioning on a healthy record.

Each volume of the sheet becomes one node. Pipes become part of the node downstream, unless the sheet names them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hil.bench.zoo.plants import FAN_COLUMN, ROOM_COLUMN
from twin import Network
from twin.twinfile import from_tables

WIDTH = 8.0
"""Bounds of a parameter over and under its nominal value, as a factor."""
STILL_SHARE = 0.05
"""Share of a radiator's conductance that remains with the fan at rest."""
SHARE_ON_METAL = 0.8
"""First guess of the water's share of the way to equilibrium at a node whose thermometer sits on the metal."""


def sheet_twin(sheet: Mapping[str, Any], *, fan_varies: bool, pump_varies: bool) -> Network:
    """Return the lumped twin of a data sheet (`ZooPlant.sheet`), not commissioned.

    Parameters
    ----------
    sheet
        Nominal values: nodes, loops, exchanger, sensors, heaters.
    fan_varies, pump_varies
        True where the healthy record varies the speed, so that exponents are identifiable.
    """
    elements: dict[str, dict[str, Any]] = {}
    free: list[str] = []

    def positive(value: float, width: float = WIDTH) -> dict[str, float]:
        return {"value": value, "lower": value / width, "upper": value * width}

    for name, node in sheet["nodes"].items():
        elements[name] = {"kind": "node", "capacitance": positive(max(node["J_per_K"], 50.0))}
        free.append(f"{name}.capacitance")
    pump_of: dict[str, str] = {}
    for k, loop in enumerate(sheet["loops"]):
        name = "circuit" if k == 0 else f"circuit{k + 1}"
        flow: dict[str, Any] = {
            "kind": "flow",
            "path": loop["path"],
            "pump": loop["pump"],
            "nominal": {"value": loop["L_per_min"]},
            "cp": {"value": loop["cp"] / 0.997},
            "factor": {"value": 1.0, "lower": 0.4, "upper": 2.5},
        }
        free.append(f"{name}.factor")
        for node in loop["path"]:
            pump_of[node] = loop["pump"]
            if sheet["nodes"][node]["reads"] == "metal":
                flow[f"effectiveness_{node}"] = {"value": SHARE_ON_METAL, "lower": 0.1, "upper": 1.6}
                free.append(f"{name}.effectiveness_{node}")
        elements[name] = flow
        for node, litres in loop["pipes_L"].items():
            elements[f"pipe_to_{node}"] = {"kind": "pipe", "to": node, "volume": positive(litres)}
            free.append(f"pipe_to_{node}.volume")
    for name, node in sheet["nodes"].items():
        if node["fan_W_per_K"]:
            full = node["fan_W_per_K"]
            elements[f"fins_{name}"] = {
                "kind": "radiator",
                "node": name,
                "fan": FAN_COLUMN,
                "pump": pump_of[name],
                "UA_100": positive(full),
                "fan_exponent": {"value": 0.6, "lower": 0.1, "upper": 1.5},
                "flow_exponent": {"value": 0.0, "lower": -0.5, "upper": 1.0},
                "UA_still": {"value": STILL_SHARE * full, "lower": 0.0, "upper": full},
            }
            free += [f"fins_{name}.UA_100"]
            free += [f"fins_{name}.fan_exponent", f"fins_{name}.UA_still"] if fan_varies else []
            free += [f"fins_{name}.flow_exponent"] if pump_varies else []
        else:
            elements[f"{name}_loss"] = {
                "kind": "ambient_loss",
                "node": name,
                "hA": {"value": node["loss_W_per_K"], "lower": 1e-3, "upper": 20.0 * node["loss_W_per_K"] + 5.0},
            }
            free.append(f"{name}_loss.hA")
    if sheet["exchanger"] is not None:
        link = sheet["exchanger"]
        elements["exchanger"] = {
            "kind": "exchanger",
            "from": link["hot"],
            "to": link["cold"],
            "UA_100": positive(1.0 / link["K_per_W"]),
            "film_from": {"value": 0.5, "lower": 0.0, "upper": 1.0},
        }
        free.append("exchanger.UA_100")
        free += ["exchanger.film_from"] if pump_varies else []
    for column, nodes in sheet["heaters"].items():
        for node in nodes:
            elements[f"power_of_{node}"] = {
                "kind": "heat_source",
                "node": node,
                "driver": column,
                "factor": {"value": 1.0 / len(nodes), "lower": 0.0, "upper": 3.0},
            }
    for node, columns in sheet["sensors"].items():
        if columns:
            name = columns[0] if len(columns) == 1 else f"T_{node}_C"
            elements[name] = {
                "kind": "sensor",
                "node": node,
                "columns": columns,
                "sigma": {"value": sheet["sigma_K"]},
            }
    inputs: dict[str, dict[str, Any]] = {
        column: {"nominal": 0.5 * rated, "lower": 0.0, "upper": rated, "unit": "W"}
        for column, rated in sheet["rated_W"].items()
    }
    for loop in sheet["loops"]:
        inputs[loop["pump"]] = {"nominal": 100.0, "lower": 0.0, "upper": 100.0, "unit": "%"}
    inputs[FAN_COLUMN] = {"nominal": 70.0, "lower": 0.0, "upper": 100.0, "unit": "%"}
    inputs[ROOM_COLUMN] = {"nominal": 22.0, "lower": -40.0, "upper": 60.0, "unit": "degC"}
    return from_tables(
        {
            "format": 1,
            "name": "zoo",
            "title": "Lumped twin from a data sheet",
            "inputs": inputs,
            "elements": elements,
            "sets": {"commission": {"members": free}},
        },
        "data sheet",
    )
