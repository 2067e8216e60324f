"""Campaigns of the paper's experiments, forty hours each: the virtual rig, stranger rigs, and the twin itself.

The virtual rig is run for it, over Modbus and CAN in lockstep; its record is kept by seed and by what it depends on.
"""

from __future__ import annotations

import asyncio
import hashlib
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.bench.experiments.published import ONSET_S
from hil.bench.kernel import steady_start
from hil.bench.peers import Absent
from hil.profile import read_profile
from hil.record import read_record
from twin import Array, Network, commission, from_datasheet, load, simulate

PROJECT = Path(__file__).resolve().parents[3]
PROFILES = PROJECT / "profiles"
CHANGES = ("healthy", "modules_heat", "tank_insulation")
STRANGERS = {"healthy": "d0", "modules_heat": "d1", "tank_insulation": "d2"}
HEAT_W = 180.0
INSULATION_W_PER_K = 6.0


@dataclass(frozen=True, slots=True)
class Campaign:
    """Record and the twins for it.

    Attributes
    ----------
    rig
        Name in the tables.
    change
        One of `CHANGES`.
    onset_s
        When it begins.
    commissioned
        Twin fitted to a healthy record of the same rig.
    by_hand
        The twin before that.
    time
        (n,) s, inputs (n, c), measured (n, m) degC in the order of the twin.
    """

    rig: str
    change: str
    onset_s: float
    commissioned: Network
    by_hand: Network
    time: Array
    inputs: Array
    measured: Array

    def part(self, start_s: float, end_s: float) -> Campaign:
        """Return the samples of [start_s, end_s)."""
        rows = slice(*np.searchsorted(self.time, [start_s, end_s]))
        return Campaign(
            self.rig,
            self.change,
            self.onset_s,
            self.commissioned,
            self.by_hand,
            self.time[rows],
            self.inputs[rows],
            self.measured[rows],
        )


def virtual(change: str, seed: int, cache: Path, say: Callable[[str], None]) -> Campaign:
    """Return forty battle hours of the virtual rig, whose equations differ from the twin's."""
    record = virtual_record(PROFILES / "loads" / "battle_40h.csv", change, seed, cache, say)
    commissioned = load(PROFILES / "twins" / "virtual.toml")
    return _read("virtual", change, record, commissioned, load(PROFILES / "twins" / "loop.toml"))


def virtual_record(profile: Path, change: str, seed: int, cache: Path, say: Callable[[str], None]) -> Path:
    """Return the path of the record of one run, made unless `cache` has it."""
    rig = PROFILES / "rigs" / "virtual.toml"
    effects = None if change == "healthy" else PROFILES / "effects" / f"{change}.toml"
    files = [profile, rig, *([effects] if effects else []), *sorted((PROJECT / "drivers").rglob("*.py"))]
    key = hashlib.sha256(b"\0".join(path.read_bytes() for path in files)).hexdigest()[:12]
    kept = cache / f"{profile.stem}-{change}-seed{seed}-{key}.parquet"
    if kept.is_file():
        return kept
    from hil.run.session import RunRequest, run_session

    cache.mkdir(parents=True, exist_ok=True)
    say(f"running {profile.stem} on the virtual rig, {change.replace('_', ' ')}, seed {seed}")
    with tempfile.TemporaryDirectory(prefix="run-", dir=cache) as runs:
        request = RunRequest(
            profile=profile,
            rig=rig,
            twin=None,
            runs=Path(runs),
            virtual=True,
            mode="lockstep",
            seed=seed,
            effects=effects,
            viewer=False,
            use_twin=False,
        )
        result = asyncio.run(run_session(request))
        shutil.move(result.folder.record, kept)
    return kept


def stranger(change: str, data: Path) -> Campaign:
    """Return forty hours of a rig of another maker, commissioned on its own healthy ten hours; raise Absent."""
    folder = data / "stranger" / STRANGERS[change]
    if not folder.is_dir():
        raise Absent(f"stranger rigs: no {folder}; set HIL_DATA to the folder that holds 'stranger'")
    sheet = from_datasheet(folder / "datasheet.json")
    healthy = read_record(folder / "commissioning.parquet")
    done = commission(sheet, healthy.time_s, *sheet.select(healthy.columns))
    return _read(f"rig {folder.name}", change, folder / "campaign.parquet", done.network, sheet)


def inverse_crime(change: str, hours: float, seed: int, onset_s: float = ONSET_S) -> Campaign:
    """Return a synthetic record of the fitted model itself, as in the paper, with white noise of the declared size.

    The twin by hand is off by up to 15 % in each of the nine tunables of Table 1.
    """
    network = load(PROFILES / "twins" / "loop.toml")
    rng = np.random.default_rng(seed)
    time_s = np.arange(int(hours * 3600), dtype=np.float64)
    inputs = _battle(network, time_s)
    after = {
        "healthy": {},
        "modules_heat": {"modules_power.power": HEAT_W},
        "tank_insulation": {"tank_loss.hA": network.parameters["tank_loss.hA"].value + INSULATION_W_PER_K},
    }[change]
    split = int(np.searchsorted(time_s, onset_s))
    state = steady_start(network)
    clean = simulate(network, time_s, inputs, state)
    if after and split < len(time_s):
        # Each volume of the loop has its own sensor, so the readings at the onset are the state.
        at_onset = network.initial_state(clean[split])
        clean[split:] = simulate(network.with_values(after), time_s[split:], inputs[split:], at_onset)
    measured = clean + network.sigma * rng.standard_normal(clean.shape)
    off = {}
    for name in network.tunables("nine"):
        p = network.parameters[name]
        off[name] = float(np.clip(p.value * (1.0 + rng.uniform(-0.15, 0.15)), p.lower, p.upper))
    by_hand = network.with_values(off)
    return Campaign("inverse", change, onset_s, network, by_hand, time_s, inputs, measured)


def _battle(network: Network, time_s: Array) -> Array:
    """Return inputs (n, c) of the ten-hour battle profile, repeated, in a room with a daily swing of a kelvin."""
    profile = read_profile(PROFILES / "loads" / "battle_10h.csv")
    row = np.searchsorted(profile.time_s, time_s % profile.time_s[-1], side="right") - 1
    columns = {name: profile.values[row, k] for k, name in enumerate(profile.columns)}
    columns["T_ambient_C"] = 22.0 + np.sin(2.0 * np.pi * time_s / 86400.0)
    return np.column_stack([columns[c] for c in network.input_columns])


def _read(rig: str, change: str, path: Path, commissioned: Network, by_hand: Network) -> Campaign:
    record = read_record(path)
    record.require(*commissioned.input_columns)
    inputs, measured = commissioned.select(record.columns)
    onset_s = float(record.time_s[0]) + ONSET_S if record.time_s[0] > 600.0 else ONSET_S
    return Campaign(rig, change, onset_s, commissioned, by_hand, record.time_s, inputs, measured)
