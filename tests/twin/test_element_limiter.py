"""Limit of an actuator: beside the actuator's own faults, and where it is refused."""

from __future__ import annotations

import numpy as np
import pytest

from tests.twin.two_nodes import U, heat, network
from twin.network import TwinFileError

ACTUATOR = '[elements.act]\nkind="actuator"\ncolumn="heater_power_W"\n'
POWER = '[elements.p]\nkind="heat_source"\nnode="a"\ndriver="heater_power_W"\n'


def limit(share: float, level: float) -> str:
    return f'[elements.l]\nkind="limiter"\ncolumn="heater_power_W"\nshare={share}\noffset={share * level}\n'


@pytest.mark.parametrize(
    ("share", "power", "delivered"), [(1.0, 900.0, 600.0), (0.5, 900.0, 750.0), (1.0, 500.0, 500.0)]
)
def test_what_is_above_the_level_is_missing(share: float, power: float, delivered: float) -> None:
    inputs = np.where(np.arange(len(U)) == 0, power, U)
    limited = heat(ACTUATOR + POWER + limit(share, 600.0), (40.0, 30.0), inputs)
    plain = heat(POWER, (40.0, 30.0), np.where(np.arange(len(U)) == 0, delivered, U))
    assert limited == pytest.approx(plain, abs=1e-9)


def test_a_limit_acts_on_what_a_faulty_actuator_would_deliver() -> None:
    inputs = np.where(np.arange(len(U)) == 0, 900.0, U)
    weak = heat(ACTUATOR + "gain=0.5\n" + POWER + limit(1.0, 600.0), (40.0, 30.0), inputs)
    assert weak == pytest.approx(heat(ACTUATOR + "gain=0.5\n" + POWER, (40.0, 30.0), inputs), abs=1e-9)


def test_a_limit_needs_an_actuator() -> None:
    with pytest.raises(TwinFileError, match="has no actuator to change"):
        network(POWER + limit(1.0, 600.0))
