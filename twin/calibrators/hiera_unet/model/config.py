"""Configuration of a network as plain data, with all choices that a checkpoint's identity covers."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

TOWER_GROUPS = (6, 9, 10, 6, 12, 9)
"""Channels of each group of the table that the published counts belong to: 52 in all."""


class HieraError(ValueError):
    """Error for a configuration, checkpoint, record or batch that cannot be used; the message is one plain sentence.

    Parameters
    ----------
    code
        Reason code before the sentence, "" for none.
    """

    def __init__(self, sentence: str, code: str = "") -> None:
        super().__init__(f"{code}: {sentence}" if code else sentence)
        self.code = code


@dataclass(frozen=True)
class Config:
    """Sizes of one network. Steps are those of the record; four stages read it at strides 1, 5, 30 and 120 steps.

    Attributes:
        groups: channels in each group of the channel table, in its order.
        bounds: (P,) range of each parameter deviation in its own unit (1.1 for a log-multiplier that may triple).
        tolerances: (Y,) engineering tolerance of each output in its own unit; errors are weighted by them.
        regimes: number of operating regimes. clock: numbers that encode the time of day and year.
        meta: static numbers of a window. With `evidence` the last 5 P + 1 of them are an independent fit of the
            deviations and its standard errors, their sparse posterior (means, standard deviations, probabilities), and
            the logarithm of the fit's condition number.
        evidence: whether the parameter head corrects the sparse posterior; without it the head starts from the
            commissioned twin.
        memory: numbers of a memory token, which the deepest stage reads beside the static numbers; 0 without memory.
        slope_signs: (P,) sign of the twin's derivative in each deviation, if the last 2 P channels are scores and
            information rates; the heads then read them directly (`heads.WeightedStep`). residual: index of the channel
            of the twin's residual in tolerances.
        gated: whether a skip passes a gate; without one it is concatenated directly.
        corrects: whether deviations and outputs are corrections of an answer that is given with a window, each scaled
            by a factor from held-out windows. Static numbers are then standardised, and the output head reads them.
        trees: models, trees and nodes of the boosted trees that give this answer (`tower.trees.Trees`); none without.
        step_s: length of a step. context, target: steps of input, and steps to predict at their end.
        margin: steps before the target that the decoder computes too, so that cropping changes nothing.
        group_dim: width of a group's own tokens. dims, depths, windows: width, blocks and attention window (tokens) of
            each stage. merges: tokens that become one before stages 2, 3 and 4. head_dim: of attention.
    """

    name: str
    groups: tuple[int, ...]
    bounds: tuple[float, ...]
    tolerances: tuple[float, ...]
    meta: int
    regimes: int = 8
    clock: int = 6
    evidence: bool = False
    memory: int = 0
    slope_signs: tuple[int, ...] = ()
    residual: int = 0
    gated: bool = True
    corrects: bool = False
    trees: tuple[int, ...] = ()
    step_s: float = 5.0
    context: int = 1440
    target: int = 120
    margin: int = 90
    group_dim: int = 32
    dims: tuple[int, ...] = (96, 192, 384, 512)
    depths: tuple[int, ...] = (2, 2, 4, 2)
    windows: tuple[int, ...] = (16, 24, 16, 12)
    merges: tuple[int, ...] = (5, 6, 4)
    head_dim: int = 32
    group_window: int = 16
    meta_tokens: int = 3
    queries: tuple[str, ...] = ("ambient", "hydraulic", "airflow", "degradation")
    query_dim: int = 32
    gate_dim: int = 32
    head_hidden: int = 128
    taps: int = 7
    knots: int = 13

    def __post_init__(self) -> None:
        tokens = self.context
        for stage, window in enumerate(self.windows):
            if tokens % window or self.dims[stage] % self.head_dim:
                raise HieraError(
                    f"configuration {self.name!r}: stage {stage + 1} has {tokens} tokens of width {self.dims[stage]}, "
                    f"which windows of {window} and heads of {self.head_dim} do not divide; choose sizes that do"
                )
            if stage < len(self.merges):
                tokens //= self.merges[stage]
        if self.evidence and self.meta < self.told:
            raise HieraError(
                f"configuration {self.name!r}: {self.meta} static numbers cannot hold the evidence of "
                f"{self.parameters} parameters ({self.told} numbers); set meta or evidence"
            )
        if (self.target + self.margin) % self.strides[1] or self.target + self.margin > self.context:
            raise HieraError(
                f"configuration {self.name!r}: target and margin together must be a multiple of {self.strides[1]} "
                f"steps within the context, not {self.target + self.margin}"
            )

    @property
    def channels(self) -> int:
        return sum(self.groups)

    @property
    def parameters(self) -> int:
        return len(self.bounds)

    @property
    def told(self) -> int:
        """Return the number of static numbers that are evidence, at their end."""
        return 5 * self.parameters + 1

    @property
    def outputs(self) -> int:
        return len(self.tolerances)

    @property
    def strides(self) -> tuple[int, ...]:
        """Return the steps of a token, by stage."""
        out = [1]
        for merge in self.merges:
            out.append(out[-1] * merge)
        return tuple(out)

    def document(self) -> dict[str, Any]:
        """Return plain data for a JSON file."""
        return {key: list(v) if isinstance(v, tuple) else v for key, v in asdict(self).items()}

    @classmethod
    def of(cls, document: dict[str, Any]) -> Config:
        """Return the configuration of a `document`.

        Raises:
            HieraError: it has other fields than this version's.
        """
        fields: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in document.items()}
        try:
            return cls(**fields)
        except TypeError as error:
            raise HieraError(f"the configuration is of another version ({error}); train again") from error


SMALL: dict[str, Any] = {"group_dim": 8, "dims": (32, 64, 96, 128), "depths": (1, 1, 2, 2), "head_dim": 16}
"""Differences of the small configuration from the full one."""

PAPER: dict[str, Any] = {
    "groups": TOWER_GROUPS,
    "bounds": (0.25, 0.18, 0.15, 1.0),
    "tolerances": (0.3, 0.4, 0.02, 0.025),
    "meta": 6,
    "step_s": 60.0,
}
"""Channels, parameters and outputs that the counts of 18,623,359 and 1,055,362 weights belong to."""


def named(name: str, **sizes: Any) -> Config:
    """Return configuration ``full`` or ``small`` with the sizes of a twin and its channel table.

    Raises:
        HieraError: no such configuration.
    """
    if name not in ("full", "small"):
        raise HieraError(f"no configuration {name!r}; there are: full, small")
    chosen: dict[str, Any] = {**(SMALL if name == "small" else {}), **sizes}
    return Config(name=name, **chosen)
