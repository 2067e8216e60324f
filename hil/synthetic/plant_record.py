"""Simulated record of the virtual rig without protocols: the same plant, instruments and thermocouple module.

What the wires do is repeated: the slew rates of the set-points, the resolution of registers and frames. What is left
out are the protocols, the engine and its interlocks; the thermostat ends the record, as it would end the run.
"""

from __future__ import annotations

import numpy as np

from drivers.rig_file import Rig
from drivers.virtual.devices import THERMOSTAT_C
from drivers.virtual.plant import (
    CHANNELS,
    FRAME_IDS,
    OPEN_CIRCUIT,
    Array,
    Instruments,
    Plant,
    PlantEffect,
    ThermocoupleModule,
)
from hil.profile import Profile
from hil.record import Record
from hil.run.outputs import Setpoints, bind

READ = ("T_ambient_C", "heater_power_W", "flow_L_per_min", "pump_speed_pct", "fan_speed_pct")
RESOLUTION = (0.01, 0.0, 0.0, 0.1, 0.1)
"""Resolution of the registers; power and flow are floats."""
COUNTS_PER_K = 100.0
WORDS = 4 * len(FRAME_IDS)
_START = (0.0, 1.0, 1.0)
"""Heater W, pump and fans before the first tick: the state in which a run leaves the rig."""


def direct_record(profile: Profile, rig: Rig, *, seed: int, unit: int, effects: tuple[PlantEffect, ...] = ()) -> Record:
    """Replay `profile` on the virtual rig's parts; one row a second, columns as `hil run` records them.

    Parameters
    ----------
    seed
        Of weather and noise.
    unit
        The specimen, whose sensors' offsets stay from run to run.
    """
    plant = Plant(seed=seed, period_s=rig.period_s, effects=effects)
    return direct_run(profile, rig, plant, seed=seed, unit=unit, effects=effects)[0]


def direct_run(
    profile: Profile, rig: Rig, plant: Plant, *, seed: int, unit: int, effects: tuple[PlantEffect, ...] = ()
) -> tuple[Record, Array]:
    """Replay a profile on a given plant, as `direct_record`.

    Parameters
    ----------
    profile, rig, plant
        Loads, rig file and plant.
    seed
        Seed of the noise.
    unit
        Number of the specimen, which decides the offsets of its sensors.
    effects
        Effects that the plant has and no twin knows of.

    Returns
    -------
    tuple
        The record, and the true temperatures of its junctions, (n, 9) degC in the order of `CHANNELS`.
    """
    period = rig.period_s
    instruments = Instruments(seed, period, effects, unit)
    module = ThermocoupleModule(seed, effects, unit)
    points = bind(rig, profile.columns)
    setpoints = Setpoints(rig)
    names = [next(p.name for p in points if p.name.startswith(what)) for what in ("heater", "pump", "fan")]
    order = [[p.name for p in points].index(name) for name in names]
    ticks = int(profile.duration_s / period) + 1
    targets = profile.sample(np.arange(ticks, dtype=np.float64) * period).tolist()
    rows: list[list[float]] = []
    frames: list[bytes] = []
    junctions: list[list[float]] = []
    plant.step(*_START)
    for target in targets:
        rows.append(instruments.read(plant))
        junctions.append(plant.junction.tolist())
        frames.extend(module.sample(plant.time_s, plant.junction.tolist()))
        if plant.heater_water_C > THERMOSTAT_C:
            break
        setpoints.move({name: target[k] for name, k in zip(names, order, strict=True)}, period)
        heater, pump, fan = (setpoints.values[name] for name in names)
        plant.step(round(heater, 1), round(pump, 1) / 100.0, round(fan, 1) / 100.0)
    raw = np.frombuffer(b"".join(frames), dtype="<i2").reshape(-1, WORDS)[:, : len(CHANNELS)]
    columns = {n: np.where(raw[:, k] == OPEN_CIRCUIT, np.nan, raw[:, k] / COUNTS_PER_K) for k, n in enumerate(CHANNELS)}
    read = np.array(rows)
    for k, (name, step) in enumerate(zip(READ, RESOLUTION, strict=True)):
        columns[name] = np.round(read[:, k] / step) * step if step else read[:, k].astype(np.float32).astype(np.float64)
    return Record(np.arange(len(rows), dtype=np.float64) * period, columns), np.array(junctions)
