"""Blind trial of the diagnosis: hidden effects, with answers sealed before the truth is opened.

Per case: the injector (a process) draws an effect, seals it and makes a record; the answerer (another) gets that
record, the twin and a healthy record, and nothing else; the hash of its answer goes into a ledger; then the truth is
opened and compared. Cases that are finished are kept, so that a trial can be taken up again.
"""

from __future__ import annotations

import asyncio
import dataclasses
import hashlib
import importlib.util
import json
import shutil
import tempfile
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.bench.discovery.injector import RIG, opened
from hil.bench.discovery.ledger import Ledger, sha256_of
from hil.bench.discovery.score import AnswerScore, judge
from hil.bench.discovery.worker import PROJECT, Worker, WorkerError
from hil.files import replacing
from hil.synthetic import Setting, profile, profile_text, setting

HOUR = 8.0
"""Time of day at the beginning of a record of the virtual rig."""
COMMISSIONING = PROJECT / "profiles" / "loads" / "commissioning_10h.csv"
COMMISSIONING_SEED = 77


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
    """Trial that runs cases in the folder `work`, one after the other."""

    def __init__(self, size: TrialSize, seed: int, work: Path) -> None:
        self.size, self.seed = size, seed
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
        self._injector = Worker("hil.bench.discovery.injector", str(self._sealed))
        self._answerer = Worker("hil.bench.discovery.answerer")
        self._ablation = Worker("hil.bench.discovery.ablation")
        self._ledger = Ledger(self._base / "ledger.jsonl")

    def close(self) -> None:
        """End the workers."""
        for worker in (self._injector, self._answerer, self._ablation):
            worker.close()

    def run(self, kind: str, number: int) -> FinishedCase:
        """Run one record of a kind, unless it is finished already."""
        name = f"{kind}_{number}"
        kept = self._base / f"{name}.json"
        if kept.is_file():
            return _read(kept)
        case = setting(number, self.seed, self.size.hours, kind)
        good, twin = commissioned(self._rigs, case.unit, self.size.twin)
        folder = self._open / name
        folder.mkdir(exist_ok=True)
        record = folder / "record.parquet"
        asked = {"setting": dataclasses.asdict(case), "draw": self.seed, "kind": kind}
        try:
            if self.size.direct:
                sealed = self._injector.ask(do="direct", record=str(record), **asked)["sealed"]
            else:
                sealed = self._over_the_wire(case, record, asked)
            self._ledger.write(name, "sealed", sealed)
            given = {
                "record": str(record),
                "twin": str(twin),
                "healthy": str(good) if self.size.known_healthy else "",
                "hour": HOUR,
            }
            try:
                handed_in = self._answerer.ask(**given, out=str(folder))
                path, took = Path(handed_in["answer"]), (float(handed_in["seconds"]), float(handed_in["cpu_s"]))
            except WorkerError as error:
                path, took = folder / "diagnosis.json", (float("nan"), float("nan"))
                path.write_text(json.dumps(no_answer(str(error))), encoding="utf-8")
            self._ledger.write(name, "answered", sha256_of(path))
            truth = self._sealed / f"{name}.json"
            self._ledger.write(name, "opened", sha256_of(truth))
            hidden, answer = opened(truth), json.loads(path.read_text(encoding="utf-8"))
            ablation = None
            if self.size.ablations and not (kind == "healthy" and number >= 40):
                try:
                    made = str(record) if self.size.direct else ""
                    shown = self._injector.ask(do="without", record=made, folder=str(folder), **asked)["records"]
                    ablation = self._ablation.ask(
                        **{**given, "healthy": str(good)},
                        effects=hidden["effects"],
                        labels=hidden["labels"],
                        records=shown,
                    )
                except WorkerError as error:
                    ablation = {"failed": str(error), "linear": [], "raw": []}
            told: dict[str, Any] = ablation or {}
            z = max((v for v in told.get("z_truth", []) if v is not None), default=None)
            beside = [v for v in told.get("z_beside", []) if v is not None]
            outcome = judge(name, case.load, hidden, answer, took, z, told.get("sizes", ()), beside)
            done = FinishedCase(outcome, answer, ablation)
            _write(done, kept)
            return done
        finally:
            for path in folder.glob("*.parquet"):
                path.unlink()

    def _over_the_wire(self, case: Setting, record: Path, asked: dict[str, Any]) -> str:
        """Replay the case's profile with `hil run`'s loop on the rig that the injector serves."""
        from hil.run.session import RunRequest, run_session

        served = self._injector.ask(do="serve", **asked)
        ports = served["ports"]
        with tempfile.TemporaryDirectory(prefix="run-", dir=self._open) as folder:
            rig = Path(folder) / "rig.toml"
            rig.write_text(_with_ports(RIG, ports), encoding="utf-8")
            loads = Path(folder) / f"case_{case.number}.csv"
            loads.write_text(profile_text(profile(case)), encoding="utf-8")
            request = RunRequest(
                profile=loads,
                rig=rig,
                twin=None,
                runs=Path(folder),
                mode="lockstep",
                seed=case.seed,
                viewer=False,
                use_twin=False,
                control=("127.0.0.1", ports["control"]),
            )
            try:
                result = asyncio.run(run_session(request))
                shutil.move(result.folder.record, record)
            finally:
                self._injector.ask(do="stop")
        return str(served["sealed"])


def commissioned(folder: Path, unit: int, twin: str) -> tuple[Path, Path]:
    """Make the healthy record and the commissioned twin of a specimen in a folder, once; `twin` of `profiles/twins`."""
    good, own = folder / f"unit_{unit}.parquet", folder / f"unit_{unit}.toml"
    if not good.is_file():
        from drivers.rig_file import load_rig
        from hil.profile import read_profile
        from hil.record import write_record
        from hil.synthetic import direct_record

        made = direct_record(read_profile(COMMISSIONING), load_rig(RIG), seed=COMMISSIONING_SEED + unit, unit=unit)
        write_record(made, good)
    if not own.is_file():
        from hil.record import read_record
        from twin import commission, load, save

        network = load(PROJECT / "profiles" / "twins" / f"{twin}.toml")
        data = read_record(good)
        save(commission(network, data.time_s, *network.select(data.columns)).network, own)
    return good, own


def measure(size: TrialSize, seed: int, work: Path, progress: Callable[[float, str], None]) -> list[FinishedCase]:
    """Run all records. `progress` is called with the share done and the last result."""
    trial = BlindTrial(size, seed, work)
    done = []
    try:
        for k, (kind, number) in enumerate(size.jobs):
            finished = trial.run(kind, number)
            done.append(finished)
            progress((k + 1) / len(size.jobs), f"{finished.outcome.case}: {finished.outcome.verdict}")
    finally:
        trial.close()
    return done


def sources(folder: Path, more: Iterable[Path]) -> str:
    """Return a hash of a package's source and of some files."""
    paths = [*sorted(folder.rglob("*.py")), *more]
    return hashlib.sha256(b"\0".join(p.read_bytes() for p in paths)).hexdigest()[:10]


def left_out() -> tuple[str, ...]:
    """Return the comparisons that are not possible here."""
    if importlib.util.find_spec("pysindy") is None:
        return ("pysindy on the same records: it is not installed",)
    return ()


_NOT_IN_A_TRIAL = ("twin = ", "stuck_after_s = ")


def _with_ports(rig: Path, ports: dict[str, int]) -> str:
    """Return the rig file with other ports and absolute data files; a stuck sensor does not end a trial's run."""
    text = rig.read_text(encoding="utf-8")
    known = tomllib.loads(text)["bus"]
    for bus in known.values():
        ours = ports["modbus" if bus["transport"] == "modbus_tcp" else "can"]
        text = text.replace(f"port = {bus['port']}\n", f"port = {ours}\n")
        if "dbc" in bus:
            text = text.replace(f'dbc = "{bus["dbc"]}"', f'dbc = "{rig.parent / bus["dbc"]}"')
    return "".join(line for line in text.splitlines(keepends=True) if not line.startswith(_NOT_IN_A_TRIAL))


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
