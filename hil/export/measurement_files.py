"""Exports as measurement files: MF4 (ASAM MDF 4.10), HDF5 and TDMS, each by the usual library of its format."""

from __future__ import annotations

import io
from typing import Any, BinaryIO

import numpy as np

from hil.export.content import QUALITY_CODES, Channel, RawCounts, RunContent
from hil.export.target import required_library

CODES = ", ".join(f"{code} {name}" for name, code in QUALITY_CODES.items())
_WHOLE = (np.uint16, np.int16, np.uint32, np.int32, np.int64)
"""Types of raw counts, the first that holds all of them is taken; the order is that of registers in use."""


def write_mf4(content: RunContent, file: BinaryIO) -> None:
    """Write an MF4 file: signals with units and comments, their qualities, raw counts with their rule, events.

    A value that is not GOOD is NaN and has its invalidation bit set (ASAM MDF 4.1, 5.14). `<column>_raw` has the
    counts of the registers as whole numbers with a linear conversion to the unit; it has invalidation bits, too.
    Events are text channels of a group of their own.

    Raises
    ------
    ExportError
        asammdf is not installed.
    """
    asammdf = required_library("asammdf", "an export as MF4")
    made = asammdf.MDF(version="4.10")
    try:
        if content.started is not None and content.started.timestamp() >= 0.0:  # MDF counts from 1970
            made.header.start_time = content.started
        made.header.comment = _described(content)
        signals = [_mf4_signal(asammdf, channel, content.time_s) for channel in content.channels]
        made.append(signals, acq_name="signals", comment="signals of the run", common_timebase=True)
        raw = [_mf4_raw(asammdf, channel, channel.raw, content.time_s) for channel in content.channels if channel.raw]
        if raw:
            made.append(raw, acq_name="raw", comment="raw counts of the registers", common_timebase=True)
        made.append(
            [
                asammdf.Signal(c.quality, content.time_s, name=f"{c.column}_quality", comment=f"codes: {CODES}")
                for c in content.channels
            ],
            acq_name="quality",
            comment="quality of each value",
            common_timebase=True,
        )
        if content.events:
            stamps = np.array([event.time_s for event in content.events])
            texts = {"level": [e.level for e in content.events], "text": [e.text for e in content.events]}
            events = [
                asammdf.Signal(_utf8(rows), stamps, name=f"event_{name}", encoding="utf-8")
                for name, rows in texts.items()
            ]
            made.append(events, acq_name="events", comment="events of the run", common_timebase=True)
        made.save(file, overwrite=True, compression=1)
    finally:
        made.close()


def _described(content: RunContent) -> str:
    return "\n".join(f"{name}: {text}" for name, text in content.about.items() if text)


def _utf8(rows: list[str]) -> Any:
    return np.array([row.encode("utf-8", "replace") for row in rows])


def _mf4_signal(asammdf: Any, channel: Channel, time_s: Any) -> Any:
    missing = np.isnan(channel.values)
    return asammdf.Signal(
        channel.values,
        time_s,
        unit=channel.unit,
        name=channel.column,
        comment=channel.comment,
        invalidation_bits=missing if missing.any() else None,
    )


def _mf4_raw(asammdf: Any, channel: Channel, raw: RawCounts, time_s: Any) -> Any:
    low, high = int(raw.counts.min()), int(raw.counts.max())
    kind = next(kind for kind in _WHOLE if np.iinfo(kind).min <= low and high <= np.iinfo(kind).max)
    return asammdf.Signal(
        raw.counts.astype(kind),
        time_s,
        unit=channel.unit,
        name=f"{channel.column}_raw",
        conversion={"a": raw.scale, "b": raw.offset},
        comment=f"raw counts of {channel.column}; {channel.comment}",
        invalidation_bits=channel.bad if channel.bad.any() else None,
    )


def write_hdf5(content: RunContent, file: BinaryIO) -> None:
    """Write an HDF5 file: `/time_s` as a dimension scale, `/signals`, `/quality`, `/raw` and `/events`.

    Units are attributes (`units`), and those of qualities follow CF 1.10, 3.5 (`flag_values`, `flag_meanings`). A value
    that is missing or not GOOD is NaN, which `_FillValue` names. The file is made in memory: a disk that is full while
    the HDF5 library writes would end this process.

    Raises
    ------
    ExportError
        h5py is not installed.
    """
    h5py = required_library("h5py", "an export as HDF5")
    packed: dict[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
    image = io.BytesIO()
    with h5py.File(image, "w") as made:
        made.attrs.update(content.about)
        time = made.create_dataset("time_s", data=content.time_s, **packed)
        time.attrs["units"] = "s"
        time.make_scale("time_s")
        groups = {name: made.create_group(name) for name in ("signals", "quality")}
        if any(channel.raw for channel in content.channels):
            groups["raw"] = made.create_group("raw")
        codes = np.array(list(QUALITY_CODES.values()), dtype=np.uint8)

        def put(group: str, name: str, values: Any, **attributes: Any) -> None:
            placed = groups[group].create_dataset(name, data=values, **packed)
            placed.dims[0].attach_scale(time)
            placed.attrs.update(attributes)

        for channel in content.channels:
            name = _object_name(channel.column)
            put(
                "signals",
                name,
                channel.values,
                units=channel.unit,
                long_name=channel.comment,
                _FillValue=np.float64("nan"),
            )
            put("quality", name, channel.quality, flag_values=codes, flag_meanings=" ".join(QUALITY_CODES))
            if channel.raw:
                raw = channel.raw
                put("raw", name, raw.counts, units=channel.unit, scale_factor=raw.scale, add_offset=raw.offset)
        events = made.create_group("events")
        events.create_dataset("time_s", data=np.array([e.time_s for e in content.events], dtype=np.float64))
        events["time_s"].attrs["units"] = "s"
        for name, rows in (("level", [e.level for e in content.events]), ("text", [e.text for e in content.events])):
            events.create_dataset(name, data=_utf8(rows).astype(object), dtype=h5py.string_dtype())
    file.write(image.getbuffer())


def _object_name(column: str) -> str:
    """Return a column's name without the character that separates groups in HDF5."""
    return column.replace("/", "_")


def write_tdms(content: RunContent, file: BinaryIO) -> None:
    """Write a TDMS file: groups `signals`, `quality`, `raw` and `events`; units as `unit_string`.

    A value that is missing or not GOOD is NaN. The first channel of each group is its time. Raw counts have the
    properties `scale` and `offset` of their rule; TDMS has no integers that are missing, so their quality decides.

    Raises
    ------
    ExportError
        nptdms is not installed.
    """
    nptdms = required_library("nptdms", "an export as TDMS")
    about: dict[str, Any] = {"name": content.about["profile"], "description": _described(content), **content.about}
    if content.started is not None:
        about["datetime"] = np.datetime64(content.started.replace(tzinfo=None), "us")
    made: list[Any] = [nptdms.RootObject(about)]

    def put(group: str, name: str, values: Any, **properties: Any) -> None:
        made.append(nptdms.ChannelObject(group, name, values, properties))

    put("signals", "time_s", content.time_s, unit_string="s")
    for channel in content.channels:
        put("signals", channel.column, channel.values, unit_string=channel.unit, description=channel.comment)
    put("quality", "time_s", content.time_s, unit_string="s")
    for channel in content.channels:
        put("quality", channel.column, channel.quality, description=f"codes: {CODES}")
    counted = [channel for channel in content.channels if channel.raw]
    if counted:
        put("raw", "time_s", content.time_s, unit_string="s")
    for channel in counted:
        assert channel.raw is not None
        rule = {"scale": channel.raw.scale, "offset": channel.raw.offset}
        put("raw", channel.column, channel.raw.counts, unit_string=channel.unit, **rule)
    if content.events:
        put("events", "time_s", np.array([e.time_s for e in content.events]), unit_string="s")
        put("events", "level", [e.level for e in content.events])
        put("events", "text", [e.text for e in content.events])
    with nptdms.TdmsWriter(file) as writer:
        writer.write_segment(made)
