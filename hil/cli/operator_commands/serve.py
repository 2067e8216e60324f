"""Command `hil serve`: panel of runs in a browser."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.argument("folder", type=click.Path(path_type=Path), default=Path("runs"))
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on; others need --cert, --key.")
@click.option("--port", type=click.IntRange(0, 65535), default=8765, show_default=True, help="Port; 0 for a free one.")
@click.option("--cert", type=click.Path(path_type=Path), metavar="FILE", help="Certificate of this machine, PEM.")
@click.option("--key", type=click.Path(path_type=Path), metavar="FILE", help="Its key, PEM, without a passphrase.")
@click.option("--name", "names", multiple=True, metavar="NAME", help="Name for browsers; may be repeated.")
def command(folder: Path, host: str, port: int, cert: Path | None, key: Path | None, names: tuple[str, ...]) -> None:
    """Serve a panel of FOLDER, a run folder or a folder of runs, to browsers until Ctrl-C.

    The panel shows state, values, alarms and trends of a run, live or ended, and steers a live one. It is a process of
    its own: the run does not depend on it. Whoever has the printed address may steer.

    \b
    Example:
      hil serve
      hil serve runs/20260520T120000Z-battle_40h --port 0
      hil serve runs --host 192.0.2.7 --cert rig.pem --key rig.key --name rig.example.org
    """
    from hil.files import on_terminal
    from hil.panel import ServeOptions, serve

    def announce(address: str) -> None:
        click.echo(on_terminal(address))
        click.echo("whoever opens this address may steer the runs; Ctrl-C ends the panel, no run", err=True)

    try:
        serve(folder, ServeOptions(host, port, cert, key, names), announce)
    except KeyboardInterrupt:
        raise SystemExit(130) from None
