"""Options of the commands that run on several workers."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from hil.executor import ExecutorOptions

Command = TypeVar("Command", bound=Callable[..., Any])

_TLS = {
    "tls_ca": "Certificate of the authority of a tls:// scheduler, PEM.",
    "tls_cert": "Own certificate for a tls:// scheduler, PEM.",
    "tls_key": "Key of that certificate, PEM.",
}


def on_workers(command: Command) -> Command:
    """Add `--on` and `--tls-*` to a command, as one argument `place`: the address and the three files."""

    @wraps(command)
    def with_place(*given: Any, on: str, **named: Any) -> Any:
        files = {key: named.pop(key) for key in _TLS}
        return command(*given, place={"on": on, **files}, **named)

    made: Any = with_place
    for key, text in reversed(_TLS.items()):
        kind = click.Path(exists=True, dir_okay=False, path_type=Path)
        made = click.option(f"--{key.replace('_', '-')}", key, type=kind, help=text)(made)
    on = click.option(
        "--on",
        default="local",
        show_default=True,
        metavar="local|tcp://HOST:PORT",
        help="Workers of this command, or those of a Dask scheduler, tcp:// or tls://.",
    )
    return on(made)


def workers_of(count: int | None, place: dict[str, Any]) -> ExecutorOptions:
    """Return the workers of a command that works in this process unless it is asked for several.

    Parameters
    ----------
    count
        Workers that the user asked for; None for the default: one here, all of a scheduler.
    place
        Argument of `on_workers`.
    """
    from hil.executor import LOCAL, SERIAL, ExecutorOptions

    if place["on"] == LOCAL and (count or 1) == 1:
        place = {**place, "on": SERIAL}
    return ExecutorOptions(workers=count or 1, **place)
