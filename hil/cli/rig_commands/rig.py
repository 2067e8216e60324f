"""Command `hil rig`: serve the virtual rig, or a rig file."""

from __future__ import annotations

import sys
from pathlib import Path

import click
from click.core import ParameterSource

from hil.cli.options import INPUT_FILE

_OF_A_FILE = ("rig", "twin", "no_twin", "out", "mode", "speed", "seed", "control_port")
"""Parameters that a served rig file takes."""


@click.command()
@click.argument("rig", type=INPUT_FILE, required=False)
@click.option("--twin", type=INPUT_FILE, help="Twin behind the devices of RIG; default: the one that RIG names.")
@click.option("--no-twin", is_flag=True, help="Serve RIG with constant values, set-points echoed to their read-backs.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Serve RIG on free ports, and write the rig file that points to them.",
)
@click.option("--modbus-port", default=5020, show_default=True, help="Modbus/TCP port of the PLC; 0 picks a free one.")
@click.option("--rtu-port", type=int, help="Serve Modbus RTU over TCP on this port, too; 0 picks a free one.")
@click.option("--serial", is_flag=True, help="Serve Modbus RTU on a pseudo-terminal, too, and print its path.")
@click.option("--can-port", default=29536, show_default=True, help="socketcand port of the CAN bus vcan0.")
@click.option("--control-port", default=0, show_default="free", help="Port that grants steps in lockstep.")
@click.option("--mode", type=click.Choice(["real", "scaled", "lockstep"]), default="real", show_default=True)
@click.option("--speed", default=1.0, show_default=True, help="Factor to real time, with --mode scaled.")
@click.option("--period", default=1.0, show_default=True, help="Seconds between samples.")
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of noise, offsets and draughts."
)
@click.option("--with", "effects", type=INPUT_FILE, help="TOML file of effects that the twin does not model.")
@click.option("--fmu", type=INPUT_FILE, help="FMU (FMI 2.0, co-simulation) in the place of the plant: a program.")
@click.option(
    "--fmu-variable",
    "fmu_variables",
    metavar="SIGNAL=VARIABLE",
    multiple=True,
    help="Variable of the FMU for a signal of the rig, where their names differ.",
)
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on.")
@click.option(
    "--server",
    type=click.Choice(["own", "pymodbus"]),
    default="own",
    show_default=True,
    help="Modbus server implementation.",
)
@click.option("--tls-certificate", type=INPUT_FILE, help="Serve Modbus over TLS with this certificate (PEM).")
@click.option("--tls-key", type=INPUT_FILE, help="Key (PEM) of the certificate.")
@click.option(
    "--tls-ca", type=INPUT_FILE, help="Certificate (PEM) of the authority that signs the clients' certificates."
)
def command(
    rig: Path | None,
    twin: Path | None,
    no_twin: bool,
    out: Path | None,
    modbus_port: int,
    rtu_port: int | None,
    serial: bool,
    can_port: int,
    control_port: int,
    mode: str,
    speed: float,
    period: float,
    seed: int,
    effects: Path | None,
    fmu: Path | None,
    fmu_variables: tuple[str, ...],
    host: str,
    server: str,
    tls_certificate: Path | None,
    tls_key: Path | None,
    tls_ca: Path | None,
) -> None:
    """Serve the virtual rig: a PLC on Modbus/TCP and a thermocouple module on CAN, in processes of their own.

    With RIG, a rig file, serve the devices which that file describes, for trials before the hardware is touched.

    \b
    Example:
      hil rig my_rig.toml --twin my_twin.toml --out served.toml
      hil rig --with profiles/effects/modules_heat.toml
      mbpoll -m tcp -a 1 -t 3 -r 1 -c 12 -p 5020 127.0.0.1
      cantools monitor -i socketcand -c vcan0 --bus-kwargs host=127.0.0.1 port=29536 -- \\
          profiles/rigs/thermocouples.dbc
    """
    if rig is not None:
        sys.exit(_serve_file(rig, None if no_twin else twin, out, no_twin=no_twin))
    if twin is not None or no_twin or out is not None:
        raise click.UsageError("--twin, --no-twin and --out belong to a rig file; name it, `hil rig my_rig.toml ...`")
    from drivers.virtual import serve

    tls = None
    if tls_certificate is not None and tls_key is not None and tls_ca is not None:
        tls = (tls_certificate, tls_key, tls_ca)
    elif tls_certificate is not None or tls_key is not None or tls_ca is not None:
        raise click.UsageError("TLS needs --tls-certificate, --tls-key and --tls-ca; give all three or none")
    wrong = [pair for pair in fmu_variables if "=" not in pair]
    if wrong:
        raise click.UsageError(f"--fmu-variable {wrong[0]!r} has no '='; write SIGNAL=VARIABLE")
    try:
        code = serve(
            modbus_port=modbus_port,
            rtu_port=rtu_port,
            serial=serial,
            can_port=can_port,
            control_port=control_port,
            mode=mode,
            speed=speed,
            period_s=period,
            seed=seed,
            effects=effects,
            fmu=fmu,
            fmu_variables=tuple(tuple(pair.split("=", 1)) for pair in fmu_variables),
            host=host,
            server=server,
            tls=tls,
        )
    except ValueError as error:
        raise click.UsageError(str(error)) from error
    sys.exit(code)


def _serve_file(rig: Path, twin: Path | None, out: Path | None, *, no_twin: bool) -> int:
    """Serve a rig file until Ctrl-C; return the exit code."""
    from drivers.rig_file import load_rig
    from hil.run_folder import RunFolderError, require_output
    from hil.served_rig import ServedRigOptions, serve

    if out is not None:
        require_output(out, RunFolderError, [rig, *([] if twin is None else [twin])])
    context = click.get_current_context()
    given = [name for name in context.params if context.get_parameter_source(name) is ParameterSource.COMMANDLINE]
    foreign = [option for option in context.command.params if option.name in given and option.name not in _OF_A_FILE]
    if foreign:
        raise click.UsageError(f"{foreign[0].opts[0]} is of the built-in virtual rig; take it out, or take {rig} out")
    if no_twin and "twin" in given:
        raise click.UsageError("--twin and --no-twin exclude each other; choose one")
    read, options = load_rig(rig), context.params
    try:
        chosen = ServedRigOptions(
            twin=None if no_twin else twin or read.twin,
            mode=options["mode"],
            speed=options["speed"] if options["mode"] == "scaled" else read.time_scale,
            seed=options["seed"],
            control_port=options["control_port"],
            free_ports=out is not None,
        )
    except ValueError as error:
        raise click.UsageError(str(error)) from error
    return serve(rig, chosen, out)
