"""Sides of a trial as tasks of an executor: one makes a case, another answers it, each in a process of its own.

A task gets and returns the bytes of files, so that it runs on any worker. The answering side gets record, healthy
record and twin, and nothing else.

    python -m hil.bench.discovery.sides

replays profiles on rigs that an injector serves on this machine (requests as `_replay` takes them).
"""

from __future__ import annotations

import asyncio
import atexit
import functools
import shutil
import tempfile
import tomllib
from pathlib import Path
from typing import Any

from hil.bench.discovery.injector import RIG
from hil.bench.discovery.worker import PROJECT, Request, Worker, WorkerError, serve
from hil.executor import Say
from hil.synthetic import Setting, direct_record, profile, profile_text

GIVEN = {"record": "record.parquet", "healthy": "healthy.parquet", "twin": "twin.toml"}
"""Files that the answering side gets, by their role; a case may be without a healthy record."""
COMMISSIONING = PROJECT / "profiles" / "loads" / "commissioning_10h.csv"
COMMISSIONING_SEED = 77
_INJECTOR = "hil.bench.discovery.injector"
_NOT_IN_A_TRIAL = ("twin = ", "stuck_after_s = ")


@functools.cache
def side_process(module: str, *arguments: str) -> Worker:
    """Return the process of a side, which lasts as long as this one."""
    worker = Worker(module, *arguments)
    atexit.register(worker.close)
    return worker


@functools.cache
def sealed_folder() -> Path:
    """Return this process's folder for truths, which is removed at its end."""
    made = tempfile.TemporaryDirectory(prefix="hil-sealed-")
    atexit.register(made.cleanup)
    return Path(made.name)


def make_case(request: dict[str, Any], say: Say) -> dict[str, Any]:
    """Make a case and seal it; return the bytes of its record, the text of its truth and its hash.

    Parameters
    ----------
    request
        `setting`, `draw` and `kind` of the case, and `direct`: without wires.
    say
        Callback for messages.

    Raises
    ------
    WorkerError
        A side failed.
    """
    asked, sealed = _asked(request), sealed_folder()
    with tempfile.TemporaryDirectory(prefix="hil-case-") as name:
        record = Path(name) / GIVEN["record"]
        injector = side_process(_INJECTOR, str(sealed))
        if request["direct"]:
            digest = injector.ask(do="direct", record=str(record), **asked)["sealed"]
        else:
            served = injector.ask(do="serve", **asked)
            digest = served["sealed"]
            try:
                run = side_process(__name__)
                run.ask(setting=asked["setting"], ports=served["ports"], folder=name, record=str(record))
            finally:
                injector.ask(do="stop")
        case = f"{request['kind']}_{request['setting']['number']}"
        truth = sealed / f"{case}.json"
        text = truth.read_bytes()
        truth.unlink()
        (sealed / f"{case}.toml").unlink(missing_ok=True)
        return {"record": record.read_bytes(), "truth": text, "sealed": digest}


def answer_case(given: dict[str, Any], say: Say) -> dict[str, Any]:
    """Diagnose a case; return the bytes of the answer and its times, or the error of the answerer."""
    with tempfile.TemporaryDirectory(prefix="hil-case-") as name:
        paths = _written(given, Path(name))
        try:
            found = side_process("hil.bench.discovery.answerer").ask(**paths, hour=given["hour"], out=name)
        except WorkerError as error:
            return {"error": str(error)}
        times = {"seconds": float(found["seconds"]), "cpu_s": float(found["cpu_s"])}
        return {"answer": Path(found["answer"]).read_bytes(), **times}


def ablate_case(request: dict[str, Any], say: Say) -> dict[str, Any]:
    """Run the ablations over a case whose truth is opened; return them, or what failed.

    Parameters
    ----------
    request
        As for `make_case`, with the files of the case, `hour`, and `effects` and `labels` of its truth.
    say
        Callback for messages.
    """
    with tempfile.TemporaryDirectory(prefix="hil-case-") as name:
        paths = _written(request, Path(name))
        made = paths["record"] if request["direct"] else ""
        try:
            injector = side_process(_INJECTOR, str(sealed_folder()))
            shown = injector.ask(do="without", record=made, folder=name, **_asked(request))["records"]
            truth = {"effects": request["effects"], "labels": request["labels"]}
            ablation = side_process("hil.bench.discovery.ablation")
            return ablation.ask(**paths, hour=request["hour"], records=shown, **truth)
        except WorkerError as error:
            return {"failed": str(error), "linear": [], "raw": []}


def commission_specimen(request: dict[str, Any], say: Say) -> dict[str, bytes]:
    """Return the bytes of the healthy record and of the commissioned twin of the specimen `unit`."""
    with tempfile.TemporaryDirectory(prefix="hil-case-") as name:
        good, own = commissioned(Path(name), request["unit"], request["twin"])
        return {"healthy": good.read_bytes(), "twin": own.read_bytes()}


def commissioned(folder: Path, unit: int, twin: str) -> tuple[Path, Path]:
    """Make the healthy record and the commissioned twin of a specimen in a folder, once; `twin` of `profiles/twins`."""
    good, own = folder / f"unit_{unit}.parquet", folder / f"unit_{unit}.toml"
    if not good.is_file():
        from drivers.rig_file import load_rig
        from hil.profile import read_profile
        from hil.record import write_record

        made = direct_record(read_profile(COMMISSIONING), load_rig(RIG), seed=COMMISSIONING_SEED + unit, unit=unit)
        write_record(made, good)
    if not own.is_file():
        from hil.record import read_record
        from twin import commission, load, save

        network = load(PROJECT / "profiles" / "twins" / f"{twin}.toml")
        data = read_record(good)
        save(commission(network, data.time_s, *network.select(data.columns)).network, own)
    return good, own


def _asked(request: dict[str, Any]) -> dict[str, Any]:
    return {key: request[key] for key in ("setting", "draw", "kind")}


def _written(given: dict[str, Any], folder: Path) -> dict[str, str]:
    """Write the files of a case; return their paths by role, empty for one that it is without."""
    paths = {}
    for role, file in GIVEN.items():
        paths[role] = str(folder / file) if given[role] else ""
        if given[role]:
            (folder / file).write_bytes(given[role])
    return paths


def _replay(request: Request) -> Request:
    """Replay a case's profile with `hil run`'s loop on the rig that an injector serves on `ports`."""
    from hil.run.session import RunRequest, run_session

    case, ports, folder = Setting(**request["setting"]), request["ports"], Path(request["folder"])
    rig, loads = folder / "rig.toml", folder / f"case_{case.number}.csv"
    rig.write_text(_with_ports(RIG, ports), encoding="utf-8")
    loads.write_text(profile_text(profile(case)), encoding="utf-8")
    asked = RunRequest(
        profile=loads,
        rig=rig,
        twin=None,
        runs=folder,
        mode="lockstep",
        seed=case.seed,
        viewer=False,
        use_twin=False,
        control=("127.0.0.1", ports["control"]),
    )
    result = asyncio.run(run_session(asked))
    shutil.move(result.folder.record, request["record"])
    return {}


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


if __name__ == "__main__":
    serve(_replay)
