"""A station as a Modbus device: its register map, its clock, gaps, and a collector that polls it like any plant."""

from __future__ import annotations

import asyncio
import csv
import math
import struct
from pathlib import Path

import numpy as np
import pytest

from drivers.historian import open_store
from drivers.rig_file.reader import load_rig
from drivers.virtual.devices.modbus_protocol import answer
from drivers.virtual.tower.device import (
    FIRST_REGISTER,
    Replay,
    StationFolderError,
    load_station,
    rig_text,
    serve_station,
    write_dictionary,
)
from hil.tower.station import read_station
from hil.tower.station.collection import Collected, collect


def ask(replay: Replay, first: int, count: int, function: int = 4) -> bytes:
    """Return the response PDU to one read."""
    return answer(replay, struct.pack(">BHH", function, first, count))


def test_registers_hold_clock_and_values_between_samples(folder: Path) -> None:
    tags = load_station(folder)
    one = tags[1]
    middle = 0.5 * (one.time_s[3] + one.time_s[4])
    replay = Replay(tags, 1.0, math.floor(middle), clock=lambda: 0.0)
    pdu = ask(replay, 0, 2)
    assert struct.unpack(">I", pdu[2:6])[0] == math.floor(middle)
    value = struct.unpack(">f", ask(replay, FIRST_REGISTER + 2, 2)[2:])[0]
    low, high = sorted((one.value[3], one.value[4]))
    assert low - 1e-3 <= value <= high + 1e-3


def test_time_runs_at_its_speed(folder: Path) -> None:
    seconds = [0.0]
    replay = Replay(load_station(folder), 600.0, None, clock=lambda: seconds[0])
    begin = replay.now_s
    seconds[0] = 2.5
    assert replay.now_s == begin + 1500.0


def test_requests_beyond_the_map_and_other_functions_are_refused(folder: Path) -> None:
    replay = Replay(load_station(folder), 1.0, None)
    assert ask(replay, 0, 126)[0] == 0x84
    assert ask(replay, 5000, 2) == bytes((0x84, 2))
    assert ask(replay, 0, 2, function=3) == bytes((0x83, 1))


def test_a_gap_and_a_bad_sample_are_no_number(folder: Path) -> None:
    one = load_station(folder)[0]
    k = len(one.time_s) // 2
    one.good[k] = False
    assert math.isnan(one.at(one.time_s[k] + 0.5))
    assert math.isnan(one.at(one.time_s[0] - 10.0))
    one.time_s[k + 1 :] += 7200.0
    one.good[k] = True
    assert math.isnan(one.at(one.time_s[k] + 7000.0))


async def test_a_collector_stores_the_station_at_the_station_s_own_times(folder: Path, tmp_path: Path) -> None:
    tags = load_station(folder)
    replay = Replay(tags, 3600.0, None)
    listening: asyncio.Future[int] = asyncio.get_running_loop().create_future()
    task = asyncio.create_task(serve_station(replay, "127.0.0.1", 0, listening.set_result))
    try:
        port = await asyncio.wait_for(listening, 20.0)
        (tmp_path / "rig.toml").write_text(rig_text(tags, "towers", "127.0.0.1", port, replay.speed))
        write_dictionary(tags, tmp_path / "tags.csv")
        rig = load_rig(tmp_path / "rig.toml")
        assert len(rig.point) == len(tags) + 1
        with open_store(str(tmp_path / "plant"), create=True) as store:
            done: Collected = await collect(rig, store, every_s=0.05, minutes=1.0 / 60.0)
            names = store.tags()
            outlet = store.read(["cell1_water_outlet_temperature"])["cell1_water_outlet_temperature"]
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
    assert done.failures == 0, done.last_failure
    station = read_station(tmp_path / "tags.csv")
    assert set(station.tags) <= set(names)
    assert replay.start_s - 1.0 <= outlet.time_s[0] <= replay.end_s
    assert outlet.time_s[-1] - outlet.time_s[0] > 600.0, "of station time, in a second"
    true = next(one for one in tags if one.point == "cell1_water_outlet_temperature")
    good = outlet.quality == 192
    assert good.mean() > 0.8
    expected = np.array([true.at(t) for t in outlet.time_s[good]])
    assert np.nanmax(np.abs(outlet.value[good] - expected)) < 0.01


def test_a_folder_that_is_no_station_is_refused_with_the_remedy(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(StationFolderError, match=r"is no station to serve.*make one with hil tower simulate"):
        load_station(tmp_path)
    (tmp_path / "raw.parquet").write_bytes((folder / "raw.parquet").read_bytes())
    text = (folder / "tags.csv").read_text()
    (tmp_path / "tags.csv").write_text(text.replace(",degC,", ",furlong,", 1))
    with pytest.raises(
        StationFolderError,
        match="is in 'furlong'; convert its samples, or remove its line: units that can be served are degC",
    ):
        load_station(tmp_path)


def test_cells_of_a_spreadsheet_and_units_of_the_field_are_served(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "raw.parquet").write_bytes((folder / "raw.parquet").read_bytes())
    with (folder / "tags.csv").open(newline="") as handle:
        rows = list(csv.DictReader(handle))
    fan = next(row for row in rows if row["role"] == "fan_power")
    for row in rows:
        row["cell"] = f"{row['cell']}.0" if row["cell"] else ""
    fan["unit"] = "hp"
    with (tmp_path / "tags.csv").open("w", newline="") as handle:
        out = csv.DictWriter(handle, list(rows[0]))
        out.writeheader()
        out.writerows(rows)
    plain, served = load_station(folder), load_station(tmp_path)
    assert [one.point for one in served] == [one.point for one in plain]
    first, second = (next(one for one in tags if one.tag == fan["tag"]) for tags in (plain, served))
    assert (first.unit, second.unit) == ("kW", "kW")
    assert second.value == pytest.approx(0.745699872 * first.value)
