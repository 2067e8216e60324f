"""Guardian process: it waits for the engine's beats, and makes the rig safe by its own connection when they stop.

The process runs as `python -I -S` with the standard library alone. It has one socket to the engine, a line a message:

    from the engine   {plan}  probe  watch  beat  check  act  done
    to the engine     alive  {"probe": ...}  {"checked": ...}  {"acted": ...}

`watch` arms it. From then on it acts when no beat has come for `silence_s`, when the socket closes, or on `act`. It
acts until the safe values are read back and the meters agree, and then keeps them until the engine sends `done` or is
gone. Its actions are in a log of its own, a JSON object a line.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import socket
import struct
import sys
import threading
import time
from typing import Any

from hil.guardian.wires import BlockingWire, ExceptionReply, WireError

POLL_S = 0.1
"""Longest wait for a message of the engine, s."""
ALIVE_EVERY_S = 0.25
"""Interval of `alive` messages, s."""
PAUSED_AFTER_S = 0.3
"""Excess of a wait, s, that means that this process was paused, and perhaps the engine with it."""
GRACE_S = 0.5
"""Time for the engine to beat again after a pause of the guardian, s."""
RETRY_S = 0.05
"""Wait between two attempts to make a wire safe, s."""
KEEP_S = 0.25
"""Interval of checks of the safe values while a silent engine still exists, s."""
FREE_AFTER_S = 0.4
"""Time of attempts, s, before the silent engine is ended: its connection may be the only one that the device admits."""
GIVE_UP_S = 3600.0
"""Time of attempts without an engine, s, after which the guardian ends."""
METER_GIVE_UP_S = 60.0
"""Time, s, after which the guardian ends where only a meter contradicts the safe values that were read back. It counts
from the end of the time that the rig file gives the meter; nothing more can be written."""
SETTLE_S = 1.0
"""Time, s, for which a guardian that has acted checks a rig whose engine has ended in order: an attempt that was under
way meanwhile says nothing about the end."""
STANDBY_S = 5.0
"""Interval of reads that keep a connection open, s: devices close those that are idle for some ten seconds."""
_FAULT_SIGNALS = (signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGABRT, signal.SIGTRAP)
_FORMATS = {
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}


def now_s() -> float:
    """Return a time, s, that also advances while the machine sleeps."""
    return time.clock_gettime(getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC))


class GuardianLog:
    """Log file of the guardian, opened before arming: a lost folder or a full disk cannot stop the guardian."""

    def __init__(self, path: str) -> None:
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW, 0o600)
        except OSError:
            self._file = -1

    def write(self, what: str, **more: object) -> None:
        """Append a line; errors of the disk are ignored."""
        stamp = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        line = (
            json.dumps({"time": stamp, "wall_s": round(time.time(), 3), "what": what, **more}, ensure_ascii=True) + "\n"
        )
        try:
            if self._file >= 0:
                os.write(self._file, line.encode())
        except OSError:
            pass


class SafeStateKeeper(threading.Thread):
    """Thread that makes one wire safe and keeps it safe. `safe` is the result of the last check, `problem` the reason.

    Until `acting` is set it only keeps the connection of `wire` open, where one is given. A device that takes no
    request for a while after connecting could otherwise not be made safe in time.
    """

    def __init__(self, plan: dict[str, Any], free: Any, wire: BlockingWire | None = None) -> None:
        super().__init__(daemon=True, name=plan["place"])
        self.safe = False
        self.problem = f"{plan['place']}: the first attempt is under way"
        self.meters: dict[str, float] = {}
        self.held = False
        self.ended = threading.Event()
        self.acting = threading.Event()
        self.may_open = threading.Event()
        self._plan = plan
        self._free = free
        self._wire = wire

    def run(self) -> None:
        """Write, read back and check the meters until `ended`; end the silent engine where it occupies the line."""
        wire = self._wire or BlockingWire(self._plan)
        self._stand_by(wire)
        self.may_open.wait()
        began = now_s()
        while not self.ended.is_set():
            try:
                self.problem = self._attempt(wire)
            except Exception as error:
                self.problem = str(error) or type(error).__name__
                wire.close()
            if not self.held and now_s() - began > FREE_AFTER_S:
                self._free(self._plan["place"])
            self.safe = not self.problem
            self.ended.wait(KEEP_S if self.safe else RETRY_S)
        wire.close()

    def _stand_by(self, wire: BlockingWire) -> None:
        """Keep the connection open until `acting`; open it anew where the device has closed it."""
        while not self.acting.wait(STANDBY_S):
            with contextlib.suppress(Exception):
                _registers(wire, self._plan["checks"][0])

    def end(self) -> None:
        """End the thread, also while it waits."""
        for event in (self.ended, self.acting, self.may_open):
            event.set()

    def _attempt(self, wire: BlockingWire) -> str:
        """Write if that is needed; return the differences from the safe values as text, "" for none."""
        wrong: list[str] = []
        if not self.safe:
            # Each output is written, also after errors of others; the read-back decides. The order holds while devices
            # answer: once one is mute, heaters come next, and what is mute comes last.
            pending, mute = list(self._plan["writes"]), set()
            while pending:
                step = pending.pop(0)
                try:
                    wire.ask(step["device"], bytes.fromhex(step["pdu"]))
                except ExceptionReply:
                    continue
                except WireError:
                    mute.add(step["device"])
                    pending.sort(key=lambda other: (other["device"] in mute, not other["heater"]))
        for check in self._plan["checks"]:
            try:
                wrong += [difference for difference in [_difference(wire, check)] if difference]
            except WireError as error:
                wrong.append(str(error))
        self.held = not wrong
        if wrong:
            self.safe = False
            return "; ".join(dict.fromkeys(wrong))
        return "; ".join(found for meter in self._plan["meters"] if (found := self._meter_problem(wire, meter)))

    def _meter_problem(self, wire: BlockingWire, meter: dict[str, Any]) -> str:
        raw = number(_registers(wire, meter), meter)
        value = raw * meter["scale"] + meter["offset"]
        if value != value or raw in meter["invalid"]:
            return f"{meter['name']} has no valid reading"
        self.meters[meter["name"]] = round(value, 3)
        if abs(value) <= meter["limit"]:
            return ""
        return f"{meter['name']} still reads {value:.1f} {meter['unit']}"


def probe(plan: dict[str, Any]) -> tuple[str, BlockingWire | None]:
    """Return why the guardian cannot reach a wire beside the engine, or ""; nothing is written.

    The second item is the connection, kept open where the device takes no request for a while after connecting. A
    serial line is not touched: the guardian would take the replies to the engine's requests.
    """
    if plan["kind"] == "serial":
        return f"{plan['place']}: a serial line has one master", None
    wire = BlockingWire(plan)
    try:
        for check in plan["checks"]:
            _registers(wire, check)
    except WireError as error:
        wire.close()
        return str(error), None
    if plan["connect_delay_s"] > 0.0:
        return "", wire
    wire.close()
    return "", None


def _registers(wire: BlockingWire, step: dict[str, Any]) -> list[int]:
    reply = wire.ask(step["device"], bytes.fromhex(step["pdu"]))
    if step["type"] == "bit":
        return [reply[2] & 1]
    return list(struct.unpack_from(f">{step['words']}H", reply, 2))


def _difference(wire: BlockingWire, check: dict[str, Any]) -> str:
    """Return the difference of a read-back from its safe value as text; "" up to half a count."""
    found = _registers(wire, check)
    if found == check["want"]:
        return ""
    held, want = number(found, check), number(check["want"], check)
    if abs(held - want) <= 0.5:
        return ""
    return f"{check['name']} holds {held * check['scale'] + check['offset']:g}"


def number(registers: list[int], step: dict[str, Any]) -> float:
    """Return the raw number in `registers` (16 bits each), by type and byte order of the plan."""
    if step["type"] == "bit":
        return float(registers[0])
    words = list(registers)
    if step["order"] in ("CDAB", "DCBA"):
        words.reverse()
    packed = struct.pack(f"{'<' if step['order'] in ('BADC', 'DCBA') else '>'}{len(words)}H", *words)
    if step["type"] == "bool":
        return float(any(packed))
    value = struct.unpack(">" + _FORMATS[step["type"]], packed)[0]
    if step["bits"]:
        lowest, highest = step["bits"]
        value = value >> lowest & (1 << highest - lowest + 1) - 1
    return float(value)


class GuardianProcess:
    """State of the guardian's process: the engine's socket, the plan, and the keepers once it acts."""

    def __init__(self, engine: socket.socket, pid: int) -> None:
        self._engine: socket.socket | None = engine
        self._pid = pid
        self._buffer = b""
        self._plan: dict[str, Any] = {}
        self._exclusive: list[bool] = []
        self._log = GuardianLog(os.devnull)
        self._armed = False
        self._done = self._is_in_order = False
        self._beat_s = now_s()
        self._silent = False
        self._reason = self._reported = ""
        self._acted_s = 0.0
        self._keepers: dict[str, SafeStateKeeper] = {}

    def run(self) -> None:
        """Wait and act until the rig is safe without an engine that could change it, or until the end without
        arming."""
        alive_s = 0.0
        while not self._done and (self._engine is not None or self._armed):
            asked = now_s()
            self._receive(POLL_S)
            woke = now_s()
            if woke - asked > POLL_S + PAUSED_AFTER_S and self._armed and not self._reason:
                self._log.write("paused", seconds=round(woke - asked, 2))
                self._beat_s = max(self._beat_s, woke - self._plan["silence_s"] + GRACE_S)
            if woke - alive_s > ALIVE_EVERY_S:
                self._send(b"alive")
                alive_s = woke
            if self._armed and not self._done:
                self._watch()
        if self._is_in_order:
            self._settle()
        for keeper in self._keepers.values():
            keeper.end()
        for keeper in self._keepers.values():
            keeper.join(1.0)
        self._log.write("ended")

    def _settle(self) -> None:
        """Report the rig that an engine leaves behind, once each wire that is open to the guardian was checked."""
        self._silent = False  # the engine has just spoken: its connections are its own
        until = now_s() + SETTLE_S
        keepers = [keeper for keeper in self._keepers.values() if keeper.may_open.is_set()]
        while self._reason and now_s() < until and not all(keeper.safe for keeper in keepers):
            time.sleep(RETRY_S)
        if self._reason:
            self._report()
        self._log.write("done", reason="the engine has ended in order")

    def _watch(self) -> None:
        silence_s = now_s() - self._beat_s
        self._silent = self._engine is None or silence_s > self._plan["silence_s"]
        if not self._reason:
            if self._engine is None:
                self._act("the engine is gone")
            elif self._silent:
                self._act(f"no beat of the engine for {self._plan['silence_s']:g} s")
            return
        for plan, exclusive in zip(self._plan["wires"], self._exclusive, strict=True):
            keeper = self._keepers[plan["place"]]
            if exclusive and self._silent:
                self.free(keeper.name)
            if not exclusive or self._engine is None:
                keeper.may_open.set()
            elif not keeper.may_open.is_set():
                keeper.problem = f"{keeper.name}: the engine holds the only connection, so that the guardian waits"
        self._report()

    def _act(self, reason: str) -> None:
        self._reason, self._acted_s, self._reported = reason, now_s(), ""
        self._log.write("acting", reason=reason)
        for plan in self._plan["wires"]:
            self._keeper(plan).acting.set()
        self._watch()

    def _keeper(self, plan: dict[str, Any], wire: BlockingWire | None = None) -> SafeStateKeeper:
        """Return the keeper of a wire; start it if there is none."""
        keeper = self._keepers.get(plan["place"])
        if keeper is None:
            keeper = self._keepers[plan["place"]] = SafeStateKeeper(plan, self.free, wire)
            keeper.start()
        elif wire is not None:
            wire.close()
        return keeper

    def _report(self) -> None:
        """Log and send a changed result; end where the engine is gone and the rig is safe, or the time is over."""
        keepers = list(self._keepers.values())
        problems = [keeper.problem for keeper in keepers if not keeper.safe]
        meters = {name: value for keeper in keepers for name, value in list(keeper.meters.items())}
        result = "; ".join(problems) or "safe"
        took_s = round(now_s() - self._acted_s, 3)
        if result != self._reported:
            self._reported = result
            self._log.write(
                "safe" if not problems else "not safe", problem="; ".join(problems), after_s=took_s, meters=meters
            )
            acted = {"reason": self._reason, "safe": not problems, "problem": "; ".join(problems), "meters": meters}
            self._send(json.dumps({"acted": acted}, ensure_ascii=True).encode())
        gone = self._engine is None
        held = all(keeper.held for keeper in keepers)
        if gone and problems and took_s > (METER_GIVE_UP_S + self._falls_within_s() if held else GIVE_UP_S):
            self._log.write("gave up", problem="; ".join(problems), after_s=took_s)
        elif not gone or problems:
            return
        self._done = True

    def _falls_within_s(self) -> float:
        """Return the longest time that the rig file gives a meter to fall, s of real time."""
        return max((meter["within_s"] for plan in self._plan["wires"] for meter in plan["meters"]), default=0.0)

    def free(self, place: str) -> None:
        """End a silent engine that still exists: it may hold the only connection, and must not write any more."""
        if self._silent and self._engine is not None and os.getppid() == self._pid:
            self._log.write("ended the engine", pid=self._pid, wire=place)
            with contextlib.suppress(OSError):
                os.kill(self._pid, signal.SIGKILL)

    def _receive(self, seconds: float) -> None:
        if self._engine is None:
            time.sleep(seconds)
            return
        if not select.select([self._engine], [], [], seconds)[0]:
            return
        try:
            data = self._engine.recv(65536)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._engine.close()
            self._engine = None
            return
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        for line in lines:
            self._handle(line)

    def _handle(self, line: bytes) -> None:
        if line == b"beat":
            self._beat_s = now_s()
        elif line == b"check":
            self._beat_s = now_s()
            self._send(json.dumps({"checked": not self._reason}).encode())
        elif line == b"watch":
            self._armed, self._beat_s = bool(self._plan), now_s()
            self._log.write("watching", pid=self._pid)
        elif line == b"act":
            if self._armed and not self._reason:
                self._act("the engine asked for it")
        elif line == b"probe":
            found = []
            for plan in self._plan["wires"]:
                why, wire = probe(plan)
                found.append(why)
                if wire is not None:
                    self._keeper(plan, wire)
            self._exclusive = [self._exclusive[k] or bool(why) for k, why in enumerate(found)]
            self._log.write("probe", problems=[why for why in found if why])
            self._send(json.dumps({"probe": found}, ensure_ascii=True).encode())
        elif line == b"done":
            self._done = self._is_in_order = True
        elif line.startswith(b"{"):
            self._plan = json.loads(line)
            # A serial line has one master: it is not touched while the engine may use it.
            self._exclusive = [wire["kind"] == "serial" for wire in self._plan["wires"]]
            self._log = GuardianLog(self._plan["log"])

    def _send(self, line: bytes) -> None:
        if self._engine is None:
            return
        with contextlib.suppress(OSError):  # an engine that is stopped does not read
            self._engine.send(line + b"\n", socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)


def main(descriptor: int, pid: int) -> None:
    """Run the guardian on the socket `descriptor` of the engine; `pid` is the engine's process."""
    # A signal to the engine's process group, or to all of Python, must not end the guardian.
    for number_ in signal.valid_signals() - {*_FAULT_SIGNALS, signal.SIGKILL, signal.SIGSTOP, signal.SIGCHLD}:
        with contextlib.suppress(OSError, ValueError):
            signal.signal(number_, signal.SIG_IGN)
    try:  # the last to be ended when memory runs out; only a privileged user may ask for it
        with open("/proc/self/oom_score_adj", "w", encoding="ascii") as file:
            file.write("-1000")
    except OSError:
        pass
    threading.stack_size(256 * 1024)
    with socket.socket(fileno=descriptor) as engine:
        engine.setblocking(False)
        GuardianProcess(engine, pid).run()


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
