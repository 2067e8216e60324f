"""Command group `hil`. Commands are imported on use, so that `hil --help` needs no heavy library."""

from __future__ import annotations

import importlib
import os
import signal
import sys
from typing import Any, NoReturn

import click

from hil import __version__

# The matrices are small: a second BLAS thread gains nothing. While a rig runs, it mostly waits for the first thread,
# and a diagnosis took five times as long. A value set by the user is kept.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

SECTIONS = {
    "Begin": {
        "start": "Lead from a register table to a first diagnosis",
        "init": "Write a rig file from options, or from a register table",
        "check": "Check a rig file, twin, profile, test plan or record",
        "rig": "Serve the virtual rig, or the devices of a rig file",
    },
    "Run a rig": {
        "profile": "Build and draw load profiles",
        "run": "Replay a load profile on a rig while twins track it",
        "ctl": "Hold, pause, resume, abort or query a live run",
        "resume": "Continue a run that a crash or a fault interrupted",
        "alarms": "List, acknowledge, shelve alarms of a run; send messages",
        "serve": "Serve a panel of runs to browsers",
        "note": "Add a note or labels to a run, also while it goes on",
    },
    "Fit a twin and explain its error": {
        "commission": "Fit a twin to a healthy record",
        "track": "Replay the calibrators on a record",
        "diagnose": "Trace the error of a twin to the effect that it lacks",
        "explain": "Run the experiments that settle an ambiguous diagnosis",
        "twin": "Revisions of a twin: log, diff, revert",
        "fleet": "Diagnose, track, train or bench over many rigs, on workers",
        "tower": "Cooling towers: historian, aligned record, calibration",
    },
    "Show, judge and export": {
        "ls": "List runs: verdict, end, rig, duration, tags",
        "review": "Show a run in Rerun: measured against twin",
        "report": "Make the record, review and report of a run, if missing",
        "test": "Judge a run by a test plan: verdicts, JUnit XML",
        "compare": "Compare runs on profile time: table, overlaid plots, drift",
        "export": "Write a run as CSV, Parquet, MF4, HDF5, TDMS; a twin as FMU",
        "stream": "Send a run to MQTT or PostgreSQL, or serve it by OPC UA",
    },
    "Train and measure": {
        "train": "Train the network calibrator",
        "bench": "Measure speed and fits, repeat the paper's experiments",
    },
}
"""Heading of the help -> verbs in the order of use, each with its purpose."""
VERBS = {verb: purpose for verbs in SECTIONS.values() for verb, purpose in verbs.items()}
PACKAGES = {
    "hil.bench.commands": ("bench",),
    "hil.cli.operator_commands": ("alarms", "serve"),
    "hil.cli.rig_commands": ("check", "init", "profile", "rig", "start"),
    "hil.cli.run_commands": (
        "compare",
        "ctl",
        "export",
        "ls",
        "note",
        "report",
        "resume",
        "review",
        "run",
        "stream",
        "test",
    ),
    "hil.cli.tower_commands": ("tower",),
    "hil.cli.twin_commands": ("commission", "diagnose", "explain", "fleet", "track", "train", "twin"),
}
"""Package -> verbs, each with a module of its name."""
_HOME = {verb: package for package, verbs in PACKAGES.items() for verb in verbs}


_LIVE = ("ctl", "explain", "resume", "rig", "run", "start", "test")
"""Verbs that need processes, locks and signals of Linux."""


INTERRUPTED = 128 + signal.SIGINT
"""Exit code after Ctrl-C, as that of a process that the signal ended: 1 is that of a fault that was found."""


def _end(why: str, code: int) -> NoReturn:
    click.echo(f"hil: {why}", err=True)
    sys.exit(code)


class _Verbs(click.Group):
    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(VERBS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in VERBS:
            return None
        module = importlib.import_module(f"{_HOME[name]}.{name}")
        command: click.Command = module.command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        width = max(map(len, VERBS))
        for heading, verbs in SECTIONS.items():
            with formatter.section(heading):
                formatter.write_dl([(verb.ljust(width), purpose) for verb, purpose in verbs.items()])

    def invoke(self, ctx: click.Context) -> Any:
        from hil.cli.options import explained_extras

        try:
            with explained_extras():
                return super().invoke(ctx)
        except KeyboardInterrupt:
            _end("interrupted; the same command begins anew", INTERRUPTED)
        except click.Abort as error:
            if isinstance(error.__context__, EOFError):
                _end("the input ended before all questions were answered; answer them, or give options (--help)", 2)
            _end("interrupted before all questions were answered", INTERRUPTED)

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        import difflib

        near = difflib.get_close_matches(args[0], VERBS, n=1, cutoff=0.5)
        if args[0] not in VERBS and near:
            ctx.fail(f"no command {args[0]!r}; did you mean {near[0]}?")
        return super().resolve_command(ctx, args)


@click.group(cls=_Verbs, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="hil")
def group() -> None:
    """Rig harness whose digital twin explains itself.

    \b
    Example, without any hardware; the first one leads through all steps:
      hil start --virtual --yes
      hil run profiles/loads/battle_10h.csv --virtual --lockstep
      hil review runs/<the folder that it names>
    """


def main() -> None:
    """Run `hil`: report errors of the user as one sentence with exit code 2, faults that were found with 1."""
    _require_platform()
    from hil.cli.options import OWN_PROCESS
    from hil.errors import explained, warn_of_little_memory
    from hil.files import accept_any_name, spare_pandas

    if (
        sys.argv[1:2] in (["run"], ["resume"], ["test"])
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    ):
        # Until a run listens to signals, Ctrl-C ends the process at once: an exception in its place may be lost in what
        # is imported, and the run would heat.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    accept_any_name()
    spare_pandas()
    warn_of_little_memory()
    with explained():
        sys.exit(group.main(standalone_mode=True, obj=OWN_PROCESS))


def _require_platform() -> None:
    """End with one sentence where this platform lacks what the verb needs: docs/reference/platforms.md."""
    if sys.platform == "win32":
        print("hil: hil does not run on Windows itself; use WSL 2 or the container", file=sys.stderr)
        sys.exit(2)
    if sys.platform != "linux" and sys.argv[1:2] and sys.argv[1] in _LIVE and "--help" not in sys.argv:
        print(f"hil: hil {sys.argv[1]} needs Linux; use the container on this platform", file=sys.stderr)
        sys.exit(2)
