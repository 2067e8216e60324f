"""Campaigns of the virtual rig's plant, whose equations are not the twin's: the other half of the training data.

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

from drivers.rig_file.reader import load_rig
from drivers.virtual.plant.effects import Effect, load_effects
from drivers.virtual.plant.geometry import CHANNELS, MODULES, Cells, build_cells
from drivers.virtual.plant.plant import Plant
from drivers.virtual.plant.thermocouple_module import ThermocoupleModule
from hil.synthetic.hidden_effects import LOADS, Setting, Truth, effects_text, profile, truth
from hil.synthetic.plant_record import direct_run
from twin.calibrators.hiera_unet.campaigns import AMISS, Campaign
from twin.calibrators.hiera_unet.features import Features
from twin.calibrators.hiera_unet.gaps import damaged
from twin.calibrators.hiera_unet.parameters import LOSS, SUM
from twin.calibrators.hiera_unet.series import Series, series
from twin.commission import CommissionOptions, commission
from twin.network import Array, Network, TwinFileError
from twin.twinfile import load

PROFILES = Path(__file__).resolve().parents[2] / "profiles"
RIG = PROFILES / "rigs" / "virtual.toml"
TWIN = PROFILES / "twins" / "virtual.toml"
HOURS = 4.0
HEALTHY = 0.15
"""Besides the healthy quarter that the hidden effects hold."""
TRACKED = 0.4
"""Share of the others whose hidden effect is one that the loop's twin tracks."""
SHIPPED = 0.35
"""Share of campaigns on the rig as built, with the twin as shipped."""
PER_RIG = 8
SCATTER = {"film": 0.25, "film_floor": 0.25, "outer": 0.4, "solid_J_per_K": 0.25, "water_kg": 0.1}
"""Standard deviations of the logarithms of what differs from specimen to specimen, by section."""
COMMISSION_H = 8.0
START_HOUR = 8.0
WARM_C = (20.0, 34.0)


@dataclass(frozen=True)
class Specimen:
    """A rig of the plant's kind: its cells, its sensors' offsets by number, and its commissioned vector (p,)."""

    cells: Cells | None
    unit: int
    nominal: Array


def campaign(features: Features, seed: int, number: int) -> Campaign:
    """Campaign `number` of a seed."""
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
    kept = Series(made.time, inputs, measured, made.spread, extra, made.hour if rng.uniform() < 0.7 else float("nan"))
    theta, amiss = told(features, effects, made.time)
    words = () if not hidden.effects else (hidden.what,)
    return Campaign(kept, clean, theta, amiss, specimen.nominal, "plant", (*words, *gaps))


def _tracked(rng: np.random.Generator) -> Truth:
    """One or two powers and losses where the loop's twin has parameters for them."""
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
    features: Features, case: Setting, specimen: Specimen, effects: tuple[Effect, ...], start_C: float | None = None
) -> tuple[Series, Array]:
    """A record on the network's own steps, and what fault-free sensors would read there (n, Y)."""
    columns, junctions, time = run(case, specimen, effects, start_C)
    made = series(features.network, time, columns, extra=features.table.extra, hour=START_HOUR)
    at = np.minimum(np.round(made.time - time[0]).astype(np.intp), len(junctions) - 1)
    # The thermocouples' constant offsets belong to the specimen: the twin was commissioned with them.
    offsets = ThermocoupleModule(0, (), specimen.unit).offsets_K
    return made, readings(features.network, junctions[at] + offsets)


def run(
    case: Setting, specimen: Specimen, effects: tuple[Effect, ...], start_C: float | None = None
) -> tuple[dict[str, Array], Array, Array]:
    """Columns, true junctions and stamps of a record."""
    rig = load_rig(RIG)
    plant = Plant(seed=case.seed, period_s=rig.period_s, effects=effects, cells=specimen.cells, start_C=start_C)
    record, junctions = direct_run(profile(case), rig, plant, seed=case.seed, unit=case.unit, effects=effects)
    return record.columns, junctions, record.time_s


def readings(network: Network, junctions: Array) -> Array:
    """What the twin's sensors would read of true junctions (n, 9), (n, Y)."""
    where = {name: k for k, name in enumerate(CHANNELS)}
    return np.column_stack([junctions[:, [where[c] for c in s.measured]].mean(axis=1) for s in network.sensors])


@lru_cache(maxsize=2)
def specimen_of(features: Features, seed: int, number: int) -> Specimen:
    """A specimen, commissioned on a healthy record of its own.

    Raises:
        TwinFileError: none of several could be commissioned.
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
    """Another specimen of the plant: every section's conductances and masses by factors of their own."""
    built = build_cells()
    changed = {}
    for name, sd in SCATTER.items():
        factors = np.exp(rng.normal(0.0, sd, built.film_exponent.size))
        changed[name] = getattr(built, name) * factors[built.section]
    return built._replace(**changed)


def _loaded(text: str) -> tuple[Effect, ...]:
    with tempfile.NamedTemporaryFile("w", suffix=".toml", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        return load_effects(Path(file.name))


def told(features: Features, effects: tuple[Effect, ...], time: Array) -> tuple[Array, np.ndarray]:
    """Deviations (n, P) that the effects amount to, NaN where they stand in for one, and where anything is amiss."""
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


def _law(effect: Effect, time: Array) -> Array:
    """A heat source's course (n,) besides its envelope; NaN where it follows something that is not known here."""
    if effect.driver == "constant":
        return np.ones(len(time))
    if effect.driver == "elapsed_time":
        growing: Array = -np.expm1(-np.maximum(time - effect.onset_s, 0.0) / effect.shape["tau_s"])
        return growing
    return np.full(len(time), np.nan)


def _stands_in(effect: Effect, where: str, parameter: str) -> bool:
    """Whether an effect does to the rig what the twin expresses by this parameter, though not exactly."""
    if effect.kind == "heat_rejection" or (effect.kind == "flow" and where == "radiator"):
        return parameter == "UA_100"
    return effect.kind == "flow" and parameter == f"effectiveness_{where}"
