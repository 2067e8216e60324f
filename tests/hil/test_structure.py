"""The shipped networks on healthy rigs that this project did not write. Skipped where the data are absent."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from hil.bench.experiments import structure
from hil.bench.experiments.structure import TEMPLATES, healthy_rigs, judge

ROOT = Path(__file__).resolve().parents[2]


def test_ten_volumes_stay_near_the_noise_where_four_do_not() -> None:
    rigs = healthy_rigs(Path(os.environ.get("HIL_DATA", ROOT.parent / "shared" / "data")) / "stranger")
    if not rigs:
        pytest.skip("no stranger rigs; set HIL_DATA to the folder that holds 'stranger'")
    four, ten = (judge(rigs[0], name, ROOT / "profiles" / "twins" / file, seed=0) for name, file in TEMPLATES.items())
    noise = ten.noise / np.sqrt(structure.MEAN_S)
    assert (ten.held_out_10s < 1.3 * noise).all()
    assert (ten.campaign_10s < 1.6 * noise).all()
    assert ten.campaign_10s.max() < 0.5 * four.campaign_10s.max()


def test_means_leave_missing_readings_out() -> None:
    time_s = np.arange(20.0)
    residual = np.repeat([[1.0], [3.0]], 10, axis=0)
    residual[3:9] = np.nan
    assert structure._rmse_of_means(time_s, residual) == pytest.approx(np.sqrt(5.0))
    residual[:10] = np.nan
    assert structure._rmse_of_means(time_s, residual) == pytest.approx(3.0)


def test_no_rigs_is_a_line(tmp_path: Path) -> None:
    tables, skipped = structure.measure(tmp_path, 0)
    assert not tables
    assert "HIL_DATA" in skipped[0]
