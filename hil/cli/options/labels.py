"""Options that label a run: test object, serial number, operator, tags."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])


class _LabelText(click.ParamType[str]):
    """Text of a label: not blank, except for the default, and not too long to be shown."""

    name = "text"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        from hil.run_folder import LONGEST_LABEL

        text = str(value)
        is_default = param is not None and value == param.default and not _is_given(param, ctx)
        if not text.strip() and not is_default:
            self.fail("it is empty; write a text, or leave the option out", param, ctx)
        if len(text) > LONGEST_LABEL:
            self.fail(f"it has {len(text)} characters, at most {LONGEST_LABEL} are kept; shorten it", param, ctx)
        return text


def _is_given(param: click.Parameter, ctx: click.Context | None) -> bool:
    source = None if ctx is None or param.name is None else ctx.get_parameter_source(param.name)
    return source is click.core.ParameterSource.COMMANDLINE


_TEXT = _LabelText()


def label_options(command: F) -> F:
    """Add the options `--object`, `--serial`, `--operator` and `--tag` to a command; a blank text is refused."""
    for option in (
        click.option("--tag", "tags", multiple=True, type=_TEXT, help="Tag of the run; may be repeated."),
        click.option("--operator", default="", type=_TEXT, help="Name of the operator."),
        click.option("--serial", "serial_number", default="", type=_TEXT, help="Serial number of the test object."),
        click.option("--object", "test_object", default="", type=_TEXT, help="Test object, for the report."),
    ):
        command = option(command)
    return command
