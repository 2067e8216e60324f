"""A run with alarms, the panel that serves it, and its control socket."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.hil.alarmed_run import AlarmedRun, alarmed_run

if TYPE_CHECKING:
    from tests.hil.panel.served import Served, Steered


@pytest.fixture
def run(tmp_path: Path) -> Iterator[AlarmedRun]:
    made = alarmed_run(tmp_path)
    made.step(55.0)
    yield made
    if made.path.exists():
        made.finish()


@pytest.fixture
def served(run: AlarmedRun, tmp_path: Path) -> Iterator[Served]:
    from tests.hil.panel.served import Served  # needs httpx and uvicorn

    made = Served(tmp_path)
    made.enter()
    yield made
    made.close()


@pytest.fixture
def steered(run: AlarmedRun) -> Iterator[Steered]:
    from tests.hil.panel.served import Steered

    made = Steered(run.path / "control.sock")
    yield made
    made.close()
