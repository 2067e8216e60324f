"""One run drives a rig at a time: advisory locks on what its rig file writes to, let go of by the kernel.

They lie in a folder of this user and this machine, one file an end point, whatever the folders of the runs are.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import ipaddress
import json
import os
import socket
import stat
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from drivers.bus_sections import CanBus, ModbusRtuBus
from drivers.rig_model import Rig


class RigBusyError(Exception):
    """Another run drives the rig; the message says which, and what to do."""


class RigClaim:
    """The end points that this process has locked; none for a rig that is its own."""

    def __init__(self) -> None:
        self._files: list[int] = []
        self._folder: int | None = None

    def take(self, rig: Rig, announce: Callable[[str], None]) -> None:
        """Lock every end point of `rig`. Where locks cannot be had that is announced, and the run may go on.

        Raises:
            RigBusyError: another run has one of them; none is kept then.
        """
        try:
            self._folder = _open_folder()
            for key, place in end_points(rig).items():
                self._lock(key, place)
            self.tell(None)
        except OSError as error:
            self.release()
            announce(f"WARNING: nothing keeps a second run from driving this rig at the same time ({error})")
        except RigBusyError:
            self.release()
            raise

    def _lock(self, key: str, place: str) -> None:
        handle = os.open(lock_name(key), os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600, dir_fd=self._folder)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            said = _owner(os.pread(handle, 10_000, 0))
            os.close(handle)
            raise RigBusyError(f"{place} is driven by {said}") from None
        except OSError:
            os.close(handle)
            raise
        self._files.append(handle)

    def tell(self, folder: Path | None) -> None:
        """Let whoever is refused know who has the rig: this process, and the run in `folder` once there is one."""
        text = json.dumps({"pid": os.getpid(), "folder": None if folder is None else str(folder.absolute())}).encode()
        for handle in self._files:
            # A full disk takes nothing but the name from who is refused.
            with contextlib.suppress(OSError):
                os.pwrite(handle, text, 0)
                os.ftruncate(handle, len(text))

    @property
    def descriptors(self) -> tuple[int, ...]:
        """Open lock files: a process that holds them, too, keeps the rig from others."""
        return tuple(self._files)

    def release(self) -> None:
        """Let another run have the rig; harmless when repeated."""
        # The files stay: one that is removed could be locked by two, each with its own.
        for handle in [*self._files, *(() if self._folder is None else (self._folder,))]:
            os.close(handle)
        self._files, self._folder = [], None


@contextlib.contextmanager
def claimed(rig: Rig | None, announce: Callable[[str], None]) -> Iterator[RigClaim]:
    """Hold `rig`, or nothing, until the end of the block or `release`; raises RigBusyError."""
    claim = RigClaim()
    try:
        if rig is not None:
            claim.take(rig, announce)
        yield claim
    finally:
        claim.release()


def end_points(rig: Rig) -> dict[str, str]:
    """What no two runs may share, and how a person reads it.

    Modbus devices that are written to, by host and port, and serial lines, which have one master. CAN is only read, by
    as many as like.
    """
    written = {point.bus for point in rig.point if point.access != "r"}
    found = {}
    for name, bus in rig.bus.items():
        if isinstance(bus, CanBus):
            if bus.transport == "slcan":
                found[f"serial {_line(bus.channel)}"] = bus.place
        elif isinstance(bus, ModbusRtuBus):
            found[f"serial {_line(bus.serial_port)}"] = bus.place
        elif name in written:
            found[f"tcp {_address(bus.host)} {bus.port} {bus.device_id}"] = bus.where
    return found


def lock_name(key: str) -> str:
    """The file that stands for an end point."""
    return hashlib.sha256(key.encode()).hexdigest()[:32] + ".lock"


def _line(path: str) -> str:
    """A serial line by its own path: udev gives it others, /dev/serial/by-id/..."""
    return path if "://" in path else os.path.realpath(path)


def _address(host: str) -> str:
    """The same text for every name of a host; the name where nothing resolves it."""
    name = host.strip("[]").rstrip(".").lower()
    try:
        found = [str(info[4][0]).partition("%")[0] for info in socket.getaddrinfo(name, None, type=socket.SOCK_STREAM)]
    except (OSError, UnicodeError):
        found = [name]
    # Names with both kinds of addresses are reached by either.
    first = min(found, key=lambda text: (":" in text, text))
    if name == "localhost" or first in ("::1", "0.0.0.0", "::"):
        return "127.0.0.1"
    with contextlib.suppress(ValueError):
        address = ipaddress.ip_address(first)
        mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
        return str(mapped or address)
    return first


def _open_folder() -> int:
    """This user's folder of locks, made where there is none; raises OSError where it cannot be trusted."""
    path = Path(tempfile.gettempdir()) / f"hil-rigs-{os.getuid()}"
    with contextlib.suppress(FileExistsError):
        path.mkdir(mode=0o700)
    handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        status = os.fstat(handle)
        if status.st_uid != os.getuid():
            raise PermissionError(f"{path} belongs to somebody else; have it removed")
        if stat.S_IMODE(status.st_mode) != 0o700:
            os.fchmod(handle, 0o700)
        # systemd-tmpfiles leaves a locked folder alone, however old its files are.
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        raise
    return handle


def _owner(text: bytes) -> str:
    """Who has an end point, and what to do about that."""
    try:
        owner = json.loads(text)
        pid, folder = int(owner["pid"]), owner["folder"]
    except (ValueError, KeyError, TypeError):
        return "another run; wait for its end, or end it with `hil ctl abort`"
    if folder is None:
        return f"a run that process {pid} is starting; wait for its end, or end it with `kill {pid}`"
    return f"the run {folder} (process {pid}); wait for its end, or end it with `hil ctl abort {folder}`"
