"""Session of one member for `hil train tower`: simulate, train, gate and write, in as many parts as it takes."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.training.tower.ensemble import assemble
from hil.training.tower.generate import TRAIN, VALIDATION, DataPlan, digest_of, generate, tables

Say = Callable[[float, str], None]
"""Callback with the units done and a note."""


@dataclass(frozen=True)
class TowerProgress:
    """Progress of a member: stations simulated of those wanted, steps done of those planned.

    At its end `card` is the written card, `refused` the gate's code of the parameters or "", `outlet` a sentence where
    the outlet is the start's, and `gate` its figures.
    """

    stations: int
    wanted: int
    done: int = 0
    steps: int = 0
    card: Path | None = None
    refused: str = ""
    outlet: str = ""
    gate: dict[str, Any] | None = None
    note: str = ""


def simulate_stations(
    plan: DataPlan, folder: Path, workers: int, minutes: float | None, stopped: Callable[[], bool], say: Say
) -> TowerProgress:
    """Simulate the stations that `folder` lacks, until it has all or the work is stopped.

    Parameters
    ----------
    plan
        Number and length of the stations.
    folder
        Folder of the stations.
    workers
        Number of processes.
    minutes
        Time limit, or None.
    stopped
        Function that turns true when the work is to end.
    say
        Function that gets the progress.

    Raises
    ------
    HieraError
        The folder holds stations of another plan.
    """
    wanted = len(plan.stations())
    until = None if minutes is None else time.monotonic() + 60.0 * minutes
    done = [0]

    def note(text: str) -> None:
        done[0] += 1
        say(float(done[0]), text)

    count = generate(plan, folder, workers, until, note, stopped)
    return TowerProgress(count, wanted)


def train_member(
    folder: Path,
    size: str,
    plan: Any,
    out: Path,
    *,
    stopped: Callable[[], bool],
    command: str,
    say: Say,
    device: str = "cpu",
) -> TowerProgress:
    """Continue the training of `out` until it is stopped, or to its end; then write weights and card.

    The network corrects the answer of boosted trees, which are fitted first where scikit-learn is installed. With a
    second member of the same data beside it, the card of their ensemble is written too.

    Parameters
    ----------
    folder
        Of the simulated stations.
    plan
        `twin.calibrators.hiera_unet.tower.plan.TowerPlan`.
    out
        The weights' path; the state of a training that was cut lies in a folder of the same name without suffix.

    Raises
    ------
    HieraError
        The stations cannot be used, or the training that was begun is another one.
    """
    from hil.training.tower.starting import begin, fit_start, load_start
    from twin.calibrators.hiera_unet.tower import MemberTraining, load_fleet
    from twin.calibrators.hiera_unet.tower.predict import start_sentence

    if load_start(folder) is None:
        fit_start(folder)
    family, held_out = load_fleet(tables(folder, TRAIN), device), load_fleet(tables(folder, VALIDATION), device)
    begin(folder, family)
    trees = load_start(folder)
    training = MemberTraining(size, plan, family, held_out, out.with_suffix(""), digest_of(folder), trees)
    training.run(None, stopped, lambda k, n, text: say(float(k), text))
    trainer = training.trainer
    if trainer.done < plan.steps:
        return TowerProgress(0, 0, trainer.done, plan.steps)
    gate = training.gate()
    card = training.write(out, gate, {"command": command})
    assemble(folder, out.with_name(out.stem.rpartition("_")[0]), device=device)
    note = training.note() if training.curves else ""
    outlet = start_sentence(trees is not None) if gate.outputs_code else ""
    return TowerProgress(0, 0, trainer.done, plan.steps, card, gate.code, outlet, gate.document(), note)
