"""A network beside Gauss-Newton in `hil tower calibrate`: table, records, queue, revisions, report, and bad input."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")
pytest.importorskip("safetensors", reason="safetensors is not installed: trained networks cannot be read")

from hil.review import write_tower_review
from tests.hil.reference_pages import page
from tests.hil.tower.made_ensemble import write_ensemble
from tests.hil.tower.made_plant import SHEET, files, iso, refused, run, write_points, write_record
from tests.twin.tower.made_cell import START_S

FULL_SHEET = {
    **SHEET,
    "design": {**SHEET["design"], "water_outlet_C": 28.0},  # type: ignore[dict-item]
    "fan": {"rated_power_kW": 45.0, "power_at_design_kW": 41.0, "speed_100pct": "50 Hz"},
    "fill": {"length_m": 9.0, "width_m": 8.0, "height_m": 1.5},
}
HEALTHY_D, DAYS = 2, 5
KEY = re.compile(r"`(\w+)`")
NAMES = ("fill", "air", "uniformity", "bias")


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a record that begins healthy, labels, ensembles, and a twin that knows its healthy record."""
    root = tmp_path_factory.mktemp("plant")
    write_record(root / "record", days=DAYS, fill=(1.0, 0.97), air=1.0, bias=0.1, test_days=(1, 3))
    notes = json.loads((root / "record" / "station.json").read_text())
    (root / "record" / "station.json").write_text(json.dumps({**notes, "datasheet": FULL_SHEET}))
    (root / "datasheet.json").write_text(json.dumps(FULL_SHEET))
    write_points(root / "points.csv")
    certificate = f"{iso(START_S + 3.5 * 86400)},1,bias,point,0.1,0.05,,,certificate"
    (root / "labels.csv").write_text(f"time,cell,parameter,kind,value,sd,lo,hi,source\n{certificate}\n")
    span = f"{iso(START_S)}..{iso(START_S + HEALTHY_D * 86400)}"
    words = ("commission", root / "record", "--cell", 1, *files(root), "--out", root / "cell1.toml", "--healthy", span)
    done = run(*words)
    assert done.exit_code == 0, done.output + repr(done.exception)
    write_ensemble(root / "network")
    write_ensemble(root / "blind", blind=(1,))
    return root


def calibrate(plant: Path, out: Path, *words: Any, twin: Path | None = None, record: str = "record") -> Any:
    options = ("--twin", twin or plant / "cell1.toml", "--labels", plant / "labels.csv", "--out", out)
    return run("calibrate", plant / record, *options, *words)


def card(plant: Path, folder: str = "network") -> Path:
    return plant / folder / "tower_made"


@pytest.fixture(scope="module")
def out(plant: Path) -> Path:
    done = calibrate(plant, plant / "out", "--network", card(plant), "--network-mode", "advisory")
    assert done.exit_code == 0, done.output + repr(done.exception)
    assert "Gauss-Newton" in done.output and "network" in done.output
    return plant / "out"


def test_the_network_has_a_table_of_its_own_with_intervals_from_the_end_of_the_healthy_record(out: Path) -> None:
    table, beside = pq.read_table(out / "network.parquet"), pq.read_table(out / "calibrated.parquet")
    assert table.schema.names == [n for n in beside.schema.names if n != "t_out_measured"]
    got = {n: table[n].to_numpy() for n in table.schema.names}
    days = (got["time"].astype("datetime64[s]").astype(float) - START_S) / 86400.0
    known = np.isfinite(got["t_out"])
    assert not known[days < HEALTHY_D].any() and known[days > HEALTHY_D].mean() > 0.9
    for name in ("t_out", *NAMES):
        low, high = got[f"{name}_lo"][known], got[f"{name}_hi"][known]
        assert ((low < got[name][known]) & (got[name][known] < high)).all()
    # An untrained member says what recursive Gauss-Newton believes, so it lies near the smoother.
    assert np.abs(got["t_out"] - beside["t_out"].to_numpy())[known].mean() < 0.2
    assert np.abs(got["fill"][known] - 0.98).max() < 0.06


def test_records_of_the_network_form_a_chain_of_their_own_of_five_minutes(out: Path) -> None:
    lines = [json.loads(line) for line in (out / "network_records.jsonl").read_text().splitlines()]
    assert len(lines) == (DAYS - HEALTHY_D) * 288
    described = {key for row in page("tower-record").rows["Keys of a record"] for key in KEY.findall(row["Key"])}
    assert set(lines[0]) == described
    assert {line["m"] for line in lines} == {"advisory"} and lines[0]["p"] == ""
    assert {line["m"] for line in map(json.loads, (out / "records.jsonl").read_text().splitlines())} == {"shadow"}


def test_the_review_queue_holds_the_network_s_proposals_with_codes_and_attention(out: Path) -> None:
    entries = json.loads((out / "review_queue.json").read_text())["proposals"]
    assert {e["parameter"] for e in entries} == set(NAMES)
    for entry in entries:
        assert entry["calibrator"] == "hiera_unet" and entry["accepted"] == (not entry["codes"])
        assert sum(entry["attention"]["hydraulic"]) == pytest.approx(1.0, abs=0.01)


def test_the_report_shows_the_network_beside_gauss_newton_and_names_its_branch(out: Path) -> None:
    text = run("report", out).output
    assert "| 1 | Gauss-Newton |" in text and "| 1 | network |" in text
    assert "symmetric branch" in text and "mean of 2 members" in text
    done = run("report", out, "--picture", out / "cell.svg")
    assert done.exit_code == 0 and "network" in (out / "cell.svg").read_text()


def test_the_review_has_the_network_s_curves(out: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun is not installed: there is no review")
    sizes = []
    for network in (None, out / "network.parquet"):
        write_tower_review(out / "calibrated.parquet", tmp_path / "review.rrd", "out", network)
        sizes.append((tmp_path / "review.rrd").read_bytes().count(b"/tower/cell1/network/fill"))
    assert sizes[0] == 0 < sizes[1]


def test_a_changed_line_of_the_network_s_records_is_reported(out: Path, tmp_path: Path) -> None:
    copy = tmp_path / "out"
    shutil.copytree(out, copy)
    path = copy / "network_records.jsonl"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:40], lines[40].replace('"c":1', '"c":1 '), *lines[41:]]) + "\n")
    assert "network_records.jsonl:42" in refused(run("report", copy))


def test_the_controlled_mode_saves_the_network_s_accepted_deviations_as_a_revision(plant: Path, tmp_path: Path) -> None:
    for path in plant.glob("*.healthy.json"):
        shutil.copy(path, tmp_path)
    twin = Path(shutil.copy(plant / "cell1.toml", tmp_path))
    done = calibrate(plant, tmp_path / "out", "--network", card(plant), "--network-mode", "controlled", twin=twin)
    assert done.exit_code == 0, done.output + repr(done.exception)
    assert "--network-mode controlled" in (tmp_path / "cell1.r1.toml").read_text()
    says = refused(calibrate(plant, tmp_path / "out", twin=twin))
    assert "its network mode is controlled, not shadow; it has network ensemble; give another --out" in says
    again = calibrate(plant, tmp_path / "out", "--replace", twin=twin)
    assert again.exit_code == 0 and not (tmp_path / "out" / "network.parquet").exists()


def test_a_blind_ensemble_only_runs_in_shadow_where_nothing_of_it_is_accepted(plant: Path, tmp_path: Path) -> None:
    for mode in ("advisory", "controlled"):
        said = refused(calibrate(plant, tmp_path / "out", "--network", card(plant, "blind"), "--network-mode", mode))
        assert said.startswith("BLIND: ") and "hardly worse with another window's channels" in said
        assert not (tmp_path / "out").exists()
    done = calibrate(plant, tmp_path / "out", "--network", card(plant, "blind"))
    assert done.exit_code == 0 and "BLIND" in done.output
    lines = (tmp_path / "out" / "network_records.jsonl").read_text().splitlines()
    assert all("BLIND" in json.loads(line)["f"] for line in lines)
    assert "BLIND" in run("report", tmp_path / "out").output


def test_an_outlet_of_the_start_is_named_by_the_command_the_table_and_the_report(plant: Path, tmp_path: Path) -> None:
    write_ensemble(tmp_path / "network", blind_outputs=(0, 1))
    done = calibrate(
        plant, tmp_path / "out", "--network", tmp_path / "network" / "tower_made", "--network-mode", "advisory"
    )
    assert done.exit_code == 0, done.output + repr(done.exception)
    said = "the outlet is that of the start (Gauss-Newton); only the parameters are the network's"
    assert f"network: {said}" in " ".join(done.output.split())
    assert said in " ".join(run("report", tmp_path / "out").output.split())
    about = pq.read_schema(tmp_path / "out" / "network.parquet").metadata[b"hil.network"]
    assert json.loads(about)["outlet"] == said


def test_both_calibrators_cannot_revise_one_twin(plant: Path, tmp_path: Path) -> None:
    words = ("--network", card(plant), "--network-mode", "controlled", "--mode", "controlled")
    assert "would both revise the twins" in refused(calibrate(plant, tmp_path / "out", *words))
    assert "needs a network" in refused(calibrate(plant, tmp_path / "out", "--network-mode", "advisory"))


def test_a_twin_without_a_healthy_record_is_refused(plant: Path, tmp_path: Path) -> None:
    twin = Path(shutil.copy(plant / "cell1.toml", tmp_path))
    said = refused(calibrate(plant, tmp_path / "out", "--network", card(plant), twin=twin))
    assert said.startswith("NO_HEALTHY_RECORD: ") and "--healthy FROM..TO" in said
    assert not (tmp_path / "out").exists()


def test_a_datasheet_without_the_numbers_that_scale_the_channels_is_refused(plant: Path, tmp_path: Path) -> None:
    shutil.copytree(plant / "record", tmp_path / "record")
    notes = json.loads((tmp_path / "record" / "station.json").read_text())
    notes["datasheet"] = {**FULL_SHEET, "fill": {"length_m": 9.0}}
    (tmp_path / "record" / "station.json").write_text(json.dumps(notes))
    for path in (*plant.glob("*.healthy.json"), plant / "cell1.toml", plant / "labels.csv"):
        shutil.copy(path, tmp_path)
    said = refused(calibrate(tmp_path, tmp_path / "out", "--network", card(plant)))
    assert "fill.width_m, fill.height_m" in said and "add it to the datasheet" in said


@pytest.mark.parametrize(("days", "code"), [(2.5, "SHORT_RECORD"), (1.5, "NO_HEALTHY_RECORD")])
def test_a_record_that_is_too_short_for_the_network_is_refused(
    plant: Path, tmp_path: Path, days: float, code: str
) -> None:
    (tmp_path / "record").mkdir()
    shutil.copy(plant / "record" / "station.json", tmp_path / "record")
    whole = pq.read_table(plant / "record" / "cell1.parquet")
    pq.write_table(whole.slice(0, int(days * 1440)), tmp_path / "record" / "cell1.parquet")
    for path in (*plant.glob("*.healthy.json"), plant / "cell1.toml", plant / "labels.csv"):
        shutil.copy(path, tmp_path)
    said = refused(calibrate(tmp_path, tmp_path / "out", "--network", card(plant)))
    assert said.startswith(f"{code}: ")
