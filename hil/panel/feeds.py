"""Feeds of the runs that somebody looks at: one poll a second each, and its result for every viewer.

A viewer waits for the next state and gets the latest: one that is slow misses states, and delays nobody.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

from hil.alarms import AlarmError
from hil.files import on_terminal
from hil.journal import JournalError
from hil.panel.errors import PanelError
from hil.panel.run_feed import RunFeed
from hil.run_folder import RunFolder, RunFolderError

POLL_S = 1.0
"""Time from one state to the next, s."""
IDLE_S = 60.0
"""Time without a viewer after which a feed is closed, s."""
MOST_FEEDS = 20
"""Runs that are followed at a time."""
MOST_RUNS = 500
"""Runs that a list shows, the newest first."""
LISTED_FOR_S = 2.0
"""So long a list of runs serves all viewers, s."""

T = TypeVar("T")
_log = logging.getLogger(__name__)


class Feed:
    """Feed of one run: `version` counts its states, `latest` is the present one as JSON, `failure` why it ended."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.latest = b""
        self.version = 0
        self.failure: str | None = None
        self.used_at = time.monotonic()
        self.viewers = 0
        self._feed: RunFeed | None = None
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="feed")
        self._changed = asyncio.Condition()
        self._task = asyncio.create_task(self._follow())

    @property
    def state(self) -> str:
        """Return the state of the run."""
        return "" if self._feed is None else self._feed.state

    async def begun(self) -> None:
        """Wait for the first state; raises PanelError where there is none."""
        await self.after(0)

    async def after(self, version: int) -> int:
        """Wait for a state later than `version`, and return its number; raises PanelError where the feed has ended."""
        async with self._changed:
            await self._changed.wait_for(lambda: self.version > version or self.failure is not None)
        if self.failure is not None:
            raise PanelError(self.failure)
        return self.version

    async def call(self, work: Callable[[RunFeed], T]) -> T:
        """Return the result of `work` in the feed's thread; raises what it raises, or PanelError."""
        await self.begun()
        feed = self._feed
        assert feed is not None
        self.used_at = time.monotonic()
        try:
            return await asyncio.get_running_loop().run_in_executor(self._thread, work, feed)
        except (PanelError, AlarmError, JournalError, RunFolderError):
            raise
        except Exception as error:
            raise PanelError(self._defect(error)) from error

    async def refresh(self) -> None:
        """Read the run now: what an operator did shows at once."""
        await self.call(lambda run: run.look_again())
        await self._poll()

    async def close(self) -> None:
        """End the feed."""
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)  # what it failed of is told to its viewers alone
        await self._end("the panel has stopped following this run; load the page again")

    async def _follow(self) -> None:
        while self.failure is None:
            began = time.monotonic()
            await self._poll()
            await asyncio.sleep(max(0.05, POLL_S - (time.monotonic() - began)))

    async def _poll(self) -> None:
        try:
            latest = await asyncio.get_running_loop().run_in_executor(self._thread, self._read)
        except (PanelError, AlarmError, JournalError, RunFolderError, OSError) as error:
            await self._end(str(error))
            return
        except Exception as error:
            await self._end(self._defect(error))
            return
        async with self._changed:
            self.latest = latest
            self.version += 1
            self._changed.notify_all()

    def _defect(self, error: Exception) -> str:
        """Return a sentence on content that no check has refused, and name it on the terminal."""
        said = f"{self.folder} holds content that no run of this version writes, and cannot be shown"
        _log.error("%s (%r)", on_terminal(said), error)
        return f"{said}; `hil report` may name it"

    def _read(self) -> bytes:
        if self._feed is None:
            self._feed = RunFeed(self.folder)
        return self._feed.poll()

    async def _end(self, failure: str) -> None:
        async with self._changed:
            first, self.failure = self.failure is None, self.failure or failure
            self._changed.notify_all()
        if first:
            feed = self._feed
            if feed is not None:
                self._thread.submit(feed.close)
            self._thread.shutdown(wait=False)


class Feeds:
    """Feeds of the runs in `folder`, a run folder or a folder of runs."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._is_run = (folder / "run.json").is_file()
        self._feeds: dict[str, Feed] = {}
        self._lock = threading.Lock()
        self._listed: list[dict[str, Any]] = []
        self._listed_at = -math.inf
        self._manifests: dict[str, tuple[int, str, str]] = {}

    def folder_of(self, name: str) -> Path:
        """Return the folder of the run called `name`; raises PanelError where there is none."""
        if self._is_run and name == self._folder.resolve().name:
            return self._folder
        path = self._folder / name
        try:
            there = not self._is_run and Path(name).name == name and (path / "run.json").is_file()
        except (OSError, ValueError):  # a name that no file can have
            there = False
        if not there:
            raise PanelError(f"there is no run {name[:80]!r}; it was deleted or moved")
        return path

    async def of(self, name: str) -> Feed:
        """Return the feed of a run, which begins where nobody has looked at it; raises PanelError."""
        await self._close_idle()
        feed = self._feeds.get(name)
        if feed is None or feed.failure is not None:
            folder = self.folder_of(name)
            if len(self._feeds) >= MOST_FEEDS:
                raise PanelError(f"{MOST_FEEDS} runs are shown already; close another one's page and wait a minute")
            feed = self._feeds[name] = Feed(folder)
        feed.used_at = time.monotonic()
        return feed

    def listing(self) -> list[dict[str, Any]]:
        """Return the runs, newest first: name, state as the manifest has it, start."""
        with self._lock:
            now = time.monotonic()
            if now - self._listed_at >= LISTED_FOR_S:
                self._listed, self._listed_at = self._list_now(), now
            return self._listed

    def _list_now(self) -> list[dict[str, Any]]:
        names = [self._folder.resolve().name] if self._is_run else self._names()
        found = []
        for name in names:
            run = RunFolder(self._folder if self._is_run else self._folder / name)
            with contextlib.suppress(RunFolderError, OSError):
                written = run.manifest.stat().st_mtime_ns
                known = self._manifests.get(name)
                if known is None or known[0] != written:
                    manifest = run.read_manifest()
                    known = written, str(manifest.get("exit_status", "")), str(manifest.get("started", ""))
                    self._manifests[name] = known
                _, status, started = known
                found.append({"name": name, "status": status, "started": started})
        self._manifests = {item["name"]: self._manifests[item["name"]] for item in found}
        found = sorted(found, key=lambda item: (item["started"], item["name"]), reverse=True)[:MOST_RUNS]
        for item in found:
            run = RunFolder(self._folder if self._is_run else self._folder / item["name"])
            if item["status"] == "running" and run.was_cut:
                item["status"] = "interrupted"
        return found

    async def close(self) -> None:
        """End all feeds."""
        for feed in self._feeds.values():
            await feed.close()
        self._feeds.clear()

    def _names(self) -> list[str]:
        try:
            return [path.parent.name for path in self._folder.glob("*/run.json")]
        except OSError:
            return []

    async def _close_idle(self) -> None:
        now = time.monotonic()
        for name, feed in list(self._feeds.items()):
            if feed.failure is not None or (feed.viewers == 0 and now - feed.used_at > IDLE_S):
                del self._feeds[name]
                await feed.close()
