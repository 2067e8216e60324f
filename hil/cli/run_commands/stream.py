"""Command `hil stream`: send a live or finished run to MQTT or PostgreSQL, or serve it by OPC UA."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--to", metavar="ADDRESS", required=True, help="mqtt://HOST/PREFIX, postgresql://..., opc.tcp://...")
@click.option(
    "--every",
    type=click.FloatRange(0.0, min_open=True),
    metavar="SECONDS",
    help="MQTT: time from a message of a signal to the next, of rig time.  [default: 1; with --all every tick]",
)
@click.option("--all", "everything", is_flag=True, help="MQTT: send all samples, also of a run that has ended.")
@click.option(
    "--give-up",
    type=click.FloatRange(0.0),
    metavar="SECONDS",
    help="End if the store is down for this long.  [default: keep trying]",
)
@click.option("--cert", type=click.Path(path_type=Path), metavar="FILE", help="OPC UA: certificate of the server, PEM.")
@click.option("--key", type=click.Path(path_type=Path), metavar="FILE", help="OPC UA: its RSA key, PEM, no passphrase.")
@click.option(
    "--trust",
    type=click.Path(path_type=Path),
    metavar="FILE",
    multiple=True,
    help="OPC UA: certificate of a client that may read; may be repeated.",
)
def command(
    run: Path,
    to: str,
    every: float | None,
    everything: bool,
    give_up: float | None,
    cert: Path | None,
    key: Path | None,
    trust: tuple[Path, ...],
) -> None:
    """Send the samples, events and state of RUN, a run folder, to a broker or a database until the run has ended.

    The command follows the journal in a process of its own, so that a store never delays a tick. Started again, it goes
    on where the store has confirmed the last sample. A run that had ended before is sent to MQTT with its last values
    alone, unless --all is given; a database gets every sample.

    With opc.tcp://ADDRESS:PORT/ the command is itself an OPC UA server until Ctrl-C. Clients read values, units,
    quality and the past, and change nothing.

    \b
    Example:
      hil stream runs/20260520T120000Z-battle_40h --to mqtt://broker.example.org/lab
      hil stream runs/20260520T120000Z-battle_40h --to postgresql://hil@db.example.org/rigs
      hil stream runs/20260520T120000Z-battle_40h --to opc.tcp://127.0.0.1:4840/
    """
    from hil.files import on_terminal
    from hil.stream import StreamOptions, stream_run

    def announce(sentence: str) -> None:
        click.echo(f"hil: {on_terminal(sentence)}", err=True)

    options = StreamOptions(every, everything, give_up, cert, key, trust)
    try:
        done = stream_run(run, to, options, announce)
    except KeyboardInterrupt:
        announce(f"the stream of {run} was stopped; start it again to go on")
        raise SystemExit(130) from None
    click.echo(on_terminal(f"{done.to}: {done.ticks} ticks and {done.events} events, run {done.state}"))
    if not done.ticks and not done.events and done.positions is not None:
        why = "the run has no samples, or all was confirmed before"
        announce(f"nothing was new: {why}; remove {done.positions} to send it again")
