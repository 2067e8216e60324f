"""Process of a served rig.

    python -m hil.served_rig RIG.toml [--twin TWIN.toml] [--mode real|scaled|lockstep] [--speed N] [--seed N]
        [--control-port P] [--own-addresses]

A file that cannot be served is reported on the readiness line.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
from pathlib import Path
from typing import Any

from drivers.rig_file import load_rig
from drivers.signals import ConfigurationError
from drivers.virtual.described import ConstantPlant, PlantModel, ServeOptions, serve_described
from drivers.virtual.devices import say
from twin import TwinFileError


async def run(arguments: argparse.Namespace) -> int:
    """Serve until the parent ends."""
    try:
        rig = load_rig(arguments.rig)
        plant: PlantModel
        if arguments.twin is None:
            plant = constant = ConstantPlant(rig, arguments.rig, arguments.seed)
            about: dict[str, Any] = {"twin": None, "constant": constant.at_rest}
        else:
            from hil.served_rig.twin_plant import TwinPlant

            plant = twin = TwinPlant(rig, arguments.rig, arguments.twin, arguments.seed)
            about = {"twin": twin.network.name, "constant": twin.constant}
        options = ServeOptions(arguments.mode, arguments.speed, arguments.control_port, not arguments.own_addresses)
        return await serve_described(rig, arguments.rig, plant, options, about)
    except (ConfigurationError, TwinFileError) as error:
        say(event="refused", message=str(error))
        return 1


def main() -> int:
    """Run the process by its command line; return its exit code."""
    parser = argparse.ArgumentParser(prog="python -m hil.served_rig")
    parser.add_argument("rig", type=Path)
    parser.add_argument("--twin", type=Path, help="twin behind the devices")
    parser.add_argument("--mode", choices=("real", "scaled", "lockstep"), default="real")
    parser.add_argument("--speed", type=float, default=1.0, help="factor to real time")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--control-port", type=int, default=0)
    parser.add_argument("--own-addresses", action="store_true", help="serve at the addresses of the rig file")
    return asyncio.run(run(parser.parse_args()))


if __name__ == "__main__":
    sys.exit(main())
