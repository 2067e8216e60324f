"""Binding of a network to a twin: its sizes, its identity, and the physics that training needs."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from twin.calibrators.hiera_unet.context_fit import evidence
from twin.calibrators.hiera_unet.data.channels import ChannelTable
from twin.calibrators.hiera_unet.data.parameters import REACH, Deviations, kernel_of, rated_power
from twin.calibrators.hiera_unet.data.regimes import COUNT
from twin.calibrators.hiera_unet.data.series import STEP_S
from twin.calibrators.hiera_unet.data.subject import Channel, Deviation, Output, Subject
from twin.calibrators.hiera_unet.data.windows import CONTEXT, TARGET, Windows
from twin.calibrators.hiera_unet.model.config import Config
from twin.calibrators.hiera_unet.simulated.store import structure
from twin.calibrators.hiera_unet.training.balance import balance_of
from twin.calibrators.hiera_unet.training.train import Physics
from twin.calibrators.hiera_unet.training.twin_layer import TwinLayer
from twin.calibrators.hiera_unet.weights.checkpoint import Identity
from twin.network import Network


def subject_of(network: Network, table: ChannelTable, deviations: Deviations) -> Subject:
    """Return the subject of a rig: its channels, deviations and outputs, as `tower.table.SUBJECT` is that of a cell."""
    told = set(table.indices("y", "r").tolist())
    return Subject(
        name=table.name,
        step_s=STEP_S,
        channels=tuple(Channel(c.name, c.group, c.unit, k in told) for k, c in enumerate(table.channels)),
        regimes=COUNT,
        outputs=tuple(Output(name, "degC", network.rules.calibrated_K) for name in network.sensor_names),
        deviations=tuple(
            Deviation(name, "1", REACH, float(sd)) for name, sd in zip(deviations.ids, deviations.prior_sd, strict=True)
        ),
        # The fit's two own numbers stand before its figures of each deviation and the condition number.
        statics=len(table.figures) + evidence.tokens(0) - 1,
        context=CONTEXT,
        target=TARGET,
    )


def config_for(name: str, network: Network, table: ChannelTable, deviations: Deviations) -> Config:
    """Return configuration ``full`` or ``small`` with the sizes of a twin and its channel table.

    Raises:
        HieraError: no such configuration.
    """
    return subject_of(network, table, deviations).config(name)


def identity_of(network: Network, table: ChannelTable, deviations: Deviations) -> Identity:
    """Return the identity of weights that are trained for this twin and table."""
    return Identity(structure(network), table.digest, deviations.ids, network.sensor_names)


def physics_of(network: Network, table: ChannelTable, deviations: Deviations) -> Physics:
    """Return the twin as a layer, its energy balance, and the channels that reveal the answer."""
    layer = TwinLayer(kernel_of(network, deviations.ids), deviations)

    def simulate(theta: Tensor, rows: Windows) -> Tensor:
        state, inputs, nominal = (
            torch.from_numpy(np.ascontiguousarray(a)) for a in (rows.state, rows.inputs, rows.nominal)
        )
        out: Tensor = layer(theta, state, inputs, nominal)
        return out

    told = np.array(subject_of(network, table, deviations).told)
    return Physics(simulate, told, balance_of(network), rated_power(network))
