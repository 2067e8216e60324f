"""Fault campaign: seeded faults of wires, rig and harness.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.bench.faults.campaign import fingerprint, hear_signals
    from hil.bench.faults.case import STALL_S
    from hil.bench.faults.disk import OwnDisk
    from hil.bench.faults.kinds import KINDS
    from hil.bench.faults.places import take_places_out, without_places
    from hil.bench.faults.rig import ABORT_AFTER_S, LOAD, PERIOD_S, WATCHDOG_S, prepare, rig_text
    from hil.bench.faults.stage import FANS_PCT, LOOK_EVERY_S, ROOT, Harness, Stage, last_words

__all__ = [
    "ABORT_AFTER_S",
    "FANS_PCT",
    "KINDS",
    "LOAD",
    "LOOK_EVERY_S",
    "PERIOD_S",
    "ROOT",
    "STALL_S",
    "WATCHDOG_S",
    "Harness",
    "OwnDisk",
    "Stage",
    "campaign",
    "fingerprint",
    "hear_signals",
    "judge",
    "last_words",
    "prepare",
    "rig_text",
    "take_places_out",
    "without_places",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "": (
            "campaign",
            "judge",
        ),
        "campaign": ("fingerprint", "hear_signals"),
        "case": ("STALL_S",),
        "disk": ("OwnDisk",),
        "kinds": ("KINDS",),
        "places": (
            "take_places_out",
            "without_places",
        ),
        "rig": (
            "ABORT_AFTER_S",
            "LOAD",
            "PERIOD_S",
            "WATCHDOG_S",
            "prepare",
            "rig_text",
        ),
        "stage": (
            "FANS_PCT",
            "Harness",
            "LOOK_EVERY_S",
            "ROOT",
            "Stage",
            "last_words",
        ),
    },
)
