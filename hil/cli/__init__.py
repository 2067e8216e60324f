"""Command line `hil`: one module a command."""

from hil.cli.verbs import group as group
from hil.cli.verbs import main as main
