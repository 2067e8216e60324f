"""Comparison of twins as batches for the review: their bands, and the network's proposals between windows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from hil.files import estimate_text
from hil.journal import BandRow, ProposalRow
from hil.review.batches.columns import Estimates, ReviewBatch, Rows, States, Texts
from hil.review.plan import path
from hil.tracking import Proposed, accepted, offset_text
from twin import NORMAL90

OPEN, SOME = "open", "some held"


def band_batches(bands: list[BandRow]) -> Iterator[ReviewBatch]:
    """Yield the mean error (n, 1) of ten minutes, and its predicted band (n, 2), by sensor and twin."""
    for twin in dict.fromkeys(band.twin for band in bands):
        mine = [band for band in bands if band.twin == twin]
        start_s = np.array([band.start_s for band in mine])
        for sensor in mine[0].document["mean_K"]:
            mean, half = (_column(mine, key, sensor) for key in ("mean_K", "half_width_K"))
            yield Rows(path("sensors", sensor, "miss", twin), start_s, mean[:, None])
            yield Rows(path("sensors", sensor, "band", twin), start_s, np.column_stack([half, -half]))


def _column(bands: list[BandRow], key: str, sensor: str) -> np.ndarray:
    cells = (band.document[key][sensor] for band in bands)
    return np.array([np.nan if cell is None else cell for cell in cells])


def gate_state(document: Mapping[str, object]) -> str:
    """Return the state of the lane of gates: open, some held, or the code that holds everything."""
    values, held = document["values"], document["held"]
    assert isinstance(values, dict) and isinstance(held, dict)
    if not held:
        return OPEN
    return SOME if len(held) < len(values) else str(next(iter(held.values())))


def proposal_text(proposed: Proposed) -> str:
    """Return a proposal in one line: accepted parameters, and codes that hold the others."""
    taken = [f"{name} = {estimate_text(a.value, a.half_width)}" for name, a in accepted([proposed]).items()]
    codes: dict[str, list[str]] = {}
    for name, code in proposed.document["held"].items():
        codes.setdefault(code, []).append(name)
    parts = [f"accepts {', '.join(taken)}"] if taken else []
    if taken or len(codes) > 1:
        parts += [f"{code} holds {', '.join(names)}" for code, names in codes.items()]
    else:
        parts += [str(proposed.document["reasons"][0]) + ": all held"]
    if proposed.document.get("adrift"):
        parts += ["the live twin is far off, and accepts held parameters too"]
    parts += [f"{d['sensor']} is excluded: {offset_text(d['off_K'])}" for d in proposed.document.get("doubted", ())]
    return "; ".join(parts)


class Proposals:
    """Converter of proposals to lanes, parameters with bands, and log lines.

    A line reports a change of the closed gates, of the excluded sensors, or a live twin that has become far off."""

    def __init__(self) -> None:
        self._told: dict[str, tuple[dict[str, str], bool, list[str]]] = {}
        self._state: dict[str, str] = {}

    @property
    def calibrators(self) -> tuple[str, ...]:
        """Return the calibrators with proposals so far."""
        return tuple(self._told)

    def batches(self, proposals: list[ProposalRow], units: Mapping[str, str]) -> Iterator[ReviewBatch]:
        """Yield the batches; `units` are those of the parameters so far."""
        for calibrator in dict.fromkeys(row.calibrator for row in proposals):
            mine = [row for row in proposals if row.calibrator == calibrator]
            time_s = np.array([row.time_s for row in mine])
            changes, texts = [], []
            for row in mine:
                state = gate_state(row.document)
                if state != self._state.get(calibrator):
                    changes.append((row.time_s, state))
                doubted = [d["sensor"] for d in row.document.get("doubted", ())]
                now = row.document["held"], bool(row.document.get("adrift")), doubted
                if now != self._told.get(calibrator):
                    texts.append((row.time_s, proposal_text(Proposed(calibrator, row.time_s, row.document))))
                self._state[calibrator], self._told[calibrator] = state, now
            if changes:
                yield States(path("gates", calibrator), np.array([t for t, _ in changes]), [s for _, s in changes])
            if texts:
                lines = [text for _, text in texts]
                yield Texts(
                    path("proposals", calibrator), np.array([t for t, _ in texts]), lines, ["INFO"] * len(lines)
                )
            for name in mine[0].document["values"]:
                # A held value is no estimate: it would only widen the axis.
                known = [name not in row.document["held"] for row in mine]
                values = np.where(known, [row.document["values"][name] for row in mine], np.nan)
                half = np.array([NORMAL90 * row.document["standard_errors"][name] for row in mine])
                entity = path("proposed", name, calibrator)
                label = f"{calibrator} proposes"
                yield Estimates(entity, label, units.get(name, "1"), time_s, values, np.where(known, half, np.nan) ** 2)
