"""Blind trial over the zoo: cases are made, answered and opened under the seals of `hil.bench.discovery`.

Per case the injector (a process) makes and seals; the answerer (another) gets record, healthy record and twin, and
nothing else; the hash of its answer goes into the ledger; then the truth is opened and scored. Both are tasks of an
executor (`hil.executor`). Finished cases are kept, so that a trial can be taken up again.
"""

from __future__ import annotations

import dataclasses
import json
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.bench.discovery import GIVEN, PROJECT, Ledger, WorkerError, answer_case, no_answer, opened, sha256_of, sources
from hil.bench.zoo import sides
from hil.bench.zoo.effects import EFFECTS, NoSuchPlaceError
from hil.bench.zoo.plan import Planned, plan
from hil.bench.zoo.plants import SEALED, START_H
from hil.bench.zoo.score import ZooScore, judge
from hil.executor import Executor, ExecutorOptions, ask, in_parallel
from hil.executor import opened as opened_executor
from hil.files import replacing


class ZooTrial:
    """Trial that runs cases in the folder `work` on an executor."""

    def __init__(self, which: str, seed: int, work: Path, executor: Executor) -> None:
        zoo = sources(PROJECT / "hil" / "bench" / "zoo", [])
        base = work / f"{which}-seed{seed}-zoo{zoo}" / f"engine{sources(PROJECT / 'twin', [])}"
        self._base, self._sealed, self._open = base, base / "sealed", base / "open"
        for folder in (self._sealed, self._open):
            folder.mkdir(parents=True, exist_ok=True)
        self._ledger, self._lock, self._executor = Ledger(base / "ledger.jsonl"), threading.Lock(), executor
        if which == "sealed":
            self._ledger.note("opened families", ", ".join(SEALED))

    def run(self, case: Planned) -> ZooScore:
        """Run one case, unless it is finished already."""
        kept = self._base / f"{case.name}.json"
        if kept.is_file():
            return ZooScore(**json.loads(kept.read_text(encoding="utf-8"))["score"])
        done, answer = self._run(case)
        with replacing(kept) as unfinished:
            text = json.dumps({"score": dataclasses.asdict(done), "answer": answer}, indent=1)
            unfinished.write_text(text + "\n", encoding="utf-8")
        return done

    def _run(self, case: Planned) -> tuple[ZooScore, dict[str, Any]]:
        folder = self._open / case.name
        folder.mkdir(parents=True, exist_ok=True)
        made = self._made(case)
        truth, twin, path = self._sealed / f"{case.name}.json", folder / "twin.toml", folder / "diagnosis.json"
        truth.write_bytes(made["truth"])
        twin.write_bytes(made["twin"])
        self._write(case.name, "sealed", made["sealed"])
        given = {**{role: made[role] for role in GIVEN}, "hour": START_H}
        found: dict[str, Any] = ask(self._executor, answer_case, given, case.name)
        if "error" in found:
            path.write_text(json.dumps(no_answer(found["error"])), encoding="utf-8")
        else:
            path.write_bytes(found["answer"])
        self._write(case.name, "answered", sha256_of(path))
        self._write(case.name, "opened", sha256_of(truth))
        answer = json.loads(path.read_text(encoding="utf-8"))
        times = {"diagnose_cpu_s": found.get("cpu_s", float("nan")), "make_cpu_s": made["cpu_s"]}
        return judge(case.name, opened(truth), answer, healthy_K=_healthy_floor(twin), **times), answer

    def _made(self, case: Planned) -> dict[str, Any]:
        """Return the injector's files; an effect without a place in the plant gives way to the next one in the list."""
        names = [e.name for e in EFFECTS if case.sealed or not e.reserved]
        first = names.index(case.effect) if case.effect is not None else 0
        for k in range(len(names)):
            effect = None if case.effect is None else names[(first + k) % len(names)]
            asked = {"family": case.family, "seed": case.seed, "effect": effect, "open_sealed": case.sealed}
            made: dict[str, Any] = ask(self._executor, sides.make, {**asked, "name": case.name}, case.name)
            if "error" not in made:
                return made
            if NoSuchPlaceError.__name__ not in made["error"]:
                raise WorkerError(made["error"])
        raise WorkerError(f"no effect fits {case.family}")

    def _write(self, case: str, event: str, sha256: str) -> None:
        with self._lock:
            self._ledger.write(case, event, sha256)


def _healthy_floor(twin: Path) -> float | None:
    """Return the RMSE of the commissioned twin on the held-out part of its healthy record, over all sensors, K."""
    from twin import load

    errors = load(twin).revision.error_after_K
    return (sum(e * e for e in errors.values()) / len(errors)) ** 0.5 if errors else None


@dataclass(frozen=True, slots=True)
class TrialSize:
    """Size of a trial: half of the families, numbers of cases with an effect and healthy ones, seed."""

    which: str
    cases: int
    healthy: int
    seed: int


def measure(
    size: TrialSize, jobs: int | None, work: Path, place: ExecutorOptions, progress: Callable[[float, str], None]
) -> list[ZooScore]:
    """Run a trial.

    Parameters
    ----------
    size
        Which cases.
    jobs
        Cases at a time; None takes as many as workers are connected.
    work
        Folder for finished cases.
    place
        Workers.
    progress
        Called with the share done and the last result.

    Raises
    ------
    ExecutorError
        The workers cannot be used.
    """
    planned = plan(size.which, size.cases, size.healthy, size.seed)
    with opened_executor(place, lambda message: None) as executor:
        trial = ZooTrial(size.which, size.seed, work, executor)
        return in_parallel(
            executor, planned, trial.run, lambda share, one: progress(share, f"{one.case}: {one.outcome}"), jobs
        )
