"""Undeclared effects: physics that the plant has, that its documents do not name and a clean twin lacks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.virtual.tower.physics import HIDDEN
from drivers.virtual.tower.sites import StationDesign

EFFECTS = {
    "recirculation": "exhaust comes back with the wind from one direction",
    "bypass_leak": "hot water of one cell leaks past its fill",
    "neighbour": "exhaust of the neighbours enters as their fans run",
    "solar": "the sun warms the water of the open channels",
}


SHARE_WIND_M_S = 5.0
"""Wind at which the key gives the share of exhaust that comes back, m/s."""


def hidden_effects(
    names: Sequence[str], site: StationDesign, recorded: int, rng: np.random.Generator
) -> tuple[NDArray[np.float64], dict[str, object]]:
    """Return the plant's row of undeclared effects, drawn by `rng`, and the answer for scoring.

    Raises
    ------
    ValueError
        A name is not in `EFFECTS`.
    """
    row = np.zeros(len(HIDDEN))
    at = HIDDEN.index
    row[at("leaking_cell")] = -1.0
    answers: list[dict[str, object]] = []
    # All are drawn, so that one effect does not change another.
    size, direction = rng.uniform(0.018, 0.032), float(10 * rng.integers(0, 36))
    near = (site.climate.prevailing + rng.choice([-30.0, 0.0, 30.0])) % 360.0
    direction = near if rng.random() < 0.7 else direction
    leak, cell = rng.uniform(0.03, 0.06), int(rng.integers(recorded))
    sun, neighbour = rng.uniform(0.3, 0.5) * site.water / 250.0, rng.uniform(0.05, 0.09)
    for name in names:
        if name == "recirculation":
            row[at("recirculation")], row[at("direction")] = size, direction
            share = round(SHARE_WIND_M_S * size, 4)
            answers.append(
                {"kind": "recirculation", "driver": "wind_direction", "from_deg": direction, "share_at_5_m_s": share}
            )
        elif name == "bypass_leak":
            row[at("leak")], row[at("leaking_cell")] = leak, cell
            answers.append({"kind": "bypass_leak", "driver": "bypass", "cell": cell + 1})
        elif name == "neighbour":
            row[at("neighbour")] = neighbour
            answers.append({"kind": "neighbour", "driver": "neighbours_speed"})
        elif name == "solar":
            row[at("sun")] = sun
            answers.append({"kind": "solar", "driver": "solar"})
        else:
            raise ValueError(f"no effect is called {name!r}; those that can be hidden are {', '.join(EFFECTS)}")
    if not answers:
        return row, {"kind": "none"}
    return row, answers[0] | ({"further": answers[1:]} if len(answers) > 1 else {})
