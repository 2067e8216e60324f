"""An explanation whose diagnoses and runs a test makes by hand: a record, a twin, a plan, and a scripted operator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hil.diagnosis.session import DiagnosisRequest, PreparedDiagnosis, Written
from hil.explain.experiment import RigChoice
from hil.explain.explanation import Experiment, Round
from hil.explain.session import ExplainRequest
from hil.run.engine.status import Outcome
from hil.run.session.request import RunRequest
from hil.run.session.run import RunResult
from hil.run_folder.folder import create_run_folder, new_manifest
from hil.run_folder.room import RunSize
from tests.discovery.conftest import Bench
from tests.hil.made_diagnosis import effect, made
from tests.hil.made_record import written
from tests.twin.conftest import LOOP
from twin.discovery.diagnosis import Alternative, Diagnosis
from twin.twinfile import load

PROJECT = Path(__file__).resolve().parents[2]
RIG = PROJECT / "profiles/rigs/virtual.toml"
LEVELS = {"heater_power_W": 600.0, "pump_speed_pct": 85.0, "fan_speed_pct": 70.0}
STEPS = [
    {"time_s": 0.0, **LEVELS},
    {"time_s": 1800.0, **LEVELS, "heater_power_W": 900.0},
    {"time_s": 3600.0, **LEVELS, "heater_power_W": 900.0},
]
PLAN = {
    "possible": True,
    "name": "steps in heater power",
    "why": "1 h of steps separates them",
    "hours": 1.0,
    "hottest_C": 46.0,
    "steps": STEPS,
    "causes": ["one", "other"],
}
RIVAL = Alternative("actuator", "heater_power", "constant", 0.3)


def diagnosis(verdict: str, plan: dict[str, Any] | None = None, share: float = 0.7) -> Diagnosis:
    """A diagnosis of the loop's twin with one effect, and a rival where it is ambiguous."""
    found = made(verdict, (effect(confidence=share),) if verdict != "adequate" else ())
    own = Alternative("heat_source", "modules", "constant", share)
    others = (own, RIVAL) if verdict == "ambiguous" else ()
    curves = {name: np.zeros((60, 4)) for name in ("residual", "residual_after")}
    return replace(found, indistinguishable=others, next_experiment=plan, band=np.full(4, 0.05), **curves)


def made_files(folder: Path) -> dict[str, Path]:
    """A twin and a short record of it."""
    bench = Bench(load(LOOP))
    twin = folder / "twin.toml"
    twin.write_text(LOOP.read_text(encoding="utf-8"), encoding="utf-8")
    return {"twin": twin, "record": written(bench.network, bench.record(0.5), folder / "first.parquet")}


def request_of(folder: Path, files: dict[str, Path], *, rounds: int = 3, **changes: Any) -> ExplainRequest:
    """A request on a virtual rig in lockstep; `changes` are fields of the diagnosis, or `rig`."""
    rig = changes.pop("rig", RigChoice(RIG, folder / "runs", virtual=True, mode="lockstep"))
    asked = DiagnosisRequest(
        files["record"], files["twin"], use_healthy=False, rig=rig.rig if rig is not None else None, **changes
    )
    return ExplainRequest(asked, folder / "out", rounds, rig)


class Scripted:
    """Operator whose diagnoses and answers are given; a run leaves a folder with a record of its own."""

    def __init__(self, *diagnoses: Diagnosis, approves: bool = True, ends: str = "done") -> None:
        self._diagnoses = list(diagnoses)
        self._approves = approves
        self._ends = ends
        self.runs: list[RunRequest] = []
        self.given: list[int] = []
        self.asked: list[str] = []
        self.notes: list[str] = []

    def diagnose(self, ready: PreparedDiagnosis, number: int) -> Diagnosis:
        self.given.append(len(ready.request.more))
        return self._diagnoses.pop(0)

    def show(self, ready: PreparedDiagnosis, found: Diagnosis, written: Written, one: Round) -> None:
        pass

    def approve(self, experiment: Experiment, run: RunRequest, notes: Sequence[str]) -> bool:
        self.asked.append(experiment.sentence)
        return self._approves

    def run(self, request: RunRequest) -> RunResult:
        self.runs.append(request)
        folder = create_run_folder(request.runs, request.profile.stem, RunSize(10))
        manifest = new_manifest({"profile": request.profile, "rig": request.rig}, virtual=request.virtual)
        folder.write_manifest(manifest | {"exit_status": self._ends})
        bench = Bench(load(LOOP))
        written(bench.network, bench.record(0.5, seed=len(self.runs) + 1), folder.record)
        return RunResult(folder, Outcome(self._ends, "a test", ticks=1801, safe=True), None, 1800.0, 1.0, False)  # type: ignore[arg-type]

    def note(self, text: str) -> None:
        self.notes.append(text)
