"""Twin as a layer of the network: predictions forward, and gradients through the kernel's Jacobian backward.

    yhat = TwinLayer(kernel, deviations)(theta, state, inputs, nominal)

The kernel's step is fixed and its map smooth, so central differences across its lanes are exact to about 1e-8: one
call gives the readings and all derivatives of a window.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from twin.calibrators.hiera_unet.data.parameters import Deviations
from twin.calibrators.hiera_unet.data.series import STEP_S
from twin.kernel import Kernel
from twin.network import Array

THETA_STEP, STATE_STEP = 1e-4, 1e-2


class TwinLayer(torch.nn.Module):
    """Free simulation of a twin over the steps of `inputs`, a layer without weights.

    Args:
        kernel: of `parameters.kernel_of`, which serves every rig of the structure. step_s: between the steps.
    """

    def __init__(self, kernel: Kernel, deviations: Deviations, step_s: float = STEP_S) -> None:
        super().__init__()
        self.run = WindowSimulation(kernel, deviations, step_s)

    def forward(
        self, theta: torch.Tensor, state: torch.Tensor, inputs: torch.Tensor, nominal: torch.Tensor | None = None
    ) -> torch.Tensor:
        """Return the readings (B, n, Y), degC, in the type of `theta`.

        Args:
            theta: (B, P). state: (B, K) at the first step. inputs: (B, n, c), held from a step to the next.
            nominal: (B, p) or (p,) full vectors of the commissioned twins; the kernel's own by default.
        """
        own = torch.as_tensor(np.array(self.run.kernel.network.values)) if nominal is None else nominal
        return _TwinFunction.apply(theta, state, inputs, own.expand(len(theta), -1), self.run)


class WindowSimulation:
    """Readings and derivatives of single windows, in numpy."""

    def __init__(self, kernel: Kernel, deviations: Deviations, step_s: float) -> None:
        self.kernel, self.deviations, self.step_s = kernel, deviations, step_s
        self.nodes = len(kernel.network.nodes)

    def readings(self, theta: Array, state: Array, inputs: Array, nominal: Array) -> Array:
        """Return the readings (n, Y), degC, of one window."""
        time = np.arange(len(inputs), dtype=np.float64) * self.step_s
        return self.kernel.trace(self.deviations.full(theta, nominal), state, time, inputs)[0][0]

    def linearised(self, theta: Array, state: Array, inputs: Array, nominal: Array) -> tuple[Array, Array]:
        """Return the readings (n, Y) and their derivatives (n, Y, P + k) in theta and the node temperatures."""
        p, k = len(theta), self.nodes
        moves = np.zeros((1 + 2 * (p + k), p + k))
        steps = np.concatenate([np.full(p, THETA_STEP), np.full(k, STATE_STEP)])
        moves[1::2], moves[2::2] = np.diag(steps), -np.diag(steps)
        full = self.deviations.full(theta + moves[:, :p], np.asarray(nominal)[None, :])
        states = np.tile(state, (len(moves), 1))
        states[:, :k] += moves[:, p:]
        time = np.arange(len(inputs), dtype=np.float64) * self.step_s
        rows = self.kernel.trace(full, states, time, inputs)[0]
        jacobian = (rows[1::2] - rows[2::2]) / (2.0 * steps[:, None, None])
        return rows[0], np.moveaxis(jacobian, 0, 2)


class _TwinFunction(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        theta: torch.Tensor,
        state: torch.Tensor,
        inputs: torch.Tensor,
        nominal: torch.Tensor,
        run: WindowSimulation,
    ) -> torch.Tensor:
        t, s, u, v = (np.ascontiguousarray(a.detach().cpu().double().numpy()) for a in (theta, state, inputs, nominal))
        wanted = ctx.needs_input_grad[0] or ctx.needs_input_grad[1]
        if wanted:
            both = [run.linearised(*row) for row in zip(t, s, u, v, strict=True)]
            jacobian = np.stack([j for _, j in both])
            ctx.save_for_backward(torch.as_tensor(jacobian, device=theta.device, dtype=theta.dtype))
            ctx.count, ctx.size, ctx.nodes = theta.shape[1], state.shape[1], run.nodes
            out = np.stack([y for y, _ in both])
        else:
            out = np.stack([run.readings(*row) for row in zip(t, s, u, v, strict=True)])
        return torch.as_tensor(out, device=theta.device, dtype=theta.dtype)

    @staticmethod
    def backward(ctx: Any, grad: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        (jacobian,) = ctx.saved_tensors
        both = torch.einsum("bnyq,bny->bq", jacobian, grad)
        theta, state = both[:, : ctx.count], both.new_zeros(len(both), ctx.size)
        state[:, : ctx.nodes] = both[:, ctx.count :]
        return theta, state, None, None, None
