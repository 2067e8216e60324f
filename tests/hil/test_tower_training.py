"""Training of tower networks: stations of the splits, folders of data, and messages to the user."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.bench.tower_network import read_results, tables_of
from hil.training.tower.ensemble import assemble
from hil.training.tower.evaluate import ensemble_of
from hil.training.tower.generate import MANIFEST, TEST, TRAIN, VALIDATION, DataPlan, digest_of, generate, tables
from hil.training.tower.stations import HEALTHY_DAYS, HIDDEN_SHARE, StationPlan, drawn_site
from hil.training.tower.unpack import unpack
from tests.hil.command_line import typed
from tests.hil.tower.made_ensemble import write_ensemble
from tests.twin.hiera.tower_tables import made_table
from twin.calibrators.hiera_unet.model.config import HieraError
from twin.calibrators.hiera_unet.tower.table import SUBJECT


def manifest(folder: Path, months: float = 8.0, table: str = "", splits: tuple[str, ...] = (TRAIN,)) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    rows = [{"split": s, "site": "F", "seed": k, "months": months, "cells": 2} for k, s in enumerate(splits)]
    document = {"format": 1, "table": table or SUBJECT.digest(), "months": months, "stations": rows, "digest": "0123"}
    (folder / MANIFEST).write_text(json.dumps(document))


def test_no_station_is_in_two_splits_and_a_cut_leaves_some_of_each() -> None:
    stations = DataPlan(train=40, validation=4, test=4).stations()
    names = [one.name for _, one in stations]
    assert len(set(names)) == len(names) == 50
    first = [split for split, _ in stations[2:14]]
    assert {split: first.count(split) for split in (TRAIN, VALIDATION, TEST)} == {TRAIN: 4, VALIDATION: 4, TEST: 4}


def test_sites_of_the_family_differ_and_some_lack_an_effect() -> None:
    drawn = [drawn_site(seed) for seed in range(1, 41)]
    assert len({site.water for site, _ in drawn}) == 40
    assert any(site.pressure < 90.0 for site, _ in drawn) and any(site.pressure > 95.0 for site, _ in drawn)
    hidden = sum(bool(hide) for _, hide in drawn) / len(drawn)
    assert abs(hidden - HIDDEN_SHARE) < 0.25
    assert drawn_site(3) == drawn_site(3)


def test_training_stations_in_parts_hold_their_healthy_record_and_two_months_apart() -> None:
    plan = DataPlan(train=30, validation=2, test=2, parts=True)
    for split, one in plan.stations():
        assert one.parts == (split == TRAIN)
        segments = one.segments()
        if not one.parts:
            assert segments == ()
            continue
        assert segments[0][0] == 0 and segments[0][1] > HEALTHY_DAYS
        assert all(a[1] <= b[0] for a, b in itertools.pairwise(segments))
        assert [b - a for a, b in segments[1:]] == [28, 28] and segments[-1][1] <= round(14 * 30.4375)
    assert len({one.segments() for split, one in plan.stations() if split == TRAIN}) == 30
    assert StationPlan("F", 1, 1.5, 2, True).segments() == ()


def test_trees_of_a_station_did_not_learn_from_it(tmp_path: Path) -> None:
    pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")
    pytest.importorskip("sklearn", reason="scikit-learn is not installed: there are no trees to fit")
    from hil.training.tower.starting import begin, fit_start, load_start
    from twin.calibrators.hiera_unet.tower import load_fleet
    from twin.calibrators.hiera_unet.tower.score import boosted, started, targets_of

    manifest(tmp_path, splits=(TRAIN, TRAIN))
    assert load_start(tmp_path) is None
    for station in range(2):
        for cell in (1, 2):
            one = made_table(f"F{station:04d}_{cell}", seed=2 * station + cell, minutes=8 * 1440)
            moved = np.float32(0.5 * station)
            replace(one, true_water=one.true_water + moved).save(tmp_path / f"{one.name}.npz")
    assert fit_start(tmp_path) is not None
    fleet = load_fleet(tables(tmp_path, TRAIN), "cpu")
    begin(tmp_path, fleet)
    t = targets_of(fleet, fleet.rows)
    own, both = started(fleet, t), boosted(load_start(tmp_path), fleet, fleet.rows)
    first = t.cell < 2
    error = t.true_water - own.water
    # The first station's trees learned from the second alone, whose water is warmer by half a kelvin.
    assert np.nanmean(error[first]) < -0.4 and np.nanmean(error[~first]) > 0.4
    assert np.nanmean(np.abs(t.true_water - both.water)) < 0.3
    manifest(tmp_path, splits=(TRAIN,))
    document = json.loads((tmp_path / MANIFEST).read_text())
    (tmp_path / MANIFEST).write_text(json.dumps({**document, "digest": "other"}))
    assert load_start(tmp_path) is None


def test_tables_are_those_of_the_split_and_the_station(tmp_path: Path) -> None:
    manifest(tmp_path, splits=(TRAIN, VALIDATION, TRAIN))
    assert [p.name for p in tables(tmp_path, VALIDATION)] == ["F0001_1.npz", "F0001_2.npz"]
    assert [p.name for p in tables(tmp_path, TRAIN, "F0002")] == ["F0002_1.npz", "F0002_2.npz"]
    assert digest_of(tmp_path) == "0123"
    with pytest.raises(HieraError, match="no station of the test split"):
        tables(tmp_path, TEST)
    with pytest.raises(HieraError, match=r"has no manifest\.json"):
        tables(tmp_path / "nowhere", TEST)


@pytest.mark.parametrize(
    ("months", "table", "says"), [(3.0, "", "stations of 3 months"), (8.0, "another", "with table another")]
)
def test_a_folder_of_another_plan_is_refused(tmp_path: Path, months: float, table: str, says: str) -> None:
    manifest(tmp_path, months, table)
    with pytest.raises(HieraError, match=says):
        generate(DataPlan(), tmp_path)


def test_a_damaged_manifest_is_named(tmp_path: Path) -> None:
    (tmp_path / MANIFEST).write_text("{")
    with pytest.raises(HieraError, match="cannot be read"):
        tables(tmp_path, TRAIN)


def test_a_station_in_two_splits_is_named(tmp_path: Path) -> None:
    manifest(tmp_path, splits=(TRAIN, TEST))
    document = json.loads((tmp_path / MANIFEST).read_text())
    document["stations"][1]["seed"] = document["stations"][0]["seed"]
    (tmp_path / MANIFEST).write_text(json.dumps(document))
    with pytest.raises(HieraError, match=r"^OVERLAPPING_SPLITS: .* station F0000 is in the train and the test split"):
        tables(tmp_path, TEST)
    with pytest.raises(HieraError, match=r"^OVERLAPPING_SPLITS: 8001 stations of the train split .* at most 8000"):
        DataPlan(train=8001)


def test_the_command_names_a_folder_of_another_plan_in_one_sentence(tmp_path: Path) -> None:
    pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")
    manifest(tmp_path / "data", 3.0)
    done = typed("train", "tower", "--data", str(tmp_path / "data"), "--out", str(tmp_path / "out"))
    assert done.returncode == 2
    assert "stations of 3 months" in done.stderr and "Traceback" not in done.stderr


def test_goals_name_the_gate_and_the_change_against_the_boosted_rival() -> None:
    def one(water: float) -> dict[str, object]:
        deviations = dict.fromkeys(("fill", "air", "uniformity", "bias"), 0.01)
        names = (
            "water_mae_K",
            "water_rmse_K",
            "water_p90_K",
            "water_p99_K",
            "water_mae_after_fan_change_K",
            "reading_mae_K",
        )
        worse = dict.fromkeys(("water", "water_after_fan_change", *deviations), (-0.2, -0.3, -0.1))
        return {"windows": 5, "deviation_mae": deviations, "worse_than_rival": worse, **dict.fromkeys(names, water)}

    scores = {"the same, boosted": one(0.1), "network, ensemble": one(0.08)}
    codes = {"refused": {"small_0": "BLIND", "small_1": ""}, "refused_outputs": {"small_1": "BLIND"}}
    found = {t.key: t for t in tables_of({"scores": {"all": scores}, **codes})}
    goals = {str(row[0]): row[-1] for row in found["goals"].rows}
    assert goals["outlet"] == "yes" and goals["outlet, 30 min after a fan change"] == "no"
    assert goals["small_0: gate, parameters"] == "no: BLIND" and goals["small_1: gate, parameters"] == "yes"
    assert goals["small_1: gate, outputs"] == "no: BLIND"
    assert [row[0] for row in found["outlet_all"].rows] == list(scores)


def test_the_command_trains_in_parts_and_refuses_a_blind_member(tmp_path: Path) -> None:
    pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")
    pytest.importorskip("safetensors", reason="safetensors is not installed: trained networks cannot be read")
    data, out = tmp_path / "data", tmp_path / "out"
    data.mkdir()
    for split, station in DataPlan(train=1, validation=1, test=1, months=8.0).stations():
        (data / f"{station.name}.done").write_text("{}\n")
        for cell in range(1, station.cells + 1) if split != TEST else ():
            made_table(f"{station.name}_{cell}", seed=cell).save(data / f"{station.name}_{cell}.npz")
    for station in ("F8002", "F8003", "F9002", "F9003"):
        (data / f"{station}.done").write_text("{}\n")
    for station in ("F8002", "F8003"):
        for cell in (1, 2):
            made_table(f"{station}_{cell}", seed=cell + 2).save(data / f"{station}_{cell}.npz")
    words = ("train", "tower", "--data", data, "--out", out, "--stations", "1", "--steps", "2", "--batch", "2")
    words = (*words, "--threads", "1")
    cut = typed(*words, "--minutes", "0")
    assert cut.returncode == 0 and "0 of 2 steps: give the same command again" in cut.stdout
    done = typed(*words)
    assert done.returncode == 1 and "BLIND" in done.stdout and "Traceback" not in done.stderr
    card = json.loads((out / "tower_small_0.json").read_text())
    assert card["refused"] == "BLIND" and card["steps_done"] == 2 and card["command"].startswith("hil train tower")
    unpacked = tmp_path / "shipped"
    results = {"cards": {"small_0": card}}
    (out / "results.json").write_text(json.dumps(results))
    assert {p.suffix for p in unpack(out, unpacked)} >= {".safetensors", ".json"}
    (out / "tower_small_0.safetensors").write_bytes(b"other weights")
    with pytest.raises(HieraError, match="is not the file that its card"):
        unpack(out, unpacked)


def test_members_of_one_folder_and_data_become_an_ensemble(tmp_path: Path) -> None:
    pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")
    pytest.importorskip("safetensors", reason="safetensors is not installed: trained networks cannot be read")
    from twin.calibrators.hiera_unet.tower import load_tower_ensemble

    manifest(tmp_path / "data", splits=(VALIDATION,))
    for cell in (1, 2):
        made_table(f"F0000_{cell}", seed=cell).save(tmp_path / "data" / f"F0000_{cell}.npz")
    write_ensemble(tmp_path / "out", count=3)
    stem = tmp_path / "out" / "tower_made"
    assert assemble(tmp_path / "data", stem, most=4) is None
    for seed, data in enumerate(("0123", "0123", "4567")):
        path = stem.with_name(f"tower_made_{seed}.json")
        path.write_text(json.dumps({**json.loads(path.read_text()), "data": data}))
    card = assemble(tmp_path / "data", stem, most=4)
    assert card == stem.with_suffix(".json")
    document = json.loads(card.read_text())
    assert list(document["members"]) == ["tower_made_0.safetensors", "tower_made_1.safetensors"]
    assert document["left_out"] == {"tower_made_2.safetensors": "trained on other data"}
    assert document["windows"] == 4 and document["data"] == "0123"
    assert len(load_tower_ensemble(card).members) == 2


@pytest.mark.parametrize("text", ["{", "[]", '{"cards": {}}', '{"evaluation": null}', '{"evaluation": {"scores": {}}}'])
def test_a_file_without_scores_is_named_with_what_to_give(tmp_path: Path, text: str) -> None:
    path = tmp_path / "results.json"
    path.write_text(text)
    with pytest.raises(HieraError, match=r"results\.json: holds no scores of a training .* give its results\.json"):
        read_results(path)


def test_a_folder_without_results_is_not_unpacked(tmp_path: Path) -> None:
    with pytest.raises(HieraError, match="cannot be read as results of a training"):
        unpack(tmp_path, tmp_path / "shipped")
    assert not (tmp_path / "shipped").exists()


def test_members_whose_weights_did_not_come_back_are_left_out(tmp_path: Path) -> None:
    (tmp_path / "results.json").write_text(json.dumps({"cards": {"full_0": {"weights": {"sha256": ""}}}}))
    assert unpack(tmp_path, tmp_path / "shipped") == []


def test_the_bench_names_a_file_without_scores_in_one_sentence(tmp_path: Path) -> None:
    pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")
    (tmp_path / "results.json").write_text("{}")
    done = typed("bench", "tower", str(tmp_path), "--results", str(tmp_path / "results.json"))
    assert done.returncode == 2
    assert "holds no scores of a training" in done.stderr and "Traceback" not in done.stderr


def test_the_ensemble_leaves_out_a_refused_member_unless_all_are() -> None:
    assert ensemble_of({"small_0": "", "small_1": "BLIND", "full_0": ""}) == ["small_0"]
    assert ensemble_of({"small_0": "BLIND", "small_1": "BLIND"}) == ["small_0", "small_1"]
    assert ensemble_of({"full_0": ""}) == []


def test_the_page_compares_the_ensemble_with_gauss_newton_cell_by_cell_and_with_intervals() -> None:
    deviations = dict.fromkeys(("fill", "air", "uniformity", "bias"), 0.01)
    names = ("rmse_K", "p90_K", "p99_K", "mae_after_fan_change_K", "mae_K")
    one = {f"water_{n}": 0.1 for n in names} | {"windows": 5, "reading_mae_K": 0.1, "deviation_mae": deviations}
    worse = dict.fromkeys(("water", "water_after_fan_change", *deviations), (0.14, 0.07, 0.21))
    worse["air"] = (-0.4, -0.5, -0.3)
    branch = {"water_mae_K": 0.1, "deviation_mae": deviations, "worse_than_rival": worse}
    scores = {"Gauss-Newton with discrepancy": one, "network, ensemble": one | {"worse_than_rival": worse}}
    document = {
        "scores": {"all": scores},
        "refused": {"small_0": "", "small_1": "BLIND"},
        "ensemble": ["small_0"],
        "by_cell": {"B9001_1": {"Gauss-Newton with discrepancy": 0.05, "network, ensemble": 0.07, "small_0": 0.08}},
        "causal": branch,
        "symmetric": branch,
        "quarter_lost": branch,
    }
    found = {t.key: t for t in tables_of(document)}
    assert found["cells"].rows == (("B9001_1", 0.05, 0.07),)
    against = dict(zip(found["against"].columns, found["against"].rows[0], strict=True))
    assert against["outlet"] == "+0.14 (+0.07 to +0.21)" and against["air"] == "-0.40 (-0.50 to -0.30)"
    assert found["goals"].notes[0] == "the ensemble is the mean of small_0"
