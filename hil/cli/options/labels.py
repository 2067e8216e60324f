"""Options that label a run: test object, serial number, operator, tags."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])


def label_options(command: F) -> F:
    """Add the options `--object`, `--serial`, `--operator` and `--tag` to a command."""
    for option in (
        click.option("--tag", "tags", multiple=True, help="Tag of the run; may be repeated."),
        click.option("--operator", default="", help="Name of the operator."),
        click.option("--serial", "serial_number", default="", help="Serial number of the test object."),
        click.option("--object", "test_object", default="", help="Test object, for the report."),
    ):
        command = option(command)
    return command
