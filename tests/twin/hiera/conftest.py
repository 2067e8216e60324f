"""Torch on one thread, as the service has it: its threads spin while they wait for one another, so that on a machine
whose cores are busy a forward of a few milliseconds takes seconds."""

from __future__ import annotations

import importlib.util
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from twin.calibrators.hiera_unet import Ensemble

if importlib.util.find_spec("torch"):
    import torch

    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def ensemble(tmp_path_factory: pytest.TempPathFactory) -> Ensemble:
    """Two untrained members for the shipped loop."""
    from tests.twin.hiera.loop_ensemble import IDENTITY, ensemble_card  # needs torch
    from twin.calibrators.hiera_unet import load_ensemble

    return load_ensemble(ensemble_card(tmp_path_factory.mktemp("trained")), IDENTITY)
