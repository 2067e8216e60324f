"""Defects that plants' records have, seeded where they arise: in the scans (instruments) or in what the archive keeps.

Times are seconds since the beginning of the simulation; spans are true times, also where stamps are local.
"""

from __future__ import annotations

import datetime
import zoneinfo
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.virtual.tower.recording.instrumentation import Instrument, StationTruth, quantised

Array = NDArray[np.float64]
DAY_S, HOUR_S = 86400.0, 3600.0
GOOD, UNCERTAIN, BAD = 192, 64, 0
MOVING, TRIES = 6.0, 50
"""Range of a quantity that moves, in deviations of its tag's compression; draws until one is found."""
OTHER_UNIT = {
    "m3/h": ("L/s", 1.0 / 3.6),
    "L/s": ("m3/h", 3.6),
    "degC": ("degF", 1.8),
    "degF": ("degC", 1.0 / 1.8),
    "kPa": ("psi", 0.1450377),
    "psi": ("kPa", 6.894757),
}
OFFSET = {"degF": 32.0, "degC": -32.0 / 1.8}
"""Units that a transmitter may be switched to, with the factor, and the offset of the new unit."""
SPANS = (0.5, 0.8), (1.25, 2.0)
"""Factors of a reading whose transmitter was given another span."""
UNIT_FACTORS, OF_NO_UNIT = (0.6, 0.7457, 1.341, 1.6667), 0.08
"""Factors of % in Hz and of kW in hp, and how far the logarithm of another span's factor is from theirs: a reading that
is in another unit looks the same."""
SHIFTS = {
    "water_inlet_temperature": (3.0, 8.0),
    "water_outlet_temperature": (3.0, 8.0),
    "basin_temperature": (3.0, 8.0),
    "return_header_temperature": (3.0, 8.0),
    "supply_temperature": (3.0, 8.0),
    "dry_bulb_temperature": (3.0, 8.0),
    "relative_humidity": (12.0, 30.0),
    "barometric_pressure": (3.0, 8.0),
}
"""Shifts of a reading whose transmitter was given another zero, either way, K, % and kPa."""
SPANNED = (
    "water_inlet_temperature",
    "water_outlet_temperature",
    "basin_temperature",
    "water_flow",
    "fan_power",
    "fan_speed",
    "header_pressure",
    "pump_power",
    "station_heat_load",
)
"""Roles of transmitters whose span may be changed; its zero stays, that of the tag's unit."""


@dataclass
class TagSamples:
    """Samples of a tag, arrays (n,): seconds since the beginning, value, OPC quality."""

    time_s: Array
    value: Array
    quality: NDArray[np.int16] = field(default_factory=lambda: np.zeros(0, dtype=np.int16))

    def __post_init__(self) -> None:
        if len(self.quality) != len(self.time_s):
            self.quality = np.full(len(self.time_s), GOOD, dtype=np.int16)

    def rows(self, chosen: NDArray[Any]) -> TagSamples:
        """Return the samples of these rows."""
        return TagSamples(self.time_s[chosen], self.value[chosen], self.quality[chosen])

    def within(self, span: tuple[float, float]) -> NDArray[np.bool_]:
        """Return the samples of a span (n,)."""
        return (self.time_s >= span[0]) & (self.time_s < span[1])


@dataclass(frozen=True)
class Seeded:
    """A defect: type, tags, true span in s since the beginning, and what else a key names (codes, units, sizes)."""

    kind: str
    tags: tuple[str, ...]
    span: tuple[float, float]
    more: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Seeding:
    """Defects of a station."""

    defects: tuple[Seeded, ...] = ()

    def of(self, kind: str) -> list[Seeded]:
        """Return the defects of a type."""
        return [one for one in self.defects if one.kind == kind]

    @classmethod
    def draw(
        cls, tags: Sequence[Instrument], days: int, zone: str, truth: StationTruth, rng: np.random.Generator
    ) -> Seeding:
        """Return defects drawn for a record of `days`: as many as its length makes likely, one of each lasting kind.

        An instrument sticks while its quantity moves: of one that rests, as a stopped fan, nobody sees a defect.
        """
        found: list[Seeded] = []
        end = days * DAY_S
        months = days / 30.0

        def span(low_h: float, high_h: float) -> tuple[float, float]:
            length = min(rng.uniform(low_h, high_h) * HOUR_S, 0.3 * end)
            begin = rng.uniform(0.02 * end, 0.97 * end - length)
            return float(round(begin / 60.0) * 60.0), float(round((begin + length) / 60.0) * 60.0)

        lively = [
            one
            for one in tags
            if one.kind.role in ("water_inlet_temperature", "water_flow", "fan_power", "basin_temperature")
        ]
        for _ in range(max(round(2 * months), 1)):
            for _ in range(TRIES):
                one, when = lively[int(rng.integers(len(lively)))], span(3.0, 12.0)
                seen = truth.seen(one)[int(when[0] / 60.0) : int(when[1] / 60.0)]
                if np.ptp(seen) > MOVING * one.kind.deviation:
                    found.append(Seeded("stuck", (one.tag,), when))
                    break
        groups: dict[str, list[str]] = {}
        for one in tags:
            groups.setdefault(one.interface, []).append(one.tag)
        silent = [name for name, members in groups.items() if len(members) > 2]
        for _ in range(max(round(6 * months), 2)):
            name = silent[int(rng.integers(len(silent)))]
            more = {"group": name.rstrip("0123456789"), "cell": int(name[3:]) if name.startswith("plc") else 0}
            found.append(Seeded("comms_gap", tuple(groups[name]), span(0.75, 5.5), more))
        for _ in range(max(round(1.5 * months), 1)):
            found.append(Seeded("duplicates", (), span(12.0, 30.0), {"share": 0.5}))
        for _ in range(max(round(12 * months), 4)):
            one = tags[int(rng.integers(len(tags)))]
            found.append(Seeded("bad_quality", (one.tag,), span(0.8, 3.5), {"code": int(rng.choice([BAD, UNCERTAIN]))}))
        found += _lasting(tags, end, zone, span, rng)
        found += _ranges(tags, end, {tag for one in found if one.kind in ALONE for tag in one.tags}, rng.spawn(1)[0])
        return cls(tuple(found))


def _lasting(tags: Sequence[Instrument], end: float, zone: str, span: Any, rng: np.random.Generator) -> list[Seeded]:
    """Return one defect of each kind that lasts for days."""
    found = []
    flows = [one for one in tags if one.kind.role == "water_flow"]
    one = flows[int(rng.integers(len(flows)))]
    begin = round(rng.uniform(0.3, 0.7) * end / 60.0) * 60.0
    found.append(
        Seeded("unit_switch", (one.tag,), (begin, end), {"from_unit": one.unit, "to_unit": OTHER_UNIT[one.unit][0]})
    )
    outlets = [one.tag for one in tags if one.kind.role == "water_outlet_temperature"]
    basins = [one.tag for one in tags if one.kind.role == "basin_temperature"]
    pair = tuple(rng.permutation(outlets)[:2]) if len(outlets) > 1 else (outlets[0], basins[0])
    length = min(rng.uniform(6.0, 14.0) * DAY_S, 0.3 * end)
    begin = round(rng.uniform(0.15, 0.6) * end / 60.0) * 60.0
    found.append(Seeded("swap", tuple(str(tag) for tag in pair), (begin, begin + length)))
    mcc = tuple(one.tag for one in tags if one.interface == "mcc")
    found.append(Seeded("local_time", mcc, (0.0, end), {"group": "mcc", "tz": zone}))
    humidity = next(one.tag for one in tags if one.kind.role == "relative_humidity")
    found.append(Seeded("humidity_latched", (humidity,), span(24.0, 60.0)))
    wet = next(one.tag for one in tags if one.kind.role == "wet_bulb_temperature")
    dry = next(one.tag for one in tags if one.kind.role == "dry_bulb_temperature")
    found.append(
        Seeded(
            "impossible_wet_bulb", (wet,), span(8.0, 16.0), {"dry_tag": dry, "size": round(rng.uniform(0.8, 1.6), 2)}
        )
    )
    return found


ALONE = ("unit_switch", "swap", "impossible_wet_bulb", "humidity_latched")
"""Kinds of defects of a tag that has no other range besides."""


def _ranges(tags: Sequence[Instrument], end: float, taken: set[str], rng: np.random.Generator) -> list[Seeded]:
    """Return changes of range, two a month, of a tag each: at any time, for days or until the end."""
    recorded = {0, *(one.cell for one in tags if one.kind.role == "water_outlet_temperature")}
    changed = {*SHIFTS, *SPANNED}
    free = [one for one in tags if one.tag not in taken and one.cell in recorded and one.kind.role in changed]
    found = []
    for k in rng.permutation(len(free))[: max(round(2.0 * end / DAY_S / 30.0), 1)].tolist():
        one, begin = free[k], round(rng.uniform(0.1, 0.8) * end / 60.0) * 60.0
        length = rng.uniform(1.0, 10.0) * DAY_S if rng.random() < 0.5 else end
        roles = [kinds for kinds in (SPANNED, SHIFTS) if one.kind.role in kinds]
        if roles[int(rng.integers(len(roles)))] is SPANNED:
            more = {"factor": _span_factor(rng)}
        else:
            size = rng.uniform(*SHIFTS[one.kind.role]) * one.factor
            more = {"shift": round(float(rng.choice([-1.0, 1.0]) * size), 2)}
        found.append(Seeded("range_change", (one.tag,), (begin, min(begin + length, end)), more))
    return found


def _span_factor(rng: np.random.Generator) -> float:
    """Return the factor of another span, which is none of a usual unit."""
    while True:
        factor = round(float(rng.uniform(*SPANS[int(rng.integers(2))])), 3)
        if all(abs(np.log(factor / one)) > OF_NO_UNIT for one in UNIT_FACTORS):
            return factor


def seed_scans(scans: dict[str, TagSamples], tags: Sequence[Instrument], seeding: Seeding) -> None:
    """Change scans as faulty instruments do, in place."""
    by_tag = {one.tag: one for one in tags}
    for one in seeding.of("swap"):
        first, second = one.tags
        for tag, other in ((first, scans[second]), (second, scans[first])):
            rows = scans[tag].within(one.span)
            scans[tag] = TagSamples(
                scans[tag].time_s,
                np.where(rows, np.interp(scans[tag].time_s, other.time_s, other.value), scans[tag].value),
            )
            scans[tag].value = np.where(rows, quantised(scans[tag].value, by_tag[tag]), scans[tag].value)
    for one in seeding.of("impossible_wet_bulb"):
        samples, dry = scans[one.tags[0]], scans[one.more["dry_tag"]]
        rows = samples.within(one.span)
        above = np.interp(samples.time_s, dry.time_s, dry.value) + one.more["size"] * by_tag[one.tags[0]].factor
        samples.value = np.where(rows, quantised(above, by_tag[one.tags[0]]), samples.value)
    for one in seeding.of("humidity_latched"):
        samples = scans[one.tags[0]]
        samples.value = np.where(samples.within(one.span), 100.0, samples.value)
    for one in seeding.of("stuck"):
        samples = scans[one.tags[0]]
        still = np.flatnonzero(samples.within(one.span))
        if len(still):
            samples.value[still] = samples.value[still[0]]
    for one in seeding.of("range_change"):
        samples, instrument = scans[one.tags[0]], by_tag[one.tags[0]]
        changed = quantised(samples.value * one.more.get("factor", 1.0) + one.more.get("shift", 0.0), instrument)
        samples.value = np.where(samples.within(one.span), changed, samples.value)
    for one in seeding.of("unit_switch"):
        samples = scans[one.tags[0]]
        factor = OTHER_UNIT[one.more["from_unit"]][1]
        changed = samples.value * factor + OFFSET.get(one.more["to_unit"], 0.0)
        samples.value = np.where(samples.within(one.span), np.round(changed, 1), samples.value)


def seed_archive(
    kept: dict[str, TagSamples],
    tags: Sequence[Instrument],
    seeding: Seeding,
    start: datetime.datetime,
    rng: np.random.Generator,
) -> None:
    """Change stored samples as networks, interfaces and archives do, in place.

    Parameters
    ----------
    kept
        Stored samples by tag.
    tags
        Instruments of the station.
    seeding
        Defects to seed.
    start
        Beginning of the record.
    rng
        Source of random numbers.
    """
    for one in seeding.of("comms_gap"):
        for tag in one.tags:
            kept[tag] = kept[tag].rows(~kept[tag].within(one.span))
    for one in seeding.of("bad_quality"):
        samples = kept[one.tags[0]]
        rows = samples.within(one.span)
        samples.quality[rows] = one.more["code"]
        if one.more["code"] == BAD:
            samples.value[rows] = 0.0
    for one in seeding.of("duplicates"):
        for instrument in tags:
            samples = kept[instrument.tag]
            again = np.flatnonzero(samples.within(one.span) & (rng.random(len(samples.time_s)) < one.more["share"]))
            kept[instrument.tag] = samples.rows(np.sort(np.concatenate([np.arange(len(samples.time_s)), again])))
    for one in seeding.of("local_time"):
        for tag in one.tags:
            kept[tag].time_s = _local(kept[tag].time_s, start, one.more["tz"])


def _local(time_s: Array, start: datetime.datetime, zone: str) -> Array:
    """Return stamps of a clock that shows local time, as seconds since the beginning."""
    info = zoneinfo.ZoneInfo(zone)
    hours, inverse = np.unique(np.floor(time_s / HOUR_S), return_inverse=True)
    offsets = np.empty(len(hours))
    for k, hour in enumerate(hours):
        shift = (start + datetime.timedelta(hours=float(hour))).astimezone(info).utcoffset()
        assert shift is not None
        offsets[k] = shift.total_seconds()
    return np.asarray(time_s + offsets[inverse])
