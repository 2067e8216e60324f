"""Answers of a network ensemble to the windows of calibrated cells, by minute of their records.

The causal branch answers as a service would have at the time. Its answers are the proposals. The symmetric branch
answers as an offline report does. Both hide the outlet readings of each window of two hours.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from hil.tower.calibration import CellResult
from hil.tower.network.cell_windows import check_cells, windows_table
from hil.tower.station import StationNotes
from twin.calibrators.hiera_unet import HieraError
from twin.tower import DEVIATIONS, Array

if TYPE_CHECKING:
    from twin.calibrators.hiera_unet.tower import EnsembleAnswer

NETWORK = "hiera_unet"
NetworkMode = Literal["shadow", "advisory", "controlled"]
Say = Callable[[str], None]


@dataclass(frozen=True)
class NetworkAnswers:
    """Answers of one branch by minute of a cell's record (n,), NaN outside of answered windows.

    Attributes
    ----------
    t_out, half
        (n,) outlet degC and half width of its 90 % interval.
    deviations, deviation_half
        (n, 4) fill, air, uniformity as deviations from 1, bias K, and half widths.
    start_s
        (K,) s since 1970, of the answered windows.
    distance
        (K,) from the training envelope, 1 at its limit.
    attention
        (K, 4, 12) of each query.
    """

    t_out: Array
    half: Array
    deviations: Array
    deviation_half: Array
    start_s: Array
    distance: Array
    attention: Array


@dataclass(frozen=True)
class StationAnswers:
    """Answers of an ensemble to the cells of a station: causal and symmetric, by cell.

    Attributes
    ----------
    name, digest
        Of the ensemble's card.
    members
        Number of members.
    blind
        Names of members that the gate against blindness refused.
    mode
        Use of the proposals.
    outlet
        Sentence on an outlet that is the start's, "" where it is the network's.
    """

    name: str
    digest: str
    members: int
    blind: tuple[str, ...]
    mode: NetworkMode
    causal: dict[int, NetworkAnswers]
    symmetric: dict[int, NetworkAnswers]
    outlet: str = ""


def ask_network(
    card: Path, results: Sequence[CellResult], notes: StationNotes, mode: NetworkMode, say: Say = lambda _: None
) -> StationAnswers:
    """Return the answers of the ensemble of a card to calibrated cells.

    Parameters
    ----------
    card
        Card of the ensemble.
    results
        Calibrated cells.
    notes
        Datasheet and events of the station.
    mode
        Use of the answers; any but shadow needs an ensemble without a blind member.
    say
        Function that is called before each cell.

    Raises
    ------
    HieraError
        The ensemble or a cell's record cannot be used.
    RecordError
        The station's notes cannot be read.
    """
    from twin.calibrators.hiera_unet.weights.device import ready

    ready()
    from twin.calibrators.hiera_unet.tower import load_tower_ensemble

    ensemble = load_tower_ensemble(card, blind_too=mode == "shadow")
    causal, symmetric = {}, {}
    for result in results:
        say(f"cell {result.cell}: asking the network")
        causal[result.cell], symmetric[result.cell] = _asked(ensemble, result, notes)
    return StationAnswers(
        ensemble.name,
        ensemble.digest,
        len(ensemble.members),
        ensemble.blind,
        mode,
        causal,
        symmetric,
        ensemble.outlet,
    )


def check_network(card: Path, mode: NetworkMode, record: Path, twins: Sequence[Path]) -> None:
    """Check the ensemble of a card and the cells of a record before a calibration that takes minutes.

    Raises
    ------
    HieraError
        The ensemble cannot be used in this mode, or the network cannot read a cell.
    RecordError, TwinFileError
        A file cannot be used.
    """
    from twin.calibrators.hiera_unet.weights.device import ready

    ready()
    from twin.calibrators.hiera_unet.tower import load_tower_ensemble

    load_tower_ensemble(card, blind_too=mode == "shadow")
    check_cells(record, twins)


def _asked(ensemble: Any, result: CellResult, notes: StationNotes) -> tuple[NetworkAnswers, NetworkAnswers]:
    from twin.calibrators.hiera_unet.tower import BRANCHES, Fleet

    table, first = windows_table(result, notes)
    fleet = Fleet([table])
    found = []
    for branch in BRANCHES:
        answer = ensemble.ask(fleet, fleet.rows, branch)
        found.append(_by_minute(answer, table.start[fleet.rows] + first, result.minutes.time_s))
    return found[0], found[1]


def _by_minute(answer: EnsembleAnswer, start: NDArray[np.int64], time_s: Array) -> NetworkAnswers:
    """Return an answer laid out over a record's minutes; deviations hold for the window's two hours."""
    found, n, four = answer.found, len(time_s), len(DEVIATIONS)
    if found.theta_half is None or found.water_half is None:
        raise HieraError("the ensemble's card has no interval factors; give that of another")
    t_out, half = np.full(n, np.nan), np.full(n, np.nan)
    deviations, deviation_half = np.full((n, four), np.nan), np.full((n, four), np.nan)
    for k, at in enumerate(start.tolist()):
        rows = slice(at, at + found.water.shape[1])
        t_out[rows], half[rows] = found.water[k], found.water_half[k]
        deviations[rows], deviation_half[rows] = found.theta[k], found.theta_half[k]
    half[~np.isfinite(t_out)] = np.nan
    return NetworkAnswers(t_out, half, deviations, deviation_half, time_s[start], answer.distance, answer.attention)
