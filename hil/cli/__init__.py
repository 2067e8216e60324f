"""Command line `hil`: one module for each command, loaded by its name."""

from hil.cli.verbs import group, main

__all__ = ["group", "main"]
