"""`hil diagnose` as a user types it, on records of the virtual rig.

The course of tests/hil/test_start.py diagnoses in a process of its own.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from drivers.rig_file.reader import load_rig
from drivers.virtual.plant.effects import load_effects
from hil.profile.load_profile import read_profile
from hil.record.reader import read_record, write_record
from hil.synthetic.plant_record import direct_record
from tests.hil.command_line import typed
from twin.kernel import simulate
from twin.twinfile import load

PROJECT = Path(__file__).resolve().parents[2]
ONSET_S = 5400.0
HEAT = (
    f'[[effect]]\nkind = "heat_source"\nwhere = "modules"\ndriver = "constant"\npower_W = 150\nonset_s = {ONSET_S:g}\n'
)
LOADS = PROJECT / "profiles" / "loads"
RIG = PROJECT / "profiles" / "rigs" / "virtual.toml"


def beginning(load: Path, hours: float) -> str:
    """Return the rows of a load profile up to a time, and a last one there."""
    _, names, *rows = load.read_text(encoding="utf-8").splitlines()
    kept = [row for row in rows if float(row.split(",")[0]) < 3600.0 * hours]
    last = ",".join([f"{3600.0 * hours:g}", *kept[-1].split(",")[1:]])
    return "\n".join([names, *kept, last, ""])


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The first hours of two shipped loads: healthy ones, and ones with heat that no twin was told of."""
    place = tmp_path_factory.mktemp("runs")
    (place / "heat.toml").write_text(HEAT, encoding="utf-8")
    for name, shipped, hours in (("healthy", "commissioning_10h", 4.0), ("heated", "battle_10h", 5.0)):
        (place / f"{name}.csv").write_text(beginning(LOADS / f"{shipped}.csv", hours), encoding="utf-8")
    # A record without the wires is as one over them: tests/hil/test_bench_discovery.py. Records over them are diagnosed
    # in tests/hil/test_live_diagnosis.py and tests/hil/test_explain.py.
    found, heat = {}, load_effects(place / "heat.toml")
    for name, effects in (("healthy", ()), ("heated", heat)):
        found[name] = place / name
        found[name].mkdir()
        made = direct_record(read_profile(place / f"{name}.csv"), load_rig(RIG), seed=5, unit=5, effects=effects)
        write_record(made, found[name] / "record.parquet")
    done = typed(
        "commission",
        found["healthy"] / "record.parquet",
        "--twin",
        PROJECT / "profiles/twins/loop.toml",
        "--out",
        place / "rig.toml",
    )
    assert done.returncode == 0, done.stderr
    return {**found, "twin": place / "rig.toml", "place": place}


def test_undeclared_heat_is_found_added_and_the_twin_is_right_again(runs: dict[str, Path]) -> None:
    record, twin = runs["heated"] / "record.parquet", runs["twin"]
    out = runs["place"] / "found"
    done = typed("diagnose", record, "--twin", twin, "--out", out, "--json")
    assert done.returncode == 1, done.stderr  # something was found
    printed = json.loads(done.stdout)
    assert printed["healthy"] == str(twin.with_name("rig.healthy.parquet"))  # kept by the commissioning
    assert printed["verdict"] == "effect found"
    (effect,) = printed["effects"]
    assert (effect["kind"], effect["where"], effect["driver"]) == ("heat_source", "modules", "constant")
    assert effect["value"] == pytest.approx(150.0, rel=0.08)
    assert abs(effect["onset_s"] - ONSET_S) < 600.0
    for error in printed["error"]["sensors"].values():
        assert error["after"] < 1.8 * error["noise"] < error["stale"]
        assert error["after"] < error["before"]
    document = json.loads((out / "diagnosis.json").read_text())
    assert document["revision"] == str(twin.with_name("rig.r2.toml"))
    # The revision stands by itself: it runs the held-out part from a settled state to the same error.
    revised, data = load(twin.with_name("rig.r2.toml")), read_record(record)
    begin = int(np.searchsorted(data.time_s, printed["error"]["held_out_s"][0]))
    inputs, measured = revised.select(data.columns)
    state = revised.initial_state(measured[begin : begin + 30])
    run = simulate(revised, data.time_s[begin:], inputs[begin:], state)
    off = np.sqrt(np.nanmean((run - measured[begin:])[1800:] ** 2, axis=0))
    assert (off < 2.5 * revised.sigma).all()
    # It may be asked again, with the same healthy record: the rig was not as it is now before the heat came.
    again = typed("diagnose", record, "--twin", twin.with_name("rig.r2.toml"), "--dry", "--json")
    assert again.returncode == 1, again.stderr
    (effect,) = json.loads(again.stdout)["effects"]
    assert (effect["kind"], effect["where"], effect["shape"]) == ("heat_source", "modules", "transient")
    assert effect["onset_s"] == 0.0
    assert effect["value"] == pytest.approx(-150.0, rel=0.08)
    # And it can be undone.
    assert typed("twin", "revert", twin.with_name("rig.r2.toml")).returncode == 0
    assert load(twin.with_name("rig.r3.toml")).parameters["modules_power.power"].value == 0.0


def test_dry_writes_nothing(runs: dict[str, Path], tmp_path: Path) -> None:
    twin = tmp_path / "rig.toml"
    twin.write_bytes(runs["twin"].read_bytes())
    done = typed(
        "diagnose",
        runs["heated"],
        "--twin",
        twin,
        "--healthy",
        runs["healthy"] / "record.parquet",
        "--dry",
        "--out",
        tmp_path / "out",
    )
    assert done.returncode == 1 and "give off" in done.stdout
    assert sorted(p.name for p in tmp_path.iterdir()) == ["rig.toml"]


def test_the_healthy_rig_is_adequate(runs: dict[str, Path], tmp_path: Path) -> None:
    record = runs["healthy"] / "record.parquet"
    done = typed("diagnose", record, "--twin", runs["twin"], "--healthy", record, "--dry")
    assert done.returncode == 0 and "adequate" in done.stdout


def test_what_cannot_be_diagnosed_is_said_in_a_sentence(runs: dict[str, Path], tmp_path: Path) -> None:
    data = read_record(runs["heated"] / "record.parquet")
    from hil.record.reader import Record

    short = tmp_path / "short.parquet"
    write_record(Record(data.time_s[:600], {k: v[:600] for k, v in data.columns.items()}), short)
    done = typed("diagnose", short, "--twin", runs["twin"], "--dry")
    assert done.returncode == 2 and "two windows" in done.stderr and "short.parquet" in done.stderr
    poor = tmp_path / "poor.parquet"
    few = ("T_heater_C", "T_radiator_C", "T_tank_C")
    write_record(Record(data.time_s, {k: v for k, v in data.columns.items() if k not in few}), poor)
    done = typed("diagnose", poor, "--twin", runs["twin"], "--dry")
    assert done.returncode == 2 and "T_tank_C" in done.stderr
    done = typed("diagnose", runs["heated"] / "record.parquet")
    assert done.returncode == 2 and "--twin" in done.stderr
