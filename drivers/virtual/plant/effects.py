"""Effect files: physics that the rig has and its twin does not declare.

A file is a list of `[[effect]]` tables in the vocabulary of `diagnosis.json`: kind, where, driver, one magnitude
(and shape keys), `onset_s`, optional `ramp_s` (linear growth to full size) and `end_s`. This module reads and
validates; `effect_physics` and `sensor_faults` apply.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import inf, isfinite
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from drivers.virtual.plant.geometry import CHANNELS, PLACES, section_cells

READINGS = ("T_ambient_C", "heater_power_W", "flow_L_per_min", "pump_speed_pct", "fan_speed_pct")
"""Measured on the Modbus side; the thermocouples of `CHANNELS` are on CAN."""

ACTUATORS = ("heater_power", "pump_speed", "fan_speed")
_BYPASSABLE = ("heater", "modules", "radiator")


class EffectFileError(ValueError):
    """Error of an effect file that cannot be used: one sentence with file, line, key and remedy."""


class Form(NamedTuple):
    """Form of effect that may be declared: its places, driver, magnitude and shape keys."""

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
COMMON = ("kind", "where", "driver", "onset_s", "ramp_s", "end_s", "note")
NO_RAMP = ("stuck", "open_circuit", "lag_s", "capacity_J_per_K")
SWITCHES = ("stuck", "open_circuit")
"""Magnitudes that are true, not a number."""
_KEYS = {*COMMON, *(form.magnitude for form in FORMS), *(name for form in FORMS for name, _ in form.shape)}
SHAPES = {
    "tau_s": (0.0, inf),
    "peak_hour": (0.0, 24.0),
    "width_h": (0.0, 24.0),
    "exponent": (0.0, 3.0),
    "period_s": (0.0, inf),
    "duty": (0.0, 1.0),
    "threshold_C": (-inf, inf),
    "hysteresis_K": (0.0, inf),
    "conductance_W_per_K": (0.0, 1000.0),
}
"""Shape keys: above the first, at most the second; `peak_hour` may be the first, too. Some keep the plant stable."""
_ALONE = ("bypass_fraction", "recirculated_fraction", "capacity_J_per_K")
"""The plant has one of each."""


@dataclass(frozen=True, slots=True)
class PlantEffect:
    """Validated effect. `value` is in the unit that ends the magnitude's name."""

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
        """Return the relative size at `time_s`: 0 before onset and after end, 1 at full size, linear on the ramp."""
        if time_s < self.onset_s or time_s >= self.end_s:
            return 0.0
        if self.ramp_s > 0.0 and time_s < self.onset_s + self.ramp_s:
            return (time_s - self.onset_s) / self.ramp_s
        return 1.0


@dataclass(frozen=True, slots=True)
class _EffectPlace:
    """Place of effect `number` (from 1) in a file; `text` is the file's, empty where its lines are not known."""

    path: Path
    number: int
    text: str = ""

    def mistake(self, key: str, what: str) -> EffectFileError:
        """Return the error with its line: the key's, or the table's where the key is not there."""
        from drivers.rig_file import line_of

        line = f", line {line_of(self.text, ('effect', self.number - 1, key))}" if self.text else ""
        return EffectFileError(f"{self.path}{line}: effect {self.number}: {what}.")


def load_effects(path: Path) -> tuple[PlantEffect, ...]:
    """Return the effects of a file, in its order; raise EffectFileError."""
    # Here, because the package's models take a quarter of a second that each process of a rig without effects saves.
    from drivers.rig_file import line_of, read_regular, tables_of

    try:
        text, document = tables_of(read_regular(path))
    except OSError as error:
        raise EffectFileError(
            f"{path}: cannot be read ({error.strerror or error}); give the path of an effect file."
        ) from error
    except ValueError as error:
        raise EffectFileError(f"{path}: {error}.") from None
    for key in document:
        if key in _KEYS:
            raise EffectFileError(
                f"{path}, line {line_of(text, (key,))}: key '{key}' belongs to no effect; write [[effect]] above it."
            )
        if key != "effect":
            raise EffectFileError(
                f"{path}, line {line_of(text, (key,))}: key '{key}' is unknown; write only [[effect]] tables."
            )
    tables = document.get("effect")
    if isinstance(tables, dict):
        line = line_of(text, ("effect",))
        raise EffectFileError(f"{path}, line {line}: [effect] is one table; write [[effect]], with two brackets.")
    if not isinstance(tables, list) or not tables or not all(isinstance(table, dict) for table in tables):
        raise EffectFileError(f"{path}: key 'effect' holds no list of tables; write at least one [[effect]].")
    places = [_EffectPlace(path, n, text) for n in range(1, len(tables) + 1)]
    effects = tuple(_parse(table, place) for table, place in zip(tables, places, strict=True))
    for number, effect in enumerate(effects):
        for before in range(number):
            clash = _clash(effects[before], effect)
            if clash is not None:
                key, why = clash
                what = f"key '{key}' {why} effect {before + 1}; let one end before the other begins"
                raise places[number].mistake(key, what)
    return effects


def _clash(first: PlantEffect, second: PlantEffect) -> tuple[str, str] | None:
    """Return the key and the cause where the plant cannot have both effects at once, else None."""
    if first.onset_s >= second.end_s or second.onset_s >= first.end_s:
        return None
    if first.magnitude == second.magnitude and first.magnitude in _ALONE:
        return first.magnitude, "is at work already, and the rig can have only one at a time: see"
    if first.kind == second.kind == "heat_loss" and first.shape["exponent"] != second.shape["exponent"]:
        one, other = section_cells(first.where), section_cells(second.where)
        if one.start < other.stop and other.start < one.stop:
            return "exponent", "must be, at one place and time, that of"
    return None


def _parse(table: dict[str, Any], place: _EffectPlace) -> PlantEffect:
    form = _find_form(table, place)
    value = _magnitude(table, form, place)
    known = (*COMMON, form.magnitude, *(name for name, _ in form.shape))
    for key in table:
        if key not in known:
            raise place.mistake(key, f"key '{key}' is unknown here; use one of {', '.join(known)}")
    if not isinstance(table.get("note", ""), str):
        raise place.mistake("note", f"key 'note' is {table['note']!r}; give text")
    shape = {name: _shape(table, name, default, place) for name, default in form.shape}
    onset = _number(table, "onset_s", place, 0.0)
    ramp = _number(table, "ramp_s", place, 0.0)
    end = _number(table, "end_s", place, inf)
    if onset < 0.0:
        raise place.mistake("onset_s", f"key 'onset_s' is {onset:g}; give seconds of rig time, 0 or later")
    if ramp < 0.0:
        raise place.mistake("ramp_s", f"key 'ramp_s' is {ramp:g}; give seconds, 0 or more")
    if ramp > 0.0 and form.magnitude in NO_RAMP:
        raise place.mistake("ramp_s", f"key 'ramp_s' is {ramp:g}; '{form.magnitude}' needs it left out or 0")
    if needs_ramp(form) and ramp == 0.0:
        raise place.mistake(
            "ramp_s", "key 'ramp_s' is missing or 0; driver 'elapsed_time' grows over it, give seconds above 0"
        )
    if end <= onset:
        raise place.mistake("end_s", f"key 'end_s' is {end:g}; give a time after onset_s = {onset:g}")
    return PlantEffect(
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


def needs_ramp(form: Form) -> bool:
    """Return True for a form that grows with time by its ramp alone."""
    return form.driver == "elapsed_time" and form.magnitude == "lost_fraction"


def _find_form(table: dict[str, Any], place: _EffectPlace) -> Form:
    """Return the form that the table's kind, where, driver and magnitude select; raise EffectFileError."""
    forms = list(FORMS)
    for key, of in (
        ("kind", lambda form: (form.kind,)),
        ("where", lambda form: form.places),
        ("driver", lambda form: (form.driver,)),
    ):
        choices = _choice(name for form in forms for name in of(form))
        if key in table:
            forms = [form for form in forms if table[key] in of(form)]
            if not forms:
                raise place.mistake(key, f"key '{key}' is {table[key]!r}; use {choices}")
        elif key != "driver":
            raise place.mistake(key, f"key '{key}' is missing; give {choices}")
    named = [form for form in forms if form.magnitude in table]
    if len({form.magnitude for form in named}) != 1:
        fault = "has no magnitude" if not named else "has more than one magnitude"
        goes = f" that goes with driver '{table['driver']}'" if "driver" in table and not named else ""
        raise place.mistake("", f"the effect {fault}{goes}; give {_choice(form.magnitude for form in forms)}")
    if len(named) > 1:
        raise place.mistake("driver", f"key 'driver' is missing; give {_choice(form.driver for form in named)}")
    return named[0]


def _choice(names: Iterable[str]) -> str:
    different = list(dict.fromkeys(names))
    return different[0] if len(different) == 1 else f"one of {', '.join(different)}"


def _magnitude(table: dict[str, Any], form: Form, place: _EffectPlace) -> float:
    key = form.magnitude
    if key in SWITCHES:
        if table[key] is not True:
            raise place.mistake(key, f"key '{key}' must be true; leave the effect out otherwise")
        return 1.0
    value = _number(table, key, place, 0.0)
    if not form.lowest <= value <= form.highest:
        raise place.mistake(key, f"key '{key}' is {value:g}; give a number from {form.lowest:g} to {form.highest:g}")
    return value


def _shape(table: dict[str, Any], key: str, default: float | None, place: _EffectPlace) -> float:
    if key not in table and default is None:
        raise place.mistake(key, f"key '{key}' is missing; give it as a number")
    value = _number(table, key, place, default or 0.0)
    lowest, highest = SHAPES[key]
    if not lowest <= value <= highest or (value == lowest and key != "peak_hour"):
        raise place.mistake(key, f"key '{key}' is {value:g}; give a number {bounds_of(key)}")
    return value


def bounds_of(key: str) -> str:
    """Return the bounds of a shape key in words; empty where any number is allowed."""
    lowest, highest = SHAPES[key]
    if key == "peak_hour":
        return f"from 0 to {highest:g}"
    return "" if lowest == -inf else "above 0" + (f", at most {highest:g}" if highest < inf else "")


def _number(table: dict[str, Any], key: str, place: _EffectPlace, default: float) -> float:
    value = table.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float):
        shown = repr(value) if isinstance(value, str) else value
        raise place.mistake(key, f"key '{key}' is {shown}; give a number")
    try:
        number = float(value)
    except OverflowError:
        number = inf
    if key in table and not isfinite(number):
        raise place.mistake(key, f"key '{key}' is {number}; give a finite number")
    return number
