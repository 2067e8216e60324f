"""CAN interfaces opened through python-can, and why that failed, in words.

What an interface can filter is filtered there (SocketCAN: in the kernel); the receiver matches every frame itself, too.
"""

from __future__ import annotations

import errno
import logging
import socket
from collections.abc import Sequence

import can

from drivers.bus_sections import CanBus
from drivers.can_ids import IdMatch
from drivers.points import LinkError

logging.getLogger("can").setLevel(logging.CRITICAL)  # what it reports, this module raises


def open_bus(config: CanBus, where: str, wanted: Sequence[IdMatch]) -> can.BusABC:
    """The interface of a bus section, for the frames of `wanted`; raises LinkError that names `where`."""
    filters = [  # of the other interfaces python-can filters in a call that is not used here
        can.typechecking.CanFilter(can_id=match.value, can_mask=match.mask, extended=match.extended) for match in wanted
    ]
    try:
        if config.transport == "socketcan":
            if config.channel not in {name for _, name in socket.if_nameindex()}:
                raise OSError(errno.ENODEV, "No such device")  # python-can would leave a socket open
            return can.Bus(interface="socketcan", channel=config.channel, can_filters=filters)
        if config.transport == "socketcand":
            # python-can retries a refused connection for ten seconds in a busy loop, and waits for ever for the
            # greeting of whatever else listens there: ask first
            with socket.create_connection((config.host, config.port), timeout=config.timeout_s) as probe:
                if not probe.recv(16).startswith(b"<"):  # "< hi >"
                    raise LinkError(f"{where}: what listens there is no socketcand; correct host and port")
            return can.Bus(
                interface="socketcand", channel=config.channel, host=config.host, port=config.port, tcp_tune=True
            )
        if config.transport == "slcan":
            return can.Bus(interface="slcan", channel=config.channel, bitrate=config.bitrate, sleep_after_open=0.1)
        return can.Bus(interface=config.transport, channel=config.channel)
    except (OSError, can.CanError, ValueError, TimeoutError) as error:
        raise LinkError(f"{where} cannot be opened: {why(config, error)}") from error


def why(config: CanBus, error: Exception) -> str:
    """What is wrong with an interface and what to do, of what opening it or receiving raised."""
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
    return said or f"{error}; `ip -details link show {name}` tells what state it is in"
