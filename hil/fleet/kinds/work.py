"""One job on a worker: its folder, its kind, what it made."""

from __future__ import annotations

import tempfile
from pathlib import Path

from hil.executor import Say
from hil.fleet.kinds import diagnose, subcommand, track
from hil.fleet.kinds.job_folder import GivenJob, JobFolder, MadeJob

_KINDS = {"diagnose": diagnose.made, "track": track.made, "train": subcommand.trained, "bench": subcommand.benched}


def perform_job(given: GivenJob, say: Say) -> MadeJob:
    """Run a job in a folder of its own, which is removed at its end; raises the errors of its kind."""
    with tempfile.TemporaryDirectory(prefix="hil-job-") as name:
        folder = JobFolder(Path(name), given)
        for place, content in given.content.items():
            path = folder.path / place
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        return _KINDS[given.kind](folder, say)


__all__ = ["GivenJob", "MadeJob", "perform_job"]
