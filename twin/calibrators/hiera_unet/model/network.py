"""Hiera-UNet: from two hours of a record to parameter deviations, output corrections and their spread."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from twin.calibrators.hiera_unet.model.config import Config
from twin.calibrators.hiera_unet.model.decoder import Decoder
from twin.calibrators.hiera_unet.model.encoder import Encoder
from twin.calibrators.hiera_unet.model.heads import OutputHead, ParameterHead, Queries, recent_of
from twin.calibrators.hiera_unet.model.trees import Trees

FARTHEST = 5.0
"""Standard deviations at which a static number is clipped."""


@dataclass(frozen=True)
class Prediction:
    """Prediction of the network for B windows.

    Without evidence the calibrated output is f_DT(u, theta) + delta, eq. 8. With it, it is f_DT(u, theta_e) + delta,
    where theta_e is the fit, which explains this record even by biased parameters. The network's theta separates
    parameters that changed from model error. For a configuration that `corrects`, delta is added to the outputs that
    are given with a window, whatever theta.

    Attributes:
        theta: (B, P) deviations in their own units. log_variance: (B, P) of theta / bound.
        delta: (B, 120, Y) corrections in the outputs' units. log_scale: (B, 120, Y) of the Laplace scale / tolerance.
        attention: (B, Q, 12) attention weights of each query.
    """

    theta: Tensor
    log_variance: Tensor
    delta: Tensor
    log_scale: Tensor
    attention: Tensor


class HieraUNet(nn.Module):
    """Encoder, decoder and heads of one `Config`. Output never depends on `.training`.

    With ``causal=True`` a correction depends on no later step, with the same weights. Deviations are one vector a
    window and depend on all of it in both modes: an online service uses those of the previous cycle.
    """

    middle: Tensor | None
    spread: Tensor | None

    start_outlet = False
    """True if the gate refused the outlet of a tower: the service then returns the answer that the network starts from.
    """

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.config = config
        self.encoder = Encoder(config)
        self.decoder = Decoder(config)
        self.queries = Queries(config)
        self.parameter_head = ParameterHead(config)
        self.output_head = OutputHead(config)
        self.trees = Trees(config.trees) if config.trees else None
        self.register_buffer("middle", torch.zeros(config.meta) if config.corrects else None)
        self.register_buffer("spread", torch.ones(config.meta) if config.corrects else None)
        self.apply(_start)
        for head in (self.parameter_head, self.output_head):
            nn.init.zeros_(head.out.weight)
        if self.parameter_head.step is not None:
            self.parameter_head.step.start()
        if self.output_head.lasting is not None:
            nn.init.zeros_(self.output_head.lasting.weight)

    def forward(
        self,
        x: Tensor,
        m: Tensor,
        regime: Tensor,
        clock: Tensor,
        meta: Tensor,
        *,
        causal: bool = False,
        crop: bool = True,
        corrected: int | None = None,
        memory: Tensor | None = None,
    ) -> Prediction:
        """Return the prediction for B windows.

        Args:
            x: (B, 1440, C) channels, normalised. m: (B, 1440, C), true or 1 where x is present. regime: (B, 1440)
                integers. clock: (B, 1440, 6). meta: (B, M).
            memory: (B, r, `config.memory`) tokens of the plant's healthy record, for a network that has them.
            crop, corrected: see `Decoder`; the other windows have no corrections and scales.
        """
        m = m.to(x.dtype)
        statics = None
        if self.middle is not None and self.spread is not None:
            statics = ((meta - self.middle) / self.spread).clamp(-FARTHEST, FARTHEST)
        scales = self.encoder(x, m, regime.long(), clock, meta if statics is None else statics, causal, memory)
        answers, attention = self.queries(scales[-1].h, scales[-1].valid)
        d3, d1 = self.decoder(scales, answers.mean(1), causal, crop, corrected)
        theta, log_variance = self.parameter_head(d3, scales[2].valid, answers, meta, scales[2].raw, statics)
        delta, log_scale = self.output_head(d1, recent_of(self.config, x, m), statics)
        return Prediction(theta, log_variance, delta, log_scale, attention)

    def count(self) -> int:
        """Return the number of weights."""
        return sum(p.numel() for p in self.parameters())


def _start(module: nn.Module) -> None:
    if isinstance(module, nn.Linear):
        nn.init.trunc_normal_(module.weight, std=0.02)
        nn.init.zeros_(module.bias)
    elif isinstance(module, nn.Embedding):
        nn.init.trunc_normal_(module.weight, std=0.02)


def decayed(network: nn.Module) -> tuple[list[nn.Parameter], list[nn.Parameter]]:
    """Return the weights with weight decay, and those without: vectors, biases, the bias tables and the queries."""
    yes: list[nn.Parameter] = []
    no: list[nn.Parameter] = []
    for name, p in network.named_parameters():
        plain = p.ndim < 2 or name.endswith(("bias", "bias.table", "query"))
        (no if plain else yes).append(p)
    return yes, no
