"""Where a network runs."""

from __future__ import annotations

import importlib.util

from twin.calibrators.hiera_unet.config import HieraError

NEEDED = ("torch", "safetensors")


def ready(device: str = "cpu", threads: int = 0) -> None:
    """Make sure that a network can run on `device`, on so many threads of the processor (0: as torch chooses).

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
    kind = device.split(":")[0]
    if kind not in ("cpu", "cuda"):
        raise HieraError(f"there is no device {device!r}; give cpu or cuda")
    if kind == "cuda" and not torch.cuda.is_available():
        raise HieraError("there is no GPU that this torch can use; give --device cpu")
