"""One case of the zoo: plant, healthy record, commissioned twin, record with a hidden effect, and the truth.

from hil.bench.zoo.case import make_case
case = make_case("serial", 7)
twin.discovery.diagnose(case.network, case.record, case.healthy)
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hil.bench.zoo.effects import EFFECTS, EffectType, Injection, NoSuchPlaceError, Scene, draw_effect
from hil.bench.zoo.plants import (
    FAMILIES,
    HOUR_S,
    KINDS,
    ROOM_COLUMN,
    ROOM_SIGMA_K,
    SEALED,
    START_H,
    Array,
    Drive,
    Schedule,
    ZooPlant,
    draw_drive,
    draw_plant,
)
from hil.bench.zoo.twins import sheet_twin
from hil.bench.zoo.visibility import yardstick
from hil.diagnosis import columns_of, with_clock
from hil.record import Record
from twin import CommissionOptions, Network, commission
from twin.discovery.healthy.basis import Columns

MOST_ROWS = 150_000
SCORES = (2.0, 1000.0)
"""Range from which the wanted true score is drawn, by its logarithm."""
HEALTHY_H = (8.0, 16.0)
RECORD_H = (6.0, 40.0)
PERIOD_S = (0.2, 30.0)
ALL_ALONG = 0.2
"""Share of the effects that act from the record's beginning."""
STARTS = 2
"""Descents of commissioning; the second is a check of the first."""
CLOSE = 0.25
"""Relative difference between the wanted score and the true one that needs no further simulation."""
TRIES = 5
"""Sizes of an effect that are simulated at most until its score is close to the wanted one."""
RUNAWAY = 0.3
"""Share of a size at which a plant ran away that is tried next, and the largest that is tried from then on."""


class SealedFamilyError(PermissionError):
    """Error of a sealed family that was asked for without opening it."""


@dataclass(frozen=True)
class ZooCase:
    """A case in memory.

    Attributes
    ----------
    name
        Family and seed, and the number within a trial.
    network
        The commissioned twin, with the time of day as an input.
    record, healthy
        Columns as `twin.discovery.diagnose` takes them.
    truth
        Effect, accepted answers, size, true score; plain data.
    tables
        Both records with all columns, by name: "record" and "healthy".
    commission_cpu_s
        Processor seconds of commissioning.
    """

    name: str
    network: Network
    record: Columns
    healthy: Columns
    truth: dict[str, Any]
    tables: Mapping[str, Record]
    commission_cpu_s: float


def make_case(
    family: str, seed: int, effect: str | None = "", *, open_sealed: bool = False, size: float | None = None
) -> ZooCase:
    """Make the case of a family and a seed.

    Parameters
    ----------
    family, seed
        One of `plants.families.FAMILIES`, and a number.
    effect
        Name of an effect; "" draws one, None leaves the plant healthy.
    open_sealed
        True allows a sealed family.
    size
        Size of the effect in its unit; by default it is found from a drawn true score.

    Raises
    ------
    SealedFamilyError
        The family is sealed and `open_sealed` is False.
    KeyError
        There is no such family or effect.
    NoSuchPlaceError
        The plant has no place for the named effect.
    """
    if family in SEALED and not open_sealed:
        raise SealedFamilyError(f"family {family} is sealed; it is run once, with --open-sealed, for published figures")
    plant = draw_plant(family, seed)
    rng = np.random.default_rng([seed, sorted(FAMILIES).index(family), 1])
    usual, schedule = draw_schedules(rng)
    healthy_drive = draw_drive(usual, plant.full_w, len(plant.pumps), rng)
    healthy = _healthy(plant, usual, healthy_drive, rng)
    network = sheet_twin(plant.sheet, fan_varies=usual.fan_varies, pump_varies=usual.pump_varies)
    began = time.process_time()
    chosen = network.select(healthy.columns)
    fit = commission(network, healthy.time_s, *chosen, CommissionOptions(starts=STARTS))
    took = time.process_time() - began

    drive = draw_drive(schedule, plant.full_w, len(plant.pumps), rng)
    onset = 0.0 if rng.random() < ALL_ALONG else float(rng.uniform(0.15, 0.6)) * schedule.hours * HOUR_S
    t = schedule.times
    calm = plant.run(drive, schedule.period_s)
    calm_shown = plant.readings(calm, schedule.period_s)
    scene = Scene(plant, drive, schedule, t, onset, rng, calm)
    kind, injection = _chosen(scene, effect, family in SEALED)
    shown, inputs = calm_shown, plant.columns(drive)
    truth: dict[str, Any] = {
        "family": family,
        "seed": seed,
        "effect": "none",
        "group": "none",
        "element": True,
        "answers": [],
        "place": "",
        "score": 0.0,
        "score_of_noise": 0.0,
    }
    if kind is not None and injection is not None:
        network_inputs, first = _of(fit.network, calm_shown, inputs)
        ruler = yardstick(fit, (healthy.time_s, *chosen), t, network_inputs, first[0])
        wanted = float(np.exp(rng.uniform(*np.log(SCORES))))
        given = size is not None
        amount = float(size) if size is not None else injection.first
        most = injection.most
        for left in reversed(range(1 if given else TRIES)):
            shown, inputs = inject(plant, drive, schedule, injection, amount, calm, calm_shown)
            scores = ruler.scores(
                *reversed(_of(fit.network, shown, inputs)),
                *reversed(_of(fit.network, calm_shown, plant.columns(drive))),
            )
            factor = wanted / max(scores[0], 1e-9)
            if not np.isfinite(factor):
                # With an effect that feeds itself a plant can run away beyond every number.
                most, factor = amount * RUNAWAY, RUNAWAY
            elif abs(factor - 1.0) < CLOSE or (factor > 1.0 and amount >= most):
                break
            if left:
                amount = float(min(amount * np.clip(factor, 1e-3, 30.0), most))
        truth |= {
            "effect": kind.name,
            "group": kind.group,
            "element": kind.element,
            "place": injection.place,
            "answers": [asdict(a) for a in injection.answers],
            "size": amount,
            "unit": injection.unit,
            "onset_s": injection.onset_s,
            "score": scores[0],
            "score_of_noise": scores[1],
            "wanted": wanted,
        }
    truth |= {"schedule": asdict(schedule), "rows": len(t), "sigma_K": plant.sigma_K, "volumes": len(network.nodes)}
    record = noisy(plant, t, shown, inputs, np.random.default_rng([seed, 3]))
    clocked = with_clock(fit.network)
    return ZooCase(
        f"{family}_{seed}",
        clocked,
        columns_of(clocked, record, START_H),
        columns_of(clocked, healthy, START_H),
        truth,
        {"record": record, "healthy": healthy},
        took,
    )


def draw_schedules(rng: np.random.Generator) -> tuple[Schedule, Schedule]:
    """Draw the schedules of the healthy record and of the record; sampling and standing speeds are the rig's."""
    period = float(np.exp(rng.uniform(*np.log(PERIOD_S))))
    period = float(f"{period:.2g}")
    longest = (MOST_ROWS - 1) * period / HOUR_S
    pump, fan = bool(rng.random() < 0.6), bool(rng.random() < 0.75)
    hours = [min(float(rng.uniform(*span)), longest) for span in (HEALTHY_H, RECORD_H)]
    usual = Schedule(str(rng.choice(["steps", "telegraph", "ramps"])), pump, fan, hours[0], period)
    return usual, Schedule(str(rng.choice(KINDS)), pump, fan, hours[1], period)


def _chosen(scene: Scene, effect: str | None, sealed: bool) -> tuple[EffectType | None, Injection | None]:
    if effect is None:
        return None, None
    if not effect:
        return draw_effect(scene, scene.rng, sealed)
    kind = next((e for e in EFFECTS if e.name == effect), None)
    if kind is None:
        raise KeyError(f"no effect {effect!r}")
    return kind, kind.build(scene)


def inject(
    plant: ZooPlant,
    drive: Drive,
    schedule: Schedule,
    injection: Injection,
    size: float,
    calm: Array,
    calm_shown: Mapping[str, Array],
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return noise-free readings and recorded inputs of a record with an effect of a size."""
    inputs = plant.columns(drive)
    shown = dict(calm_shown)
    if injection.modifiers or injection.commands:
        acting = _delivered(plant, drive, injection, size)
        shown = plant.readings(plant.run(acting, schedule.period_s, injection.sized(size), calm[0]), schedule.period_s)
    context = {**shown, **inputs}
    for column, form in injection.readings.items():
        shown[column] = form(size, shown[column], context)
    for column, form in injection.recorded.items():
        inputs[column] = form(size, inputs[column], context)
    return shown, inputs


def _delivered(plant: ZooPlant, drive: Drive, injection: Injection, size: float) -> Drive:
    heat, pump, fan = drive.heat.copy(), drive.pump.copy(), drive.fan.copy()
    for column, form in injection.commands.items():
        if column in plant.heat_columns:
            k = plant.heat_columns.index(column)
            heat[:, k] = np.clip(form(size, heat[:, k]), 0.0, None)
        elif column in plant.pumps:
            k = plant.pumps.index(column)
            pump[:, k] = np.clip(form(size, pump[:, k]), 0.0, 1.0)
        else:
            fan = np.clip(form(size, fan), 0.0, 1.0)
    return Drive(pump, fan, heat, drive.room, drive.humidity, drive.flow_noise, drive.fan_noise)


def noisy(
    plant: ZooPlant, t: Array, shown: Mapping[str, Array], inputs: Mapping[str, Array], rng: np.random.Generator
) -> Record:
    """Return the record: readings and room with white noise, the other inputs as they are."""
    columns = {c: y + plant.sigma_K * rng.normal(size=len(t)) for c, y in shown.items()}
    found = {**inputs, **columns}
    found[ROOM_COLUMN] = found[ROOM_COLUMN] + ROOM_SIGMA_K * rng.normal(size=len(t))
    return Record(t, found)


def _healthy(plant: ZooPlant, schedule: Schedule, drive: Drive, rng: np.random.Generator) -> Record:
    t = schedule.times
    shown = plant.readings(plant.run(drive, schedule.period_s), schedule.period_s)
    return noisy(plant, t, shown, plant.columns(drive), rng)


def _of(network: Network, shown: Mapping[str, Array], inputs: Mapping[str, Array]) -> tuple[Array, Array]:
    """Return a network's inputs and noise-free readings."""
    return network.select({**shown, **inputs})


__all__ = ["NoSuchPlaceError", "SealedFamilyError", "ZooCase", "make_case"]
