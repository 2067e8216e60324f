"""Mark of a command that has a process of its own, in contrast to one that a test calls within its own."""

from __future__ import annotations

import click

OWN_PROCESS = "own process"
"""Object of the root context where the process ends with the command."""


def owns_process() -> bool:
    """Return True where this process ends with the command that runs."""
    return click.get_current_context().find_root().obj == OWN_PROCESS
