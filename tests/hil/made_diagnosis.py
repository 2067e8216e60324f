"""A diagnosis made by hand: three sensors of which one reads nothing good for a while, one effect, two others."""

from __future__ import annotations

import numpy as np

from twin.discovery.diagnosis import Alternative, Course, Diagnosis, Effect, Fold, Moved, Rung, SensorError
from twin.network import Network

SENSORS = ("T_heater_C", "T_modules_C", "T_tank_C")
SAYS = "The modules give off 180 W that the twin does not know of, since 2 h 00 min"


def effect(value: float = 180.0, where: str = "modules", onset_s: float = 7200.0, confidence: float = 0.97) -> Effect:
    return Effect(
        "heat_source",
        where,
        "constant",
        "new",
        value,
        "W",
        (value - 4.0, value + 4.0),
        onset_s,
        (onset_s - 60.0, onset_s + 60.0),
        "step",
        confidence,
        41.0,
        "with it 99 % of the mismatch is gone",
        0.0,
        SAYS,
        1e-9,
    )


def made(
    verdict: str = "effect found",
    effects: tuple[Effect, ...] | None = None,
    errors: dict[str, SensorError] | None = None,
    network: Network | None = None,
    summary: str = SAYS + ".",
) -> Diagnosis:
    hours = np.arange(60) / 6.0
    shape = np.where(hours > 2.0, 1.0 - np.exp(-(hours - 2.0)), 0.0)
    residual = np.stack([2.0 * shape, 4.0 * shape, 2.0 * shape], axis=1)
    residual[10:14, 2] = np.nan
    sd = np.full(60, 6.0)
    given = effects if effects is not None else (effect(),) if verdict != "adequate" else ()
    return Diagnosis(
        verdict=verdict,  # type: ignore[arg-type]
        summary=summary,
        effects=given,
        indistinguishable=(Alternative("heat_source", "heater", "constant", 0.2),),
        alternatives=(Alternative("sensor", "T_tank_C", "constant", 1e-4, "explains 12 % of the mismatch"),),
        held_out_s=(27000.0, 36000.0),
        errors=errors
        or {name: SensorError(3.0, 1.0, 0.06, 0.05, (3.0, 1.0, 0.02)) for name in SENSORS[:2]}
        | {SENSORS[2]: SensorError(3.0, 1.0, 0.06, 0.05)},
        moved=(Moved("tank.capacitance", 1.6e5, 2.8e5, 1.59e5, "J/K", 20.9, -0.2),),
        blind_spots=("two things look alike",),
        ladder=(Rung("as commissioned", 58.0, 236.0), Rung("heat_source at modules", 0.08, 1.7)),
        courses=(
            Course("modules", "W", hours, 180.0 * (hours > 2.0), sd, 900.0),
            Course("T_tank_C", "K", hours, 0.5 * shape, sd / 100.0, 100.0),
        ),
        hours=hours,
        residual=residual,
        residual_after=residual / 100.0,
        band=np.array([0.05, 0.02, 0.05]),
        network=network,
        folds=tuple(
            Fold(9000.0 * k, 9000.0 * (k + 1), 45, gain) for k, gain in enumerate((-4.0, 210.0, 3900.0, 4100.0))
        ),
        threshold=4.8,
    )
