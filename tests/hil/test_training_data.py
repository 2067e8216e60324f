"""Training data of the virtual rig's plant: the same again from a seed, and labelled with what is known."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.virtual.plant.effects import PlantEffect
from drivers.virtual.plant.geometry import build_cells
from hil.executor import ExecutorOptions, opened
from hil.training import generate as data
from hil.training import plant_windows
from hil.training.data import FEWEST, least_windows, looked_at
from hil.training.stopping import Stop
from twin.calibrators.hiera_unet.simulated.store import SPLITS, Store
from twin.network import TwinFileError

FEATURES = data.features_of()
IDS = FEATURES.deviations.ids


def told(*effects: PlantEffect) -> tuple[np.ndarray, np.ndarray]:
    return plant_windows.equivalent_deviations(FEATURES, effects, np.arange(0.0, 7200.0, 5.0))


def test_a_campaign_is_the_same_again_and_its_twin_nearly_right():
    first, again = plant_windows.campaign(FEATURES, 1, 1), plant_windows.campaign(FEATURES, 1, 1)
    np.testing.assert_array_equal(first.series.measured, again.series.measured)
    np.testing.assert_array_equal(first.truth, again.truth)
    assert first.truth.shape == first.series.measured.shape
    both = np.isfinite(first.series.measured).all(axis=1)
    assert np.abs(np.median(first.series.measured[both] - first.truth[both], axis=0)).max() < 0.02 or first.what


def test_heat_in_the_modules_is_a_known_deviation_from_its_onset_on():
    theta, amiss = told(PlantEffect("heat_source", "modules", "constant", "power_W", 140.0, onset_s=3600.0))
    k = IDS.index("modules_power.power")
    assert (theta[:720] == 0.0).all() and not amiss[:720].any()
    assert theta[721:, k] == pytest.approx(140.0 / FEATURES.deviations.scale[k])
    assert not np.delete(theta, k, axis=1).any()


def test_a_lost_insulation_is_a_known_deviation():
    shape = {"exponent": 1.0}
    theta, _ = told(
        PlantEffect(
            "heat_loss", "tank", "temperature_difference", "conductance_W_per_K", 7.0, ramp_s=3600.0, shape=shape
        )
    )
    k = IDS.index("tank_loss.hA")
    assert theta[-1, k] == pytest.approx(7.0 / FEATURES.deviations.scale[k])
    assert 0.0 < theta[360, k] < theta[-1, k]


def test_what_only_stands_in_for_a_parameter_leaves_it_unknown_and_the_others_as_they_were():
    theta, amiss = told(PlantEffect("heat_rejection", "radiator", "constant", "lost_fraction", 0.2))
    k = IDS.index("fins.UA_100")
    assert np.isnan(theta[:, k]).all() and amiss.all()
    assert not np.delete(theta, k, axis=1).any()


def test_specimens_differ_by_section_and_keep_the_shape_of_the_rig():
    built, other = build_cells(), plant_windows.scattered(np.random.default_rng(0))
    assert not np.array_equal(built.outer, other.outer)
    np.testing.assert_array_equal(built.section, other.section)
    ratio = other.film / built.film
    for k in range(built.film_exponent.size):
        assert np.ptp(ratio[built.section == k]) == pytest.approx(0.0, abs=1e-12)


@pytest.fixture(scope="module")
def twenty(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """The store of a folder of twenty windows, made at once."""
    store = data.generate(3, 20, tmp_path_factory.mktemp("twenty"))
    assert store is not None
    return store


def test_a_generated_folder_has_its_splits_and_is_not_made_twice(twenty):
    store, folder = twenty, twenty.folder
    assert store.manifest["windows"] >= 20
    shards = store.manifest["shards"]
    assert {entry["split"] for entry in shards.values()} == set(SPLITS)
    assert len({entry["seed"] for entry in shards.values()}) == len(shards)
    stamps = {path: path.stat().st_mtime_ns for path in folder.glob("*.npz")}
    again = data.generate(3, 20, folder)
    assert again is not None and again.digest == store.digest
    assert {path: path.stat().st_mtime_ns for path in folder.glob("*.npz")} == stamps
    test = store.windows("test")
    assert len(test) and np.isfinite(test.x).all()


def test_workers_simulate_the_same_windows_and_go_on_with_what_is_there(twenty, tmp_path):
    pytest.importorskip("distributed")
    assert data.generate(3, 20, tmp_path, None, After(3)) is None
    with opened(ExecutorOptions(workers=1), lambda message: None) as executor:
        assert data.generate(3, 20, tmp_path, None, After(1), executor) is None  # it is stopped while they work
    with opened(ExecutorOptions(workers=2), lambda message: None) as executor:
        store = data.generate(3, 20, tmp_path, None, None, executor)
    assert store is not None and store.digest == twenty.digest


class After(Stop):
    """Over when it was asked so many times."""

    def __init__(self, times: int) -> None:
        super().__init__()
        self.left = times

    @property
    def over(self) -> bool:
        self.left -= 1
        return self.left < 0


def test_what_was_cut_or_was_less_is_added_to_and_is_the_same_as_at_once(twenty, tmp_path, monkeypatch):
    made = []
    plain = data.plant_campaign
    monkeypatch.setattr(data, "plant_campaign", lambda f, s, n: made.append((s, n)) or plain(f, s, n))
    parts, shares = tmp_path / "parts", []
    assert data.generate(3, 10, parts) is not None
    assert data.complete(parts, 3, 10) and not data.complete(parts, 3, 20)
    before = data.begun(parts, 20)
    while (store := data.generate(3, 20, parts, None, After(1))) is None:
        shares.append(data.begun(parts, 20))
        assert data.asked_of(parts) == (3, 20) and not data.complete(parts, 3, 20)
        with pytest.raises(TwinFileError, match="no training data there"):
            Store(parts, FEATURES)
    assert 0.0 < before < shares[0] and len(shares) > 1 and shares == sorted(shares)
    assert store.digest == twenty.digest and data.complete(parts, 3, 20)
    assert len(made) == len(set(made))


def test_windows_of_another_seed_or_fewer_do_not_replace_those_of_a_folder(tmp_path):
    data.generate(3, 10, tmp_path)
    kept = {path: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(TwinFileError, match="holds windows of data seed 3, not 4"):
        data.generate(4, 10, tmp_path)
    with pytest.raises(TwinFileError, match="holds 10 windows, more than 5"):
        data.generate(3, 5, tmp_path)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == kept


def test_the_fewest_windows_leave_rigs_to_set_intervals_with():
    least = least_windows()
    for count, enough in ((least, True), (least - 10, False), (240, False)):
        campaigns = sum(data.campaigns_of(count, "conformal").values())
        assert (campaigns - sum(looked_at(campaigns)) >= FEWEST) == enough
