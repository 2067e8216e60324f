"""Kinds of attack of the chaos campaign: each with its act and its required outcome.

Nobody but the rig's watchdog or a person can cut the heater where the device does not apply its set-point, or where
harness and guardian are gone at once. These kinds have requirements of their own.
"""

from __future__ import annotations

import signal
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from drivers.virtual.devices import HEATER_SET, PUMP_SET
from hil.bench.chaos import acts, control
from hil.bench.chaos.acts import Act

Ending = Literal["rides", "either", "pauses", "stops", "killed", "frozen", "unguarded", "lies"]
"""Endings: the run goes on; goes on or ends; is made safe and goes on; ends by itself; is gone; stands still for ever;
is gone with its guardian; ends on a device that does not obey. From the mildest to the gravest.
"""
SEVERITY: tuple[Ending, ...] = ("rides", "either", "pauses", "stops", "frozen", "killed", "unguarded", "lies")


@dataclass(frozen=True, slots=True)
class ChaosKind:
    """Kind of attack of the chaos campaign.

    Two kinds of one `group` make no pair. `needs`: `pipe` or `pty` for a terminal of that type, `tmpfs` for a disk of
    its own, `twin` for a calibrator, `device` for a relay that can lie, `clock` for a wall clock of its own. `disables`
    names the agents that cannot act any more. `early`: it may come before anything heats. `spoils`: record and report
    cannot be demanded. `alarm`: an event of level WARN or ERROR with one of these words must be recorded within
    `verdict.ALARM_S`. `last` is the signal that ends a run which rode through. `watched`: only with the rig's watchdog.
    `deletes`: it needs a folder in which files can be deleted; `protects`: afterwards none can.
    """

    about: str
    ending: Ending
    act: Act
    group: str
    needs: frozenset[str] = frozenset()
    disables: frozenset[str] = frozenset()
    early: bool = False
    spoils: bool = False
    alarm: tuple[str, ...] = ()
    last: signal.Signals = signal.SIGTERM
    watched: bool = False
    deletes: bool = False
    protects: bool = False
    alone: bool = False
    """True for a kind that makes no pair."""
    status: str = ""
    """Exit status that the run must record after this kind alone; any but `running` if empty."""


def gravest(endings: Iterable[Ending]) -> Ending:
    """Return the gravest of `endings`."""
    return max(endings, key=SEVERITY.index)


_HARNESS, _GUARDIAN = frozenset({"harness"}), frozenset({"guardian"})
_PIPE, _PTY, _DEVICE, _TWIN = (frozenset({need}) for need in ("pipe", "pty", "device", "twin"))

CHAOS_KINDS: dict[str, ChaosKind] = {
    "harness killed": ChaosKind(
        "kill -9 of the harness",
        "killed",
        acts.sent(signal.SIGKILL),
        "process",
        disables=_HARNESS,
        early=True,
        spoils=True,
    ),
    "guardian killed": ChaosKind(
        "kill -9 of the guardian",
        "stops",
        acts.guardian_sent(signal.SIGKILL),
        "guardian",
        disables=_GUARDIAN,
        status="faulted",
    ),
    "guardian stopped": ChaosKind(
        "SIGSTOP of the guardian, for ever",
        "either",
        acts.guardian_sent(signal.SIGSTOP),
        "guardian",
        disables=_GUARDIAN,
    ),
    "both killed": ChaosKind(
        "kill -9 of harness and guardian at once; the rig's watchdog is on",
        "unguarded",
        acts.all_killed,
        "process",
        disables=_HARNESS | _GUARDIAN,
        spoils=True,
        watched=True,
        alone=True,
    ),
    "stopped": ChaosKind(
        "SIGSTOP of the harness, for ever",
        "frozen",
        acts.sent(signal.SIGSTOP),
        "process",
        disables=_HARNESS,
        early=True,
        spoils=True,
    ),
    "stopped, brief": ChaosKind("SIGSTOP for 0.3 to 0.7 s", "rides", acts.paused(acts.BRIEF_S), "process"),
    "stopped and continued": ChaosKind(
        "SIGSTOP for 1.5 to 6 s",
        "stops",
        acts.paused(acts.LONG_S),
        "process",
        disables=_HARNESS,
        status="faulted",
    ),
    "all stopped and continued": ChaosKind(
        "SIGSTOP of harness and guardian for 1.8 to 6 s, as a paused machine; safe counts from the continuation",
        "stops",
        acts.paused(acts.ALL_LONG_S, everything=True),
        "process",
        disables=_HARNESS,
        status="faulted",
    ),
    "SIGTERM": ChaosKind("at any instant", "stops", acts.sent(signal.SIGTERM), "signal", early=True),
    "SIGINT": ChaosKind("the same", "stops", acts.sent(signal.SIGINT), "signal", early=True),
    "SIGHUP": ChaosKind("the same", "stops", acts.sent(signal.SIGHUP), "signal", early=True),
    "reader gone": ChaosKind(
        "the reader of the pipe ends (tee), later Ctrl-C",
        "rides",
        acts.reader_gone,
        "terminal",
        needs=_PIPE,
        last=signal.SIGINT,
    ),
    "reader stops": ChaosKind(
        "the reader of the pipe reads no more, later SIGTERM",
        "rides",
        acts.reader_stops,
        "terminal",
        needs=_PIPE,
    ),
    "Ctrl-S": ChaosKind("the terminal is stopped, later SIGTERM", "rides", acts.ctrl_s, "terminal", needs=_PTY),
    "terminal lost": ChaosKind(
        "the terminal goes and SIGHUP comes (ssh drops)",
        "stops",
        acts.terminal_lost,
        "terminal",
        needs=_PTY,
    ),
    "journal locked": ChaosKind(
        "write lock held for 1 to 10 s, SIGTERM meanwhile or later",
        "rides",
        acts.journal_locked,
        "files",
    ),
    "folder deleted": ChaosKind("rm -r of the run's folder", "stops", acts.folder_deleted, "files", spoils=True),
    "folder renamed": ChaosKind("mv of the run's folder", "either", acts.folder_renamed, "files", spoils=True),
    "folder read-only": ChaosKind(
        "nothing can be made or renamed in it",
        "either",
        acts.folder_read_only,
        "files",
        spoils=True,
        protects=True,
    ),
    "journal deleted": ChaosKind(
        "journal.sqlite and its log deleted",
        "stops",
        acts.deleted("journal.sqlite*", samples=True),
        "files",
        spoils=True,
        deletes=True,
    ),
    "socket deleted": ChaosKind("control.sock deleted", "rides", acts.deleted("control.sock"), "control", deletes=True),
    "guardian's file deleted": ChaosKind(
        "guardian.* deleted", "rides", acts.deleted("guardian*"), "guardian file", deletes=True
    ),
    "disk full": ChaosKind(
        "no byte can be written any more",
        "stops",
        acts.disk_full,
        "files",
        needs=frozenset({"tmpfs"}),
        spoils=True,
    ),
    "descriptors gone": ChaosKind(
        "no descriptor can be opened, and the link drops for 0.05 to 0.3 s",
        "either",
        acts.descriptors_gone,
        "limits",
        disables=_HARNESS,
        spoils=True,
    ),
    "memory gone": ChaosKind(
        "2 to 12 MB of address space left",
        "either",
        acts.memory_gone,
        "limits",
        disables=_HARNESS,
        spoils=True,
    ),
    "connections leaked": ChaosKind("300 connections to control.sock", "rides", control.leaked, "control"),
    "connections and descriptors": ChaosKind(
        "the same with room for 40, and the link drops for 0.05 to 0.3 s",
        "either",
        control.leaked_all,
        "limits",
        disables=_HARNESS,
        spoils=True,
    ),
    "control garbage": ChaosKind("what no client sends, up to 1 MB a line", "rides", control.garbage, "control"),
    "control flood": ChaosKind("status asked for 2 s, no answer read", "rides", control.flood, "control"),
    "abort, odd reason": ChaosKind(
        "reason with lone surrogates, NUL, line ends, escapes",
        "stops",
        control.asked("abort"),
        "control",
    ),
    "pause, odd reason": ChaosKind("the same", "pauses", control.asked("pause"), "control"),
    "hold, odd reason": ChaosKind("the same", "rides", control.asked("hold"), "control"),
    "calibrator killed": ChaosKind(
        "kill -9 of the calibrators' process",
        "rides",
        acts.calibrator_sent(signal.SIGKILL),
        "child",
        needs=_TWIN,
    ),
    "calibrator stopped": ChaosKind(
        "SIGSTOP of it, until the heater is off",
        "rides",
        acts.calibrator_sent(signal.SIGSTOP),
        "child",
        needs=_TWIN,
    ),
    "clock stepped": ChaosKind(
        "the run's wall clock set by 10 min to 10 years, either way",
        "rides",
        acts.clock_stepped,
        "clock",
        needs=frozenset({"clock"}),
    ),
    "link drop, brief": ChaosKind(
        "Modbus connection reset, port gone for 0.05 to 0.3 s",
        "rides",
        acts.link_blip,
        "wire",
    ),
    "second master, heater": ChaosKind(
        "another master writes 200 W, up to four times in 0.2 s",
        "either",
        acts.second_master(HEATER_SET, 2000, acts.FOREIGN_ONCE_S, heats=True),
        "rig",
    ),
    "second master, pump": ChaosKind(
        "another master stops the pump every 0.05 s for 1.5 to 3 s",
        "either",
        acts.second_master(PUMP_SET, 0, acts.FOREIGN_ON_S),
        "rig",
        alarm=("master", "pump_speed_set"),
    ),
    "device acknowledges only": ChaosKind(
        "heater set-points acknowledged, not applied; later SIGTERM",
        "lies",
        acts.device_is("echo"),
        "rig",
        needs=_DEVICE,
    ),
    "device lies": ChaosKind(
        "the same, and read back as asked",
        "lies",
        acts.device_is("lie"),
        "rig",
        needs=_DEVICE,
    ),
    "device is slow": ChaosKind(
        "heater set-points applied 3 s later",
        "lies",
        acts.device_is("delay"),
        "rig",
        needs=_DEVICE,
    ),
    "device swallows heartbeats": ChaosKind(
        "heartbeats acknowledged, not applied",
        "either",
        acts.device_is("deaf"),
        "rig",
        needs=_DEVICE,
    ),
}
