"""Plan of a tower training as plain data."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from twin.calibrators.hiera_unet.model.config import HieraError


@dataclass(frozen=True)
class TowerPlan:
    """Plan of a tower training.

    Attributes:
        steps, batch: of the optimiser, and windows of each, of which a share `pairs` are followed by their next cycle.
        mix: shares of the kinds of windows: stable, fan staging, load ramp, high wet bulb, after maintenance; empty for
            natural shares with equal cells. A correction is learned for the shares that it is scored by.
        balance, smooth, uncertainty: weights of eq. 11. The balance of a tower holds by construction, as heat is
            derived from the corrected outlet. price: of the corrections' squares.
        through: share of the outputs' gradient that reaches the parameters through the twin, for a network whose outlet
            depends on them.
        sure: share of steps without the likelihoods. even_every: steps between two measurements of the gradients that
            are made equal.
        jumped, shifted: shares of windows with a jump of a deviation, and with a prior that is shifted by its sd.
        offset: sd, K, of an offset that a window's thermometer gets, with prior and label. unnamed: share of windows
            without the numbers that identify a plant: design, memory, clock.
        dropped, burst: shares of windows that lose channels, and that lose all measurements for up to two hours.
        adapt: share of windows of the station itself when a network is adapted to it; 0 for the family.
        half: bfloat16 in the network's products.
    """

    steps: int = 4000
    batch: int = 24
    pairs: float = 0.125
    mix: tuple[float, ...] = ()
    rate: float = 1.5e-3
    warmup: float = 0.04
    decay: float = 0.1
    clip: float = 1.0
    ema: float = 0.995
    smooth: float = 0.08
    uncertainty: float = 0.15
    price: float = 0.01
    through: float = 0.1
    sure: float = 0.1
    even_every: int = 25
    jumped: float = 0.03
    shifted: float = 0.0
    offset: float = 0.15
    unnamed: float = 0.3
    dropped: float = 0.15
    burst: float = 0.1
    half: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        if self.steps < 1 or self.batch < 2:
            raise HieraError(
                f"a training of {self.steps} steps with {self.batch} windows each cannot be; give at least 1 and 2"
            )

    def document(self) -> dict[str, Any]:
        """Return plain data for a JSON file."""
        return asdict(self)
