"""Command `hil alarms`: alarm list of a run, acknowledgement, shelving, messages to people."""

from __future__ import annotations

import getpass
import json
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from hil.alarms import ActName, AlarmWatch

_SECONDS = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}


class _Duration(click.ParamType):
    name = "duration"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        found = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*(s|min|h|d)\s*", str(value))
        if found is None:
            self.fail(f"{str(value)[:40]!r} is no duration; write a number and s, min, h or d, as 30min", param, ctx)
        return float(found[1]) * _SECONDS[found[2]]


@click.command()
@click.argument("run", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--ack", metavar="ID", help="Acknowledge an alarm; `all` for every one that waits.")
@click.option("--shelve", metavar="ID", help="Take an alarm out of the list; needs --for and --reason.")
@click.option("--unshelve", metavar="ID", help="End a shelving.")
@click.option(
    "--for", "for_s", type=_Duration(), metavar="DURATION", help="Duration of a shelving: 90s, 30min, 8h, 2d."
)
@click.option("--reason", default="", help="Reason, for the next shift.")
@click.option("--by", default="", help="Name of the operator; default: the user of this session.")
@click.option("--all", "everything", is_flag=True, help="List normal alarms, too.")
@click.option("--json", "as_json", is_flag=True, help="Print the list and its history as JSON.")
@click.option("--follow", is_flag=True, help="Print each change until the run ends.")
@click.option("--notify", "addresses", multiple=True, metavar="URL", help="Send messages to an address of Apprise.")
@click.option("--notify-file", type=click.Path(path_type=Path), metavar="FILE", help="File of addresses, one a line.")
@click.option(
    "--at-most",
    type=click.IntRange(1, 3600),
    default=10,
    show_default=True,
    help="Messages to an address in an hour; more are put together.",
)
def command(
    run: Path,
    ack: str | None,
    shelve: str | None,
    unshelve: str | None,
    for_s: float | None,
    reason: str,
    by: str,
    everything: bool,
    as_json: bool,
    follow: bool,
    addresses: tuple[str, ...],
    notify_file: Path | None,
    at_most: int,
) -> None:
    """List the alarms of RUN, a run folder, live or ended; acknowledge or shelve one; send messages.

    An acknowledgement states that somebody has seen an alarm. It releases no trip: `hil ctl ack` does that. Everything
    is kept in alarms.jsonl in the run's folder.

    \b
    Example:
      hil alarms runs/20260520T120000Z-battle_40h
      hil alarms runs/20260520T120000Z-battle_40h --ack T_tank.H
      hil alarms runs/20260520T120000Z-battle_40h --shelve T_pm3.sensor --for 8h --reason "sensor replaced tomorrow"
      hil alarms runs/20260520T120000Z-battle_40h --follow --notify-file ~/.config/hil/notify
    """
    from hil.alarms import AlarmWatch

    given = [(name, alarm) for name, alarm in _acts(ack, shelve, unshelve) if alarm is not None]
    if len(given) > 1:
        raise click.UsageError("give one of --ack, --shelve and --unshelve at a time")
    if for_s is not None and shelve is None:
        raise click.UsageError("--for is the duration of a shelving; give --shelve ID, too")
    if given and (follow or addresses or notify_file):
        raise click.UsageError("acknowledge or shelve in one command, follow in another")
    if (addresses or notify_file) and not follow:
        raise click.UsageError("messages are sent while the run is followed; add --follow")
    if follow:
        _follow(run, addresses, notify_file, at_most)
        return
    with AlarmWatch(run) as watch:
        for name, alarm in given:
            done = watch.act(name, alarm, by or _user(), reason, math.nan if for_s is None else for_s)
            if as_json:
                _show(watch, everything, as_json, done=done.splitlines())
                return
            for line in done.splitlines():
                click.echo(_shown(line))
            return
        _show(watch, everything, as_json)


def _acts(ack: str | None, shelve: str | None, unshelve: str | None) -> tuple[tuple[ActName, str | None], ...]:
    return (("acknowledge", ack), ("shelve", shelve), ("unshelve", unshelve))


def _show(watch: AlarmWatch, everything: bool, as_json: bool, done: list[str] | None = None) -> None:
    """Print the list; as JSON with what an act has `done`, where there was one."""
    from hil.alarms import alarm_document, alarm_lines

    kept = watch.poll()
    if as_json:
        document = alarm_document(kept, everything=everything) | ({} if done is None else {"done": done})
        click.echo(json.dumps(document, indent=1))
        return
    statuses = list(kept.statuses.values()) if everything else kept.standing()
    if not statuses:
        count = sum(item.count for item in kept.statuses.values())
        past = f"; {count} have come and gone, see --json" if count else ", and none has been"
        click.echo(f"no alarm stands{past}")
        return
    for line in alarm_lines(statuses):
        click.echo(_shown(line))


def _follow(run: Path, addresses: tuple[str, ...], notify_file: Path | None, at_most: int) -> None:
    from hil.alarms import NotifyOptions, notify_run, read_addresses

    found = (*addresses, *(read_addresses(notify_file) if notify_file is not None else ()))
    if notify_file is None and addresses:
        click.echo(
            "hil: other users of this machine can read the options of a command; --notify-file hides them", err=True
        )
    try:
        sent = notify_run(run, found, NotifyOptions(at_most), lambda line: click.echo(_shown(line)))
    except KeyboardInterrupt:
        raise SystemExit(130) from None
    if found:
        click.echo(f"{sent} messages sent")


def _shown(text: str) -> str:
    from hil.files import on_terminal

    return on_terminal(text)


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a user without an entry, as in a container
        return "unknown"
