"""Where the results of calibrators go."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from numpy.typing import NDArray


class Results(Protocol):
    """Where calibrators' results go: what `JournalWriter` has for them."""

    def twin_outputs(self, twin: str, ticks: Sequence[int], time_s: Sequence[float], values: NDArray[Any]) -> None: ...

    def calibration(self, calibrator: str, start_s: float, end_s: float, document: dict[str, Any]) -> None: ...

    def proposal(self, calibrator: str, time_s: float, document: dict[str, Any]) -> None: ...

    def band(self, twin: str, start_s: float, end_s: float, document: dict[str, Any]) -> None: ...

    def event(self, tick: int, time_s: float, level: str, text: str) -> None: ...
