"""Device and memory settings for a network."""

from __future__ import annotations

import ctypes
import importlib.util
import sys

from twin.calibrators.hiera_unet.model.config import HieraError

NEEDED = ("torch", "safetensors")
MMAP_THRESHOLD, TRIM_THRESHOLD = -3, -1
"""Numbers of glibc's mallopt(3)."""
MAPPED_BYTES, KEPT_BYTES = 1 << 25, 1 << 26
"""Largest allocation, bytes, that glibc serves without a mapping of its own, and freed bytes that it keeps, enough for
two forward passes of the full network."""


def ready(device: str = "cpu", threads: int = 0) -> None:
    """Check that a network can run on `device`, and set the number of processor threads (0: torch's choice).

    Raises:
        HieraError: a package is missing, or there is no such device.
    """
    missing = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        raise HieraError(
            f"the network calibrator needs {' and '.join(missing)}, which this installation lacks; install the extra "
            "with `pip install -c constraints.txt -e '.[ml]'`"
        )
    import torch

    if threads:
        torch.set_num_threads(threads)
    _keep_memory()
    kind = device.split(":")[0]
    if kind not in ("cpu", "cuda"):
        raise HieraError(f"there is no device {device!r}; give cpu or cuda")
    if kind == "cuda" and not torch.cuda.is_available():
        raise HieraError("there is no GPU that this torch can use; give --device cpu")


def _keep_memory() -> None:
    """Let glibc keep the memory that a forward pass frees.

    By default it returns the memory, and a tenth of the next forward pass is spent on zeroing thousands of pages again.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:
        mallopt(MMAP_THRESHOLD, MAPPED_BYTES)
        mallopt(TRIM_THRESHOLD, KEPT_BYTES)
