"""Command line `hil`: one module a command."""

from hil.cli.group import main as main
