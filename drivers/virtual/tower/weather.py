"""Weather of a station, minute by minute: from a typical year in a file, or from a seeded generator.

Hourly values are joined by lines. Within the hour a second-order process is added whose numbers are those of a day of
one-minute measurements (SURFRAD): standard deviation 0.55 K (dry) and 0.48 K (wet bulb), correlation 0.57 over 15 min
and 0.17 over 30 min. Each day has an anomaly of its own, so that no year comes twice.
"""

from __future__ import annotations

import csv
import datetime
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.signals import DriverError
from drivers.virtual.tower.physics import humidities, ratios, wet_bulbs

Array = NDArray[np.float64]
HOURS = 8760
DAY_S, HOUR_S, MINUTE_S = 86400.0, 3600.0, 60.0


class WeatherError(DriverError):
    """A file of weather that cannot be read; the message names file and line."""


@dataclass(frozen=True)
class Climate:
    """Site for the generator: time zone h, mean dry bulb degC, half range over the year and the day K, dew point
    below it K, day-to-day spread K, pressure kPa, wind m/s, direction deg that prevails, latitude deg."""

    zone_h: float
    mean: float
    year: float
    day: float
    depression: float
    spread: float
    pressure: float
    wind: float
    prevailing: float
    latitude: float


CHICAGO = Climate(-6.0, 10.0, 14.0, 4.5, 6.0, 4.0, 98.9, 4.4, 220.0, 42.0)
MIAMI = Climate(-5.0, 24.6, 4.2, 3.6, 5.2, 1.4, 101.6, 3.9, 100.0, 25.8)


@dataclass(frozen=True)
class Year:
    """Hourly typical year in local standard time, arrays (8760,): degC, degC, kPa, m/s, deg, W/m2; zone in h."""

    dry: Array
    dew: Array
    pressure: Array
    wind: Array
    direction: Array
    sun: Array
    zone_h: float
    source: str


@dataclass(frozen=True)
class WeatherMinutes:
    """Weather by the minute, arrays (n,): dry bulb degC, humidity ratio, pressure kPa, wind m/s and deg, sun W/m2."""

    dry: Array
    ratio: Array
    pressure: Array
    wind: Array
    direction: Array
    sun: Array

    def wet_bulb(self) -> Array:
        """Return the wet bulb, degC."""
        return np.asarray(wet_bulbs(self.dry, self.ratio, self.pressure))

    def humidity(self) -> Array:
        """Return the relative humidity, 0 to 1."""
        return np.asarray(humidities(self.dry, self.ratio, self.pressure))


def find_file(folder: Path | None, words: tuple[str, ...]) -> Path | None:
    """Return the first EPW or TM2 file of the folder whose name has one of the words, in any case; None without one."""
    if folder is None or not folder.is_dir():
        return None
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() in (".epw", ".tm2") and any(word in path.name.lower() for word in words):
            return path
    return None


def read_year(path: Path) -> Year:
    """Return the typical year of an EnergyPlus (.epw) or TMY2 (.tm2) file.

    Raises
    ------
    WeatherError
        The file cannot be read, is cut short, or a line holds no number where one must be.
    """
    try:
        lines = path.read_text(encoding="latin-1").splitlines()
    except OSError as error:
        raise WeatherError(f"{path}: cannot be read: {error.strerror}") from error
    epw = path.suffix.lower() == ".epw"
    first = 8 if epw else 1
    rows = [line for line in lines[first:] if line.strip()]
    if len(rows) < HOURS:
        raise WeatherError(f"{path}: has {len(rows)} hours; a year of {HOURS} is needed; use a whole file")
    read = _epw if epw else _tm2
    out = np.empty((HOURS, 6))
    for k, row in enumerate(rows[:HOURS]):
        try:
            out[k] = read(row)
        except (ValueError, IndexError):
            raise WeatherError(f"{path}:{first + k + 1}: is no line of hourly weather; use a whole file") from None
    try:
        zone = float(lines[0].split(",")[8]) if epw else float(lines[0][33:36])
    except (ValueError, IndexError):
        raise WeatherError(f"{path}:1: names no time zone; use a file with its header") from None
    dry, dew, pressure, wind, direction, sun = np.ascontiguousarray(out.T)
    return Year(dry, dew, pressure, wind, direction, sun, zone, path.name)


def _epw(line: str) -> tuple[float, ...]:
    row = next(csv.reader([line]))
    return float(row[6]), float(row[7]), float(row[9]) * 1e-3, float(row[21]), float(row[20]), float(row[13])


def _tm2(line: str) -> tuple[float, ...]:
    """Return a line's values by the columns of the TMY2 manual (tenths of degC and m/s, millibars)."""
    return (
        float(line[67:71]) / 10.0,
        float(line[73:77]) / 10.0,
        float(line[84:88]) / 10.0,
        float(line[95:98]) / 10.0,
        float(line[90:93]),
        float(line[17:21]),
    )


def made_year(climate: Climate, rng: np.random.Generator) -> Year:
    """Return a year of the generator: harmonics of year and day, fronts that last some days, a dew point that
    follows."""
    hour = np.arange(HOURS, dtype=np.float64)
    day = hour / 24.0
    fronts = _process(rng, HOURS, 0.985)
    clouds = 0.5 + 0.5 * np.tanh(_process(rng, HOURS, 0.93))
    local = hour % 24.0
    season = -np.cos(2.0 * np.pi * (day - 20.0) / 365.0)
    swing = climate.day * (1.2 - 0.6 * clouds)
    dry = (
        climate.mean
        + climate.year * season
        + climate.spread * fronts
        + swing * np.cos(2.0 * np.pi * (local - 15.5) / 24.0)
    )
    damp = _process(rng, HOURS, 0.97)
    dew = dry - swing * np.cos(2.0 * np.pi * (local - 15.5) / 24.0) - climate.depression * np.exp(0.45 * damp)
    declination = np.deg2rad(23.45) * np.sin(2.0 * np.pi * (284.0 + day) / 365.0)
    latitude, angle = np.deg2rad(climate.latitude), np.deg2rad(15.0 * (local - 12.0))
    height = np.sin(latitude) * np.sin(declination) + np.cos(latitude) * np.cos(declination) * np.cos(angle)
    wind = climate.wind * np.exp(0.45 * _process(rng, HOURS, 0.9) - 0.1)
    direction = (climate.prevailing + 75.0 * _process(rng, HOURS, 0.96)) % 360.0
    pressure = climate.pressure + 0.5 * _process(rng, HOURS, 0.99)
    sun = np.maximum(height, 0.0) * 1000.0 * (1.0 - 0.75 * clouds)
    return Year(dry, np.minimum(dew, dry), pressure, wind, direction, sun, climate.zone_h, "seeded generator")


def _process(rng: np.random.Generator, n: int, memory: float) -> Array:
    """Return a first-order process of unit variance."""
    return _autoregression(rng.normal(size=n) * np.sqrt(1.0 - memory * memory), memory, 0.0)


def _autoregression(noise: Array, first: float, second: float) -> Array:
    from scipy.signal import lfilter, lfiltic

    start = lfiltic([1.0], [1.0, -first, -second], [noise[0], noise[0]])
    return np.asarray(lfilter([1.0], [1.0, -first, -second], noise, zi=start)[0])


def minutes(year: Year, start: datetime.datetime, n: int, rng: np.random.Generator) -> WeatherMinutes:
    """Return `n` minutes of weather from `start` (UTC), of the typical year by its day and hour, with noise and
    anomalies."""
    first = datetime.datetime(start.year, 1, 1, tzinfo=datetime.UTC)
    time_h = (start - first).total_seconds() / HOUR_S + np.arange(n) / 60.0 + year.zone_h
    days = int(n / 1440) + 3
    anomaly = _process(rng, days, 0.7)[:, None] * np.array([1.3, 1.0, 0.25])  # K dry, K dew, kPa
    day = np.arange(n) / 1440.0

    def of(hourly: Array) -> Array:
        return np.asarray(np.interp(time_h % HOURS, np.arange(HOURS + 1), np.append(hourly, hourly[0])))

    dry = of(year.dry) + np.interp(day, np.arange(days), anomaly[:, 0]) + 0.55 * _within_hour(rng, n)
    dew = of(year.dew) + np.interp(day, np.arange(days), anomaly[:, 1]) + 0.50 * _within_hour(rng, n)
    pressure = of(year.pressure) + np.interp(day, np.arange(days), anomaly[:, 2])
    dew = np.minimum(dew, dry - 0.05)
    east, north = of(np.sin(np.deg2rad(year.direction))), of(np.cos(np.deg2rad(year.direction)))
    direction = (np.rad2deg(np.arctan2(east, north)) + 14.0 * _within_hour(rng, n) + 4.0 * rng.normal(size=n)) % 360.0
    gusts = 0.14 * _within_hour(rng, n)
    wind = np.maximum(of(year.wind) * (1.0 + gusts) + 0.2 * rng.normal(size=n), 0.0)
    ratio = ratios(dew, np.ones(n), pressure)
    return WeatherMinutes(
        dry, ratio, pressure, wind, direction, np.maximum(of(year.sun) * (1.0 + 0.2 * _within_hour(rng, n)), 0.0)
    )


def _within_hour(rng: np.random.Generator, n: int) -> Array:
    """Return the second-order process of the module's docstring with unit variance, by the minute."""
    one, two = 0.57, 0.17
    a = one * (1.0 - two) / (1.0 - one * one)
    b = (two - one * one) / (1.0 - one * one)
    steps = n // 15 + 3
    coarse = _autoregression(rng.normal(size=steps), a, b)
    coarse /= np.sqrt((1.0 - b) / ((1.0 + b) * ((1.0 - b) ** 2 - a * a)))
    # Lines between quarters of an hour lose a fifth of the variance.
    return np.asarray(np.interp(np.arange(n) / 15.0, np.arange(steps), coarse) * 1.12)
