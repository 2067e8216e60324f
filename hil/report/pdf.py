"""PDF of a report, printed by a Chromium on this machine."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

from hil.files import replacing

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "microsoft-edge")
"""Names of programs that print a page with the options of Chromium."""
PRINT_WITHIN_S = 120.0
"""Longest time for printing, s: a report of 40 h takes some seconds."""


class PdfError(RuntimeError):
    """PDF that cannot be made; the message states the remedy."""


def write_pdf(page: Path, pdf: Path) -> None:
    """Print the HTML file `page` to `pdf`.

    Raises
    ------
    PdfError
        There is no Chromium on this machine, or it prints nothing.
    """
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        raise PdfError(
            f"no Chromium is on this machine to make {pdf.name}; install one, or open {page} in a browser and print it"
        )
    with replacing(pdf) as unfinished, tempfile.TemporaryDirectory(prefix="hil-pdf-") as profile:
        command = [
            browser,
            "--headless",
            "--disable-gpu",
            "--no-first-run",
            "--no-pdf-header-footer",
            f"--user-data-dir={profile}",
            f"--print-to-pdf={unfinished.absolute()}",
            page.absolute().as_uri(),
        ]
        problem = ""
        # In a container and for root Chromium has no sandbox; the page runs no script and loads nothing.
        for extra in ((), ("--no-sandbox",)):
            try:
                done = subprocess.run(
                    [command[0], *extra, *command[1:]], capture_output=True, timeout=PRINT_WITHIN_S, check=False
                )
            except (OSError, subprocess.TimeoutExpired) as error:
                raise PdfError(f"{browser} did not print {page} ({error}); print it from a browser") from None
            if unfinished.is_file() and unfinished.stat().st_size:
                return
            lines = done.stderr.decode("utf-8", "replace").strip().splitlines()
            problem = lines[-1] if lines else f"exit code {done.returncode}"
        raise PdfError(f"{browser} did not print {page} ({problem}); print it from a browser")
