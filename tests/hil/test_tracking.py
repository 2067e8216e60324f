"""`hil track` where more parameters are tuned than the windows tell."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from hil.cli import group
from hil.record.reader import Record, read_record, write_record
from hil.tracking.twins import OUTDONE, PredictionErrors, TrackingConfig, Twins, disturbance, window_kind
from twin.kernel import simulate
from twin.twinfile import load

NODES = ("plate", "radiator", "tank")
TUNED = (
    "plate.capacitance",
    "radiator.capacitance",
    "tank.capacitance",
    "plate_radiator.resistance",
    "radiator_tank.resistance",
    "plate_loss.hA",
    "radiator_loss.hA",
    "tank_loss.hA",
    "heat.factor",
)
START = np.array([45.0, 38.0, 34.0])


def between(value: float, low: float, high: float) -> str:
    return f'{{ value = {value}, lower = {low}, upper = {high}, status = "tunable" }}'


def small_twin(window_s: float, tuned: tuple[str, ...]) -> str:
    """Three masses in a row, heated at one end."""
    text = 'format = 1\nname = "small"\n[inputs]\nheater_power_W = { nominal = 100.0 }\n'
    text += "T_ambient_C = { nominal = 20.0 }\n"
    for node, capacity, loss in zip(NODES, (250.0, 400.0, 1100.0), (0.3, 3.0, 0.8), strict=True):
        text += f'[elements.{node}]\nkind = "node"\ncapacitance = {between(capacity, 50.0, 5000.0)}\n'
        text += f'[elements.{node}_loss]\nkind = "ambient_loss"\nnode = "{node}"\nhA = {between(loss, 0.01, 30.0)}\n'
        text += f'[elements.T_{node}_C]\nkind = "sensor"\nnode = "{node}"\ncolumns = ["T_{node}_C"]\n'
    for one, other in zip(NODES, NODES[1:], strict=False):
        text += f'[elements.{one}_{other}]\nkind = "conduction"\nfrom = "{one}"\nto = "{other}"\n'
        text += f"resistance = {between(0.05, 0.005, 1.0)}\n"
    text += '[elements.heat]\nkind = "heat_source"\nnode = "plate"\ndriver = "heater_power_W"\nlaw = "proportional"\n'
    text += f"factor = {between(1.0, 0.2, 2.0)}\n[windows]\nwindow_s = {window_s}\nfirst_s = 15.0\n"
    text += f"calibrated_K = 0.3\nlarge_K = 1.0\n[sets.commission]\nmembers = {json.dumps(tuned)}\n"
    return text


def made(folder: Path, window_s: float, tuned: tuple[str, ...] = TUNED, extra_W: float = 0.0) -> tuple[Path, Path]:
    """Twin file and record of the rig that it describes; from 600 s on `extra_W` that it does not know of."""
    twin, path = folder / "small.toml", folder / "record.parquet"
    twin.write_text(small_twin(window_s, tuned), encoding="utf-8")
    network, time_s = load(twin), np.arange(1201.0)
    power = np.array([100.0, 900.0, 300.0, 1000.0, 50.0, 700.0, 400.0])[(time_s // 180).astype(int)]
    inputs = np.column_stack([power, np.full(len(time_s), 20.0)])
    real = inputs + np.column_stack([np.where(time_s >= 600.0, extra_W, 0.0), np.zeros(len(time_s))])
    clean = simulate(network, time_s, real, START)
    noisy = clean + 0.05 * np.random.default_rng(0).standard_normal(clean.shape)
    columns = dict(zip(network.input_columns, inputs.T, strict=True))
    write_record(Record(time_s, columns | dict(zip((f"T_{n}_C" for n in NODES), noisy.T, strict=True))), path)
    return twin, path


def track(twin: Path, record: Path, *more: str) -> str:
    done = CliRunner().invoke(group, ["track", str(record), "--twin", str(twin), *more])
    assert done.exit_code == 0, done.output
    return str(done.stdout)


def told(twin: Path, record: Path) -> dict[str, Any]:
    found = json.loads(track(twin, record, "--json"))
    assert isinstance(found, dict)
    return found


def test_too_many_parameters_on_short_windows_are_said_in_place_of_heat(tmp_path: Path) -> None:
    files = made(tmp_path, 120.0)
    found, printed = told(*files), track(*files)
    assert "pso" in found["outdone"] and found["windows"]["pso"][OUTDONE] >= 2
    assert not [d for d in found["disturbed"] if d["calibrator"] in found["outdone"]]
    sentence = found["outdone"]["pso"]
    assert sentence in printed and "that the twin does not model" not in printed
    assert "the commissioned twin predicts better than pso: over the same 10 windows its error is 1" in sentence
    assert (
        "windows of 120 s probably do not identify the 9 parameters that pso tunes ([sets.commission] of the"
        in sentence
    )
    assert "remove some from [sets.commission], or set window_s under [windows] of the twin file to more" in sentence
    assert f"{OUTDONE} where the twin ahead was within 0.3 K" in printed
    assert "tuned by pso, least_squares: 9 parameters ([sets.commission] of the twin file) on windows of" in printed


@pytest.mark.parametrize(("window_s", "tuned"), [(400.0, TUNED), (120.0, ("heat.factor",))])
def test_either_remedy_helps(tmp_path: Path, window_s: float, tuned: tuple[str, ...]) -> None:
    found = told(*made(tmp_path, window_s, tuned))
    assert found["outdone"] == {} and found["disturbed"] == []
    assert all(set(counts) == {"calibrated"} for counts in found["windows"].values())


def test_heat_that_is_there_is_still_said(tmp_path: Path) -> None:
    found = told(*made(tmp_path, 300.0, ("tank_loss.hA",), extra_W=60.0))
    assert found["outdone"] == {}
    assert found["disturbed"][0]["found"].startswith("plate gives off")


def test_what_is_outdone_does_not_depend_on_the_cut(tmp_path: Path) -> None:
    twin, path = made(tmp_path, 120.0)
    data = read_record(path)

    def flags(rows: int) -> list[bool]:
        twins = Twins(TrackingConfig(twin, tuple(data.columns), ("least_squares",)))
        blocks = [block for _, block in twins.over(data.time_s, data.columns, rows)]
        return [done.document["outdone"] for block in blocks for done in block.calibrations]

    assert flags(7) == flags(1201) and any(flags(1201))


def test_a_calibrator_is_outdone_in_a_window_and_on_the_whole() -> None:
    healthy, fooled_once, no_good, both_wrong = (PredictionErrors() for _ in range(4))
    assert [healthy.add(1.0, tracked) for tracked in (1.0, 1.3, 1.4, 1.1)] == [False] * 4
    assert [no_good.add(1.0, tracked) for tracked in (1.0, 4.0, 1.1, 5.0)] == [False, True, False, True]
    assert no_good.outdone and no_good.whole == pytest.approx((1.0, np.sqrt((1 + 16 + 1.21 + 25) / 4)))
    for static, tracked in ((1.0, 1.0), (9.0, 9.0), (1.5, 9.0), (1.0, 1.2), (1.0, 1.1)):
        fooled_once.add(static, tracked)
    assert not fooled_once.outdone
    assert [both_wrong.add(20.0, 24.0) for _ in range(3)] == [False] * 3
    assert not PredictionErrors().outdone


def test_an_outdone_window_is_no_calibrated_one_and_says_nothing_of_heat() -> None:
    document = {"kind": "calibrated", "disturbed": "tank", "disturbed_W": 44.0, "disturbed_interval90_W": (32.0, 57.0)}
    assert disturbance(document) == "tank gives off 44 W (32 to 57) that the twin does not model"
    assert window_kind(document) == "calibrated" and window_kind(document | {"outdone": True}) == OUTDONE
    assert disturbance(document | {"outdone": True}) is None
    assert disturbance(document | {"flags": ["SHORT_RECORD: why", "a flag"]}) is not None
    assert disturbance(document | {"flags": ["FLAT_RECORD: no thermometer has moved at all"]}) is None
    assert window_kind({"kind": "stall", "outdone": True}) == "stall"
