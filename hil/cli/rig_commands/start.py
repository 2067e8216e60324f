"""Command `hil start`: lead from a register table to a diagnosis."""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import click

from hil.cli.options import INPUT_FILE


@click.command()
@click.option("--from", "source", metavar="FILE", help="Register table, Telegraf, Home Assistant, DBC or rig file.")
@click.option("--virtual", is_flag=True, help="Touch no rig: the built-in virtual one, or the devices of --from.")
@click.option("--answers", type=INPUT_FILE, help="TOML file of answers, such as start.answers.toml of another folder.")
@click.option("--answer", "single", metavar="KEY=VALUE", multiple=True, help="One answer; may be repeated.")
@click.option("--yes", "takes_defaults", is_flag=True, help="Take each default; nothing is written to a rig by it.")
def command(
    source: str | None, virtual: bool, answers: Path | None, single: tuple[str, ...], takes_defaults: bool
) -> None:
    """Lead from a register table to a first diagnosis: describe, check, try, record, commission, run, diagnose.

    All files are in the working directory. Each answer is saved at once in start.answers.toml, and the commands in
    start.sh; after Ctrl-C a second `hil start` goes on there. Before a run writes to a rig it names set-points, ranges
    and limits, and asks for a yes.

    \b
    Example:
      hil start --virtual --yes
      hil start --from registers.csv
      hil start --from registers.csv --answer addressing=modicon --answer host=192.168.1.20
      hil start --virtual --from registers.csv --answers answers.toml --yes
    """
    from hil.start import StartRequest, StopRequest, read_answers, start

    given = {} if answers is None else read_answers(answers)
    for text in single:
        key, sign, value = text.partition("=")
        if not sign or not value:
            raise click.UsageError(f"--answer {text!r} is no KEY=VALUE; write it like host=192.168.1.20")
        given[key] = value
    for name in {"SIGTERM", "SIGHUP"} & set(dir(signal)):
        if signal.getsignal(getattr(signal, name)) is not signal.SIG_IGN:
            signal.signal(getattr(signal, name), signal.default_int_handler)  # ends like Ctrl-C
    request = StartRequest(Path(), virtual, source, given, takes_defaults)
    try:
        start(request, _say, _read)
    except KeyboardInterrupt:
        click.echo("\nhil: stopped; `hil start` in this folder goes on here", err=True)
        sys.exit(130)
    except StopRequest as stop:
        click.echo(f"hil: {stop}; `hil start` in this folder goes on there", err=True)
        sys.exit(stop.exit_code)


def _say(line: str) -> None:
    click.echo(line)


def _read(prompt: str) -> str:
    click.echo(prompt, nl=False)
    line = sys.stdin.readline()
    if not line:
        click.echo()
        raise EOFError
    if not sys.stdin.isatty():
        click.echo(line.rstrip("\n"))
    return line
