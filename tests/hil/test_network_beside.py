"""The network beside the fits, as a user runs it: left out with a reason, in a process of its own, modes."""

from __future__ import annotations

import asyncio
import importlib.util
import json
import os
import shutil
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.rig_file.reader import file_sha256
from drivers.signals.points import Signal
from hil.cli import group
from hil.journal.writer import Header, JournalReader, JournalWriter
from hil.record.reader import Record, read_record, write_record
from hil.run.session.interrupted_run import request_of
from hil.run_folder.folder import RunFolder, RunFolderError
from hil.tracking.bands import SPAN_S, Bands
from hil.tracking.process import Tracking
from hil.tracking.twins import TrackingConfig, disturbance
from twin.kernel import simulate
from twin.revisions import with_elements
from twin.twinfile import load, save

PROFILES = Path(__file__).resolve().parents[2] / "profiles"
LOOP = PROFILES / "twins" / "loop.toml"
NEEDED = ("torch", "safetensors")
network_here = pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in NEEDED), reason="torch or safetensors is not installed"
)
LOAD = "time_s,heater_power_W,pump_speed_pct,fan_speed_pct\n0,700,100,70\n900,850,85,70\n1300,650,100,100\n"


def hil(*arguments: object) -> Any:
    return CliRunner().invoke(group, [str(item) for item in arguments])


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A hundred minutes of a loop with other fins than the twin's."""
    rng, network = np.random.default_rng(0), load(LOOP)
    n = 6000
    time_s = np.arange(n, dtype=np.float64)
    level = lambda low, high, every: np.repeat(rng.uniform(low, high, n // every + 1), every)[:n]  # noqa: E731
    inputs = np.column_stack([level(400, 900, 700), level(60, 100, 1100), level(30, 90, 900), np.full(n, 22.0)])
    clean = simulate(network.with_values({"fins.UA_100": 45.0}), time_s, inputs, np.array([35.0, 32.0, 29.0, 30.0]))
    columns = dict(zip(network.input_columns, inputs.T, strict=True))
    for j, parts in enumerate(network.sensor_columns.values()):
        columns |= {c: clean[:, j] + 0.05 * rng.standard_normal(n) for c in parts}
    path = tmp_path_factory.mktemp("record") / "record.parquet"
    write_record(Record(time_s, columns), path)
    return path


@pytest.fixture(scope="module")
def brief(record: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first windows of that record, for what does not depend on what the calibrators make of it."""
    whole, path = read_record(record), tmp_path_factory.mktemp("brief") / "record.parquet"
    write_record(Record(whole.time_s[:1900], {name: values[:1900] for name, values in whole.columns.items()}), path)
    return path


@network_here
def test_shadow_writes_nothing_and_controlled_writes_one_revision(record: Path, tmp_path: Path) -> None:
    twin = Path(shutil.copy(LOOP, tmp_path / "my_twin.toml"))
    shadow = hil("track", record, "--twin", twin, "--json")
    assert shadow.exit_code == 0, shadow.output
    told = json.loads(shadow.stdout)
    assert told["errors_K"]["columns"][::2] == ["static", "pso fitted", "least_squares fitted", "hiera_unet fitted"]
    assert list(told["bands"]) == list(told["parameters"]) == ["static", "pso", "least_squares", "hiera_unet"]
    assert told["adoption"] is None and told["advice"] == [] and len(told["proposals"]) == 20
    assert list(tmp_path.iterdir()) == [twin]
    advisory = hil("track", record, "--twin", twin, "--calibrator", "hiera_unet", "--network-mode", "advisory")
    assert "hiera_unet would change fins.UA_100" in advisory.output and list(tmp_path.iterdir()) == [twin]
    done = hil("track", record, "--twin", twin, "--calibrator", "hiera_unet", "--network-mode", "controlled")
    assert done.exit_code == 0 and "are saved as" in done.output
    (revision,) = (path for path in tmp_path.iterdir() if path != twin)
    log = hil("twin", "log", revision).output
    assert "hil track record.parquet" in log and "its gates accepted" in log
    assert "fins.UA_100" in hil("twin", "diff", revision).output
    assert hil("twin", "revert", revision).exit_code == 0


def test_without_torch_the_others_run_and_a_sentence_says_why(
    brief: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *rest: None if name in NEEDED else real(name, *rest))
    done = hil("track", brief, "--twin", LOOP, "--json")
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert list(told["parameters"]) == ["static", "pso", "least_squares"]
    assert "needs torch and safetensors" in told["left_out"]["hiera_unet"]
    named = hil("track", brief, "--twin", LOOP, "--calibrator", "hiera_unet")
    assert named.exit_code != 0 and "needs torch" in str(named.exception)


@network_here
@pytest.mark.parametrize(
    ("damage", "words"),
    [
        ("table", "were trained with another channel table"),
        ("config", "are of another configuration than"),
        ("twin", "were trained for a twin of another structure, with other elements"),
        ("weights", "their checksum differs"),
        ("missing", "there is no trained network"),
    ],
)
def test_weights_of_something_else_are_refused_in_one_sentence(
    brief: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, damage: str, words: str
) -> None:
    from twin.calibrators.hiera_unet.serve import service

    folder, twin = Path(shutil.copytree(PROFILES / "trained", tmp_path / "trained")), LOOP
    card, weights = (folder / f"loop_small_0.{end}" for end in ("json", "safetensors"))
    document = json.loads(card.read_text(encoding="utf-8"))
    match damage:
        case "table":
            document["table"] = "0" * 64
        case "config":
            document["config"]["dims"] = [96, 192, 384, 512]
        case "weights":
            weights.write_bytes(weights.read_bytes() + b" ")
        case "missing":
            (folder / "loop_small.json").unlink()
        case "twin":
            source = {"kind": "heat_source", "node": "tank", "power": {"value": 5.0, "lower": 0.0, "upper": 50.0}}
            twin = save(with_elements(load(LOOP), {"one_more": source}), tmp_path / "more.toml")
    card.write_text(json.dumps(document), encoding="utf-8")
    monkeypatch.setattr(service, "TRAINED", folder)
    named = hil("track", brief, "--twin", twin, "--calibrator", "hiera_unet")
    assert named.exit_code != 0 and words in str(named.exception) and "\n" not in str(named.exception)
    told = json.loads(hil("track", brief, "--twin", twin, "--json").stdout)
    assert damage != "twin" or "trains for the shipped loop's structure alone" in told["left_out"]["hiera_unet"]
    assert words in told["left_out"]["hiera_unet"] and list(told["bands"]) == ["static", "pso", "least_squares"]


@network_here
@pytest.mark.parametrize(
    ("damage", "code", "times"),
    [("flat", "FLAT_RECORD", 20), ("shuffled", "SHUFFLED_RECORD", 20), ("blocks", "SHUFFLED_RECORD", 18)],
)
def test_a_flat_or_shuffled_record_moves_nothing_and_says_why(
    record: Path, tmp_path: Path, damage: str, code: str, times: int
) -> None:
    data = read_record(record)
    rng, n = np.random.default_rng(1), len(data.time_s)
    order = (
        rng.permutation(n) if damage != "blocks" else rng.permutation(n // 600).repeat(600) * 600 + np.arange(n) % 600
    )
    change = (lambda v: np.full_like(v, 100.0 / 3.0)) if damage == "flat" else (lambda v: v[order])
    thermometers = {c for parts in load(LOOP).sensor_columns.values() for c in parts}
    columns = {name: change(v) if name in thermometers or damage == "blocks" else v for name, v in data.columns.items()}
    write_record(Record(data.time_s, columns), tmp_path / "bad.parquet")
    twin = Path(shutil.copy(LOOP, tmp_path / "my_twin.toml"))
    done = hil(
        "track", tmp_path / "bad.parquet", "--twin", twin, "--calibrator", "hiera_unet", "--network-mode", "controlled"
    )
    assert f"hiera_unet held everything in 20 of 20 proposals; {code} in {times} (" in done.output
    # Of blocks in another order the first window is as it was measured, and is judged before anything is torn.
    assert damage == "blocks" or "that the twin does not model" not in done.output
    assert "no revision is saved" in done.output and len(list(tmp_path.glob("*.toml"))) == 1


ROOM = """
format = 1
name = "room"
[inputs]
heater_power_W = { nominal = 500.0 }
T_ambient_C = { nominal = 10.0 }
[elements.room]
kind = "node"
capacitance = 3.0e5
[elements.heater]
kind = "heat_source"
node = "room"
driver = "heater_power_W"
[elements.loss]
kind = "ambient_loss"
node = "room"
hA = 30.0
[elements.T_room_C]
kind = "sensor"
node = "room"
columns = ["T_room_C"]
[windows]
window_s = 7200.0
[sets.commission]
members = ["room.capacitance", "loss.hA"]
"""


def test_a_room_is_tracked_by_the_calibrators_that_take_any_twin(tmp_path: Path) -> None:
    twin, short, data = (tmp_path / name for name in ("room.toml", "short.toml", "room.csv"))
    twin.write_text(ROOM, encoding="utf-8")
    short.write_text(ROOM.replace("7200.0", "600.0"), encoding="utf-8")
    network = load(twin)
    time_s = np.arange(0.0, 80000.0, 600.0)
    inputs = np.column_stack([np.where(time_s % 14400.0 < 7200.0, 900.0, 200.0), np.full(len(time_s), 10.0)])
    clean = simulate(network.with_values({"loss.hA": 24.0}), time_s, inputs, np.array([20.0]))
    columns = dict(zip(network.input_columns, inputs.T, strict=True)) | {"T_room_C": clean[:, 0]}
    write_record(Record(time_s, columns), data)
    done = hil("track", data, "--twin", twin)
    assert done.exit_code == 0, done.output
    assert "hiera_unet is left out: hiera_unet is of the coolant loop only" in done.output
    assert "stall where the twin ahead was within 0.1 K neither at its start nor over the whole" in done.output
    found = json.loads(hil("track", data, "--twin", twin, "--json").stdout)["parameters"]
    assert list(found) == ["static", "pso", "least_squares"]
    assert found["least_squares"]["loss.hA"][0] == pytest.approx(24.0, rel=0.05)
    coarse = hil("track", data, "--twin", short, "--calibrator", "kalman")
    assert "skipped where fewer than 8 samples are there" in coarse.output
    assert "set window_s under [windows] of the twin file to 9600" in coarse.output


def test_small_powers_are_told_with_digits() -> None:
    document = {"disturbed": "heater_1", "disturbed_W": 0.187, "disturbed_interval90_W": (0.1, 0.2751)}
    assert disturbance(document) == "heater_1 gives off 0.19 W (0.1 to 0.28) that the twin does not model"
    document |= {"disturbed_W": 187.2, "disturbed_interval90_W": (99.6, 270.1)}
    assert disturbance(document) == "heater_1 gives off 187 W (100 to 270) that the twin does not model"
    document.update(disturbed_W=-187.4, disturbed_interval90_W=(-270.0, -100.0))
    assert disturbance(document) == "heater_1 takes up 187 W (100 to 270) that the twin does not model"


@network_here
def test_own_weights_are_asked_where_their_card_is_named(
    brief: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from twin.calibrators.hiera_unet.serve import service

    card = Path(shutil.copytree(PROFILES / "trained", tmp_path / "own")) / "loop_small.json"
    monkeypatch.setattr(service, "TRAINED", tmp_path / "none")
    for name in ("hiera_unet", "hiera_ls"):
        asked = hil("track", brief, "--twin", LOOP, "--calibrator", name, "--network", card, "--json")
        assert asked.exit_code == 0 and list(json.loads(asked.stdout)["bands"]) == ["static", name], asked.output
    card.write_text(card.read_text(encoding="utf-8").replace('"format": 2', '"format": 99'), encoding="utf-8")
    refused = hil("track", brief, "--twin", LOOP, "--network", card)  # by the usual calibrators, too
    assert refused.exit_code != 0 and "has format 99, not 2" in str(refused.exception)
    missing = hil("track", brief, "--twin", LOOP, "--network", tmp_path / "no.json")
    assert missing.exit_code == 2 and "no.json: there is no such file" in missing.output
    unasked = hil("track", brief, "--twin", LOOP, "--network", card, "--calibrator", "pso")
    assert "no calibrator uses it; add --calibrator hiera_unet or hiera_ls" in str(unasked.exception)


@dataclass
class Networked:
    """A run in lockstep whose network is named by a card of its own."""

    place: Path
    card: Path
    folder: RunFolder


@pytest.fixture(scope="module")
def networked(tmp_path_factory: pytest.TempPathFactory) -> Networked:
    place = tmp_path_factory.mktemp("networked")
    card = Path(shutil.copytree(PROFILES / "trained", place / "own")) / "loop_small.json"
    (place / "load.csv").write_text(LOAD, encoding="utf-8")
    done = hil(*run_words(place), "--network", card, "--json")
    assert done.exit_code == 0, done.output
    return Networked(place, card, RunFolder(Path(json.loads(done.stdout)["folder"])))


def run_words(place: Path) -> list[object]:
    return ["run", place / "load.csv", "--virtual", "--lockstep", "--runs", place / "runs", "--no-viewer"]


@network_here
def test_a_run_names_its_network_and_goes_on_with_that_alone(
    networked: Networked, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, card, words = networked.folder, networked.card, run_words(networked.place)
    manifest = folder.read_manifest()
    assert manifest["files"]["network"] == {"path": str(card), "sha256": file_sha256(card)}
    monkeypatch.setattr("hil.run.session.interrupted_run.has_ended", lambda folder: False)  # as if it had been cut
    assert request_of(folder, manifest, {}).card == card
    moved = card.with_name("moved.json")
    card.rename(moved)
    with pytest.raises(RunFolderError, match="the run's network, is not there; give its place with --network"):
        request_of(folder, manifest, {})
    assert request_of(folder, manifest, {"network": moved}).card == moved
    moved.write_text(moved.read_text(encoding="utf-8").replace('"format": 2', '"format": 99'), encoding="utf-8")
    with pytest.raises(RunFolderError, match="is not what it was when the run began; put that network back"):
        request_of(folder, manifest, {"network": moved})
    before = list((networked.place / "runs").iterdir())
    assert "has format 99" in str(hil(*words, "--network", moved).exception)
    assert "no twin" in str(hil(*words, "--network", moved, "--no-twin").exception)
    assert list((networked.place / "runs").iterdir()) == before


def test_a_twin_without_a_network_is_run_by_the_others(tmp_path: Path) -> None:
    (tmp_path / "load.csv").write_text(LOAD, encoding="utf-8")
    done = hil(
        "run",
        tmp_path / "load.csv",
        "--virtual",
        "--lockstep",
        "--twin",
        PROFILES / "twins/loop_six.toml",
        "--runs",
        tmp_path / "runs",
        "--check-only",
    )
    assert done.exit_code == 0, done.output
    assert "hiera_unet is left out: " in done.output


@network_here
def test_lockstep_with_the_network_is_the_same_every_time(networked: Networked) -> None:
    """By the shipped card, and by a copy of it."""
    done = hil(*run_words(networked.place), "--json")
    assert done.exit_code == 0, done.output
    seen = []
    for folder in (networked.folder, RunFolder(Path(json.loads(done.stdout)["folder"]))):
        reader = JournalReader(folder.journal)
        twins = {name: reader.twin_outputs(name).values for name in reader.header.twin_names}
        rows = [(r.calibrator, r.end_s, r.document) for r in reader.calibrations()]
        bands = [(r.twin, r.start_s, r.document) for r in reader.bands()]
        proposals = [(r.time_s, r.document) for r in reader.proposals()]
        reader.close()
        assert "Parameters accepted by the network" in folder.report.read_text(encoding="utf-8")
        order = {name: k for k, name in enumerate(twins)}
        seen.append(
            (twins, sorted(rows, key=lambda r: (order[r[0]], r[1])), sorted(bands, key=lambda r: r[:2]), proposals)
        )
    (one, *rest), (other, *same) = seen
    assert list(one) == ["static", "pso", "least_squares", "hiera_unet"]
    assert all(np.array_equal(one[name], other[name]) for name in one)
    assert rest == same and len(seen[0][3]) == 4


@network_here
async def test_a_network_that_hangs_holds_up_neither_the_engine_nor_the_fits(record: Path, tmp_path: Path) -> None:
    data = read_record(record)
    columns = tuple(data.columns)
    header = Header(
        signals=tuple(Signal(name, "1") for name in columns),
        twin_sensors=dict(load(LOOP).sensor_columns),
        twin_names=("static", "least_squares", "hiera_unet"),
        profile="p",
        duration_s=1300.0,
        period_s=1.0,
        noise_K={},
    )
    tracking = Tracking(TrackingConfig(LOOP, columns, ("least_squares", "hiera_unet")), wait=False)
    await tracking.start()
    journal = JournalWriter(tmp_path / "journal.sqlite", header)
    reader = JournalReader(tmp_path / "journal.sqlite")
    tracking.attach(journal)
    table = np.column_stack([data.columns[name] for name in columns])
    _, network = tracking.processes
    os.kill(network, signal.SIGSTOP)
    longest = 0.0
    for first in range(0, 1300, 10):
        began = time.monotonic()
        rows = range(first, first + 10)
        await tracking.publish(list(rows), data.time_s[first : first + 10].tolist(), table[first : first + 10].tolist())
        longest = max(longest, time.monotonic() - began)
        await asyncio.sleep(0.001)
    deadline = time.monotonic() + 30.0
    while len(reader.twin_outputs("least_squares").tick) < 1300 and time.monotonic() < deadline:
        await asyncio.sleep(0.05)
        journal.commit()
    assert len(reader.twin_outputs("least_squares").tick) == 1300 and len(reader.calibrations()) == 2
    assert not len(reader.twin_outputs("hiera_unet").tick) and longest < 0.2
    os.kill(network, signal.SIGCONT)
    compared = await tracking.finish()
    journal.commit()
    assert compared is not None and list(compared.bands) == ["static", "least_squares", "hiera_unet"]
    assert len(reader.twin_outputs("hiera_unet").tick) == 1300 and len(reader.proposals()) == 4
    reader.close()
    journal.close()


def test_a_band_is_foretold_and_counted_however_the_stream_is_cut() -> None:
    rng = np.random.default_rng(0)
    n = int(6 * SPAN_S)
    time_s = np.arange(n, dtype=np.float64)
    measured = 0.05 * rng.standard_normal((n, 1))
    measured[:700] = np.nan
    whole, parts = Bands(("T",)), Bands(("T",))
    found = whole.push(time_s, measured, {"pso": np.zeros((n, 1))})
    cut = [
        parts.push(time_s[i : i + 77], measured[i : i + 77], {"pso": np.zeros((77, 1))[: n - i]})
        for i in range(0, n, 77)
    ]
    assert found == tuple(band for bands in cut for band in bands)
    halves = [band.half_width_K["T"] for band in found]
    assert halves[:2] == [None, None] and found[0].mean_K["T"] is None
    assert all(abs((half or 0.0) - 1.645 * 0.05) < 0.01 for half in halves[2:])
    half, inside = whole.table()["pso"]["T"]
    assert abs(inside - 0.9) < 0.03 and abs(half - 0.082) < 0.01


def test_a_run_that_ends_before_its_first_window_has_no_parameters_to_show() -> None:
    from hil.tracking.twins import Twins

    twins = Twins(TrackingConfig(LOOP, (), ("least_squares",)))
    columns = {column: np.full(60, spec.nominal) for column, spec in twins.network.inputs.items()}
    columns |= {column: np.full(60, 22.0) for names in twins.network.sensor_columns.values() for column in names}
    twins.push(np.arange(60.0), columns)
    assert twins.comparison().parameters == {}
