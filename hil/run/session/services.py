"""Services that accompany a run: calibrators, live diagnosis, review, guardian."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass

from drivers.rig import rig_signals
from drivers.rig_file import Rig
from hil.diagnosis import LiveConfig, LiveDiagnosis, commissioned_on
from hil.guardian import Guard, GuardianClient, NoGuard
from hil.journal import JournalWriter
from hil.review import Follower
from hil.run.engine import Publisher
from hil.run.locks import RigClaim
from hil.run.session.request import RunInputs, RunRequest, tracking_config
from hil.run_folder import FolderLostError, RunFolder
from hil.tracking import Advice, Tracking


async def start_tracking(request: RunRequest, ready: RunInputs) -> Tracking | None:
    """Start the calibrators of a run in processes of their own; return None without a twin."""
    config = tracking_config(request, ready, tuple(signal.column for signal in rig_signals(ready.rig)))
    if config is None or ready.network is None:
        return None
    advise = None if request.network_mode == "shadow" else Advice(ready.network).news
    lockstep, watched = request.mode == "lockstep", any(spec.kind == "residual" for spec in ready.rig.interlock)
    tracking = Tracking(config, wait=lockstep, in_step=lockstep and watched, advise=advise)
    await tracking.start()
    return tracking


@dataclass(frozen=True, slots=True)
class Publishers:
    """Several publishers as one: each gets every block of ticks."""

    each: tuple[Publisher, ...]

    async def publish(self, ticks: list[int], time_s: list[float], rows: list[list[float]]) -> None:
        for publisher in self.each:
            await publisher.publish(ticks, time_s, rows)


def start_diagnosis(
    request: RunRequest, folder: RunFolder, journal: JournalWriter, announce: Callable[[str], None]
) -> LiveDiagnosis | None:
    """Start the diagnosis of the record so far if the request asks for one; return it, or None."""
    if request.diagnose_s is None:
        return None
    healthy = request.healthy or commissioned_on(folder.twin).path
    config = LiveConfig(folder.twin, folder.journal, healthy, request.diagnose_s, request.adopt)
    live = LiveDiagnosis(config, journal, announce)
    live.start()
    return live


@dataclass(slots=True)
class RunReview:
    """Review of a run by a process of its own: `shown` in a viewer, `complete` when it has been closed in order."""

    folder: RunFolder
    shown: bool = False
    complete: bool = False
    _follower: Follower | None = None

    async def start(self, *, show: bool) -> None:
        """Start that process, unless it runs already, and a viewer that it feeds if `show`."""
        from hil.review import start_follower

        if self._follower is None:
            self.shown = show
            self._follower = await asyncio.to_thread(start_follower, self.folder.journal, self.folder.review, show=show)

    async def close(self) -> None:
        """Let the process write the rest; what it leaves of an unfinished file in a moved folder is removed."""
        if self._follower is None:
            return
        self.complete = await asyncio.to_thread(self._follower.finish)
        if not self.complete:
            with contextlib.suppress(FolderLostError, OSError):
                for left in self.folder.located().path.glob(f".{self.folder.review.name}.*.part"):
                    left.unlink()


@contextlib.asynccontextmanager
async def run_review(
    request: RunRequest, folder: RunFolder, announce: Callable[[str], None]
) -> AsyncIterator[RunReview]:
    """Give the review of a run, with a viewer if there is a display or the request asks for it; close it at the end."""
    review = RunReview(folder)
    wanted = request.viewer
    if wanted is None:
        from hil.review import has_display  # its import takes half a second, which a run without a viewer saves

        wanted = has_display()
    if wanted:
        announce("opening Rerun")
        await review.start(show=True)
    try:
        yield review
    finally:
        await review.close()


async def prepare_pages(review: RunReview) -> None:
    """Start the process of the review and load the libraries of the report, while a diagnosis is waited for."""
    from hil.report import load_libraries

    await review.start(show=False)
    await asyncio.to_thread(load_libraries)


def guard_of(request: RunRequest, folder: RunFolder, claim: RigClaim, rig: Rig) -> Guard:
    """Return the guardian of a rig that outlives this process; a virtual rig of the run itself needs none."""
    if request.virtual or request.control is not None or not request.guardian:
        return NoGuard()
    return GuardianClient(rig, folder.path / "guardian.log", claim.descriptors)
