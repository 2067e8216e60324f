"""Command line `hil`: one module for each command."""

from hil.cli.verbs import group as group
from hil.cli.verbs import main as main
