"""`hil bench ablations`: every variant gets the same CPU time, and is compared on the same rigs."""

from __future__ import annotations

import numpy as np
import pytest
from click.testing import CliRunner

torch = pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")

from hil.bench.commands.bench import command  # noqa: E402
from hil.bench.hiera import ablations  # noqa: E402
from hil.training.ablation import PIECES  # noqa: E402
from hil.training.data import TrainingData  # noqa: E402
from tests.twin.hiera import fake  # noqa: E402
from twin.calibrators.hiera_unet.training.train import Physics  # noqa: E402
from twin.calibrators.hiera_unet.weights import binding  # noqa: E402


class Table:
    """Channels of the fake windows."""

    def indices(self, *roles: str) -> list[int]:
        return [2, 3] if roles == ("r",) else []


@pytest.fixture
def data(monkeypatch: pytest.MonkeyPatch) -> TrainingData:
    monkeypatch.setattr(binding, "config_for", lambda *_: fake.config())
    monkeypatch.setattr(binding, "physics_of", lambda *_: Physics(fake.simulate, fake.TOLD))
    parts = [fake.windows(n, seed) for seed, n in enumerate((24, 6, 6, 12))]
    return TrainingData(None, Table(), None, *parts, manifest={}, digest="d")  # type: ignore[arg-type]


def test_every_variant_is_trained_for_the_same_time_and_its_row_says_how_far_it_came(
    data: TrainingData, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ablations, "PROBED", 1)
    monkeypatch.setattr(ablations, "FEWEST", 2)
    told: list[str] = []
    (found, meanings), left_out = ablations.measure(data, "small", 0, 1e-9, lambda share, what: told.append(what))
    assert [row[0] for row in found.rows] == ["nothing", *ablations.LEFT_OUT, "the network"] and not left_out
    assert [row[1] for row in found.rows] == [2] * 6 + [0]
    assert all(np.isfinite([row[2], row[3], row[4]]).all() for row in found.rows)
    assert found.rows[0][5] is None and all(" to " in str(row[5]) for row in found.rows[1:])
    assert {row[0] for row in meanings.rows} <= set(PIECES) and len(told) == 6


def test_differences_are_drawn_again_by_rigs() -> None:
    """Ten rigs with a hundred windows each are ten, not a thousand."""
    rng = np.random.default_rng(0)
    rig = np.repeat(np.arange(10), 100)
    low, high = (float(x) for x in str(ablations._span(rng.normal(size=10)[rig], rig)).split(" to "))
    assert 0.3 < high - low < 2.0
    low, high = (float(x) for x in str(ablations._span(np.full(1000, 0.2), rig)).split(" to "))
    assert low == high == pytest.approx(0.2)


def test_means_leave_out_what_is_not_known() -> None:
    found = ablations.mean(np.array([[1.0, np.nan, 3.0], [np.nan] * 3]))
    assert found[0] == 2.0 and np.isnan(found[1])
    assert ablations.rigs(np.array([[1.0], [2.0], [1.0]])).tolist() == [0, 1, 0]


def test_a_folder_without_data_is_refused(tmp_path) -> None:
    done = CliRunner().invoke(command, ["ablations", "--data", str(tmp_path / "none")])
    assert done.exit_code == 2 and "does not exist" in done.output
