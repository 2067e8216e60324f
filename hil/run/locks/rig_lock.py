"""Locks on every end point that a rig file writes to, so that one run at a time drives a rig.

The kernel releases them. Each end point has two kinds of lock with different ranges:

- A name of this machine (`machine_lock`). Every user, home, TMPDIR and mount namespace shares it. Another user who
  takes it first can prevent a run, but admits no second one. It does not cover other network namespaces and machines.
- A lock file in each private folder of this user (`lock_folder`). It names the run that holds it. It covers containers
  and, where the file system passes locks on, machines that share the home folder. It does not cover other users.

Neither separates two users on two machines, or in two containers. The alarm on foreign set-points
(`hil.run.outputs.readback`) remains for them.

The key of an end point is its resolved address and port, not its device id: some devices answer to any id. Devices
behind one gateway are therefore driven by one run. All addresses of this machine are one host, and a host with several
addresses is locked at each of them.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shlex
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from drivers.rig_file import CanBus, ModbusRtuBus, ModbusRtuTcpBus, Rig, addresses, is_own, serial_device
from hil.run.locks.lock_folder import LockFile, LockFolder, LockHolder, RigLockError, open_folders, user_name
from hil.run.locks.machine_lock import NameHolder, take_name

HANDOVER_S = 10.0
"""Longest wait of a new run for the guardian of a killed one, s."""
_SO_NETNS_COOKIE = 71
"""Socket option that identifies a network namespace (Linux 5.14, <asm-generic/socket.h>); Python has no name for it."""


class RigBusyError(Exception):
    """Rig that another run drives; the message names that run and the remedy. `pid` is its process here, if known."""

    def __init__(self, sentence: str, pid: int | None = None) -> None:
        super().__init__(sentence)
        self.pid = pid


class RigClaim:
    """End points that this process has locked; none for a virtual rig of its own."""

    def __init__(self) -> None:
        self._folders: list[LockFolder] = []
        self._files: list[LockFile] = []
        self._names: list[socket.socket] = []

    def take(self, rig: Rig, announce: Callable[[str], None], *, no_lock: bool = False) -> None:
        """Lock every end point of `rig`, or none.

        With `no_lock` no error is raised. The free locks are taken, so that other runs are still refused, and
        `announce` gets a warning with the locks that are missing.

        Raises
        ------
        RigBusyError
            Another run holds one of them.
        RigLockError
            A lock folder of this user is foreign, cannot be written to, or has no locks.
        """
        points = end_points(rig)
        if not points:
            return
        problems: list[str] = []
        self._folders, errors = open_folders()
        try:
            if errors and not no_lock:
                raise RigLockError(f"{errors[0]}, or use --no-lock, which does not keep a second run off this rig")
            for key, place in points.items():
                try:
                    self._lock_after_guardian(key, place)
                except (RigBusyError, RigLockError) as error:
                    if not no_lock:
                        raise
                    problems.append(str(error))
        except (RigBusyError, RigLockError):
            self.release()
            raise
        self.record_holder(None)
        if no_lock:
            because = "; ".join(dict.fromkeys([*map(str, errors), *problems]))
            announce(
                "WARNING: --no-lock: nothing keeps a second run from driving this rig at the same time"
                f"{f' ({because})' if because else ''}; only the read-back of its set-points can notice one"
            )

    def _lock_after_guardian(self, key: str, place: str) -> None:
        """Take the locks once the guardian of a killed run has made the rig safe and released them."""
        end = time.monotonic() + HANDOVER_S
        while True:
            try:
                return self._lock(key, place)
            except RigBusyError as error:
                if error.pid is None or _is_there(error.pid):
                    raise
                if time.monotonic() > end:
                    raise RigBusyError(
                        f"{place} is held by the guardian of a killed run (process {error.pid}), which cannot make the "
                        "rig safe; read its guardian.log in the run's folder, and check the rig"
                    ) from None
                time.sleep(0.05)

    def _lock(self, key: str, place: str) -> None:
        """Take both locks of an end point; raises RigBusyError or RigLockError."""
        name = lock_name(key)
        try:
            taken = take_name(f"hil-rig-{name}")
        except OSError as error:
            raise RigLockError(
                f"this machine's lock of {place} cannot be taken ({error.strerror or error}); allow Unix sockets to "
                "this process, or use --no-lock, which does not keep a second run off this rig"
            ) from error
        if isinstance(taken, NameHolder):
            known = [folder.holder(name) for folder in self._folders]
            holder = next((one for one in known if one and one.pid == taken.pid), None)
            raise RigBusyError(_busy(place, taken, holder), taken.pid or None)
        if taken is not None:
            self._names.append(taken)
        for folder in self._folders:
            try:
                file = folder.take(name)
            except OSError as error:
                raise RigLockError(
                    f"{folder.path}, the folder of rig locks, cannot be used ({error.strerror or error}); have it made "
                    "writable, or use --no-lock, which does not keep a second run off this rig"
                ) from error
            if file is None:
                holder = folder.holder(name)
                here = holder is not None and holder.machine == socket.gethostname()
                raise RigBusyError(_busy(place, None, holder), holder.pid if here and holder is not None else None)
            self._files.append(file)

    def record_holder(self, folder: Path | None) -> None:
        """Write the holder into the lock files: this process, and the run in `folder` once there is one."""
        for file in self._files:
            file.write(LockHolder.own(folder))

    @property
    def descriptors(self) -> tuple[int, ...]:
        """Descriptors of the locks: a process that inherits them holds the locks, too."""
        return (*(file.fileno() for file in self._files), *(name.fileno() for name in self._names))

    def release(self) -> None:
        """Release all locks; harmless when repeated."""
        for file in self._files:
            file.release()
        for name in self._names:
            name.close()
        for folder in self._folders:
            folder.close()
        self._files, self._names, self._folders = [], [], []


@contextlib.contextmanager
def claimed(rig: Rig | None, announce: Callable[[str], None], *, no_lock: bool = False) -> Iterator[RigClaim]:
    """Lock `rig`, if there is one, until the end of the block or `release`; raises RigBusyError and RigLockError."""
    claim = RigClaim()
    try:
        if rig is not None:
            claim.take(rig, announce, no_lock=no_lock)
        yield claim
    finally:
        claim.release()


def _is_there(pid: int) -> bool:
    """Return True for a process that runs; a zombie does not."""
    try:
        return (
            Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()[0] != "Z"
        )
    except OSError:
        return False


def end_points(rig: Rig) -> dict[str, str]:
    """Return the end points that no two runs may share: key -> name for messages.

    These are Modbus servers that are written to, by address and port, and all serial lines. A serial line has one
    master even without writes, also behind a converter that passes RTU frames over TCP. CAN is only read, by any number
    of processes.
    """
    written = {point.bus for point in rig.point if point.access != "r"}
    found: dict[str, str] = {}
    for name, bus in rig.bus.items():
        if isinstance(bus, CanBus):
            if bus.transport == "slcan":
                found.setdefault(f"serial {_serial(bus.channel)}", bus.place)
        elif isinstance(bus, ModbusRtuBus):
            found.setdefault(f"serial {_serial(bus.serial_port)}", bus.place)
        elif name in written or isinstance(bus, ModbusRtuTcpBus):
            for host in _hosts(bus.host):
                found.setdefault(f"tcp {host} {bus.port}", bus.place)
    return found


def lock_name(key: str) -> str:
    """Return the name of the locks of an end point."""
    return hashlib.sha256(key.encode()).hexdigest()[:32]


def _hosts(name: str) -> list[str]:
    """Return one text for each host behind a name; all addresses of this machine are one host."""
    return sorted({f"own {_this_network()}" if is_own(address) else address for address in addresses(name)})


def _serial(path: str) -> str:
    """Return one text for each serial line, independent of the links to it."""
    return f"{_this_machine()} {serial_device(path)}"


def _this_machine() -> str:
    """Return an identity of this machine among those that share the home folder."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:  # not Linux
        return socket.gethostname()


def _this_network() -> str:
    """Return an identity of this machine's network among other machines and its containers."""
    try:
        with socket.socket() as any_socket:
            cookie = any_socket.getsockopt(socket.SOL_SOCKET, _SO_NETNS_COOKIE, 8).hex()
    except OSError:  # an older Linux, or not Linux
        cookie = ""
    return f"{_this_machine()} {cookie}"


def _busy(place: str, peer: NameHolder | None, holder: LockHolder | None) -> str:
    """Return the sentence for a run that is refused."""
    rule = "one run at a time may drive the devices at this address, whatever their ids"
    if holder is not None:
        here = holder.machine == socket.gethostname()
        process = f"process {holder.pid}{'' if here else f' on {holder.machine}'}"
        if holder.folder is None:
            return f"{place} is driven by a run that {process} is starting ({rule}); {_wait(f'kill {holder.pid}')}"
        return f"{place} is driven by the run {holder.folder} ({process}; {rule}); " + _wait(
            f"hil ctl abort {shlex.quote(str(holder.folder))}"
        )
    if peer is None or peer.uid is None:
        return f"{place} is driven by another run ({rule}); {_wait('hil ctl abort')}"
    process = f"process {peer.pid} of {user_name(peer.uid)}" if peer.pid else f"a process of {user_name(peer.uid)}"
    if peer.uid != os.getuid():
        return f"{place} is driven by {process} ({rule}); wait for its end, or ask that user to end it"
    return f"{place} is driven by {process} ({rule}); {_wait(f'kill {peer.pid}' if peer.pid else 'hil ctl abort')}"


def _wait(command: str) -> str:
    return f"wait for its end, or end it with `{command}`"
