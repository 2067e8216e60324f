"""Calibrators: each turns completed windows into parameters behind one interface (`base.Calibrator`)."""

from __future__ import annotations

from twin.calibrators.base import Calibration, Calibrator, Kind, Window
from twin.network import Network, TwinFileError

__all__ = ["FITTING", "NAMES", "Calibration", "Calibrator", "Kind", "Window", "make"]

FITTING = ("pso", "pso_paper", "least_squares", "kalman")
"""Those that need nothing but a window; the others need what training made."""
NAMES = (*FITTING, "hiera_unet", "hiera_ls")


def make(name: str, network: Network, tunables: str | None = None, seed: int = 0) -> Calibrator:
    """Calibrator by name: ``pso`` (tuned swarm), ``pso_paper`` (Table 2 to the letter), ``least_squares``,
    ``kalman`` (filter), ``hiera_unet`` (trained network; needs the extra ``ml``), ``hiera_ls`` (that, then least
    squares).

    Args:
        tunables: a set of the twin; each calibrator has its own default.

    Raises:
        TwinFileError: no such calibrator or set. HieraError: there is no trained network for this twin.
    """
    if name in ("pso", "pso_paper"):
        from twin.calibrators.pso import Swarm

        preset, usual = ("paper", "paper4") if name == "pso_paper" else ("tuned", "nine")
        return Swarm(network, tunables or usual, preset, seed)
    if name == "least_squares":
        from twin.calibrators.least_squares import LeastSquares

        return LeastSquares(network, tunables or "nine")
    if name == "kalman":
        from twin.calibrators.kalman import KalmanFilter

        return KalmanFilter(network, tunables or "nine")
    if name == "hiera_unet":
        from twin.calibrators.hiera_unet.service import HieraUNetCalibrator

        return HieraUNetCalibrator.shipped(network, tunables or "nine")
    if name == "hiera_ls":
        from twin.calibrators.hiera_unet.refined import RefinedCalibrator
        from twin.calibrators.hiera_unet.service import HieraUNetCalibrator

        return RefinedCalibrator(network, HieraUNetCalibrator.shipped(network, tunables or "nine"), tunables or "nine")
    raise TwinFileError(f"no calibrator {name!r}; there are: {', '.join(NAMES)}")
