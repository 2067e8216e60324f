"""Gradient-boosted regression trees as constants of a network: the answer that the network corrects.

They are fitted by scikit-learn and only evaluated here, so that a service needs torch alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

MOST_DEPTH = 64
"""Levels of a tree at most; trees of 31 leaves have at most 30."""
NAMES = ("feature", "threshold", "left", "right", "missing", "value", "base")
"""Array names: of nodes (models, trees, nodes), and the value without any tree (models,)."""
CHUNK = 4096
"""Rows in one batch."""


class Trees(nn.Module):
    """Several models of boosted trees over one kind of rows each.

    Parameters
    ----------
    sizes
        Models, trees of each at most, nodes of a tree at most.
    """

    feature: Tensor
    threshold: Tensor
    left: Tensor
    right: Tensor
    missing: Tensor
    value: Tensor
    base: Tensor

    def __init__(self, sizes: Sequence[int]) -> None:
        super().__init__()
        models, trees, nodes = sizes
        shape = (models, trees, nodes)
        for name in ("feature", "left", "right", "missing", "threshold", "value"):
            self.register_buffer(name, torch.zeros(shape))
        self.register_buffer("base", torch.zeros(models))

    def forward(self, rows: Tensor, model: int) -> Tensor:
        """Return the values (N,) of a model for rows (N, F); NaN is a missing value."""
        return torch.cat([self._of(part, model) for part in rows.float().split(CHUNK)])

    def _of(self, rows: Tensor, model: int) -> Tensor:
        feature, left, right = (getattr(self, n)[model].long() for n in ("feature", "left", "right"))
        threshold, missing, value = self.threshold[model], self.missing[model], self.value[model]
        tree = torch.arange(len(feature), device=rows.device)[None]
        at = torch.zeros(len(rows), len(feature), dtype=torch.long, device=rows.device)
        for _ in range(MOST_DEPTH):
            seen = rows.gather(1, feature[tree, at])
            goes = torch.where(torch.isnan(seen), missing[tree, at] > 0.5, seen <= threshold[tree, at])
            following = torch.where(goes, left[tree, at], right[tree, at])
            if bool((following == at).all()):
                break
            at = following
        return self.base[model] + value[tree, at].sum(1)


def trees_from(arrays: Mapping[str, NDArray[Any]]) -> Trees:
    """Return trees from arrays by the names of `NAMES`."""
    found = Trees(arrays["value"].shape)
    found.load_state_dict({name: torch.from_numpy(np.asarray(arrays[name], dtype=np.float32)) for name in NAMES})
    return found


def sizes_of(models: Sequence[Any]) -> tuple[int, int, int]:
    """Return the sizes of `Trees` that hold fitted `HistGradientBoostingRegressor` models."""
    trees = [one[0].nodes for model in models for one in model._predictors]
    return len(models), max(len(model._predictors) for model in models), max(len(nodes) for nodes in trees)


def trees_of(models: Sequence[Any]) -> Trees:
    """Return fitted `HistGradientBoostingRegressor` models as `Trees`; a leaf leads to itself."""
    found = Trees(sizes_of(models))
    for i, model in enumerate(models):
        found.base[i] = float(np.ravel(model._baseline_prediction)[0])
        for j, (one,) in enumerate(model._predictors):
            nodes, own = one.nodes, np.arange(len(one.nodes))
            leaf = nodes["is_leaf"] > 0
            columns = {
                "feature": np.where(leaf, 0, nodes["feature_idx"]),
                "left": np.where(leaf, own, nodes["left"]),
                "right": np.where(leaf, own, nodes["right"]),
                "missing": nodes["missing_go_to_left"],
                "threshold": np.where(leaf, 0.0, nodes["num_threshold"]),
                "value": np.where(leaf, nodes["value"], 0.0),
            }
            for name, values in columns.items():
                getattr(found, name)[i, j, : len(nodes)] = torch.from_numpy(values.astype(np.float32))
    return found
