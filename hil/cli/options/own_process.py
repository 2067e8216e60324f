"""Mark of a command that has its own process, in contrast to one that a test calls in its process."""

from __future__ import annotations

import click

OWN_PROCESS = "own process"
"""Object of the root context if the process ends with the command."""


def owns_process() -> bool:
    """Return True if this process ends with the command that runs."""
    return click.get_current_context().find_root().obj == OWN_PROCESS
