"""Blind trial of the diagnosis: hidden effects, with answers sealed before the truth is opened.

Per case: the injector (a process) draws an effect, seals it and makes a record; the answerer (another) gets that
record, the twin and a healthy record, and nothing else; the hash of its answer goes into a ledger; then the truth is
opened and compared. Both are tasks of an executor (`hil.executor`). Cases that are finished are kept, so that a trial
can be taken up again.
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.util
import json
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.bench.discovery.injector import opened
from hil.bench.discovery.ledger import Ledger, sha256_of
from hil.bench.discovery.score import AnswerScore, judge
from hil.bench.discovery.sides import COMMISSIONING, ablate_case, answer_case, commission_specimen, make_case
from hil.bench.discovery.worker import PROJECT
from hil.executor import Executor, ExecutorOptions, ask, in_parallel
from hil.executor import opened as opened_executor
from hil.files import replacing
from hil.synthetic import setting

HOUR = 8.0
"""Time of day at the beginning of a record of the virtual rig."""


@dataclass(frozen=True, slots=True)
class TrialSize:
    """Size of a trial: numbers of cases, of further healthy records and of further ones with two effects, length in h,
    use of the wires, and use of healthy records.
    """

    cases: tuple[int, ...]
    healthy: tuple[int, ...]
    hours: float
    direct: bool
    twin: str = "loop"
    ablations: bool = True
    doubles: tuple[int, ...] = ()
    known_healthy: bool = True

    @property
    def jobs(self) -> tuple[tuple[str, int], ...]:
        """Return kind and number of each record."""
        each = (("case", self.cases), ("healthy", self.healthy), ("double", self.doubles))
        return tuple((kind, number) for kind, numbers in each for number in numbers)


@dataclass(frozen=True, slots=True)
class FinishedCase:
    """Finished case with its answers and scores; `ablation` is None if it was not run."""

    outcome: AnswerScore
    answer: dict[str, Any]
    ablation: dict[str, Any] | None


class BlindTrial:
    """Trial that runs cases in the folder `work` on an executor."""

    def __init__(self, size: TrialSize, seed: int, work: Path, executor: Executor) -> None:
        self.size, self.seed, self._executor = size, seed, executor
        how = "direct" if size.direct else "wire"
        drawn = [PROJECT / "hil" / "synthetic" / name for name in ("hidden_effects.py", "settings.py")]
        rig_key = sources(PROJECT / "drivers", [*drawn, COMMISSIONING])
        twin_key = sources(PROJECT / "twin", [PROJECT / "profiles" / "twins" / f"{size.twin}.toml"])
        base = work / f"{how}-{size.twin}-{size.hours:g}h-seed{seed}-rig{rig_key}"
        self._rigs = base / "rigs"
        self._base = base / (f"engine{twin_key}" + ("" if size.known_healthy else "-alone"))
        self._sealed, self._open = self._base / "sealed", self._base / "open"
        for folder in (self._rigs, self._sealed, self._open):
            folder.mkdir(parents=True, exist_ok=True)
        self._ledger, self._lock = Ledger(self._base / "ledger.jsonl"), threading.Lock()
        self._units: dict[int, threading.Lock] = {}

    def run(self, kind: str, number: int) -> FinishedCase:
        """Run one record of a kind, unless it is finished already; raises TaskError and ExecutorError."""
        name = f"{kind}_{number}"
        kept = self._base / f"{name}.json"
        if kept.is_file():
            return _read(kept)
        case = setting(number, self.seed, self.size.hours, kind)
        good, twin = self._specimen(case.unit)
        folder = self._open / name
        folder.mkdir(exist_ok=True)
        asked = {"setting": dataclasses.asdict(case), "draw": self.seed, "kind": kind, "direct": self.size.direct}
        made = ask(self._executor, make_case, asked, name)
        truth, path = self._sealed / f"{name}.json", folder / "diagnosis.json"
        truth.write_bytes(made["truth"])
        self._write(name, "sealed", made["sealed"])
        files = {"record": made["record"], "healthy": good, "twin": twin, "hour": HOUR}
        shown = files if self.size.known_healthy else {**files, "healthy": b""}
        found = ask(self._executor, answer_case, shown, name)
        if "error" in found:
            path.write_text(json.dumps(no_answer(found["error"])), encoding="utf-8")
        else:
            path.write_bytes(found["answer"])
        took = found.get("seconds", float("nan")), found.get("cpu_s", float("nan"))
        self._write(name, "answered", sha256_of(path))
        self._write(name, "opened", sha256_of(truth))
        hidden, answer = opened(truth), json.loads(path.read_text(encoding="utf-8"))
        ablation = None
        if self.size.ablations and not (kind == "healthy" and number >= 40):
            known = {"effects": hidden["effects"], "labels": hidden["labels"]}
            ablation = ask(self._executor, ablate_case, {**asked, **files, **known}, name)
        told: dict[str, Any] = ablation or {}
        z = max((v for v in told.get("z_truth", []) if v is not None), default=None)
        beside = [v for v in told.get("z_beside", []) if v is not None]
        outcome = judge(name, case.load, hidden, answer, took, z, told.get("sizes", ()), beside)
        done = FinishedCase(outcome, answer, ablation)
        _write(done, kept)
        return done

    def _specimen(self, unit: int) -> tuple[bytes, bytes]:
        """Return the healthy record and the commissioned twin of a specimen, which is made once."""
        good, own = self._rigs / f"unit_{unit}.parquet", self._rigs / f"unit_{unit}.toml"
        with self._lock:
            once = self._units.setdefault(unit, threading.Lock())
        with once:
            if not (good.is_file() and own.is_file()):
                made = ask(
                    self._executor, commission_specimen, {"unit": unit, "twin": self.size.twin}, f"specimen {unit}"
                )
                for path, content in ((good, made["healthy"]), (own, made["twin"])):
                    with replacing(path) as unfinished:
                        unfinished.write_bytes(content)
        return good.read_bytes(), own.read_bytes()

    def _write(self, case: str, event: str, sha256: str) -> None:
        with self._lock:
            self._ledger.write(case, event, sha256)


def measure(
    size: TrialSize,
    seed: int,
    jobs: int | None,
    work: Path,
    place: ExecutorOptions,
    progress: Callable[[float, str], None],
) -> list[FinishedCase]:
    """Run all records.

    Parameters
    ----------
    size, seed
        Which records.
    jobs
        Records at a time; None takes as many as workers are connected.
    work
        Folder for finished cases.
    place
        Workers.
    progress
        Called with the share done and the last result.

    Raises
    ------
    TaskError, ExecutorError
        A side failed, or the workers cannot be used.
    """
    with opened_executor(place, lambda message: None) as executor:
        trial = BlindTrial(size, seed, work, executor)
        return in_parallel(
            executor,
            size.jobs,
            lambda job: trial.run(*job),
            lambda share, one: progress(share, f"{one.outcome.case}: {one.outcome.verdict}"),
            jobs,
        )


def sources(folder: Path, more: Iterable[Path]) -> str:
    """Return a hash of a package's source and of some files."""
    paths = [*sorted(folder.rglob("*.py")), *more]
    return hashlib.sha256(b"\0".join(p.read_bytes() for p in paths)).hexdigest()[:10]


def left_out() -> tuple[str, ...]:
    """Return the comparisons that are not possible here."""
    if importlib.util.find_spec("pysindy") is None:
        return ("pysindy on the same records: it is not installed",)
    return ()


def no_answer(error: str) -> dict[str, Any]:
    """Return the document of a diagnosis that ended with an error."""
    return {
        "verdict": "crashed",
        "summary": error,
        "effects": [],
        "indistinguishable": [],
        "alternatives": [],
        "error": {"sensors": {}},
    }


def _write(done: FinishedCase, path: Path) -> None:
    with replacing(path) as unfinished:
        unfinished.write_text(json.dumps(dataclasses.asdict(done), indent=1) + "\n", encoding="utf-8")


def _read(path: Path) -> FinishedCase:
    data = json.loads(path.read_text(encoding="utf-8"))
    outcome = data["outcome"]
    if outcome["errors_K"] is not None:
        outcome["errors_K"] = tuple(outcome["errors_K"])
    return FinishedCase(AnswerScore(**outcome), data["answer"], data["ablation"])
