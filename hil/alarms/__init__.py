"""Alarms of a run (ANSI/ISA-18.2): conditions, states, acts of operators, messages to people.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.alarms.alarm_list import ActName, AlarmList, AlarmRecord, AlarmStatus
    from hil.alarms.definitions import META_KEY, AlarmDefinition, as_document, definitions_of
    from hil.alarms.errors import AlarmError, NotSentError
    from hil.alarms.notify import NotifyOptions, notify_run, read_addresses
    from hil.alarms.show import alarm_document, alarm_lines, condition_of, value_of
    from hil.alarms.states import ACTIVE, SHELVED, WAITING, AlarmEvent, AlarmState
    from hil.alarms.watch import AlarmWatch

__all__ = [
    "ACTIVE",
    "META_KEY",
    "SHELVED",
    "WAITING",
    "ActName",
    "AlarmDefinition",
    "AlarmError",
    "AlarmEvent",
    "AlarmList",
    "AlarmRecord",
    "AlarmState",
    "AlarmStatus",
    "AlarmWatch",
    "NotSentError",
    "NotifyOptions",
    "alarm_document",
    "alarm_lines",
    "as_document",
    "condition_of",
    "definitions_of",
    "notify_run",
    "read_addresses",
    "value_of",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "alarm_list": ("ActName", "AlarmList", "AlarmRecord", "AlarmStatus"),
        "definitions": ("META_KEY", "AlarmDefinition", "as_document", "definitions_of"),
        "errors": ("AlarmError", "NotSentError"),
        "notify": ("NotifyOptions", "notify_run", "read_addresses"),
        "show": ("alarm_document", "alarm_lines", "condition_of", "value_of"),
        "states": ("ACTIVE", "SHELVED", "WAITING", "AlarmEvent", "AlarmState"),
        "watch": ("AlarmWatch",),
    },
)
