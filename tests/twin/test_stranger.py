"""On rigs that this project did not write: commission, then track. Skipped where the data are absent."""

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from twin.commissioning import commission
from twin.network import Network
from twin.tracking import TwinTracker
from twin.twinfile.datasheet import from_datasheet


def read(path: Path, net: Network) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    table = pq.read_table(path)
    columns = {c: table[c].to_numpy().astype(np.float64) for c in table.schema.names}
    return (columns["time_s"], *net.select(columns))


@pytest.mark.parametrize("case", ["d0", "d7"])
def test_a_healthy_stranger_is_commissioned_to_its_noise(stranger: Path, case: str) -> None:
    net = from_datasheet(stranger / case / "datasheet.json")
    done = commission(net, *read(stranger / case / "commissioning.parquet", net))
    for name, sigma in zip(net.sensor_names, net.sigma, strict=True):
        assert done.rmse_fitted[name] < 1.8 * sigma
        assert done.rmse_after[name] < done.rmse_before[name]


@pytest.fixture(scope="module")
def healthy(stranger: Path) -> Network:
    net = from_datasheet(stranger / "d1" / "datasheet.json")
    return commission(net, *read(stranger / "d1" / "commissioning.parquet", net)).network


@pytest.mark.parametrize("calibrator", ["pso", "least_squares"])
def test_a_changed_stranger_is_tracked(stranger: Path, healthy: Network, calibrator: str) -> None:
    t, u, y = read(stranger / "d1" / "campaign.parquet", healthy)
    tracker = TwinTracker(healthy, calibrator)
    update = tracker.push(t, u, y)
    table = tracker.table()
    for row in table.values():
        assert row["tracked"] < 0.05 * row["static"]
        assert row["fitted"] < row["tracked"]
    assert sum(c.calibrated for c in update.calibrations) >= 0.95 * len(update.calibrations)
