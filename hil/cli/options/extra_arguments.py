"""Arguments beyond those of a command, as a shell's pattern gives them, reported with the remedy."""

from __future__ import annotations

import contextlib
import re
import shlex
from collections.abc import Iterator

import click

_EXTRA = re.compile(r"Got unexpected extra arguments? \((.*)\)", re.DOTALL)
_SHOWN = 3
"""Arguments that a message repeats."""


@contextlib.contextmanager
def explained_extras() -> Iterator[None]:
    """Raise click's error on extra arguments again, with the command for each of them.

    Raises
    ------
    click.UsageError
        In place of the one that the block raised.
    """
    try:
        yield
    except click.UsageError as error:
        found = _EXTRA.fullmatch(error.message)
        if found is None or error.ctx is None:
            raise
        raise click.UsageError(_sentence(error.ctx, found[1].split()), error.ctx) from None


def _sentence(ctx: click.Context, extra: list[str]) -> str:
    shown = " ".join(shlex.quote(word) for word in extra[:_SHOWN]) + (" ..." if len(extra) > _SHOWN else "")
    taken = [param.make_metavar(ctx) for param in ctx.command.params if isinstance(param, click.Argument)]
    options = [name for param in ctx.command.params if isinstance(param, click.Option) for name in param.opts]
    called = _called(ctx)
    if not taken:
        as_option = f"; give a file behind its option, as in --from {shown}" if "--from" in options else ""
        return f"{called} takes no argument, and {shown} is one{as_option or '; take it out'}"
    further = "; further records of the same rig go behind --with" if "--with" in options else ""
    return (
        f"{called} takes one {' and one '.join(taken)}, and {shown} came besides; give one command for each "
        f'(`for x in PATTERN; do {called} "$x"; done`){further}'
    )


def _called(ctx: click.Context) -> str:
    """Return the command as a user writes it, `hil twin log`, also where Python runs the package."""
    names: list[str] = []
    at: click.Context | None = ctx
    while at is not None and at.parent is not None:
        names.insert(0, at.info_name or "")
        at = at.parent
    return " ".join(("hil", *names))
