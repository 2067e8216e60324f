"""Journals of a made-up coolant loop: load steps, two or three twins, bad quality, gaps, calibrations, events."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.signals.points import Quality, Signal
from hil.journal.writer import Header, JournalWriter

SENSORS = {
    "T_heater_C": ("T_heater_C",),
    "T_modules_C": tuple(f"T_pm{i}_C" for i in range(1, 7)),
    "T_radiator_C": ("T_radiator_C",),
    "T_tank_C": ("T_tank_C",),
}
NARROW = ("heater_power_set", "heater_power", "T_tank")
COMMISSIONED = {
    "heater.capacity": (4200.0, "J/K"),
    "modules.capacity": (9800.0, "J/K"),
    "radiator.UA": (62.0, "W/K"),
    "tank.ambient_loss": (3.1, "W/K"),
    "pump.gain": (1.0, "1"),
    "fan.gain": (1.0, "1"),
}


def signals() -> tuple[Signal, ...]:
    """Set-points, read-backs, boundary conditions, nine thermocouples and two counters."""
    return (
        Signal("heater_power_set", "W", "setpoint", role="heater_power"),
        Signal("pump_speed_set", "%", "setpoint", role="pump_speed"),
        Signal("fan_speed_set", "%", "setpoint", role="fan_speed"),
        Signal("heater_power", "W", role="heater_power"),
        Signal("pump_speed", "%", role="pump_speed"),
        Signal("fan_speed", "%", role="fan_speed"),
        Signal("flow", "L/min"),
        Signal("T_ambient", "degC", role="T_ambient"),
        Signal("T_heater", "degC"),
        *(Signal(f"T_pm{i}", "degC") for i in range(1, 7)),
        Signal("T_radiator", "degC"),
        Signal("T_tank", "degC"),
        Signal("heartbeat", "1", "status"),
        Signal("alarm_bits", "1", "status"),
    )


@dataclass(frozen=True)
class Truth:
    """All arrays that `write` appends: `time_s (n,)`, `values (n, k)`, `quality (n, k)`, `twins` name -> `(n, m)`."""

    header: Header
    time_s: NDArray[np.float64]
    values: NDArray[np.float64]
    quality: NDArray[np.uint8]
    twins: dict[str, NDArray[np.float64]]


def _lagged(drive: NDArray[np.float64], tau_s: float, period_s: float) -> NDArray[np.float64]:
    from scipy.signal import lfilter

    a = np.exp(-period_s / tau_s)
    filtered, _ = lfilter([1 - a], [1, -a], drive, zi=[a * drive[0]])
    return np.asarray(filtered)


def make(ticks: int, *, period_s: float = 1.0, twins: tuple[str, ...] = ("static", "pso"), seed: int = 0) -> Truth:
    """A run of `ticks`, with NaN, every bad quality and a twin that starts late."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(ticks) * period_s
    header = Header(
        signals=signals(),
        twin_sensors=SENSORS,
        twin_names=twins,
        profile="battle_40h",
        duration_s=ticks * period_s,
        period_s=period_s,
        noise_K={"T_heater_C": 0.05, "T_modules_C": 0.03, "T_radiator_C": 0.05, "T_tank_C": 0.05},
    )
    columns = [signal.column for signal in header.signals]
    step = np.maximum(1, ticks // 40)
    power = 600.0 + 300.0 * rng.random(ticks // step + 1)[np.arange(ticks) // step]
    pump = 60.0 + 20.0 * (rng.random(ticks // (3 * step) + 1)[np.arange(ticks) // (3 * step)] > 0.5)
    fan = 40.0 + 40.0 * rng.random(ticks // (2 * step) + 1)[np.arange(ticks) // (2 * step)]
    ambient = 24.0 + 3.0 * np.sin(2 * np.pi * time_s / 86400.0)
    heater = ambient + _lagged(power / (12 + 0.2 * fan), 900.0, period_s)
    clean = {
        "T_heater_C": heater,
        "T_radiator_C": ambient + 0.62 * _lagged(heater - ambient, 120.0, period_s),
        "T_tank_C": ambient + 0.66 * _lagged(heater - ambient, 400.0, period_s),
        **{f"T_pm{i}_C": ambient + (0.8 + 0.02 * i) * _lagged(heater - ambient, 60.0, period_s) for i in range(1, 7)},
        "heater_power_set_W": power,
        "pump_speed_set_pct": pump,
        "fan_speed_set_pct": fan,
        "heater_power_W": _lagged(power, 5.0, period_s),
        "pump_speed_pct": _lagged(pump, 8.0, period_s),
        "fan_speed_pct": _lagged(fan, 12.0, period_s),
        "flow_L_per_min": _lagged(pump, 8.0, period_s) * 0.12,
        "T_ambient_C": ambient,
        "heartbeat": np.arange(ticks) % 65536.0,
        "alarm_bits": np.zeros(ticks),
    }
    values = np.column_stack([clean[column] for column in columns])
    for k, column in enumerate(columns):
        if column.startswith("T_"):
            values[:, k] = np.round((values[:, k] + rng.normal(0, 0.05, ticks)) / 0.0625) * 0.0625
        elif column in ("heater_power_W", "flow_L_per_min"):
            values[:, k] += rng.normal(0, 0.004 * np.abs(values[:, k]).max(), ticks)
    quality = np.zeros(values.shape, dtype=np.uint8)
    fault = slice(int(0.30 * ticks), int(0.36 * ticks))
    pm3 = columns.index("T_pm3_C")
    values[fault, pm3], quality[fault, pm3] = 327.67, Quality.SENSOR_FAULT
    stale = slice(int(0.55 * ticks), int(0.57 * ticks))
    tank = columns.index("T_tank_C")
    quality[stale, tank] = Quality.STALE
    link = slice(int(0.80 * ticks), int(0.81 * ticks))
    values[link], quality[link] = np.nan, Quality.LINK_FAULT
    values[int(0.9 * ticks), tank], quality[int(0.9 * ticks), tank] = 140.0, Quality.OUT_OF_RANGE
    outputs = {}
    for i, twin in enumerate(twins):
        off = (0.5, 0.05, 0.08)[i % 3]
        means = [np.mean([clean[column] for column in of], axis=0) for of in SENSORS.values()]
        shape = np.sin(2 * np.pi * time_s / (0.2 * ticks * period_s) + i)
        outputs[twin] = np.column_stack([mean + off * (1 + 0.3 * s * shape) for s, mean in enumerate(means)])
        if i:
            outputs[twin][: int(0.02 * ticks)] = np.nan
    return Truth(header, time_s, values, quality, outputs)


def narrowed(truth: Truth) -> Truth:
    """The same run of a rig with a heater and a tank alone, and one twin: its report has three plots, not thirteen."""
    kept = [k for k, signal in enumerate(truth.header.signals) if signal.name in NARROW]
    header = dataclasses.replace(
        truth.header,
        signals=tuple(truth.header.signals[k] for k in kept),
        twin_sensors={"T_tank_C": SENSORS["T_tank_C"]},
        twin_names=("static",),
        noise_K={"T_tank_C": truth.header.noise_K["T_tank_C"]},
    )
    static = truth.twins["static"][:, [list(SENSORS).index("T_tank_C")]]
    return Truth(header, truth.time_s, truth.values[:, kept], truth.quality[:, kept], {"static": static})


def put_ticks(writer: JournalWriter, truth: Truth, first: int, stop: int, twin_lag: int = 0) -> None:
    """Append ticks `first..stop`; the tracked twins follow `twin_lag` ticks behind."""
    for i in range(first, stop):
        writer.sample(
            i,
            float(truth.time_s[i]),
            1.7e9 + float(truth.time_s[i]),
            0.003,
            truth.values[i].tolist(),
            truth.quality[i].tolist(),
            (truth.time_s[i] - 0.01 + np.zeros(truth.values.shape[1])).tolist(),
        )
    for n, (twin, output) in enumerate(truth.twins.items()):
        lag = 0 if n == 0 else twin_lag
        a, b = max(0, first - lag), stop - lag if stop < len(truth.time_s) else stop
        if b > a:
            writer.twin_outputs(twin, range(a, b), truth.time_s[a:b].tolist(), output[a:b])


def put_window(writer: JournalWriter, truth: Truth, calibrator: str, n: int, start_s: float, end_s: float) -> None:
    """Append window `n` of `calibrator`: recovery first, one stall, else calibrated."""
    kind = "recovery" if n < 3 else "stall" if n % 29 == 11 else "calibrated"
    phase = len(calibrator) + np.arange(len(COMMISSIONED))
    drift = 1 + 0.08 * np.sin(n / 40.0 + phase)
    values = {name: float(value * d) for (name, (value, _)), d in zip(COMMISSIONED.items(), drift, strict=True)}
    writer.calibration(
        calibrator,
        start_s,
        end_s,
        {
            "kind": kind,
            "cost": 0.02 if kind == "calibrated" else 0.4,
            "rmse_before_K": 0.4,
            "rmse_K": 0.05 if kind == "calibrated" else 0.3,
            "calibrated": kind == "calibrated",
            "parameters": values,
            "standard_errors": {name: 0.01 * value for name, value in values.items()} if n % 7 else None,
            "flags": ["tank.ambient_loss at its upper bound"] if n == 5 else [],
        },
    )


def put_beside(writer: JournalWriter, truth: Truth, n: int, start_s: float, end_s: float) -> None:
    """Append the twins' bands of window `n`, none foretold for the first, and what the last tracked twin proposes."""
    for k, twin in enumerate(truth.header.twin_names):
        mean = dict.fromkeys(SENSORS, 0.01 * k + 0.001 * n)
        half = dict.fromkeys(SENSORS, 0.1 if n else None)
        writer.band(twin, start_s, end_s, {"mean_K": mean, "half_width_K": half})
    names = list(COMMISSIONED)
    held = dict.fromkeys(names, "SHORT_RECORD") if n < 3 else {names[n // 5 % len(names)]: "LOW_SENSITIVITY"}
    document = {
        "values": {name: value * (1.0 + 0.01 * n) for name, (value, _) in COMMISSIONED.items()},
        "standard_errors": {name: 0.02 * value for name, (value, _) in COMMISSIONED.items()},
        "held": held,
        "reasons": [f"{code}: withheld" for code in dict.fromkeys(held.values())],
    }
    writer.proposal(truth.header.twin_names[-1], end_s, document)


def write(
    path: Path, truth: Truth, *, block: int = 500, after_block: Callable[[int], None] = lambda tick: None
) -> None:
    """Write the whole run to a new journal at `path`, calling `after_block(ticks so far)` after each commit."""
    writer = JournalWriter(path, truth.header)
    ticks = len(truth.time_s)
    writer.put_meta("commissioned", {name: value for name, (value, _) in COMMISSIONED.items()})
    writer.put_meta("parameter_units", {name: unit for name, (_, unit) in COMMISSIONED.items()})
    writer.event(0, 0.0, "INFO", "run started: battle_40h on the virtual rig")
    window_s = min(600.0, ticks * truth.header.period_s / 20)
    windows = 0
    for first in range(0, ticks, block):
        stop = min(first + block, ticks)
        put_ticks(writer, truth, first, stop, twin_lag=block // 2)
        end_s = float(truth.time_s[stop - 1])
        while (windows + 1) * window_s <= end_s:
            for twin in truth.header.twin_names[1:]:
                put_window(writer, truth, twin, windows, windows * window_s, (windows + 1) * window_s)
            put_beside(writer, truth, windows, windows * window_s, (windows + 1) * window_s)
            windows += 1
        if first <= 0.3 * ticks < stop:
            writer.event(stop - 1, end_s, "WARN", "T_pm3_C: sensor fault, masked until it reads good again")
        if first <= 0.8 * ticks < stop:
            writer.event(stop - 1, end_s, "ERROR", "CAN link lost; heater to its safe value 0 W")
            writer.write(stop - 1, end_s, "heater_power_set", 0.0, "safe: CAN link lost")
        writer.commit()
        after_block(stop)
    writer.event(ticks - 1, float(truth.time_s[-1]), "INFO", "run finished")
    writer.put_meta("exit_status", "done")
    writer.close()
