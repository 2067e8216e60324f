"""Boosted trees as numbers of a network: they answer as the models that they were made of, also to missing values."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")
ensemble = pytest.importorskip("sklearn.ensemble", reason="scikit-learn is not installed: there are no trees to copy")

from twin.calibrators.hiera_unet.model.trees import Trees, sizes_of, trees_of  # noqa: E402


def test_trees_answer_as_the_models_they_were_made_of() -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=(2000, 4)).astype(np.float32)
    x[rng.random(x.shape) < 0.1] = np.nan
    y = np.nan_to_num(x[:, 0]) ** 2 + np.where(np.isnan(x[:, 1]), 1.0, x[:, 1])
    models = [
        ensemble.HistGradientBoostingRegressor(max_iter=15, loss=loss, random_state=0).fit(x, sign * y)
        for loss, sign in (("squared_error", 1.0), ("absolute_error", -1.0))
    ]
    trees = trees_of(models)
    assert tuple(trees.value.shape) == sizes_of(models)
    for i, model in enumerate(models):
        np.testing.assert_allclose(trees(torch.from_numpy(x), i).numpy(), model.predict(x), atol=1e-5)


def test_trees_keep_their_answer_in_a_state_of_the_same_sizes() -> None:
    trees, other = Trees((1, 1, 3)), Trees((1, 1, 3))
    trees.left[0, 0], trees.right[0, 0] = torch.tensor([1.0, 1.0, 2.0]), torch.tensor([2.0, 1.0, 2.0])
    trees.value[0, 0] = torch.tensor([0.0, -1.0, 1.0])
    other.load_state_dict(trees.state_dict())
    assert other(torch.tensor([[-0.5], [0.5]]), 0).tolist() == [-1.0, 1.0]
