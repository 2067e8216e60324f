"""Options of every command that reads a record, for properties that the record does not show itself."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

import click

Command = TypeVar("Command", bound=Callable[..., Any])

_OF_TABLES = (
    click.option("--decimal", type=click.Choice([".", ","]), help="Decimal sign of RECORD, if ambiguous."),
    click.option(
        "--dates", type=click.Choice(["dmy", "mdy", "ymd"]), help="Order of day, month and year in its dates."
    ),
    click.option(
        "--time-column", metavar="NAME", help="Time column of RECORD; DATES,TIMES if date and time have two columns."
    ),
)
"""Options of every table with times."""
_TIME_SCALE = (
    click.option(
        "--time-scale",
        type=click.FloatRange(min=0.0, min_open=True),
        default=1.0,
        metavar="N",
        help="Seconds of the rig in a unit of that column: 60 for a rig that runs 60 times as fast as its clock.",
    ),
)


def reading(command: Command) -> Command:
    """Add the options to `command`, as one argument `choice`, a `hil.record.raw.ReadingOptions`."""
    return _with_choice(command, (*_OF_TABLES, *_TIME_SCALE))


def reading_tables(command: Command) -> Command:
    """Add the options of `reading` but the time scale, for tables whose times are those of a clock."""
    return _with_choice(command, _OF_TABLES)


def _with_choice(command: Command, options: tuple[Callable[[Any], Any], ...]) -> Command:
    @wraps(command)
    def with_choice(
        *given: Any, decimal: Any, dates: Any, time_column: str | None, time_scale: float = 1.0, **named: Any
    ) -> Any:
        from hil.record import ReadingOptions

        return command(*given, choice=ReadingOptions(decimal, dates, time_column, time_scale), **named)

    for option in reversed(options):
        with_choice = option(with_choice)
    return with_choice  # type: ignore[return-value]
