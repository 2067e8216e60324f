"""Torch on one thread, as the service has it: its threads spin while they wait for one another, so that on a machine
whose cores are busy a forward of a few milliseconds takes seconds."""

from __future__ import annotations

import importlib.util

if importlib.util.find_spec("torch"):
    import torch

    torch.set_num_threads(1)
