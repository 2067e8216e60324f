"""Code fences of the pages, and the words after their language that state how a test treats them.

``sh``            commands, run one by one in the folder of the page
``sh background`` one command that goes on until a later fence ends it
``sh REASON``     commands that no test can run, with a reason of `REASONS`
``sh serving``    `hil rig`, which goes on until the end of the page
``python``        run in the folder of the page
``LANG file=X``   the text of the file X, which later fences use
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]
REASONS = {
    "needs-docker": "builds or runs a container",
    "needs-rig": "a rig, bus or device of the reader's own",
    "needs-install": "downloads packages or changes the machine",
    "needs-display": "opens a window",
    "fixed-port": "listens on a port that another process may hold",
    "takes-long": "minutes of processor time",
}
_OPEN = re.compile(r"^(?P<ticks>`{3,})(?P<info>[^`]*)$")


@dataclass(frozen=True)
class Fence:
    """One code fence: where it is, its language, the further words of its info string, and its text."""

    page: Path
    line: int
    language: str
    words: tuple[str, ...]
    text: str

    @property
    def place(self) -> str:
        """Page and line, for messages."""
        return f"{self.page.relative_to(PROJECT)}:{self.line}"

    @property
    def reason(self) -> str | None:
        """Return why no test can run it, or None."""
        return next((word for word in self.words if word in REASONS), None)

    @property
    def file(self) -> str | None:
        """Return the name of the file that the text is, or None."""
        return next((word.removeprefix("file=") for word in self.words if word.startswith("file=")), None)

    def commands(self) -> list[str]:
        """Return the commands of a fence of `sh`: lines joined at backslashes, without prompts and comments."""
        joined = re.sub(r"\\\n\s*", "", self.text)
        lines = (line.strip().removeprefix("$ ") for line in joined.splitlines())
        return [line for line in lines if line and not line.startswith("#")]


def pages() -> list[Path]:
    """Return the pages whose fences are run: README, CONTRIBUTING, tutorials and how-to guides."""
    found = [PROJECT / "README.md", PROJECT / "CONTRIBUTING.md"]
    for folder in ("tutorial", "how-to"):
        found += sorted((PROJECT / "docs" / folder).glob("*.md"))
    return [page for page in found if page.is_file()]


def fences(page: Path) -> list[Fence]:
    """Return the fences of a page in order; those of MyST directives (``{toctree}``) are left out."""
    found: list[Fence] = []
    info: str | None = None
    ticks, start, lines = "", 0, []
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
        opened = _OPEN.match(line)
        if info is None and opened:
            info, ticks, start, lines = opened["info"].strip(), opened["ticks"], number, []
        elif info is not None and line.strip() == ticks:
            language, *words = info.split() or [""]
            if not language.startswith("{"):
                found.append(Fence(page, start, language, tuple(words), "\n".join(lines) + "\n"))
            info = None
        elif info is not None:
            lines.append(line)
    assert info is None, f"{page.name}: the fence of line {start} is not closed"
    return found
