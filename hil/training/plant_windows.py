"""Campaigns of the virtual rig's plant, whose equations differ from the twin's: the other half of the training data.

Half of the rigs are other specimens: films, losses and masses scattered about the built ones, each commissioned on a
record of its own as a user would. Hidden effects are those of `hil bench discovery`; where one is a parameter that the
twin tracks, its deviation is known, and where it stands in for one, that one's is not.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from drivers.rig_file import load_rig
from drivers.virtual.plant import (
    CHANNELS,
    MODULES,
    Cells,
    Plant,
    PlantEffect,
    ThermocoupleModule,
    build_cells,
    load_effects,
)
from hil.synthetic import LOADS, Setting, Truth, direct_run, effects_text, profile, truth
from twin.calibrators.hiera_unet import Features, LabelledRecord, ResampledSeries
from twin.calibrators.hiera_unet.data.parameters import LOSS, SUM
from twin.calibrators.hiera_unet.data.series import series
from twin.calibrators.hiera_unet.simulated.campaigns import AMISS
from twin.calibrators.hiera_unet.simulated.gaps import damaged
from twin.commissioning import CommissionOptions, commission
from twin.network import Array, Network, TwinFileError
from twin.twinfile import load

PROFILES = Path(__file__).resolve().parents[2] / "profiles"
RIG = PROFILES / "rigs" / "virtual.toml"
TWIN = PROFILES / "twins" / "virtual.toml"
HOURS = 4.0
HEALTHY = 0.15
"""Share of healthy campaigns, in addition to the healthy quarter of the hidden effects."""
TRACKED = 0.4
"""Share of the others whose hidden effect is a parameter of the loop's twin."""
SHIPPED = 0.35
"""Share of campaigns on the rig as built, with the twin as shipped."""
PER_RIG = 8
SCATTER = {"film": 0.25, "film_floor": 0.25, "outer": 0.4, "solid_J_per_K": 0.25, "water_kg": 0.1}
"""Standard deviations of the logarithms of quantities that differ between specimens, by section."""
COMMISSION_H = 8.0
START_HOUR = 8.0
WARM_C = (20.0, 34.0)


@dataclass(frozen=True)
class Specimen:
    """Specimen of the plant's kind: its cells, its sensors' offsets by number, and its commissioned vector (p,)."""

    cells: Cells | None
    unit: int
    nominal: Array


def campaign(features: Features, seed: int, number: int) -> LabelledRecord:
    """Return campaign `number` of a seed."""
    rng = np.random.default_rng([seed, number, 7])
    specimen = specimen_of(features, seed, number // PER_RIG)
    case = Setting(number, int(rng.integers(1_000_000, 2**31)), specimen.unit, _load(rng), HOURS)
    hidden = truth(number, seed + 1_000_003, HOURS, "healthy" if rng.uniform() < HEALTHY else "case")
    if hidden.effects and rng.uniform() < TRACKED:
        hidden = _tracked(rng)
    effects = _loaded(effects_text(hidden.effects)) if hidden.effects else ()
    made, clean = recorded(features, case, specimen, effects, start_C=float(rng.uniform(*WARM_C)))
    inputs, measured, gaps = damaged(rng, made.inputs, made.measured)
    extra = made.extra if rng.uniform() < 0.6 else {}
    kept = ResampledSeries(
        made.time, inputs, measured, made.spread, extra, made.hour if rng.uniform() < 0.7 else float("nan")
    )
    theta, amiss = equivalent_deviations(features, effects, made.time)
    words = () if not hidden.effects else (hidden.what,)
    return LabelledRecord(kept, clean, theta, amiss, specimen.nominal, "plant", (*words, *gaps))


def _tracked(rng: np.random.Generator) -> Truth:
    """Draw one or two powers and losses that are parameters of the loop's twin."""
    tables: list[dict[str, Any]] = []
    for _ in range(1 + int(rng.uniform() < 0.35)):
        onset = 0.0 if rng.uniform() < 0.2 else float(round(rng.uniform(0.1, 0.9) * HOURS * 3600.0))
        grown = {"ramp_s": float(round(rng.uniform(600.0, 5400.0)))} if rng.uniform() < 0.2 else {}
        if rng.uniform() < 0.5:
            power = float(round(np.exp(rng.uniform(np.log(8.0), np.log(300.0))), 1))
            what = {"kind": "heat_source", "where": "modules", "driver": "constant", "power_W": power}
        else:
            size = float(round(np.exp(rng.uniform(np.log(0.3), np.log(10.0))), 2))
            where = str(rng.choice(("heater", "modules", "tank")))
            what = {"kind": "heat_loss", "where": where, "driver": "temperature_difference"}
            what |= {"conductance_W_per_K": size}
        tables.append({**what, **grown, "onset_s": onset})
    said = " + ".join(f"{t['kind']} at {t['where']}" for t in tables)
    return Truth("one", said, tuple(tables), ())


def _load(rng: np.random.Generator) -> str:
    return str(LOADS[int(rng.integers(len(LOADS)))])


def recorded(
    features: Features,
    case: Setting,
    specimen: Specimen,
    effects: tuple[PlantEffect, ...],
    start_C: float | None = None,
) -> tuple[ResampledSeries, Array]:
    """Return a record on the network's own steps, and fault-free sensor readings there (n, Y).

    Parameters
    ----------
    features
        Channels of the network, with their step.
    case
        Load and duration.
    specimen
        Specimen of the plant, with its commissioned twin.
    effects
        Effects that the plant has.
    start_C
        Temperature at the beginning, degC; None for a plant at rest.
    """
    columns, junctions, time = run(case, specimen, effects, start_C)
    made = series(features.network, time, columns, extra=features.table.extra, hour=START_HOUR)
    at = np.minimum(np.round(made.time - time[0]).astype(np.intp), len(junctions) - 1)
    # The thermocouples' constant offsets belong to the specimen: the twin was commissioned with them.
    offsets = ThermocoupleModule(0, (), specimen.unit).offsets_K
    return made, readings(features.network, junctions[at] + offsets)


def run(
    case: Setting, specimen: Specimen, effects: tuple[PlantEffect, ...], start_C: float | None = None
) -> tuple[dict[str, Array], Array, Array]:
    """Return columns, true junctions and stamps of a record."""
    rig = load_rig(RIG)
    plant = Plant(seed=case.seed, period_s=rig.period_s, effects=effects, cells=specimen.cells, start_C=start_C)
    record, junctions = direct_run(profile(case), rig, plant, seed=case.seed, unit=case.unit, effects=effects)
    return record.columns, junctions, record.time_s


def readings(network: Network, junctions: Array) -> Array:
    """Return the sensor readings (n, Y) of true junctions (n, 9)."""
    where = {name: k for k, name in enumerate(CHANNELS)}
    return np.column_stack([junctions[:, [where[c] for c in s.measured]].mean(axis=1) for s in network.sensors])


@lru_cache(maxsize=2)
def specimen_of(features: Features, seed: int, number: int) -> Specimen:
    """Return a specimen, commissioned on a healthy record of its own.

    Raises
    ------
    TwinFileError
        None of several could be commissioned.
    """
    rng = np.random.default_rng([seed, number, 11])
    network = load(TWIN)
    unit = int(rng.integers(1, 10_000))
    if rng.uniform() < SHIPPED:
        return Specimen(None, unit, network.values.copy())
    for _ in range(8):
        cells = scattered(rng)
        load_kind = "steps" if rng.uniform() < 0.8 else "battle"
        case = Setting(number, int(rng.integers(1_000_000, 2**31)), unit, load_kind, COMMISSION_H)
        columns, _, time = run(case, Specimen(cells, unit, network.values), ())
        made = series(network, time, columns)
        try:
            done = commission(
                network, made.time[::2], made.inputs[::2], made.measured[::2], CommissionOptions(starts=1)
            )
        except TwinFileError:
            continue
        return Specimen(cells, unit, done.network.values.copy())
    raise TwinFileError(f"no specimen of the plant could be commissioned with seed {seed}")


def scattered(rng: np.random.Generator) -> Cells:
    """Return another specimen of the plant: conductances and masses of every section by factors of their own."""
    built = build_cells()
    changed = {}
    for name, sd in SCATTER.items():
        factors = np.exp(rng.normal(0.0, sd, built.film_exponent.size))
        changed[name] = getattr(built, name) * factors[built.section]
    return built._replace(**changed)


def _loaded(text: str) -> tuple[PlantEffect, ...]:
    with tempfile.NamedTemporaryFile("w", suffix=".toml", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        return load_effects(Path(file.name))


def equivalent_deviations(
    features: Features, effects: tuple[PlantEffect, ...], time: Array
) -> tuple[Array, np.ndarray]:
    """Return deviations (n, P) equivalent to the effects, NaN for approximate ones, and the presence of a fault."""
    deviations = features.deviations
    theta: Array = np.zeros((len(time), len(deviations)))
    amiss = np.zeros(len(time), dtype=bool)
    for effect in effects:
        size = np.array([effect.envelope(t) for t in time.tolist()])
        amiss |= size > AMISS
        where = "modules" if effect.where in MODULES else effect.where
        for k, name in enumerate(deviations.ids):
            element, parameter = name.split(".")
            if effect.kind == "heat_source" and deviations.law[k] == SUM and element == f"{where}_power":
                theta[:, k] += np.where(size > 0.0, size * _law(effect, time) * effect.value / deviations.scale[k], 0.0)
            elif effect.kind == "heat_loss" and deviations.law[k] == LOSS and element == f"{where}_loss":
                theta[:, k] += size * effect.value / deviations.scale[k]
            elif _stands_in(effect, where, parameter):
                theta[:, k] = np.where(size > 0.0, np.nan, theta[:, k])
    return theta, amiss


def _law(effect: PlantEffect, time: Array) -> Array:
    """Return a heat source's course (n,) without its envelope; NaN if it follows an unknown variable."""
    if effect.driver == "constant":
        return np.ones(len(time))
    if effect.driver == "elapsed_time":
        growing: Array = -np.expm1(-np.maximum(time - effect.onset_s, 0.0) / effect.shape["tau_s"])
        return growing
    return np.full(len(time), np.nan)


def _stands_in(effect: PlantEffect, where: str, parameter: str) -> bool:
    """Return True if an effect acts as this parameter of the twin, though not exactly."""
    if effect.kind == "heat_rejection" or (effect.kind == "flow" and where == "radiator"):
        return parameter == "UA_100"
    return effect.kind == "flow" and parameter == f"effectiveness_{where}"
