"""Receiver of the calibrators' results."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from numpy.typing import NDArray


class Results(Protocol):
    """Receiver of the calibrators' results, as `JournalWriter` implements it."""

    def twin_outputs(self, twin: str, ticks: Sequence[int], time_s: Sequence[float], values: NDArray[Any]) -> None: ...

    def calibration(self, calibrator: str, start_s: float, end_s: float, document: dict[str, Any]) -> None: ...

    def proposal(self, calibrator: str, time_s: float, document: dict[str, Any]) -> None: ...

    def band(self, twin: str, start_s: float, end_s: float, document: dict[str, Any]) -> None: ...

    def event(self, tick: int, time_s: float, level: str, text: str) -> None: ...
