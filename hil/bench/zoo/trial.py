"""Blind trial over the zoo: cases are made, answered and opened under the seals of `hil.bench.discovery`.

Per case the injector (a process) makes and seals; the answerer (another) gets record, healthy record and twin, and
nothing else; the hash of its answer goes into the ledger; then the truth is opened and scored. Finished cases are kept,
so that a trial can be taken up again.
"""

from __future__ import annotations

import dataclasses
import json
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from hil.bench.discovery import PROJECT, Ledger, Worker, WorkerError, no_answer, opened, sha256_of, sources
from hil.bench.zoo.effects import EFFECTS, NoSuchPlaceError
from hil.bench.zoo.plan import Planned, plan
from hil.bench.zoo.plants import SEALED, START_H
from hil.bench.zoo.score import ZooScore, judge
from hil.files import replacing


class ZooTrial:
    """Trial that runs cases in the folder `work`; `jobs` pairs of workers."""

    def __init__(self, which: str, seed: int, work: Path, jobs: int = 1) -> None:
        zoo = sources(PROJECT / "hil" / "bench" / "zoo", [])
        base = work / f"{which}-seed{seed}-zoo{zoo}" / f"engine{sources(PROJECT / 'twin', [])}"
        self._base, self._sealed, self._open = base, base / "sealed", base / "open"
        for folder in (self._sealed, self._open):
            folder.mkdir(parents=True, exist_ok=True)
        self._ledger, self._lock = Ledger(base / "ledger.jsonl"), threading.Lock()
        self._pairs: SimpleQueue[tuple[Worker, Worker]] = SimpleQueue()
        self._workers: list[Worker] = []
        for _ in range(jobs):
            pair = (Worker("hil.bench.zoo.injector", str(self._sealed)), Worker("hil.bench.discovery.answerer"))
            self._workers += pair
            self._pairs.put(pair)
        if which == "sealed":
            self._ledger.note("opened families", ", ".join(SEALED))

    def close(self) -> None:
        """End the workers."""
        for worker in self._workers:
            worker.close()

    def run(self, case: Planned) -> ZooScore:
        """Run one case, unless it is finished already."""
        kept = self._base / f"{case.name}.json"
        if kept.is_file():
            return ZooScore(**json.loads(kept.read_text(encoding="utf-8"))["score"])
        injector, answerer = pair = self._pairs.get()
        try:
            done, answer = self._run(case, injector, answerer)
        finally:
            self._pairs.put(pair)
        with replacing(kept) as unfinished:
            text = json.dumps({"score": dataclasses.asdict(done), "answer": answer}, indent=1)
            unfinished.write_text(text + "\n", encoding="utf-8")
        return done

    def _run(self, case: Planned, injector: Worker, answerer: Worker) -> tuple[ZooScore, dict[str, Any]]:
        folder = self._open / case.name
        folder.mkdir(parents=True, exist_ok=True)
        try:
            made = _made(injector, case, folder)
            self._write(case.name, "sealed", made["sealed"])
            given = {
                "record": made["record"],
                "twin": made["twin"],
                "healthy": made["healthy"],
                "hour": START_H,
            }
            try:
                handed_in = answerer.ask(**given, out=str(folder))
                path, took = Path(handed_in["answer"]), float(handed_in["cpu_s"])
            except WorkerError as error:
                path, took = folder / "diagnosis.json", float("nan")
                path.write_text(json.dumps(no_answer(str(error))), encoding="utf-8")
            self._write(case.name, "answered", sha256_of(path))
            truth = self._sealed / f"{case.name}.json"
            self._write(case.name, "opened", sha256_of(truth))
            answer = json.loads(path.read_text(encoding="utf-8"))
            floor = _healthy_floor(Path(made["twin"]))
            done = judge(
                case.name, opened(truth), answer, healthy_K=floor, diagnose_cpu_s=took, make_cpu_s=made["cpu_s"]
            )
            return done, answer
        finally:
            for path in folder.glob("*.parquet"):
                path.unlink()

    def _write(self, case: str, event: str, sha256: str) -> None:
        with self._lock:
            self._ledger.write(case, event, sha256)


def _made(injector: Worker, case: Planned, folder: Path) -> dict[str, Any]:
    """Return the injector's files; an effect without a place in the plant gives way to the next one in the list."""
    names = [e.name for e in EFFECTS if case.sealed or not e.reserved]
    first = names.index(case.effect) if case.effect is not None else 0
    for k in range(len(names)):
        effect = None if case.effect is None else names[(first + k) % len(names)]
        asked = {"family": case.family, "seed": case.seed, "effect": effect, "open_sealed": case.sealed}
        try:
            return injector.ask(**asked, name=case.name, folder=str(folder))
        except WorkerError as error:
            if NoSuchPlaceError.__name__ not in str(error):
                raise
    raise WorkerError(f"no effect fits {case.family}")


def _healthy_floor(twin: Path) -> float | None:
    """Return the RMSE of the commissioned twin on the held-out part of its healthy record, over all sensors, K."""
    from twin import load

    errors = load(twin).revision.error_after_K
    return (sum(e * e for e in errors.values()) / len(errors)) ** 0.5 if errors else None


def measure(
    which: str,
    cases: int,
    healthy: int,
    seed: int,
    jobs: int,
    work: Path,
    progress: Callable[[float, str], None],
) -> list[ZooScore]:
    """Run a trial. `progress` is called with the share done and the last result."""
    trial = ZooTrial(which, seed, work, jobs)
    planned = plan(which, cases, healthy, seed)
    finished = 0
    lock = threading.Lock()

    def run(case: Planned) -> ZooScore:
        nonlocal finished
        done = trial.run(case)
        with lock:
            finished += 1
            progress(finished / len(planned), f"{done.case}: {done.outcome}")
        return done

    try:
        with ThreadPoolExecutor(jobs) as pool:
            return list(pool.map(run, planned))
    finally:
        trial.close()
