"""Channel table of a cooling-tower cell: 52 channels in the paper's six groups, and the evidence over time.

Values are dimensionless: shares of design flow, speed and power, temperatures over design ranges. Channels without a
design value are centred and scaled by the station's own healthy record (median and quartiles). Channels of the outlet
hold interpolated minutes too; a window leaves out those after its last sample before the target, which an interpolation
towards the target's own samples made.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.calibrators.hiera_unet.data.subject import Channel, Deviation, Output, Subject
from twin.historian.events import Event
from twin.tower.air import CP_WATER, Array
from twin.tower.cell import Design
from twin.tower.identifiability.identify import TOLERANCE
from twin.tower.minutes import MEASURED, OFF_CHECK, Minutes
from twin.tower.model import DEVIATIONS
from twin.tower.twin_file import BOUNDS

DAY_S = 86400.0
MOST = 6.0
"""Largest absolute normalised value: a defect of the archive must not dominate a window."""
EVAPORATED = 0.00146
"""Share of the water that evaporates for a kelvin of its range: 85 % of c_p over the heat of vaporisation."""
LOAD_STEP = 0.05
"""Change of the load within ten minutes, share of design, that counts as a step."""
RATE_K = 0.5
"""Change of an outlet reading in five minutes, K, beyond the dynamics of a basin and a thermowell."""
CERTIFICATES = ("reference_thermometer", "instrument_work", "calibration", "thermometer_replacement")
CLEANINGS = ("cleaning", "fill_cleaning", "nozzle_cleaning")
CHANGES = ("fan_maintenance", "belt_change", "blade_pitch", "drift_eliminator")
MEMORY_D = 5.0
"""Days in which the trace of an event in its channel decays."""


def _group(group: str, *names: str, told: Sequence[str] = (), windowed: Sequence[str] = ()) -> tuple[Channel, ...]:
    return tuple(Channel(n, group, "1", n in told, n in windowed) for n in names)


CHANNELS = (
    *_group("ambient", "dry", "humidity", "wet", "wet_redundant", "pressure", "wind"),
    *_group(
        "hydraulic",
        "flow",
        "header",
        "pump_power",
        "valve",
        "bypass",
        "makeup",
        "blowdown",
        "r_evaporation",
        "r_energy",
    ),
    *_group(
        "thermal",
        "t_in",
        "t_out",
        "basin",
        "approach",
        "range",
        "effectiveness",
        "heat",
        "load",
        "r_outlet",
        "r_commissioned",
        told=("t_out", "basin", "approach", "range", "effectiveness", "heat", "r_outlet", "r_commissioned"),
        windowed=("r_outlet",),
    ),
    *_group("electrical", "fan_command", "fan_speed", "fan_power", "available", "neighbours", "r_fan"),
    *_group(
        "quality",
        "age_t_in",
        "age_t_out",
        "age_flow",
        "age_wet",
        "linked_t_in",
        "linked_t_out",
        "linked_flow",
        "linked_wet",
        "closure",
        "fast",
        "beyond",
        "redundancy",
        told=("age_t_out", "linked_t_out", "fast", "beyond", "redundancy"),
    ),
    *_group(
        "event",
        "fan_trip",
        "makeup_on",
        "certificate",
        "cleaning",
        "bypass_open",
        "overflow",
        "load_step",
        "configuration",
        "since_maintenance",
    ),
    *_group(
        "evidence",
        *(f"score_{n}" for n in DEVIATIONS),
        *(f"rate_{n}" for n in DEVIATIONS),
        told=tuple(f"score_{n}" for n in DEVIATIONS),
        windowed=(*(f"score_{n}" for n in DEVIATIONS), *(f"rate_{n}" for n in DEVIATIONS)),
    ),
)
"""Six groups of the paper (6, 9, 10, 6, 12, 9), then score and information rate of each deviation."""

STATICS = 16
"""Design 6, operating point of the day 8, age of the belief and blocks that it rests on 2."""
MEMORY = 8
SUBJECT = Subject(
    name="tower",
    step_s=60.0,
    channels=CHANNELS,
    regimes=8,
    outputs=(Output("t_out", "degC", TOLERANCE["outlet"]),),
    deviations=tuple(
        Deviation(n, "K" if n == "bias" else "1", BOUNDS[n], BOUNDS[n] / (2.0 if n == "bias" else 3.0))
        for n in DEVIATIONS
    ),
    statics=STATICS,
    memory=MEMORY,
    slope_signs=(-1, -1, -1, 1),
    residual="r_outlet",
    corrects=True,
)

CellColumns = Mapping[str, NDArray[Any]]


def channels_of(
    columns: CellColumns,
    minutes: Minutes,
    design: Design,
    sheet: Mapping[str, Any],
    clean: Array,
    log_clean: Array,
    events: Sequence[Event],
    healthy: slice,
) -> tuple[NDArray[np.float16], NDArray[np.bool_]]:
    """Return the channels (n, 60) of a record and where they are there; windowed ones are empty.

    Parameters:
        columns: of the aligned record. clean: outlet of the commissioned twin, degC. log_clean: logarithm of its fan
        power, kW. healthy: minutes of the healthy record, whose statistics scale what has no design value.
    """
    n = len(minutes.time_s)

    def column(name: str) -> Array:
        return np.asarray(columns[name], dtype=np.float64) if name in columns else np.full(n, np.nan)

    def measured(name: str) -> Array:
        how = columns.get(f"{name}_how")
        values = column(name)
        return values if how is None else np.where(np.asarray(how) == MEASURED, values, np.nan)

    sizes = sheet["design"]
    hot, cold, wet0 = (float(sizes[k]) for k in ("water_inlet_C", "water_outlet_C", "wet_bulb_C"))
    fall, approach, cells = hot - cold, cold - wet0, float(sheet["cells_in_station"])
    heat0 = design.m_w0 * CP_WATER * fall
    u = minutes.operation.inputs
    t_out, basin, load = reading_of(columns, n), measured("basin_C"), column("load_kW")
    span = u.t_in - t_out
    flow, around = u.m_w / design.m_w0, column("return_C") - column("supply_C")
    lost = (column("makeup_kg_s") - column("blowdown_kg_s")) / (design.m_w0 * cells)
    with np.errstate(invalid="ignore", divide="ignore"):
        log_power = np.where(u.speed > 0.15, np.log(column("fan_power_kW")), np.nan)
        effectiveness = np.where(u.t_in - u.wet > 0.5, span / (u.t_in - u.wet), np.nan)
    check = np.nan_to_num(column("check")).astype(int)
    shown = np.isfinite(t_out)
    values: dict[str, NDArray[Any]] = {
        "dry": (column("dry_C") - wet0) / 10.0,
        "humidity": _either(column("rh_pct"), column("rh2_pct")) / 50.0 - 1.0,
        "wet": (column("wet_C") - wet0) / 10.0,
        "wet_redundant": (column("wet_rh_C") - wet0) / 10.0,
        "pressure": 20.0 * (column("pressure_kPa") / float(sizes["pressure_kPa"]) - 1.0),
        "wind": column("wind_m_s") / 5.0 - 1.0,
        "flow": 2.0 * (flow - 1.0),
        "valve": column("riser_valve_pct") / 100.0,
        "bypass": column("bypass_pct") / 100.0,
        "t_in": (u.t_in - hot) / 10.0,
        "t_out": (t_out - cold) / 10.0,
        "basin": (basin - cold) / 10.0,
        "approach": (t_out - u.wet) / approach - 1.0,
        "range": span / fall - 1.0,
        "effectiveness": 4.0 * effectiveness - 2.0,
        "heat": u.m_w * CP_WATER * span / heat0 - 1.0,
        "load": 1e3 * load / (heat0 * cells) - 0.6,
        "r_commissioned": (t_out - clean) / TOLERANCE["outlet"],
        "fan_command": column("fan_command_pct") / 50.0 - 1.0,
        "fan_speed": 2.0 * u.speed - 1.0,
        "fan_power": column("fan_power_kW") / float(sheet["fan"]["power_at_design_kW"]) - 0.5,
        "available": np.where(
            np.isfinite(column("in_service")), (column("in_service") > 0.5) & ~(column("fan_fault") > 0.5), np.nan
        ),
        "neighbours": column("neighbours_speed_pct") / 50.0 - 1.0,
        "r_fan": 10.0 * (log_power - log_clean),
        "closure": column("closure_K") / 0.35,
        "fast": np.where(shown, _fast(t_out), np.nan),
        "beyond": np.where(shown, (check & 12) > 0, np.nan),
        "redundancy": np.where(shown, (check & 3) > 0, np.nan),
        "fan_trip": column("fan_fault"),
        "makeup_on": column("makeup_kg_s") > 0.2 * EVAPORATED * fall * design.m_w0 * cells,
        "bypass_open": column("bypass_pct") > 5.0,
        "overflow": column("level_pct") > 95.0,
        "load_step": _stepped(1e3 * load / (heat0 * cells)),
        "certificate": _trace(events, CERTIFICATES, minutes.time_s),
        "cleaning": _trace(events, CLEANINGS, minutes.time_s),
        "configuration": _trace(events, CHANGES, minutes.time_s),
        "since_maintenance": _since((*CLEANINGS, *CHANGES), events, minutes.time_s),
    }
    for name, source in (("t_in", "t_in_C"), ("t_out", "t_out_C"), ("flow", "m_w_kg_s"), ("wet", "wet_C")):
        age, how = column(f"{source}_age_min"), column(f"{source}_how")
        values[f"age_{name}"] = np.log1p(np.clip(age, 0.0, 1e4)) / 3.0
        values[f"linked_{name}"] = np.where(np.isfinite(how), how >= 2, np.nan)
    scaled = {
        "header": column("header_kPa"),
        "pump_power": column("pump_kW"),
        "makeup": column("makeup_kg_s"),
        "blowdown": column("blowdown_kg_s"),
        "r_evaporation": lost - EVAPORATED * around,
        "r_energy": 1e3 * load / (heat0 * cells) - around / fall,
    }
    values |= {name: _scaled(v, healthy) for name, v in scaled.items()}
    x = np.zeros((n, len(CHANNELS)), dtype=np.float16)
    there = np.zeros((n, len(CHANNELS)), dtype=bool)
    for i, one in enumerate(CHANNELS):
        if one.windowed:
            continue
        v = np.asarray(values[one.name], dtype=np.float64)
        there[:, i] = np.isfinite(v)
        x[:, i] = np.clip(np.where(there[:, i], v, 0.0), -MOST, MOST)
    return x, there


def reading_of(columns: CellColumns, n: int) -> Array:
    """Return the outlet reading, degC (n,), interpolated too; NaN where it contradicts inlet or wet bulb."""
    if "t_out_C" not in columns:
        return np.full(n, np.nan)
    bad = (np.nan_to_num(np.asarray(columns["check"], dtype=np.float64)).astype(int) & OFF_CHECK) > 0
    return np.where(bad, np.nan, np.asarray(columns["t_out_C"], dtype=np.float64))


def _either(a: Array, b: Array) -> Array:
    """Return the mean of two values, the other where one is missing."""
    return np.where(np.isfinite(a) & np.isfinite(b), 0.5 * (a + b), np.where(np.isfinite(a), a, b))


def statics_of(sheet: Mapping[str, Any], design: Design) -> Array:
    """Return the static numbers of a cell (6,): design flow, fan power, fill length, width and height, approach."""
    sizes, fill = sheet["design"], sheet["fill"]
    approach = float(sizes["water_outlet_C"]) - float(sizes["wet_bulb_C"])
    return np.array(
        [
            np.log(design.m_w0 / 200.0),
            np.log(float(sheet["fan"]["rated_power_kW"]) / 40.0),
            float(fill["length_m"]) / 10.0 - 1.0,
            float(fill["width_m"]) / 10.0 - 1.0,
            float(fill["height_m"]) / 1.5 - 1.0,
            approach / 4.0 - 1.0,
        ]
    )


def clock_of(time_s: Array) -> NDArray[np.float16]:
    """Return two harmonics of the day and one of the year, UTC (n, 6)."""
    day, year = 2.0 * np.pi * (time_s % DAY_S) / DAY_S, 2.0 * np.pi * (time_s % (365.25 * DAY_S)) / (365.25 * DAY_S)
    waves = [np.sin(day), np.cos(day), np.sin(2 * day), np.cos(2 * day), np.sin(year), np.cos(year)]
    return np.stack(waves, axis=1).astype(np.float16)


def _scaled(values: Array, healthy: slice) -> Array:
    """Return values less the median of the healthy record, over its interquartile range."""
    known = values[healthy][np.isfinite(values[healthy])]
    if len(known) < 100:
        return np.full(len(values), np.nan)
    low, middle, high = np.quantile(known, (0.25, 0.5, 0.75))
    # A quantity that hardly moves keeps a twentieth of its size as its scale.
    return np.asarray((values - middle) / max(high - low, 0.05 * abs(middle), 1e-9))


def _fast(t_out: Array) -> NDArray[np.bool_]:
    """Return readings that differ by more than `RATE_K` from the one before within five minutes."""
    rows = np.flatnonzero(np.isfinite(t_out))
    found = np.zeros(len(t_out), dtype=bool)
    near = np.diff(rows) <= 5
    found[rows[1:]] = near & (np.abs(np.diff(t_out[rows])) > RATE_K)
    return found


def _stepped(share: Array) -> Array:
    found = np.full(len(share), np.nan)
    change = np.abs(share[10:] - share[:-10])
    found[10:] = np.where(np.isfinite(change), change > LOAD_STEP, np.nan)
    return found


def _seen_at(event: Event) -> float:
    """Return the time, s, at which a maintenance entry is known: the end of its day if only that is recorded."""
    return event.time_s + (DAY_S if event.by_day else 0.0)


def _trace(events: Sequence[Event], kinds: Sequence[str], time_s: Array) -> Array:
    """Return 1 at an event of these kinds, decaying over days."""
    found = np.zeros(len(time_s))
    for event in events:
        if event.kind in kinds:
            days = (time_s - _seen_at(event)) / DAY_S
            found = np.maximum(found, np.where(days >= 0.0, np.exp(-np.maximum(days, 0.0) / MEMORY_D), 0.0))
    return found


def _since(kinds: Sequence[str], events: Sequence[Event], time_s: Array) -> Array:
    """Return the logarithm of the days since the last of these events, a year where there was none."""
    days = np.full(len(time_s), 365.0)
    for event in events:
        if event.kind in kinds:
            passed = (time_s - _seen_at(event)) / DAY_S
            days = np.where(passed >= 0.0, np.minimum(days, passed), days)
    return np.asarray(np.log1p(days) / 3.0 - 1.0)
