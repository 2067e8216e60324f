"""Effect files: physics that the rig has and its twin does not declare.

A file is a list of `[[effect]]` tables in the vocabulary of `diagnosis.json`: kind, where, driver, one magnitude
(and shape keys), `onset_s`, optional `ramp_s` (linear growth to full size) and `end_s`. This module reads and
validates; `effect_physics` and `sensor_faults` apply.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf, isfinite
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from drivers.virtual.geometry import CHANNELS, PLACES

READINGS = ("T_ambient_C", "heater_power_W", "flow_L_per_min", "pump_speed_pct", "fan_speed_pct")
"""Measured on the Modbus side; the thermocouples of `CHANNELS` are on CAN."""

ACTUATORS = ("heater_power", "pump_speed", "fan_speed")
_BYPASSABLE = ("heater", "modules", "radiator")


class EffectFileError(ValueError):
    """An effect file that cannot be used: one sentence with file, key and remedy."""


class Form(NamedTuple):
    """One thing that may be declared: where it may stand, its driver, its magnitude and its shape keys."""

    kind: str
    places: tuple[str, ...]
    driver: str
    magnitude: str
    lowest: float
    highest: float
    shape: tuple[tuple[str, float | None], ...] = ()
    """Further keys with their default; None means that the key must be given."""


_HEAT = ("heat_source", PLACES)
_LIMIT_W = 3000.0
FORMS = (
    Form(*_HEAT, "constant", "power_W", -_LIMIT_W, _LIMIT_W),
    Form(*_HEAT, "elapsed_time", "power_W", -_LIMIT_W, _LIMIT_W, (("tau_s", None),)),
    Form(*_HEAT, "time_of_day", "power_W", -_LIMIT_W, _LIMIT_W, (("peak_hour", 13.0), ("width_h", 6.0))),
    Form(*_HEAT, "heater_power", "power_W", -_LIMIT_W, _LIMIT_W, (("exponent", 1.0),)),
    Form(*_HEAT, "pump_speed", "power_W", -_LIMIT_W, _LIMIT_W, (("exponent", 3.0),)),
    Form(*_HEAT, "fan_speed", "power_W", -_LIMIT_W, _LIMIT_W, (("exponent", 1.0),)),
    Form(*_HEAT, "periodic", "power_W", -_LIMIT_W, _LIMIT_W, (("period_s", None), ("duty", 0.5))),
    Form(*_HEAT, "threshold", "power_W", -_LIMIT_W, _LIMIT_W, (("threshold_C", None), ("hysteresis_K", 0.5))),
    Form("heat_loss", PLACES, "temperature_difference", "conductance_W_per_K", 0.0, 60.0, (("exponent", 1.0),)),
    Form("heat_rejection", ("radiator",), "constant", "lost_fraction", -0.5, 0.95),
    Form("heat_rejection", ("radiator",), "elapsed_time", "lost_fraction", -0.5, 0.95),
    Form("heat_rejection", ("radiator",), "fan_speed", "exponent_change", -0.6, 2.0),
    Form("heat_rejection", ("radiator",), "rejected_heat", "recirculated_fraction", 0.0, 0.7),
    Form("flow", ("loop",), "constant", "lost_fraction", -0.5, 1.0),
    Form("flow", ("loop",), "elapsed_time", "lost_fraction", -0.5, 1.0),
    Form("flow", _BYPASSABLE, "constant", "bypass_fraction", 0.0, 0.95),
    Form("thermal_mass", ("tank",), "history", "capacity_J_per_K", 100.0, 1e6, (("conductance_W_per_K", None),)),
    Form("sensor", CHANNELS + READINGS, "constant", "bias", -1000.0, 1000.0),
    Form("sensor", CHANNELS + READINGS, "elapsed_time", "drift_per_h", -1000.0, 1000.0),
    Form("sensor", CHANNELS + READINGS, "history", "lag_s", 0.0, 7200.0),
    Form("sensor", CHANNELS + READINGS, "constant", "stuck", 1.0, 1.0),
    Form("sensor", CHANNELS, "constant", "open_circuit", 1.0, 1.0),
    Form("sensor", CHANNELS, "periodic", "jump_K", -1000.0, 1000.0, (("period_s", None), ("duty", 0.5))),
    Form("actuator", ACTUATORS, "constant", "gain", 0.0, 2.0),
)
_COMMON = ("kind", "where", "driver", "onset_s", "ramp_s", "end_s", "note")
_NO_RAMP = ("stuck", "open_circuit", "lag_s", "capacity_J_per_K")
_POSITIVE = ("tau_s", "width_h", "period_s", "duty", "exponent", "conductance_W_per_K", "hysteresis_K")


@dataclass(frozen=True, slots=True)
class Effect:
    """One validated effect. `value` is in the unit that ends the magnitude's name."""

    kind: str
    where: str
    driver: str
    magnitude: str
    value: float
    onset_s: float = 0.0
    ramp_s: float = 0.0
    end_s: float = inf
    shape: Mapping[str, float] = field(default_factory=dict)

    def envelope(self, time_s: float) -> float:
        """0 before the onset and after the end, 1 at full size, linear on the ramp."""
        if time_s < self.onset_s or time_s >= self.end_s:
            return 0.0
        if self.ramp_s > 0.0 and time_s < self.onset_s + self.ramp_s:
            return (time_s - self.onset_s) / self.ramp_s
        return 1.0


def load_effects(path: Path) -> tuple[Effect, ...]:
    """Effects of a file, in its order. Raises `EffectFileError`."""
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise EffectFileError(
            f"{path}: cannot be read ({error.strerror or error}); give the path of an effect file."
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise EffectFileError(f"{path}: is not TOML ({error}); correct the file there.") from error
    for key in document:
        if key != "effect":
            raise EffectFileError(f"{path}: key '{key}' is unknown; write only [[effect]] tables.")
    tables = document.get("effect")
    if not isinstance(tables, list) or not tables or not all(isinstance(table, dict) for table in tables):
        raise EffectFileError(f"{path}: key 'effect' holds no list of tables; write at least one [[effect]].")
    return tuple(_parse(table, f"{path}: effect {number}") for number, table in enumerate(tables, 1))


def _parse(table: dict[str, Any], place: str) -> Effect:
    form = _find_form(table, place)
    value = _magnitude(table, form, place)
    known = (*_COMMON, form.magnitude, *(name for name, _ in form.shape))
    for key in table:
        if key not in known:
            raise EffectFileError(f"{place}: key '{key}' is unknown here; use one of {', '.join(known)}.")
    shape = {}
    for name, default in form.shape:
        if name not in table and default is None:
            raise EffectFileError(f"{place}: key '{name}' is missing; give it as a number.")
        shape[name] = _number(table, name, place, default or 0.0)
        if name in _POSITIVE and shape[name] <= 0.0:
            raise EffectFileError(f"{place}: key '{name}' is {shape[name]:g}; give a number above 0.")
    if shape.get("duty", 0.0) > 1.0:
        raise EffectFileError(f"{place}: key 'duty' is {shape['duty']:g}; give the share of the period, up to 1.")
    onset = _number(table, "onset_s", place, 0.0)
    ramp = _number(table, "ramp_s", place, 0.0)
    end = _number(table, "end_s", place, inf)
    if onset < 0.0:
        raise EffectFileError(f"{place}: key 'onset_s' is {onset:g}; give seconds of rig time, 0 or later.")
    if ramp < 0.0 or (ramp > 0.0 and form.magnitude in _NO_RAMP):
        raise EffectFileError(f"{place}: key 'ramp_s' is {ramp:g}; '{form.magnitude}' needs it left out or 0.")
    if form.driver == "elapsed_time" and form.magnitude == "lost_fraction" and ramp == 0.0:
        raise EffectFileError(f"{place}: key 'ramp_s' is missing; driver 'elapsed_time' grows over it.")
    if end <= onset:
        raise EffectFileError(f"{place}: key 'end_s' is {end:g}; give a time after onset_s = {onset:g}.")
    return Effect(
        kind=form.kind,
        where=table["where"],
        driver=form.driver,
        magnitude=form.magnitude,
        value=value,
        onset_s=onset,
        ramp_s=ramp,
        end_s=end,
        shape=MappingProxyType(shape),
    )


def _find_form(table: dict[str, Any], place: str) -> Form:
    """The one form that the table's kind, where, driver and magnitude select."""
    forms = list(FORMS)
    for key, of in (
        ("kind", lambda form: (form.kind,)),
        ("where", lambda form: form.places),
        ("driver", lambda form: (form.driver,)),
    ):
        choices = list(dict.fromkeys(name for form in forms for name in of(form)))
        if key not in table:
            if key == "driver" and sum(form.magnitude in table for form in forms) == 1:
                continue  # the magnitude alone says which driver is meant
            raise EffectFileError(f"{place}: key '{key}' is missing; give one of {', '.join(choices)}.")
        forms_left = [form for form in forms if table[key] in of(form)]
        if not forms_left:
            raise EffectFileError(f"{place}: key '{key}' is {table[key]!r}; use one of {', '.join(choices)}.")
        forms = forms_left
    named = [form for form in forms if form.magnitude in table]
    if len(named) != 1:
        names = ", ".join(dict.fromkeys(form.magnitude for form in forms))
        fault = "is missing its magnitude" if not named else "has more than one magnitude"
        raise EffectFileError(f"{place}: the effect {fault}; give exactly one of {names}.")
    return named[0]


def _magnitude(table: dict[str, Any], form: Form, place: str) -> float:
    if form.magnitude in ("stuck", "open_circuit"):
        if table[form.magnitude] is not True:
            raise EffectFileError(f"{place}: key '{form.magnitude}' must be true; leave the effect out otherwise.")
        return 1.0
    value = _number(table, form.magnitude, place, 0.0)
    if not form.lowest <= value <= form.highest:
        raise EffectFileError(
            f"{place}: key '{form.magnitude}' is {value:g}; give a number from {form.lowest:g} to {form.highest:g}."
        )
    return value


def _number(table: dict[str, Any], key: str, place: str, default: float) -> float:
    value = table.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise EffectFileError(f"{place}: key '{key}' is {value!r}; give a number.")
    try:
        number = float(value)
    except OverflowError:
        number = inf
    if key in table and not isfinite(number):
        raise EffectFileError(f"{place}: key '{key}' is {number}; give a finite number.")
    return number
