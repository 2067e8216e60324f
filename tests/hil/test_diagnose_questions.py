"""`hil diagnose` where the answer is a question back: two causes, no cause, too little to say. As a user types it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from subprocess import CompletedProcess
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.rig_file.reader import load_rig
from hil.cli import group
from hil.diagnosis.experiment_file import limits_of
from hil.diagnosis.session import with_unread_flow
from hil.profile.load_profile import read_profile, validate
from hil.record.reader import Record, write_record
from hil.run.session.request import setpoint_limits
from tests.discovery.conftest import Bench, brisk, brisk_healthy  # noqa: F401
from tests.discovery.plans import run, steady
from tests.hil.command_line import typed
from tests.hil.made_diagnosis import made
from tests.hil.made_record import written
from tests.twin.conftest import LOOP
from twin.discovery.healthy.basis import Columns
from twin.twinfile import dump, load

PROJECT = Path(__file__).resolve().parents[2]
RIG = PROJECT / "profiles/rigs/virtual.toml"


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Path]:
    """A twin, the record of it in good order, and one with heat at the heater at a load that never changes."""
    folder = tmp_path_factory.mktemp("questions")
    bench = Bench(load(LOOP))
    heated = bench.with_element("more", {"kind": "heat_source", "node": "heater", "power": 40.0})
    (folder / "twin.toml").write_text(LOOP.read_text(encoding="utf-8"), encoding="utf-8")
    return {
        "folder": folder,
        "twin": folder / "twin.toml",
        "healthy": written(bench.network, bench.record(10.0, seed=7), folder / "healthy.parquet"),
        "steady": written(bench.network, run(bench.network, steady(8.0), heated, 3.0), folder / "steady.parquet"),
    }


def diagnosed(place: Mapping[str, Path], record: Path, *more: object) -> CompletedProcess[str]:
    return typed("diagnose", record, "--twin", place["twin"], "--healthy", place["healthy"], *more)


def test_two_causes_one_experiment_one_answer(place: Mapping[str, Path], tmp_path: Path) -> None:
    done = diagnosed(place, place["steady"], "--rig", RIG, "--out", tmp_path / "first")
    assert done.returncode == 1, done.stderr
    assert "ambiguous" in done.stdout and "run it: " in done.stdout and "--with" in done.stdout
    assert "revision of the twin" not in done.stdout  # nothing is added while two causes are open
    first = json.loads((tmp_path / "first/diagnosis.json").read_text())
    kinds = {(a["kind"], a["where"]) for a in first["indistinguishable"]}
    assert {("heat_source", "heater"), ("actuator", "heater_power")} <= kinds
    # The plan is a load profile that the rig accepts.
    plan = tmp_path / "first/experiment.csv"
    rig = load_rig(RIG)
    profile = read_profile(plan)
    validate(profile, setpoint_limits(rig), period_s=rig.period_s)
    assert profile.duration_s == 3600.0 * first["next_experiment"]["hours"]
    assert first["next_experiment"]["hottest_C"] < limits_of(RIG).hottest_C
    assert typed("run", plan, "--virtual", "--lockstep", "--no-twin", "--check-only").returncode == 0
    # The record of it says which of the two it is; tests/hil/test_explain.py has one that says the other.
    network = load(LOOP)
    heated = Bench(network).with_element("more", {"kind": "heat_source", "node": "heater", "power": 40.0})
    later = written(network, run(network, first["next_experiment"]["steps"], heated), tmp_path / "later.parquet")
    done = diagnosed(place, place["steady"], "--rig", RIG, "--with", later, "--dry", "--json")
    settled = json.loads(done.stdout)
    assert settled["verdict"] == "effect found" and settled["next_experiment"] is None
    assert [(e["kind"], e["where"]) for e in settled["effects"]] == [("heat_source", "heater")]


def test_a_curve_is_offered_and_adopted_only_when_asked(
    brisk: Bench,  # noqa: F811
    brisk_healthy: Columns,  # noqa: F811
    tmp_path: Path,
) -> None:
    knots = dict(zip([f"x_{k}" for k in range(1, 6)], (50.0, 60.0, 70.0, 85.0, 100.0), strict=True))
    knots |= dict(zip([f"q_{k}" for k in range(1, 6)], (0.0, 40.0, 90.0, 40.0, 0.0), strict=True))
    odd = {
        "kind": "empirical_heat",
        "node": "tank",
        "driver": "fan_speed_pct",
        **{k: {"value": v} for k, v in knots.items()},
    }
    made = brisk.record(14.0, seed=2, changed=brisk.with_element("odd", odd))
    record = written(brisk.network, made, tmp_path / "odd.parquet")
    healthy = written(brisk.network, brisk_healthy, tmp_path / "healthy.parquet")
    twin = tmp_path / "twin.toml"
    twin.write_text(dump(brisk.network), encoding="utf-8")
    asked = ("diagnose", record, "--twin", twin, "--healthy", healthy, "--out", tmp_path / "out")
    done = typed(*asked)
    assert done.returncode == 1 and "effect found" in done.stdout and "offered, not adopted" in done.stdout
    assert not (tmp_path / "twin.r1.toml").exists() and len(list(tmp_path.glob("twin*.toml"))) == 1
    proposal = load(tmp_path / "out/empirical.toml")
    assert proposal.parameters["unexplained_at_tank.q_3"].value > 50.0
    assert "Empirical curve" in (tmp_path / "out/diagnosis.html").read_text(encoding="utf-8")
    done = typed(*asked, "--empirical")
    assert done.returncode == 1 and "adopted: as a curve of fan_speed_pct" in done.stdout
    (revision,) = list(tmp_path.glob("twin.r*.toml"))
    adopted = load(revision)
    assert adopted.revision.error_after_K["T_tank_C"] < 0.5 * adopted.revision.error_before_K["T_tank_C"]


def test_a_rig_at_rest_says_too_little(place: Mapping[str, Path], tmp_path: Path) -> None:
    network = load(LOOP)
    t = np.arange(0.0, 3.0 * 3600.0, 5.0)
    noise = network.sigma * np.random.default_rng(1).normal(0.0, 1.0, (len(t), len(network.sensors)))
    idle = Columns(t, np.tile([0.0, 85.0, 70.0, 22.0], (len(t), 1)), 22.0 + noise)
    done = diagnosed(place, written(network, idle, tmp_path / "idle.parquet"), "--dry")
    said = [line for line in done.stderr.splitlines() if line.startswith("hil: ")]
    assert done.returncode == 2 and len(said) == 1
    assert "too little excitation" in done.stderr and "heat rejection" in done.stderr
    assert "heater_power_W stays at 0" in done.stderr and "idle.parquet" in done.stderr


def test_what_cannot_be_used_is_said_in_one_sentence_each(place: Mapping[str, Path], tmp_path: Path) -> None:
    bench = Bench(load(LOOP))
    sick = bench.record(6.0, changed=bench.with_values(modules_power__power=300.0), onset_h=2.0)
    record = written(bench.network, sick, tmp_path / "sick.parquet")
    done = typed("diagnose", place["steady"], "--twin", place["twin"], "--healthy", record, "--dry")
    assert done.returncode == 2 and "the healthy record does not fit the twin" in done.stderr
    brief = written(bench.network, bench.record(0.3), tmp_path / "brief.parquet")
    done = diagnosed(place, brief, "--dry")
    assert done.returncode == 2 and "at least two windows" in done.stderr and "brief.parquet" in done.stderr
    full = bench.record(1.0)
    kept = {"heater_power_W": full.inputs[:, 0], "pump_speed_pct": full.inputs[:, 1], "T_ambient_C": full.inputs[:, 3]}
    write_record(Record(full.time_s, {**kept, "T_tank_C": full.measured[:, 3]}), tmp_path / "other.parquet")
    done = diagnosed(place, tmp_path / "other.parquet", "--dry")
    assert done.returncode == 2 and "fan_speed_pct" in done.stderr and "other.parquet" in done.stderr
    assert "Traceback" not in done.stderr and sum(x.startswith("hil: ") for x in done.stderr.splitlines()) == 1


def test_a_plan_is_forecast_before_it_is_run(place: Mapping[str, Path], tmp_path: Path) -> None:
    """A load that never changes cannot show a mass; steps of load, pump and fan can."""
    lines = ["time_s,heater_power_W,pump_speed_pct,fan_speed_pct", "0,700,85,70", "28800,700,85,70"]
    (tmp_path / "flat.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    found = {}
    for name, profile in (("flat", tmp_path / "flat.csv"), ("steps", PROJECT / "profiles/loads/commissioning_10h.csv")):
        done = diagnosed(place, profile, "--forecast", "--json")
        assert done.returncode == 0, done.stderr
        found[name] = json.loads(done.stdout)
    assert any("T_ambient_C" in note for note in found["flat"]["notes"])
    least = {
        name: min(s["least"] for s in f["seen"] if (s["kind"], s["where"]) == ("thermal_mass", "tank"))
        for name, f in found.items()
        if any((s["kind"], s["where"]) == ("thermal_mass", "tank") for s in f["seen"])
    }
    assert least["steps"] < 0.2 * least.get("flat", np.inf)
    assert len(found["steps"]["confused"]) < len(found["flat"]["confused"])
    bare = typed("diagnose", tmp_path / "flat.csv", "--forecast", "--twin", place["twin"])
    assert bare.returncode == 2 and "--healthy" in bare.stderr


def test_groups_of_the_same_names_are_stated_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Masses with other time constants have the same names, and are one line."""
    one, other = (("thermal_mass", node, "history") for node in ("plate", "tank"))
    found = SimpleNamespace(groups=((one, other), (other, one), (one, one, other)), undetectable=())
    monkeypatch.setattr("twin.discovery.ambiguity_groups", lambda network: found)
    done = CliRunner().invoke(group, ["check", str(LOOP), "--catalogue"])
    lines = [line for line in done.output.splitlines() if line.startswith("no input distinguishes: ")]
    assert lines == ["no input distinguishes: thermal mass at plate (history); thermal mass at tank (history)"]


def test_a_catalogue_is_checked(place: Mapping[str, Path]) -> None:
    done = typed("check", place["twin"], "--catalogue")
    assert done.returncode == 0, done.stderr
    groups = [line for line in done.stdout.splitlines() if line.startswith("no input distinguishes: ")]
    assert any("actuator at pump_speed (constant)" in x and "flow at loop (constant)" in x for x in groups)
    assert "To separate those of two places, measure there" in done.stdout
    refused = typed("check", RIG, "--catalogue")
    assert refused.returncode == 2 and "--catalogue" in refused.stderr


def test_a_measured_flow_that_the_twin_does_not_read_is_named_with_its_use() -> None:
    twin = load(LOOP)
    columns = [*twin.input_columns, *twin.sensor_names, "flow_L_per_min"]
    (note,) = with_unread_flow(made("ambiguous"), twin, columns).notes
    assert "(flow_L_per_min)" in note and "in % of 3.785 L/min as the column that pump of circuit names" in note
    assert not with_unread_flow(made("ambiguous"), twin, columns[:-1]).notes
