"""Directive ``command-pages``: a section for each command of a click group, made of the help that the program prints.

The argument is ``module:attribute`` of the group. Sections are named as commands are typed, whatever the functions are
called.
"""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective


def markdown_of(group: click.Group, name: str, level: int = 2) -> Iterator[str]:
    """Yield the lines of Markdown for the commands of `group`, called `name`, in the order of its help."""
    parent = click.Context(group, info_name=name)
    for verb in group.list_commands(parent):
        command = group.get_command(parent, verb)
        assert command is not None, verb
        context = click.Context(command, info_name=f"{name} {verb}")
        yield from (f"{'#' * level} {name} {verb}", "")
        yield from ("```text", command.get_usage(context).removeprefix("Usage: "), "```", "")
        yield from _help(command.help or "")
        if isinstance(command, click.Group):
            yield from markdown_of(command, f"{name} {verb}", level + 1)
        else:
            yield from _options(command, context)


def _help(text: str) -> Iterator[str]:
    """Yield paragraphs; a block that click must not wrap is shown as it is, its first line above it."""
    for paragraph in re.split(r"\n\s*\n", inspect.cleandoc(text).replace("\f", "")):
        if not paragraph.startswith("\b"):
            yield from (_escaped(" ".join(paragraph.split())), "")
            continue
        lines = paragraph.splitlines()[1:]
        if lines and lines[0].rstrip().endswith(":"):
            yield from (_escaped(lines[0].strip()), "")
            lines = lines[1:]
        yield from ("```text", *inspect.cleandoc("\n".join(lines)).splitlines(), "```", "")


def _options(command: click.Command, context: click.Context) -> Iterator[str]:
    rows = []
    for parameter in command.get_params(context):
        if not isinstance(parameter, click.Option) or parameter.hidden or "--help" in parameter.opts:
            continue
        spelled = ", ".join(f"`{name}`" for name in (*parameter.opts, *parameter.secondary_opts))
        if not parameter.is_flag:
            spelled += f" {_escaped(parameter.make_metavar(context))}"
        rows.append(f"| {spelled} | {_escaped(parameter.help or '')} | {_default(parameter)} |")
    if rows:
        yield from ("| Option | Meaning | Default |", "|---|---|---|", *rows, "")


def _default(option: click.Option) -> str:
    """Return the default as it would be typed, or nothing where it has none or states it in its help."""
    value = option.default
    if option.required:
        return "required"
    if not option.show_default or value is None or callable(value):
        return ""
    if isinstance(option.show_default, str):
        return _escaped(option.show_default)
    return f"`{value}`" if isinstance(value, str | int | float | Path) else ""


def _escaped(text: str) -> str:
    """Return a line of help as Markdown: code stays code, and nothing else is markup."""
    pieces = re.split(r"(`[^`]*`)", text)
    return "".join(p if p.startswith("`") else re.sub(r"([\\*_<>\[\]|#$])", r"\\\1", p) for p in pieces)


class CommandPages(SphinxDirective):
    """Directive that documents a click group."""

    required_arguments = 1
    has_content = False

    def run(self) -> list[nodes.Node]:
        module, attribute = self.arguments[0].split(":")
        group = getattr(importlib.import_module(module), attribute)
        lines = list(markdown_of(group, "hil"))
        holder = nodes.section()
        holder.document = self.state.document
        self.state.nested_parse(
            StringList(lines, source="command-pages"), self.content_offset, holder, match_titles=True
        )
        return holder.children


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_directive("command-pages", CommandPages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
