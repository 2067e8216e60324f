"""A simulated station from seed to files, in the format of a plant's export.

`raw.parquet` (timestamp UTC, tag, value, quality), `tags.csv`, `datasheet.json`, `commissioning.csv`, `events.csv`,
`labels.csv`; for scoring also `truth.parquet`. Every part draws from a stream of its own, so that a change of one
leaves the others as they are.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.virtual.tower import degradation, operation, weather
from drivers.virtual.tower.effects import hidden_effects
from drivers.virtual.tower.physics import S_FILL, STATE, compiled
from drivers.virtual.tower.recording import (
    Instrument,
    Seeding,
    StationTruth,
    TagSamples,
    archived,
    instruments,
    scan_times,
    scanned,
    seed_archive,
    seed_scans,
    tag_name,
)
from drivers.virtual.tower.sites import SITES, BuiltStation, StationDesign, build

MINUTES_A_DAY = 1440
DAYS_A_MONTH = 30.4375
LONGEST_S = 3600.0
"""Longest time between two archived samples of a tag, s: a value at rest is confirmed every hour."""
LONGEST_OF_THE_AIR_S = 600.0
"""The same for temperatures and pressure of the air, which all cells of the station use, s."""
MAST = "met"
"""Interface of the weather mast (`Kind.interface`)."""
COARSE_DEVIATION = 0.3
"""Deviation of compression, in the unit of the simulation, between those of the mast's temperatures and pressure (0.1
degC, 0.04 kPa) and those of its humidity and wind (from 0.5 on)."""
STREAMS = (
    "build",
    "weather",
    "operation",
    "life",
    "instruments",
    "scans",
    "defects",
    "commissioning",
    "records",
    "effects",
)


@dataclass(frozen=True)
class SimulationPlan:
    """Plan of a simulation: months, cells that are recorded, seed, beginning (UTC), effects to hide, defects, weather's
    folder.

    Attributes
    ----------
    segments
        Days [first, end) that are simulated, in order and apart, each from a plant at rest; all days without. The
        archive has no sample of other days. Weather, operation and degradation are those of the whole time.
    ramps
        Changes of the cells' degradation beside what the seed draws.
    """

    months: float = 14.0
    cells: int = 6
    seed: int = 0
    start: datetime.datetime = datetime.datetime(2022, 5, 1, tzinfo=datetime.UTC)
    hide: tuple[str, ...] = ()
    defects: bool = False
    weather: Path | None = None
    segments: tuple[tuple[int, int], ...] = ()
    ramps: tuple[degradation.Ramp, ...] = ()

    @property
    def days(self) -> int:
        """Whole days, two at least."""
        return max(round(self.months * DAYS_A_MONTH), 2)

    def recorded(self) -> dict[str, int]:
        """Return the number of recorded cells by station: two thirds are of A, as far as it has them."""
        of_a = min(-(-2 * self.cells // 3), SITES[0].cells)
        return {"A": of_a, "B": min(self.cells - of_a, SITES[1].cells)}


@dataclass(frozen=True)
class Simulated:
    """A simulated station: as built, its truth, operation, instruments, raw samples by tag, and what was seeded."""

    plan: SimulationPlan
    built: BuiltStation
    recorded: int
    truth: StationTruth
    operation: operation.StationOperation
    instruments: tuple[Instrument, ...]
    samples: dict[str, TagSamples]
    seeded: Seeding
    weather_source: str
    answer: dict[str, object]
    streams: dict[str, np.random.Generator]

    @property
    def site(self) -> StationDesign:
        """Site of the station."""
        return self.built.site


def simulate(
    site: StationDesign, recorded: int, plan: SimulationPlan, note: Callable[[str], None] = lambda _: None
) -> Simulated:
    """Return a station with `recorded` cells simulated by the plan.

    Raises
    ------
    WeatherError
        A file of weather cannot be read.
    ValueError
        An effect to hide is not known, or a ramp is of no cell or state of the station.
    """
    days, n = plan.days, plan.days * MINUTES_A_DAY
    seeds = np.random.SeedSequence([plan.seed, ord(site.station)]).spawn(len(STREAMS))
    streams = {name: np.random.default_rng(one) for name, one in zip(STREAMS, seeds, strict=True)}
    built = build(site, streams["build"])
    hidden, answer = hidden_effects(plan.hide, site, recorded, streams["effects"])
    file = weather.find_file(plan.weather, site.weather_words)
    year = weather.read_year(file) if file else weather.made_year(site.climate, streams["weather"])
    air = weather.minutes(year, plan.start, n, streams["weather"])
    done = operation.operate(site, plan.start, n, streams["operation"])
    life = degradation.live(
        built, days, streams["life"], lambda c: tag_name(site, "water_outlet_temperature", c + 1), plan.ramps
    )
    sectors = built.shares.shape[2]
    note(f"station {site.station}: {site.cells} cells of {sectors} sectors, {days} days, weather by {year.source}")
    columns = np.stack([air.dry, air.ratio, air.pressure, air.wind, air.direction, air.sun], axis=1)
    parts = []
    for first, end in plan.segments or ((0, days),):
        minutes = slice(first * MINUTES_A_DAY, end * MINUTES_A_DAY)
        parts.append(
            compiled.run(
                built.cells,
                built.shares,
                built.numbers,
                hidden,
                built.rtd_s,
                columns[minutes],
                life.states[first : end + 2],
                done.load[minutes],
                done.outage[minutes],
                done.trips[minutes],
                done.test_speed[minutes],
                done.test_flow[minutes],
                done.lead[minutes],
            )
        )
    cells, station = (_whole([part[i] for part in parts], plan, n) for i in range(2))
    truth = StationTruth(cells, station, air, air.wet_bulb(), air.humidity(), life)
    tags = instruments(site, recorded, streams["instruments"])
    seeding = Seeding.draw(tags, days, site.timezone, truth, streams["defects"]) if plan.defects else Seeding()
    samples = _historian(tags, truth, plan, seeding, streams)
    return Simulated(plan, built, recorded, truth, done, tags, samples, seeding, year.source, answer, streams)


def with_defects(made: Simulated) -> Simulated:
    """Return the same station with an archive into which defects are seeded: instruments scan anew, the plant stays."""
    seeding = Seeding.draw(made.instruments, made.plan.days, made.site.timezone, made.truth, made.streams["defects"])
    samples = _historian(made.instruments, made.truth, made.plan, seeding, made.streams)
    return replace(made, plan=replace(made.plan, defects=True), samples=samples, seeded=seeding)


def _whole(parts: Sequence[NDArray[np.float32]], plan: SimulationPlan, n: int) -> NDArray[np.float32]:
    """Return the results (n, ...) of the whole time, NaN in days that are not simulated."""
    if not plan.segments:
        return parts[0]
    found = np.full((n, *parts[0].shape[1:]), np.nan, dtype=np.float32)
    for (first, end), part in zip(plan.segments, parts, strict=True):
        found[first * MINUTES_A_DAY : end * MINUTES_A_DAY] = part
    return found


def _historian(
    tags: Sequence[Instrument],
    truth: StationTruth,
    plan: SimulationPlan,
    seeding: Seeding,
    streams: dict[str, np.random.Generator],
) -> dict[str, TagSamples]:
    """Return what the archive holds of each tag."""
    end_s = plan.days * 86400.0
    scans = {}
    for one in tags:
        time_s = scan_times(0.0, end_s, one.scan_s, streams["scans"])
        if plan.segments:
            # The last minute has no successor to be joined with.
            inside = [(time_s >= 86400.0 * a) & (time_s < 86400.0 * b - 60.0) for a, b in plan.segments]
            time_s = time_s[np.any(inside, axis=0)]
        scans[one.tag] = TagSamples(time_s, scanned(one, truth, time_s, streams["scans"]))
    seed_scans(scans, tags, seeding)
    kept = {}
    for one in tags:
        samples = scans[one.tag]
        rows = archived(samples.time_s, samples.value, one.kind.deviation * one.factor, _longest_s(one))
        kept[one.tag] = samples.rows(rows)
    seed_archive(kept, tags, seeding, plan.start, streams["defects"])
    return kept


def _longest_s(one: Instrument) -> float:
    """Return the longest time between two archived samples of a tag, s."""
    is_of_the_air = one.kind.interface == MAST and one.kind.deviation < COARSE_DEVIATION
    return LONGEST_OF_THE_AIR_S if is_of_the_air else LONGEST_S


def state_by_minute(made: Simulated, cell: int) -> dict[str, np.ndarray]:
    """Return fill, air, uniformity of a cell (numbered from 1) by the minute, as in the truth."""
    states = made.truth.life.states[:, cell - 1]
    days = np.arange(len(states))
    air = np.array([made.built.air_multiplier(cell - 1, row) for row in states])
    even = np.array([made.built.uniformity(cell - 1, row) for row in states])
    day = np.arange(len(made.truth.wet)) / MINUTES_A_DAY
    assert states.shape[1] == len(STATE)
    return {
        "fill": np.interp(day, days, states[:, S_FILL]),
        "air": np.interp(day, days, air),
        "uniformity": np.interp(day, days, even),
    }
