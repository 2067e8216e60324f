"""Calibrators: each turns completed windows into parameters behind one interface (`base.Calibrator`)."""

from __future__ import annotations

from pathlib import Path

from twin.calibrators.base import (
    Calibration,
    Calibrator,
    FilteredReadings,
    Proposer,
    Restartable,
    SampleFilter,
    Window,
    WindowKind,
)
from twin.calibrators.windows import LEAST_ROWS, LEAST_SPAN, WindowSamples, make_window
from twin.network import Network, TwinFileError

__all__ = [
    "ANY_TWIN_CALIBRATORS",
    "CALIBRATOR_NAMES",
    "LEAST_ROWS",
    "LEAST_SPAN",
    "UNTRAINED_CALIBRATORS",
    "Calibration",
    "Calibrator",
    "FilteredReadings",
    "Proposer",
    "Restartable",
    "SampleFilter",
    "Window",
    "WindowKind",
    "WindowSamples",
    "default_tunables",
    "make_calibrator",
    "make_window",
]

UNTRAINED_CALIBRATORS = ("pso", "pso_paper", "least_squares", "kalman")
"""Calibrators that need nothing but a window; the others need a trained network."""
CALIBRATOR_NAMES = (*UNTRAINED_CALIBRATORS, "hiera_unet", "hiera_ls")
"""Names of all calibrators."""
ANY_TWIN_CALIBRATORS = ("pso", "least_squares", "kalman")
"""Calibrators for any twin; the others are for the coolant loop."""


def make_calibrator(
    name: str, network: Network, tunables: str | None = None, seed: int = 0, card: Path | None = None
) -> Calibrator:
    """Make a calibrator by its name.

    Parameters
    ----------
    name
        ``pso`` (tuned swarm), ``pso_paper`` (Table 2 to the letter), ``least_squares``, ``kalman`` (filter),
        ``hiera_unet`` (trained network; needs the extra ``ml``), ``hiera_ls`` (network, then least squares).
    network
        The commissioned twin.
    tunables
        A set of the twin; without one that of `default_tunables`, for ``pso_paper`` it is ``paper4``.
    seed
        Seed of the random generator.
    card
        Card of the ensemble for ``hiera_unet`` and ``hiera_ls``; the shipped one by default.

    Raises
    ------
    TwinFileError
        There is no such calibrator or set, or the calibrator is for the coolant loop and the twin is another plant.
    HieraError
        There is no trained network for this twin, or that of `card` does not fit it.
    """
    if name == "pso":
        from twin.calibrators.pso import ParticleSwarm

        return ParticleSwarm(network, tunables or default_tunables(network), "tuned", seed)
    if name == "least_squares":
        from twin.calibrators.least_squares import LeastSquares

        return LeastSquares(network, tunables or default_tunables(network))
    if name == "kalman":
        from twin.calibrators.kalman import KalmanFilter

        return KalmanFilter(network, tunables or default_tunables(network))
    if name in CALIBRATOR_NAMES:
        _require_loop(name, network, tunables)
    if name == "pso_paper":
        from twin.calibrators.pso import ParticleSwarm

        return ParticleSwarm(network, tunables or "paper4", "paper", seed)
    if name == "hiera_unet":
        from twin.calibrators.hiera_unet.serve.service import HieraUNetCalibrator

        return HieraUNetCalibrator.shipped(network, tunables or "nine", card)
    if name == "hiera_ls":
        from twin.calibrators.hiera_unet.serve.refined import RefinedCalibrator
        from twin.calibrators.hiera_unet.serve.service import HieraUNetCalibrator

        asked = HieraUNetCalibrator.shipped(network, tunables or "nine", card)
        return RefinedCalibrator(network, asked, tunables or "nine")
    raise TwinFileError(f"no calibrator {name!r}; there are: {', '.join(CALIBRATOR_NAMES)}")


def default_tunables(network: Network) -> str | tuple[str, ...]:
    """Return the tunables where none are named: the set ``nine``, ``commission``, the twin's only set, or all tunables.

    Raises
    ------
    TwinFileError
        There is nothing to calibrate.
    """
    for name in ("nine", "commission", *(network.sets if len(network.sets) == 1 else ())):
        if name in network.sets:
            return name
    ids = tuple(p for p in network.tunables() if not network.parameters[p].same_as)
    if not ids:
        raise TwinFileError(
            f"twin {network.name!r} has nothing to calibrate; give a parameter the status 'tunable', or add "
            "[sets.commission] with its members"
        )
    return ids


def _require_loop(name: str, network: Network, tunables: str | None) -> None:
    """Raise TwinFileError for a twin without the sets of the coolant loop."""
    if network.meters and name != "pso_paper":
        raise TwinFileError(
            f"{name} takes thermometers only, and twin {network.name!r} has the meter {network.meters[0].name!r}; take "
            f"another calibrator, or a twin without meters"
        )
    wanted = "paper4" if name == "pso_paper" else "nine"
    if tunables is None and wanted not in network.sets:
        raise TwinFileError(
            f"{name} is of the coolant loop only, and twin {network.name!r} has no set {wanted!r} as the "
            f"loop has; {', '.join(ANY_TWIN_CALIBRATORS[:-1])} and {ANY_TWIN_CALIBRATORS[-1]} take any twin"
        )
