"""Plan of a training as plain data, which reproduces it together with the data and the seed."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from twin.calibrators.hiera_unet.model.config import HieraError


@dataclass(frozen=True)
class Hiding:
    """Rules of hiding inputs in training.

    `whole`: probability that all of the target is hidden; otherwise, if `blocks`, random ones of `block_steps` are.
    `dropped`: probability that a window loses whole channels, each with probability `each`. `burst`: probability that
    it loses all measurements for 2 to `burst_steps` steps.
    """

    whole: float = 0.7
    blocks: bool = True
    block_steps: int = 20
    dropped: float = 0.3
    each: float = 0.1
    burst: float = 0.3
    burst_steps: int = 240


@dataclass(frozen=True)
class LossWeights:
    """Weights of the losses.

    Balance, smoothness and uncertainty are as published; parameters, corrections and slow corrections are this
    project's. `through`: share of the outputs' gradient that passes through the twin into the parameters. If the
    outputs are calibrated from the evidence, the twin with the parameters alone has a loss of its own.
    """

    balance: float = 0.30
    smooth: float = 0.08
    uncertainty: float = 0.15
    parameter: float = 10.0
    delta: float = 0.01
    slow: float = 0.1
    through: float = 0.05


@dataclass(frozen=True)
class TrainingPlan:
    """Plan of a training.

    Attributes:
        steps: in all. batch: windows a step, of which 2 `pairs` are adjacent ones of a rig, and a share `moved` of the
            rest has a known changed parameter; intervals are set on natural shares. rate: highest of AdamW, reached
            over the share `warmup` and then lowered along a cosine. (The paper's 3e-2 does not train.)
        structure: share of steps, the first, with healthy windows only and fixed parameters, in which the correction
            learns the model error of a healthy rig.
        sure: share of steps, the first, without the likelihood.
        healthy: largest absolute deviation of a healthy window, as a share of its bound; beyond it a parameter changed.
        half: bfloat16 in the network's products; never in losses or the twin.
    """

    steps: int = 6000
    batch: int = 12
    pairs: int = 2
    moved: float = 0.3
    rate: float = 2e-3
    warmup: float = 0.03
    decay: float = 0.05
    clip: float = 1.0
    ema: float = 0.995
    structure: float = 0.1
    sure: float = 0.1
    healthy: float = 0.02
    half: bool = False
    seed: int = 0
    weights: LossWeights = field(default_factory=LossWeights)
    hiding: Hiding = field(default_factory=Hiding)

    def __post_init__(self) -> None:
        if self.steps < 1 or self.batch < 1 + 2 * self.pairs:
            raise HieraError(
                f"a training of {self.steps} steps with batches of {self.batch} windows and {self.pairs} pairs cannot "
                "be; give at least one step and a batch that holds the pairs"
            )

    def document(self) -> dict[str, Any]:
        """Return plain data for a JSON file."""
        return asdict(self)
