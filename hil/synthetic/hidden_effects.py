"""Hidden effects of `hil bench discovery`: drawn from a seed, in the vocabulary of the virtual rig's effect files.

A case has a public part (load profile, specimen, length), known to the diagnosis, and a hidden one (the effects).
They come from different random streams, so that the public part gives no information about the hidden one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

GROUPS = ("none", "one", "two", "outside")
"""Groups: no effect; one or two effects of the catalogue; an effect outside the catalogue."""
PLACES = ("heater", "modules", "radiator", "tank")
CHANNELS = (
    "T_heater_C",
    "T_radiator_C",
    "T_tank_C",
    "T_ambient_C",
)
_ONE_MODULE_SHARE = 0.15
_BARELY, _LARGE = 0.15, 3.0
"""Least and largest size as a multiple of a form's usual size; sizes are log-uniform between them."""
_NONE_SHARE, _OUTSIDE_SHARE, _DOUBLE_SHARE = 0.25, 0.25, 0.3


@dataclass(frozen=True, slots=True)
class Truth:
    """Hidden part of a case: group, a word for the effect, tables of an effect file, and the labels of a right answer.

    Attributes
    ----------
    effects
        Tables of `[[effect]]`.
    labels
        A (kind, where, driver) each, one for every effect of the catalogue.
    """

    group: str
    what: str
    effects: tuple[dict[str, Any], ...]
    labels: tuple[tuple[str, str, str], ...]

    def document(self) -> dict[str, Any]:
        """Return the hidden part as plain data, for its sealed file."""
        return asdict(self)


def truth(number: int, seed: int, hours: float, kind: str = "case") -> Truth:
    """Return the hidden part of record `number` of a kind."""
    end = hours * 3600.0
    if kind == "healthy":
        return Truth("none", "nothing", (), ())
    if kind == "double":
        rng = np.random.default_rng([seed, number, 3])
        return _two(rng, end, _inside(rng, end))
    rng = np.random.default_rng([seed, number, 1])
    # A stratified draw: each four consecutive cases hold one of each quarter, in random order.
    quarter = int(np.random.default_rng([seed, number // 4, 2]).permutation(4)[number % 4])
    if quarter == 0:
        return Truth("none", "nothing", (), ())
    if quarter == 1:
        what, effects, label = _OUTSIDE[int(rng.integers(len(_OUTSIDE)))](rng, end)
        return Truth("outside", what, effects, (label,))
    first = _inside(rng, end)
    if rng.uniform() >= _DOUBLE_SHARE:
        return Truth("one", first[0], (first[1],), (first[2],))
    return _two(rng, end, first)


def lasting(number: int, seed: int, hours: float) -> tuple[Truth, Truth]:
    """Return two different permanent effects for one rig."""
    rng = np.random.default_rng([seed, number, 6])
    found: list[Drawn] = []
    while len(found) < 2:
        drawn = _inside(rng, hours * 3600.0)
        if drawn[2][2] != "elapsed_time" and all(_apart(old, drawn) for old in found):
            found.append(drawn)
    first, second = (Truth("one", what, (table,), (label,)) for what, table, label in found)
    return first, second


Drawn = tuple[str, dict[str, Any], tuple[str, str, str]]


def _two(rng: np.random.Generator, end: float, first: Drawn) -> Truth:
    """Return the first effect and another one, of another kind or at another place."""
    while True:
        second = _inside(rng, end)
        if _apart(first, second):
            return Truth("two", f"{first[0]} + {second[0]}", (first[1], second[1]), (first[2], second[2]))


def _apart(first: Drawn, second: Drawn) -> bool:
    """Return True if two effects differ in kind or place; the rig has only one bypass."""
    return first[2][:2] != second[2][:2] and not ("bypass_fraction" in first[1] and "bypass_fraction" in second[1])


Outside = tuple[str, tuple[dict[str, Any], ...], tuple[str, str, str]]


def _size(rng: np.random.Generator, usual: float) -> float:
    return float(f"{usual * np.exp(rng.uniform(np.log(_BARELY), np.log(_LARGE))):.3g}")


def _onset(rng: np.random.Generator, end: float) -> float:
    """Draw an onset: a quarter at the beginning, a tenth late, perhaps in the held-out segment."""
    u = rng.uniform()
    if u < 0.25:
        return 0.0
    low, high = (0.72, 0.88) if u > 0.9 else (0.12, 0.65)
    return float(round(end * rng.uniform(low, high)))


def _pick(rng: np.random.Generator, names: tuple[str, ...]) -> str:
    return str(names[int(rng.integers(len(names)))])


def _place(rng: np.random.Generator) -> str:
    """Draw a volume; sometimes a single module."""
    return f"pm{rng.integers(1, 7)}" if rng.uniform() < _ONE_MODULE_SHARE else _pick(rng, PLACES)


def _inside(rng: np.random.Generator, end: float) -> Drawn:
    """Draw one effect of the catalogue: its description, its table, its label."""
    onset = _onset(rng, end)
    table, label = _FORMS[int(rng.integers(len(_FORMS)))](rng, end)
    table = {**table, "onset_s": onset}
    grows = table.pop("grows", False)
    if (grows and rng.uniform() < 0.25) or (table.get("driver") == "elapsed_time" and "tau_s" not in table):
        if "drift_per_h" in table:
            hours = (end - onset) / 3600.0
            table["drift_per_h"] = float(f"{table['drift_per_h'] / hours:.3g}")
        else:
            table["ramp_s"] = end - onset
        label = (label[0], label[1], "elapsed_time")
    magnitude = next(k for k in _MAGNITUDES if k in table)
    return f"{label[0]} at {label[1]} ({label[2]}), {magnitude} {table[magnitude]:.3g}", table, label


_MAGNITUDES = (
    "power_W",
    "capacity_J_per_K",
    "conductance_W_per_K",
    "lost_fraction",
    "exponent_change",
    "recirculated_fraction",
    "bypass_fraction",
    "bias",
    "drift_per_h",
    "lag_s",
    "gain",
)


def _source(rng: np.random.Generator, end: float) -> tuple[dict[str, Any], tuple[str, str, str]]:
    where = _place(rng)
    table = {"kind": "heat_source", "where": where, "driver": "constant", "power_W": _size(rng, 40.0), "grows": True}
    return table, ("heat_source", where, "constant")


def _source_grows(rng: np.random.Generator, end: float) -> tuple[dict[str, Any], tuple[str, str, str]]:
    where = _pick(rng, PLACES)
    table = {
        "kind": "heat_source",
        "where": where,
        "driver": "elapsed_time",
        "power_W": _size(rng, 50.0),
        "tau_s": float(round(rng.uniform(0.05, 0.3) * end)),
    }
    return table, ("heat_source", where, "elapsed_time")


def _source_of_day(rng: np.random.Generator, end: float) -> tuple[dict[str, Any], tuple[str, str, str]]:
    where = _pick(rng, PLACES)
    table = {
        "kind": "heat_source",
        "where": where,
        "driver": "time_of_day",
        "power_W": _size(rng, 60.0),
        "peak_hour": float(round(rng.uniform(0.0, 24.0), 1)),
        "width_h": float(round(rng.uniform(8.0, 14.0), 1)),
    }
    return table, ("heat_source", where, "time_of_day")


def _source_driven(rng: np.random.Generator, end: float) -> tuple[dict[str, Any], tuple[str, str, str]]:
    driver = _pick(rng, ("heater_power", "pump_speed", "fan_speed"))
    where = _pick(rng, PLACES[1:] if driver == "heater_power" else PLACES)
    # The twin's shaft power follows the cube of the speed, and a share of the heater's power.
    exponent = 1.0 if driver == "heater_power" else 3.0
    table = {
        "kind": "heat_source",
        "where": where,
        "driver": driver,
        "power_W": _size(rng, 60.0),
        "exponent": exponent,
    }
    return table, ("heat_source", where, driver)


def _loss(rng: np.random.Generator, end: float) -> tuple[dict[str, Any], tuple[str, str, str]]:
    where = _pick(rng, PLACES)
    table = {
        "kind": "heat_loss",
        "where": where,
        "driver": "temperature_difference",
        "conductance_W_per_K": _size(rng, 3.0),
        "grows": True,
    }
    return table, ("heat_loss", where, "temperature_difference")


def _rejection(rng: np.random.Generator, end: float) -> tuple[dict[str, Any], tuple[str, str, str]]:
    driver = _pick(rng, ("constant", "elapsed_time", "fan_speed", "rejected_heat"))
    table: dict[str, Any] = {"kind": "heat_rejection", "where": "radiator", "driver": driver}
    if driver == "fan_speed":
        table["exponent_change"] = min(_size(rng, 0.15), 0.6) * float(rng.choice((-1.0, 1.0)))
    elif driver == "rejected_heat":
        table["recirculated_fraction"] = min(_size(rng, 0.12), 0.4)
    else:
        table["lost_fraction"] = min(_size(rng, 0.12), 0.4)
    return table, ("heat_rejection", "radiator", driver)


def _flow(rng: np.random.Generator, end: float) -> tuple[dict[str, Any], tuple[str, str, str]]:
    driver = _pick(rng, ("constant", "elapsed_time"))
    table = {"kind": "flow", "where": "loop", "driver": driver, "lost_fraction": min(_size(rng, 0.08), 0.35)}
    return table, ("flow", "loop", driver)


def _bypass(rng: np.random.Generator, end: float) -> tuple[dict[str, Any], tuple[str, str, str]]:
    where = _pick(rng, ("modules", "radiator"))
    table = {
        "kind": "flow",
        "where": where,
        "driver": "constant",
        "bypass_fraction": min(_size(rng, 0.1), 0.5),
        "grows": True,
    }
    return table, ("flow", where, "constant")


def _mass(rng: np.random.Generator, end: float) -> tuple[dict[str, Any], tuple[str, str, str]]:
    table = {
        "kind": "thermal_mass",
        "where": "tank",
        "driver": "history",
        "capacity_J_per_K": _size(rng, 40000.0),
        "conductance_W_per_K": float(round(rng.uniform(10.0, 80.0))),
    }
    return table, ("thermal_mass", "tank", "history")


def _bias(rng: np.random.Generator, end: float) -> tuple[dict[str, Any], tuple[str, str, str]]:
    where = f"T_pm{rng.integers(1, 7)}_C" if rng.uniform() < _ONE_MODULE_SHARE else _pick(rng, CHANNELS)
    sign = float(rng.choice((-1.0, 1.0)))
    if rng.uniform() < 0.35:
        table = {"kind": "sensor", "where": where, "driver": "elapsed_time", "drift_per_h": sign * _size(rng, 0.6)}
        return table, ("sensor", where, "elapsed_time")
    table = {"kind": "sensor", "where": where, "driver": "constant", "bias": sign * _size(rng, 0.4)}
    return table, ("sensor", where, "constant")


def _lag(rng: np.random.Generator, end: float) -> tuple[dict[str, Any], tuple[str, str, str]]:
    where = _pick(rng, CHANNELS[:2])
    table = {"kind": "sensor", "where": where, "driver": "history", "lag_s": _size(rng, 60.0)}
    return table, ("sensor", where, "history")


def _actuator(rng: np.random.Generator, end: float) -> tuple[dict[str, Any], tuple[str, str, str]]:
    where = _pick(rng, ("heater_power", "pump_speed"))
    gain = 1.0 + float(rng.choice((-1.0, 1.0))) * min(_size(rng, 0.06), 0.2)
    if where == "pump_speed":
        gain = min(gain, 1.0 / gain)
    return {"kind": "actuator", "where": where, "driver": "constant", "gain": round(gain, 4)}, (
        "actuator",
        where,
        "constant",
    )


_FORMS: tuple[Callable[[np.random.Generator, float], tuple[dict[str, Any], tuple[str, str, str]]], ...] = (
    _source,
    _source,
    _source,
    _source_grows,
    _source_of_day,
    _source_driven,
    _loss,
    _loss,
    _rejection,
    _rejection,
    _flow,
    _bypass,
    _mass,
    _bias,
    _bias,
    _lag,
    _actuator,
)
"""Forms of effects; heat sources, losses, rejection and biases have more weight, as in practice."""


def _large(rng: np.random.Generator, usual: float) -> float:
    """Draw a size above the barely visible ones, for an effect outside the catalogue."""
    return float(f"{usual * np.exp(rng.uniform(np.log(0.4), np.log(2.5))):.3g}")


def _periodic(rng: np.random.Generator, end: float) -> Outside:
    where, period = _pick(rng, PLACES), float(round(rng.uniform(1800.0, 14400.0)))
    duty, power = float(round(rng.uniform(0.2, 0.7), 2)), _large(rng, 60.0)
    onset = _onset(rng, 0.8 * end)
    table = {
        "kind": "heat_source",
        "where": where,
        "driver": "periodic",
        "power_W": power,
        "period_s": period,
        "duty": duty,
        "onset_s": onset,
    }
    what = f"source of {power:g} W at {where}, on for {duty:.0%} of every {period:.0f} s"
    return what, (table,), ("heat_source", where, "periodic")


_WARMER_K = {"heater": 3.0, "modules": 3.0, "radiator": 0.5, "tank": 0.0}
"""Typical temperature above the tank, K."""


def _latch(rng: np.random.Generator, end: float) -> Outside:
    where, power = _pick(rng, PLACES), _large(rng, 60.0)
    # Between the coldest and the warmest temperature of these places on the loads drawn here.
    edge = float(round(rng.uniform(29.5, 33.0) + _WARMER_K[where], 1))
    table = {
        "kind": "heat_source",
        "where": where,
        "driver": "threshold",
        "power_W": power,
        "threshold_C": edge,
        "hysteresis_K": float(round(rng.uniform(0.5, 3.0), 1)),
        "onset_s": 0.0,
    }
    return f"source of {power:g} W at {where} above {edge:g} degC", (table,), ("heat_source", where, "threshold")


def _windows(rng: np.random.Generator, end: float, table: dict[str, Any], count: int) -> tuple[dict[str, Any], ...]:
    edges = np.sort(rng.uniform(0.08, 0.95, 2 * count)) * end
    return tuple(
        {**table, "onset_s": float(round(a)), "end_s": float(round(max(b, a + 600.0)))}
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    )


def _flow_for_a_time(rng: np.random.Generator, end: float) -> Outside:
    lost = min(_large(rng, 0.1), 0.35)
    table = {"kind": "flow", "where": "loop", "driver": "constant", "lost_fraction": lost}
    start = float(round(end * rng.uniform(0.1, 0.4)))
    tables = ({**table, "onset_s": start, "end_s": float(round(start + end * rng.uniform(0.12, 0.3)))},)
    return f"{lost:.0%} of the flow lost for a time", tables, ("flow", "loop", "history")


def _rejection_for_a_time(rng: np.random.Generator, end: float) -> Outside:
    lost = min(_large(rng, 0.15), 0.4)
    table = {"kind": "heat_rejection", "where": "radiator", "driver": "constant", "lost_fraction": lost}
    start = float(round(end * rng.uniform(0.1, 0.4)))
    tables = ({**table, "onset_s": start, "end_s": float(round(start + end * rng.uniform(0.12, 0.3)))},)
    return f"{lost:.0%} of the rejection lost for a time", tables, ("heat_rejection", "radiator", "history")


def _comes_and_goes(rng: np.random.Generator, end: float) -> Outside:
    where, power, count = _pick(rng, PLACES), _large(rng, 60.0), int(rng.integers(2, 6))
    table = {"kind": "heat_source", "where": where, "driver": "constant", "power_W": power}
    what = f"source of {power:g} W at {where}, {count} times on and off"
    return what, _windows(rng, end, table, count), ("heat_source", where, "history")


def _bias_for_a_time(rng: np.random.Generator, end: float) -> Outside:
    where, bias = _pick(rng, CHANNELS[:3]), _large(rng, 0.6)
    table = {"kind": "sensor", "where": where, "driver": "constant", "bias": bias}
    return f"{where} off by {bias:g} K twice for a time", _windows(rng, end, table, 2), ("sensor", where, "history")


def _stuck(rng: np.random.Generator, end: float) -> Outside:
    where, onset = _pick(rng, CHANNELS[:3]), float(round(end * rng.uniform(0.15, 0.6)))
    table = {"kind": "sensor", "where": where, "driver": "constant", "stuck": True, "onset_s": onset}
    return f"{where} stuck", (table,), ("sensor", where, "constant")


_OUTSIDE: tuple[Callable[[np.random.Generator, float], Outside], ...] = (
    _periodic,
    _periodic,
    _latch,
    _flow_for_a_time,
    _rejection_for_a_time,
    _comes_and_goes,
    _comes_and_goes,
    _bias_for_a_time,
    _stuck,
)


def effects_text(effects: tuple[dict[str, Any], ...]) -> str:
    """Return the effect file of a case."""
    lines = []
    for table in effects:
        lines.append("[[effect]]")
        for key, value in table.items():
            shown = "true" if value is True else f'"{value}"' if isinstance(value, str) else repr(float(value))
            lines.append(f"{key} = {shown}")
        lines.append("")
    return "\n".join(lines)
