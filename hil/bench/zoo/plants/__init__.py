"""Random thermal plants with equations of their own; nothing here imports `twin`.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.bench.zoo.plants.cells import (
        ABOVE,
        ALWAYS,
        EVAPORATION,
        FLOW,
        GATE,
        HEAT,
        LATCH,
        LINEAR,
        LINK,
        POWER,
        ROOM,
        TRANSFER,
        Array,
        Drive,
        Modifier,
    )
    from hil.bench.zoo.plants.families import DEVELOPMENT, FAMILIES, SEALED, draw_plant
    from hil.bench.zoo.plants.parts import NOTHING, BuiltPart
    from hil.bench.zoo.plants.plant import FAN_COLUMN, ROOM_COLUMN, ROOM_SIGMA_K, ZooPlant
    from hil.bench.zoo.plants.schedules import HOUR_S, KINDS, START_H, Schedule, draw_drive, wander

__all__ = [
    "ABOVE",
    "ALWAYS",
    "DEVELOPMENT",
    "EVAPORATION",
    "FAMILIES",
    "FAN_COLUMN",
    "FLOW",
    "GATE",
    "HEAT",
    "HOUR_S",
    "KINDS",
    "LATCH",
    "LINEAR",
    "LINK",
    "NOTHING",
    "POWER",
    "ROOM",
    "ROOM_COLUMN",
    "ROOM_SIGMA_K",
    "SEALED",
    "START_H",
    "TRANSFER",
    "Array",
    "BuiltPart",
    "Drive",
    "Modifier",
    "Schedule",
    "ZooPlant",
    "draw_drive",
    "draw_plant",
    "wander",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "cells": (
            "ABOVE",
            "ALWAYS",
            "Array",
            "Drive",
            "EVAPORATION",
            "FLOW",
            "GATE",
            "HEAT",
            "LATCH",
            "LINEAR",
            "LINK",
            "Modifier",
            "POWER",
            "ROOM",
            "TRANSFER",
        ),
        "families": (
            "DEVELOPMENT",
            "FAMILIES",
            "SEALED",
            "draw_plant",
        ),
        "parts": (
            "BuiltPart",
            "NOTHING",
        ),
        "plant": (
            "FAN_COLUMN",
            "ZooPlant",
            "ROOM_COLUMN",
            "ROOM_SIGMA_K",
        ),
        "schedules": (
            "HOUR_S",
            "KINDS",
            "START_H",
            "Schedule",
            "draw_drive",
            "wander",
        ),
    },
)
