"""Public records: read without surprises; figures as published, or the shortfall stated."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from hil.bench.experiments.public_records import RecordsResult, run
from hil.record.public import PIPE_TESTS, PublicRecordError, dry_cooler, heated_pipe, held_steady, tclab

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def data() -> Path:
    folder = Path(os.environ.get("HIL_DATA", ROOT.parent / "shared" / "data"))
    if not (folder / "real").is_dir():
        pytest.skip(f"no public records at {folder}; set HIL_DATA to the folder that holds 'real'")
    return folder


@pytest.fixture(scope="module")
def result(data: Path) -> RecordsResult:
    return run(data)


def test_heater_values_act_before_their_row(data: Path) -> None:
    record = tclab(data / "real", "mimo_train")
    # the file switches heater 1 to 80 % in its row of 10 s
    assert record.columns["heater_1_pct"][8] == 0.0
    assert record.columns["heater_1_pct"][9] == 80.0
    assert record.time_s[9] == 9.0
    assert "not measured" in record.messages[0]


def test_dead_channel_is_left_out_and_told(data: Path) -> None:
    record = heated_pipe(data / "real", "ulg_151202")
    assert np.isnan(record.columns["T_pipe_out_C"]).all()
    assert any("T_pipe_out_C" in m and "dead channel" in m for m in record.messages)
    for test in PIPE_TESTS:
        others = heated_pipe(data / "real", test)
        assert np.isfinite(others.columns["T_water_out_C"]).all()
        assert ("dead channel" in " ".join(others.messages)) == (test == "ulg_151202")


def test_steady_states_as_a_record(data: Path) -> None:
    states = dry_cooler(data / "real", "dc_exp1")
    record = held_steady(states, ("T_out_C",))
    assert np.isfinite(record.columns["T_out_C"]).sum() == states.time_s.size == 27
    measured = np.flatnonzero(np.isfinite(record.columns["T_out_C"]))
    for name in ("T_in_C", "fan_speed_pct"):
        assert record.columns[name][measured] == pytest.approx(states.columns[name])
        assert record.columns[name][measured - 1] == pytest.approx(states.columns[name])


def test_absent_and_foreign_files_are_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(PublicRecordError, match="HIL_DATA"):
        tclab(tmp_path, "mimo_train")
    folder = tmp_path / "tclab"
    folder.mkdir()
    (folder / "mimo_train.csv").write_text("Time,H1\n0,1\n1,2\n")
    with pytest.raises(PublicRecordError, match="lacks H2, T1, T2"):
        tclab(tmp_path, "mimo_train")


def test_published_heater_model_is_reproduced(result: RecordsResult) -> None:
    as_source = "sum |error|, K, integrated as the source does"
    assert result.error("tclab mimo_train", as_source).unfitted == pytest.approx(270.26, rel=1e-3)
    assert result.error("tclab mimo_validation", as_source).unfitted == pytest.approx(840.95, rel=1e-3)


def test_own_heater_fit(result: RecordsResult) -> None:
    train, validation = (result.error(f"tclab mimo_{part}", "sum |error|, K") for part in ("train", "validation"))
    assert train.published and train.fitted and validation.published and validation.fitted
    assert train.fitted < train.published
    # Measured shortfall: 15 % above the published sum on the validation record. The training record cannot tell the
    # published values from ours: they lie inside every interval, and their sum inside the fit's own uncertainty.
    assert validation.fitted < 1.16 * validation.published
    low, high = (float(x) for x in validation.note.rsplit(": ", 1)[1].split(" to "))
    assert low < validation.published < high
    for value in result.parameters:
        if value.parameter.startswith("tclab"):
            assert value.low90 < value.before < value.high90


def test_pipe_from_geometry_is_right_to_half_a_kelvin(result: RecordsResult) -> None:
    better = 0
    for test in PIPE_TESTS:
        row, known = (result.error(f"heated_pipe {test}", f) for f in ("RMSE, K", "RMSE after the first transit, K"))
        mixed = result.error(f"heated_pipe {test}", "RMSE as one mixed volume, K")
        assert mixed.unfitted and row.unfitted and row.fitted and known.fitted and known.unfitted
        assert row.unfitted < 0.6
        assert row.unfitted < 0.55 * mixed.unfitted
        assert row.fitted < 0.7
        better += row.fitted < row.unfitted and known.fitted < known.unfitted
    # Fitted on the first test alone. Measured shortfall: on ulg_151202 the geometry alone does better.
    assert better >= 3


def test_dry_cooler_meets_the_published_figure(result: RecordsResult) -> None:
    row = result.error("dry_cooler dc_exp3", "RMSE, K")
    assert row.published is not None and row.fitted is not None
    assert row.fitted <= row.published
