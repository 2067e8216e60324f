"""Public records: read without surprises; figures as published, or the shortfall stated."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from hil.bench.records import RecordsResult, run
from hil.public_records import PIPE_TESTS, PublicRecordError, dry_cooler, heated_pipe, held_steady, tclab

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


def test_own_heater_fits(result: RecordsResult) -> None:
    figure = "sum |error|, K"
    pinned = f"{figure}, fitted from the first reading"

    def share(part: str, which: str) -> float:
        row = result.error(f"tclab mimo_{part}", which)
        assert row.published is not None and row.fitted is not None
        return row.fitted / row.published

    assert share("train", pinned) < 1.001
    # Measured shortfall: 3 % above the published sum on the validation record. Commissioning, which estimates the
    # initial state that the score takes from the first reading, ends 2 % above on the one and 12 % on the other.
    assert share("validation", pinned) < 1.04
    assert share("train", figure) < 1.03
    assert share("validation", figure) < 1.14


def test_pipe_from_geometry_is_right_to_half_a_kelvin(result: RecordsResult) -> None:
    for test in PIPE_TESTS:
        row = result.error(f"heated_pipe {test}", "RMSE, K")
        assert row.unfitted is not None and row.unfitted < 0.6
    for test in PIPE_TESTS[:3]:
        row = result.error(f"heated_pipe {test}", "RMSE, K")
        mixed = result.error(f"heated_pipe {test}", "RMSE as one mixed volume, K")
        assert mixed.unfitted is not None and row.unfitted is not None and row.unfitted < 0.2 * mixed.unfitted


def test_dry_cooler_meets_the_published_figure(result: RecordsResult) -> None:
    row = result.error("dry_cooler dc_exp3", "RMSE, K")
    assert row.published is not None and row.fitted is not None
    assert row.fitted <= row.published
