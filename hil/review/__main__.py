"""Process of the review, `python -m hil.review follow JOURNAL`, so that no tick waits for it."""

from __future__ import annotations

import argparse
import logging
import os
import signal
import sys
import threading
from pathlib import Path

from hil.journal import JournalError
from hil.review.follower import POLL_S, follow


def main(arguments: list[str] | None = None) -> int:
    """Follow a journal until the run or the parent process ends, SIGTERM or Ctrl-C comes; then close in order."""
    parser = argparse.ArgumentParser(prog="python -m hil.review", description="Send a journal to Rerun as it grows.")
    verbs = parser.add_subparsers(dest="verb", required=True)
    verb = verbs.add_parser("follow", help="file and viewer, live")
    verb.add_argument("journal", type=Path)
    verb.add_argument("--rrd", type=Path, help="file to write at the end of the run")
    verb.add_argument("--viewer", help="URL of a running viewer, rerun+http://127.0.0.1:PORT/proxy")
    verb.add_argument("--poll", type=float, default=POLL_S, metavar="SECONDS")
    verb.add_argument("--while-open", action="store_true", help="end when the standard input is closed")
    given = parser.parse_args(arguments)
    logging.basicConfig(format="%(message)s", level=logging.WARNING)
    asked = False

    def ask(*_: object) -> None:
        nonlocal asked
        asked = True

    def until_closed() -> None:
        # Not through the stream: a thread that holds it prevents an orderly end of the process.
        while os.read(sys.stdin.fileno(), 4096):
            pass
        ask()

    signal.signal(signal.SIGTERM, ask)
    signal.signal(signal.SIGINT, ask)
    if given.while_open:
        # A signal could come before this process has a handler for it.
        threading.Thread(target=until_closed, daemon=True).start()
    parent = os.getppid()
    try:
        follow(
            given.journal,
            rrd=given.rrd,
            viewer=given.viewer,
            stop=lambda: asked or os.getppid() != parent,
            poll_s=given.poll,
        )
    except (JournalError, OSError) as error:
        print(f"review: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
