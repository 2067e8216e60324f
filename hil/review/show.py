"""Commands on a review: open a window, follow a live run, take a screenshot."""

from __future__ import annotations

import contextlib
import logging
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from hil.files import replacing, utf8_path
from hil.review.follower import follow
from hil.review.rerun_io import Camera
from hil.review.viewer import Viewer, ViewerError, open_viewer

_FINISH_TIMEOUT_S = 120.0

_log = logging.getLogger(__name__)


@dataclass(slots=True)
class Follower:
    """Process that follows a journal into a Rerun file and into a viewer, if one opened."""

    process: subprocess.Popen[bytes]
    viewer: Viewer | None

    def finish(self) -> bool:
        """Let it send all committed rows and close the file; return True if that succeeded.

        The viewer stays open for the operator.
        """
        assert self.process.stdin is not None
        self.process.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            if self.process.wait(timeout=_FINISH_TIMEOUT_S) == 0:
                return True
        self.process.kill()
        self.process.wait()
        return False


def start_follower(journal: Path, rrd: Path, *, show: bool = True) -> Follower:
    """Start the process that writes a review, and a viewer that it feeds if `show`; without one it writes the file."""
    viewer = None
    try:
        viewer = open_viewer() if show else None
    except ViewerError as error:
        _log.warning("%s; the review is written to %s only", error, rrd)
    command = [sys.executable, "-m", "hil.review", "follow", str(journal), "--rrd", str(rrd), "--while-open"]
    command += ["--viewer", viewer.url] if viewer is not None else []
    # In its own session: Ctrl-C belongs to the engine, and its last ticks are still shown.
    # Without a viewer it says nothing: where it fails, the run makes the file from the journal and tells why not.
    errors = None if show else subprocess.DEVNULL
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=errors, start_new_session=True)
    return Follower(process, viewer)


def follow_review(journal: Path) -> None:
    """Show a run in a window while it goes on; return after the window is closed. Raise ViewerError, JournalError."""
    viewer = open_viewer()
    with contextlib.suppress(KeyboardInterrupt):
        follow(journal, rrd=None, viewer=viewer.url, stop=lambda: not viewer.alive)
        viewer.wait()
    viewer.close()


def show_review(rrd: Path) -> None:
    """Show a finished review in a window; return after it is closed. Raise ViewerError."""
    with utf8_path(rrd) as path:
        viewer = open_viewer(files=(path,))
        with contextlib.suppress(KeyboardInterrupt):
            viewer.wait()
        viewer.close()


def screenshot(
    rrd: Path, png: Path, *, size: tuple[int, int] = (1600, 1000), tab: str | None = None, timeout_s: float = 30.0
) -> list[str]:
    """Take a screenshot of a Rerun file without a display.

    Parameters
    ----------
    rrd, png
        The file, and the picture to write.
    size
        Width and height in pixels.
    tab
        Title of the tab to show, or None for the first.
    timeout_s
        Time for the viewer to draw, s.

    Returns
    -------
    list
        Complaints of the viewer's views; empty when all is well.

    Raises
    ------
    ViewerError
        No headless viewer can run.
    KeyError
        There is no such tab.
    """
    viewer = open_viewer(headless=True, size=size)
    try:
        camera = Camera(viewer.url)
        with utf8_path(rrd) as path:
            camera.open(path, tab)
            picture, settled = camera.picture(timeout_s)
            complaints = camera.complaints()
    except (ConnectionError, RuntimeError) as error:
        why = viewer.last_words() if not viewer.alive else str(error)
        raise ViewerError(
            f"no screenshot of {rrd}: {why}; a headless viewer needs a Vulkan driver (Debian: mesa-vulkan-drivers)"
        ) from error
    finally:
        viewer.close()
    with replacing(png) as temporary:
        temporary.write_bytes(picture)
    return complaints if settled else [*complaints, f"the screenshot was still changing after {timeout_s:g} s"]


screenshot_review = screenshot
