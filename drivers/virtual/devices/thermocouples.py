"""Process 2 of the virtual rig: the thermocouple module's CAN node and its bus.

    python -m drivers.virtual.devices.thermocouples --link-fd FD [--seed N] [--with EFFECTS.toml] [--port P] [--host H]

Junction temperatures arrive from the PLC process on an inherited socket; frames go to every client of the hub.
"""

import argparse
import asyncio
import socket
import sys
import time
from pathlib import Path

from drivers.virtual.devices.link import LinkReceiver
from drivers.virtual.devices.socketcand import CanConnection, CanHub
from drivers.virtual.devices.supervision import end_with_parent, listen, port_of, say
from drivers.virtual.plant import ThermocoupleModule, load_effects


class CanNode:
    """Sender of the module's three frames for each record from the PLC, stamped with epoch of start plus rig time."""

    def __init__(self, module: ThermocoupleModule, hub: CanHub, epoch_s: float) -> None:
        self._module, self._hub, self._epoch_s = module, hub, epoch_s

    def on_record(self, time_s: float, junctions_C: list[float]) -> None:
        """Send the frames of one period."""
        a, b, c = self._module.sample(time_s, junctions_C)
        if self._hub.listeners:
            stamp = f"{self._epoch_s + time_s:.6f}"
            text = f"< frame 181 {stamp} {a.hex()} >< frame 281 {stamp} {b.hex()} >< frame 381 {stamp} {c.hex()} >"
            self._hub.publish(text.encode("ascii"), 3)


async def run(arguments: argparse.Namespace) -> int:
    """Serve until the parent or the PLC ends."""
    effects = load_effects(arguments.effects) if arguments.effects else ()
    stop = asyncio.Event()
    hub = CanHub(time.time)
    node = CanNode(ThermocoupleModule(arguments.seed, effects, arguments.unit), hub, arguments.epoch or time.time())
    server = await listen(lambda: CanConnection(hub), arguments.host, arguments.port, "CAN")
    loop = asyncio.get_running_loop()
    link = socket.socket(fileno=arguments.link_fd)
    transport, _ = await loop.create_connection(lambda: LinkReceiver(node.on_record, stop.set), sock=link)
    end_with_parent(stop)
    say(event="ready", can_port=port_of(server))
    await stop.wait()
    server.close()
    for client in tuple(hub.clients):
        client.close()
    transport.abort()
    await asyncio.sleep(0)
    say(event="ended", dropped_frames=hub.dropped)
    return 0


def main() -> int:
    """Run the process by its command line; return its exit code."""
    parser = argparse.ArgumentParser(prog="python -m drivers.virtual.devices.thermocouples")
    parser.add_argument("--link-fd", type=int, required=True, help="inherited socket from the PLC process")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--unit", type=int, help="specimen whose sensors' offsets these are; default: the seed's")
    parser.add_argument("--with", dest="effects", type=Path, help="file of effects")
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=0)
    parser.add_argument("--epoch", type=float, default=0.0, help="Unix time at rig time zero; default: now")
    return asyncio.run(run(parser.parse_args()))


if __name__ == "__main__":
    sys.exit(main())
