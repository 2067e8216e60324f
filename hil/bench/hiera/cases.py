"""Records of `hil bench hiera`: rigs never trained on, with a change at a known moment or none.

simulated   networks with more in them than the twin, from seeds of the benchmark's own
virtual     the virtual rig's plant, built and other specimens, with the shipped effects
stranger    recordings of another maker's rigs in $HIL_DATA; never trained on, never tuned to
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drivers.virtual.plant import load_effects
from hil.bench.peers import Absent
from hil.record import read_record
from hil.synthetic import Setting
from hil.training import PROFILES, equivalent_deviations, recorded, specimen_of
from twin import Array, commission, from_datasheet
from twin.calibrators.hiera_unet import Family, Features, LabelledRecord
from twin.calibrators.hiera_unet.data.series import series
from twin.calibrators.hiera_unet.data.windows import TARGET
from twin.calibrators.hiera_unet.simulated import changes
from twin.calibrators.hiera_unet.simulated.campaigns import recorded as logged
from twin.calibrators.hiera_unet.simulated.campaigns import rig_of
from twin.calibrators.hiera_unet.simulated.loads import drive

RIGS = ("simulated", "virtual", "stranger")
FIRST = 13
"""First target of the score: two hours and ten minutes into the record."""
BEFORE, AFTER = 3, 8
"""Targets before and after the change, which lies within the target between."""
STEPS = TARGET * (FIRST + BEFORE + 1 + AFTER)
LEAST = 0.1
"""Least deviation of a tracked parameter in these cases."""
EFFECTS = ("modules_heat", "tank_insulation", "radiator_fouling", "pump_heat", "tank_sensor_lag")
STRANGERS = ("d0", "d1", "d2", "d3", "d4", "d5", "d6", "d7")
STRANGER_TARGETS = 36
BENCH = 7_000_000
"""Offset of seeds, so that no campaign is one of training's."""


@dataclass(frozen=True)
class HieraCase:
    """Record of the benchmark.

    Attributes
    ----------
    rig
        One of RIGS.
    kind
        Healthy, tracked (a parameter that the twin has moved) or other.
    seed
        What made it.
    targets
        Numbers of the ten-minute targets to predict, from 0 at the record's beginning.
    onset
        Step of the change; the length of the record where there is none.
    """

    name: str
    rig: str
    kind: str
    seed: int
    campaign: LabelledRecord
    targets: tuple[int, ...]
    onset: int

    @property
    def first_after(self) -> int:
        """Return the number of the first target after the change."""
        return -(-self.onset // TARGET)

    def truth(self) -> Array:
        """Return (n, 120, Y) degC, the truth of the targets' score: measurements if nothing better is known."""
        c = self.campaign
        source = np.where(np.isfinite(c.truth), c.truth, c.series.measured)
        return np.stack([source[TARGET * k : TARGET * (k + 1)] for k in self.targets])


def _window_of_change(rng: np.random.Generator) -> int:
    """Draw the step of a change within target FIRST + BEFORE."""
    return TARGET * (FIRST + BEFORE) + int(rng.integers(1, TARGET))


def _targets() -> tuple[int, ...]:
    return tuple(range(FIRST, FIRST + BEFORE + 1 + AFTER))


def simulated(family: Family, seed: int, count: int) -> Iterator[HieraCase]:
    """Return cases of simulated rigs: healthy, tracked and other in turn."""
    for number in range(count):
        rng = np.random.default_rng([seed + BENCH, number, 23])
        rig = rig_of(family, seed + BENCH, number)
        hour = float(rng.uniform(0.0, 24.0))
        inputs = drive(family.network, rng, STEPS, hour, power=rig.power)
        kind = ("tracked", "healthy", "other")[number % 3]
        found: tuple[changes.Change, ...] = ()
        onset = STEPS
        if kind == "tracked":
            onset = _window_of_change(rng)
            step = (np.arange(STEPS) >= onset).astype(np.float64)
            while not found or np.abs(found[0].theta).max() < LEAST or "resistance" in found[0].what:
                found = (replace(changes.tracked(family, rng, STEPS, 1), course=step),)
        elif kind == "other":
            found, onset = _other(family, rig.plant, rng, inputs, hour)
        campaign = logged(family, rig, rng, inputs, hour, found, gaps=False)
        name = "; ".join(c.what for c in found) or "healthy"
        yield HieraCase(name, "simulated", kind, seed, campaign, _targets(), onset)


def _other(
    family: Family, plant: Array, rng: np.random.Generator, inputs: Array, hour: float
) -> tuple[tuple[changes.Change, ...], int]:
    """Draw an effect that the twin lacks, with its onset within the right window."""
    low, high = TARGET * (FIRST + BEFORE) + 1, TARGET * (FIRST + BEFORE + 1)
    while True:
        drawn = changes.untracked(family, plant, rng, inputs, hour)
        onset = int(np.argmax(drawn.course > 0.0))
        if low <= onset < high and drawn.course[onset] == 1.0 and drawn.course[-1] == 1.0:
            return (drawn,), onset


def virtual(features: Features, seed: int, count: int) -> Iterator[HieraCase]:
    """Return cases of the virtual rig's plant: every other one healthy, the rest with a shipped effect at its onset."""
    for number in range(count):
        rng = np.random.default_rng([seed + BENCH, number, 29])
        specimen = specimen_of(features, seed + BENCH, number)
        load = ("battle", "steps", "busy")[number % 3]
        hours = (STEPS + 1) * 5.0 / 3600.0
        setting = Setting(number, int(rng.integers(1_000_000, 2**31)), specimen.unit, load, hours)
        effect = EFFECTS[(number // 2 + seed) % len(EFFECTS)] if number % 2 else ""
        onset = _window_of_change(rng) if effect else STEPS
        known = load_effects(PROFILES / "effects" / f"{effect}.toml") if effect else ()
        moved = tuple(replace(e, onset_s=5.0 * onset, ramp_s=min(e.ramp_s, 1.0)) for e in known)
        made, clean = recorded(features, setting, specimen, moved, start_C=float(rng.uniform(24.0, 32.0)))
        theta, amiss = equivalent_deviations(features, moved, made.time)
        campaign = LabelledRecord(made, clean, theta, amiss, specimen.nominal, "plant", (effect,) if effect else ())
        kind = "healthy" if not effect else "tracked" if effect in EFFECTS[:2] else "other"
        yield HieraCase(effect.replace("_", " ") or "healthy", "virtual", kind, seed, campaign, _targets(), onset)


def strangers(features: Features, data: Path, names: tuple[str, ...] = STRANGERS) -> Iterator[HieraCase]:
    """Return rigs of another maker, each commissioned on its own healthy record.

    Raises
    ------
    Absent
        Their records are not here.
    """
    folder = data / "stranger"
    if not (folder / "KEY.json").is_file():
        raise Absent(f"stranger rigs: no {folder}; set HIL_DATA to the folder that holds 'stranger'")
    key = json.loads((folder / "KEY.json").read_text(encoding="utf-8"))
    for name in names:
        sheet = from_datasheet(folder / name / "datasheet.json")
        healthy = read_record(folder / name / "commissioning.parquet")
        twin = commission(sheet, healthy.time_s, *sheet.select(healthy.columns)).network
        record = read_record(folder / name / "campaign.parquet")
        made = series(features.network, record.time_s, record.columns, extra=features.table.extra)
        answer, onset_s = key[name]["answer"]["kind"], float(key[name]["onset_s"])
        quiet = answer == "none"
        onset = len(made) if quiet else round(onset_s / 5.0)
        start = max(FIRST, 0 if quiet else onset // TARGET - BEFORE)
        unknown = np.full((len(made), len(features.deviations)), np.nan)
        campaign = LabelledRecord(
            made,
            np.full(made.measured.shape, np.nan),
            unknown,
            np.arange(len(made)) >= onset,
            twin.values.copy(),
            "stranger",
            () if quiet else (answer,),
        )
        targets = tuple(range(start, min(start + STRANGER_TARGETS, len(made) // TARGET)))
        yield HieraCase(name, "stranger", "healthy" if quiet else "other", 0, campaign, targets, onset)


def hidden(case: HieraCase, share: float, seed: int) -> HieraCase:
    """Return the same case with a share of its channels lost, half an hour into the record."""
    s = case.campaign.series
    rng = np.random.default_rng([seed, 31])
    inputs, measured = s.inputs.copy(), s.measured.copy()
    count = inputs.shape[1] + measured.shape[1]
    for k in rng.choice(count, size=max(round(share * count), 1), replace=False):
        if k < measured.shape[1]:
            measured[360:, k] = np.nan
        else:
            inputs[360:, k - measured.shape[1]] = np.nan
    truth = np.where(np.isfinite(case.campaign.truth), case.campaign.truth, s.measured)
    lost = replace(case.campaign, series=replace(s, inputs=inputs, measured=measured), truth=truth)
    return replace(case, campaign=lost)
