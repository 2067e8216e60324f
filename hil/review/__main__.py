"""Process of the review, `python -m hil.review follow JOURNAL`, so that no tick waits for it."""

from __future__ import annotations

import argparse
import logging
import os
import signal
import sys
from pathlib import Path
from types import FrameType

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
    given = parser.parse_args(arguments)
    logging.basicConfig(format="%(message)s", level=logging.WARNING)
    asked = False

    def ask(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        asked = True

    signal.signal(signal.SIGTERM, ask)
    signal.signal(signal.SIGINT, ask)
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
