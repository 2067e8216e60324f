"""Training data: seeded, labelled with what is true, and the same again from disk."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from functools import lru_cache

import numpy as np
import pytest

from tests.twin.hiera.records import NETWORK, features
from twin.calibrators.hiera_unet.data.windows import CONTEXT, TARGET, concatenate
from twin.calibrators.hiera_unet.simulated import changes
from twin.calibrators.hiera_unet.simulated.campaigns import STEPS, LabelledRecord, ends, label, simulated
from twin.calibrators.hiera_unet.simulated.gaps import damaged, logged
from twin.calibrators.hiera_unet.simulated.plants import Family
from twin.calibrators.hiera_unet.simulated.store import Kept, Store, windows_of, write_manifest, write_shard
from twin.network import TwinFileError

SEED = 5


@lru_cache(maxsize=1)
def family() -> Family:
    return Family(NETWORK, features().deviations)


@lru_cache(maxsize=1)
def campaigns() -> tuple[LabelledRecord, ...]:
    return tuple(simulated(family(), SEED, k) for k in range(12))


def kept(campaign: LabelledRecord, seed: int = 0) -> Kept:
    rng = np.random.default_rng(seed)
    return Kept(campaign, tuple(label(features(), campaign, end) for end in ends(campaign, rng, 2)))


def test_a_campaign_is_the_same_again_from_its_seed():
    again, first = simulated(family(), SEED, 3), campaigns()[3]
    np.testing.assert_array_equal(again.series.measured, first.series.measured)
    np.testing.assert_array_equal(again.truth, first.truth)
    np.testing.assert_array_equal(again.nominal, first.nominal)
    assert again.what == first.what


def test_other_numbers_and_seeds_give_other_campaigns():
    assert not np.array_equal(simulated(family(), SEED + 1, 3).truth, campaigns()[3].truth)
    assert len({c.truth[100, 0] for c in campaigns()}) == len(campaigns())


def test_some_are_healthy_and_healthy_ones_do_not_deviate():
    healthy = [c for c in campaigns() if not c.amiss.any()]
    assert 0 < len(healthy) < len(campaigns())
    assert all((c.theta == 0.0).all() for c in healthy)


def test_the_commissioned_twin_is_nearly_right_on_a_healthy_rig_and_wrong_on_a_changed_one():
    """Otherwise there would be nothing to learn: neither structure nor change."""
    rig, rng = family().rig(2), np.random.default_rng(0)
    n = 1500
    inputs = np.tile(NETWORK.nominal_inputs, (n, 1))
    inputs[700:, 0] += 150.0
    still, zero = np.zeros((n, len(NETWORK.nodes))), np.zeros(len(features().deviations))
    start = family().start(rig.plant, inputs, rng)
    theta = zero.copy()
    theta[features().deviations.ids.index("modules_power.power")] = 0.3
    errors = []
    for vectors in ([(0, rig.plant)], [(0, rig.plant), (500, family().deviated(rig.plant, theta))]):
        truth = family().readings(vectors, start, inputs, still) + rig.offsets
        made = replace(campaigns()[0].series, time=np.arange(n) * 5.0, inputs=inputs, measured=truth, spread=truth)
        frame = features().frame(made, n, rig.nominal)
        errors.append(float(np.sqrt(np.nanmean((frame.free - frame.measured) ** 2))))
    assert 0.0 < errors[0] < 0.2
    assert errors[1] > 3.0 * errors[0]


def test_injected_heat_where_the_twin_tracks_a_power_is_that_deviation():
    heat = np.zeros((4, len(NETWORK.nodes)))
    heat[2:, NETWORK.nodes.index("modules")] = 70.0
    heat[:, NETWORK.nodes.index("tank")] = 50.0
    theta = changes.equivalent(heat, family())
    k = features().deviations.ids.index("modules_power.power")
    assert theta[2:, k] == pytest.approx(70.0 / features().deviations.scale[k])
    assert not np.delete(theta, k, axis=1).any()


def test_a_known_label_is_what_the_evidence_finds_on_clean_data():
    found = [k for k in map(kept, campaigns()) if not any("lost" in w or "stuck" in w for w in k.campaign.what)]
    errors, priors = [], []
    count = len(features().deviations)
    for one in found:
        last = one.labels[-1]
        if not one.campaign.amiss.any() or "T_" in one.campaign.what[0]:
            errors.append((last.fit[2 : 2 + count] - last.theta)[last.known])
            priors.append(np.broadcast_to(features().deviations.prior_sd, (count,))[last.known])
    assert len(errors) >= 2
    assert np.median(np.abs(np.concatenate(errors))) < 0.25 * np.median(np.concatenate(priors))


def test_windows_lie_inside_the_record_and_mostly_after_the_change():
    changed = [c for c in campaigns() if 200 < c.onset < STEPS - 300]
    assert changed
    after = []
    for seed in range(20):
        for c in changed:
            found = ends(c, np.random.default_rng(seed), 3)
            assert all(TARGET < end <= STEPS for end in found)
            assert found == sorted(found)
            after.append(found[-1] > c.onset)
    assert np.mean(after) > 0.6


def test_gaps_lose_readings_but_never_invent_any():
    rng = np.random.default_rng(0)
    inputs, measured = np.ones((800, 4)), np.random.default_rng(1).normal(size=(800, 4))
    lost = 0
    for _ in range(40):
        u, y, said = damaged(rng, inputs, measured)
        assert u.shape == inputs.shape and y.shape == measured.shape
        assert (np.isnan(u) | (u == inputs)).all()
        if not any("stuck" in word for word in said):
            assert (np.isnan(y) | (y == measured)).all()
        lost += bool(np.isnan(y).any())
        assert bool(said) or not np.isnan(y).any()
    assert 5 < lost < 35


def test_a_coarse_or_slow_logger_adds_what_it_must():
    rng, clean = np.random.default_rng(3), np.full((4000, 1), 30.0)
    spread = [np.nanstd(logged(rng, clean, np.array([0.05]))) for _ in range(30)]
    assert 0.5 * 0.05 / np.sqrt(5.0) < min(spread) < max(spread) < 0.12


def test_windows_come_back_from_disk_as_they_were(tmp_path):
    rows = [kept(c) for c in campaigns()[:2]]
    shard = tmp_path / "train-twin-000.npz"
    digest = write_shard(shard, rows)
    entry = {"split": "train", "source": "twin", "sha256": digest, "campaigns": 2, "windows": 4}
    write_manifest(tmp_path, features(), {shard.name: entry}, seed=1)
    store = Store(tmp_path, features())
    found, direct = store.windows("train"), windows_of(features(), rows)
    assert found.x.shape == (4, CONTEXT, len(features().table))
    for f in fields(found):
        a, b = getattr(found, f.name), getattr(direct, f.name)
        assert a.dtype == b.dtype and a.shape == b.shape
        np.testing.assert_allclose(a.astype(float), b.astype(float), atol=2e-3, err_msg=f.name)
    assert len(concatenate([found, direct])) == 8
    assert np.isfinite(found.x).all() and np.isfinite(found.meta).all() and np.isfinite(found.base).all()


def test_altered_data_and_data_for_other_parameters_are_refused(tmp_path):
    shard = tmp_path / "train-twin-000.npz"
    write_shard(shard, [kept(campaigns()[0])])
    entry = {"split": "train", "source": "twin", "sha256": "0" * 64}
    write_manifest(tmp_path, features(), {shard.name: entry})
    with pytest.raises(TwinFileError, match="missing or altered"):
        Store(tmp_path, features()).windows("train")
    path = tmp_path / "manifest.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"parameters": ["another"]}))
    with pytest.raises(TwinFileError, match="another parameters"):
        Store(tmp_path, features())
    with pytest.raises(TwinFileError, match="no training data"):
        Store(tmp_path / "nowhere", features())
