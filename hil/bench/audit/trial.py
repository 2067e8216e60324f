"""Benchmark `hil bench audit`: measures of each known cause of the network's blindness, before anything is trained."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hil.bench.audit import loop, tower
from hil.bench.audit.causes import blind_outputs, causes_of
from hil.bench.audit.subject import SubjectAudit
from hil.bench.audit.tables import causes_table, subject_tables
from hil.bench.measure import ReportTable


@dataclass(frozen=True, slots=True)
class AuditSize:
    """Size of an audit: simulated rigs of the loop; training stations, and as many unseen ones, of the tower whose
    records are simulated in parts and whole; windows of each of these four kinds.
    """

    rigs: int = 10
    stations: tuple[int, int] = (4, 4)
    windows: int = 96


FULL = AuditSize()
QUICK = AuditSize(rigs=2, stations=(1, 2), windows=12)


def measure(
    size: AuditSize, seed: int, loop_card: Path | None, tower_card: Path | None, say: Callable[[float, str], None]
) -> tuple[tuple[ReportTable, ...], tuple[str, ...]]:
    """Return the tables, and a line for everything left out.

    Parameters
    ----------
    loop_card, tower_card
        Cards of the ensembles; None leaves a subject out.
    say
        Called with each stage.

    Raises
    ------
    HieraError
        A card or a member cannot be used.
    """
    from twin.calibrators.hiera_unet.weights.device import ready

    ready("cpu", 1)
    found: list[SubjectAudit] = []
    left_out = []
    if loop_card is None:
        left_out.append("loop: name the card of its ensemble with --loop")
    else:
        say(0.0, "loop")
        found.append(loop.audit_loop(loop_card, size.rigs, seed))
    if tower_card is None:
        left_out.append("tower: name the card of its ensemble with --tower")
    else:
        say(0.3, "tower")
        found.append(tower.audit_tower(tower_card, size.stations, size.windows, seed, lambda text: say(0.4, text)))
    causes = [cause for one in found for cause in causes_of(one)]
    outputs = [c for one in found for c in blind_outputs(one, tower.LEARNED, tower.OTHERS, tower.GAUSS_NEWTON)]
    tables = [causes_table("causes", "Known causes of blindness", causes)]
    if outputs:
        tables.append(causes_table("outputs", "Explanations of the blind outputs of the tower's members", outputs))
    for one in found:
        tables += subject_tables(one)
    return tuple(tables), tuple(left_out)
