"""CAN interfaces opened through python-can, and the causes of failures as sentences. No other module imports it.

Interfaces that can filter frames do so (SocketCAN: in the kernel); the receiver matches every frame itself, too.
"""

from __future__ import annotations

import errno
import logging
import socket
from collections.abc import Sequence

from drivers.can.imports import without
from drivers.rig_file import CanBus, IdMatch
from drivers.signals import LinkError

with without("asammdf"):
    import can

logging.getLogger("can").setLevel(logging.CRITICAL)  # this module raises the errors that it logs


Frame = can.Message


class CanWire:
    """Open interface that gives the frames of `wanted`, and perhaps others; raises LinkError that names `where`."""

    def __init__(self, config: CanBus, where: str, wanted: Sequence[IdMatch]) -> None:
        self._config = config
        self._where = where
        try:
            self._bus = _opened(config, wanted)
        except (OSError, can.CanError, ValueError) as error:
            raise LinkError(f"{where} cannot be opened: {failure_reason(config, error)}") from error

    def receive(self, timeout_s: float) -> Frame | None:
        """Return the next frame; None after `timeout_s`, or at once. Raise LinkError where the bus is lost."""
        try:
            # recv() itself spins through its whole time-out on a closed socketcand connection and hides the end;
            # the one call that every interface implements comes back at once
            frame, _ = self._bus._recv_internal(timeout_s)
        except (can.CanError, OSError, ValueError) as error:
            raise LinkError(f"{self._where}: {failure_reason(self._config, error)}") from error
        return frame

    def close(self) -> None:
        """Close the interface."""
        self._bus.shutdown()


def _opened(config: CanBus, wanted: Sequence[IdMatch]) -> can.BusABC:
    if config.transport == "socketcan":
        if config.channel not in {name for _, name in socket.if_nameindex()}:
            raise OSError(errno.ENODEV, "No such device")  # python-can would leave a socket open
        filters = [
            can.typechecking.CanFilter(can_id=match.value, can_mask=match.mask, extended=match.extended)
            for match in wanted
        ]
        return can.Bus(interface="socketcan", channel=config.channel, can_filters=filters)
    if config.transport == "socketcand":
        # python-can retries a refused connection for ten seconds in a busy loop, and waits for ever for the
        # greeting of whatever else listens there: ask first
        with socket.create_connection((config.host, config.port), timeout=config.timeout_s) as probe:
            if not probe.recv(16).startswith(b"<"):  # "< hi >"
                raise ValueError("the service that listens there is no socketcand; correct host and port")
        return can.Bus(
            interface="socketcand", channel=config.channel, host=config.host, port=config.port, tcp_tune=True
        )
    if config.transport == "slcan":
        return can.Bus(interface="slcan", channel=config.channel, bitrate=config.bitrate, sleep_after_open=0.1)
    return can.Bus(interface=config.transport, channel=config.channel)


def failure_reason(config: CanBus, error: Exception) -> str:
    """Return cause and remedy of an error that opening an interface, or receiving on it, raised."""
    if config.transport != "socketcan":
        return f"{error}; is the rig on?"
    name, code = config.channel, getattr(error, "errno", None) or getattr(error, "error_code", None)
    known = {
        errno.ENODEV: f"there is no CAN interface {name}; plug the adapter in and load its driver, or correct channel "
        "(`ip link` lists what there is; a container needs the host's network)",
        errno.ENETDOWN: f"{name} is down; bring it up: `ip link set {name} up type can bitrate 500000`, at your bus's "
        "rate",
        errno.EPERM: f"this user may not open {name}; run it as one who may use raw sockets (CAP_NET_RAW)",
        errno.EAFNOSUPPORT: "the kernel has no CAN; load its module (`modprobe can_raw`) or use another transport",
    }
    same = {errno.ENXIO: errno.ENODEV, errno.EACCES: errno.EPERM, errno.EPROTONOSUPPORT: errno.EAFNOSUPPORT}
    said = known.get(same.get(code, code) if code is not None else -1)
    return said or f"{error}; `ip -details link show {name}` shows its state"
