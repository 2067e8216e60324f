"""Training within a time limit: simulate stations, train members side by side, adapt one to stations, score, pack.

    python -m hil.training.tower.budgeted --out OUT --seconds 560 --device cuda --workers 15 --members 4 --full

Each step is a process of its own, so that one that fails leaves the others as they are. Test stations are simulated
while members train, which start at the answer of boosted trees. OUT gets the small members' weights, the card of their
ensemble, `results.json` with cards, curves and scores, and `windows.npz` with errors by window.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hil.training.tower.generate import TEST, TRAIN, VALIDATION, DataPlan, digest_of, generate, tables

SIMULATED, TRAINED, ADAPTED = 0.33, 0.80, 0.87
"""Shares of the time at which simulating what members learn from, training, and adapting end."""
TESTED = 0.72
"""Share of the time after which no test station is begun."""
TESTING = 0.3
"""Share of the workers that simulate test stations from the beginning: the two sites take longest."""
START_S = 120.0
"""Seconds that a member waits for the trees it starts at, at most."""
FINISH_S = 14.0
"""Seconds that a member needs for its gate and its files after the last step."""
BATCH = {"small": 160, "full": 48}
"""A device is busy with starting its programs, not with what they compute: large batches cost it little."""
GATED = (96, 768)
"""Windows of the gate on a processor and on a device."""
RATE = {"small": 1.5e-3, "full": 5e-4}
STARTED = "start.done"
"""Empty file that appears when the trees are there, or will never be."""
STEPS = ("all", "simulate", "test", "member", "adapt", "boost", "selftest")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one of the steps, or all of them; return the exit status."""
    options = _options(arguments)
    return {
        "all": _all,
        "simulate": _simulate,
        "test": _simulate,
        "member": _member,
        "adapt": _adapt,
        "boost": _boost,
        "selftest": _selftest,
    }[options.step](options)


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", nargs="?", default="all", choices=STEPS)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--work", type=Path, default=Path("/tmp/tower_training"))
    parser.add_argument("--seconds", type=float, default=560.0)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--members", type=int, default=4)
    parser.add_argument("--full", action="store_true")
    parser.add_argument("--stations", type=int, default=200)
    parser.add_argument("--validation", type=int, default=6)
    parser.add_argument("--test", type=int, default=12)
    parser.add_argument("--months", type=float, default=7.0)
    parser.add_argument("--site-months", type=float, default=14.0)
    parser.add_argument("--batch", type=int, default=0)
    parser.add_argument("--most", type=int, default=0, help="test windows at most; 0 for all")
    parser.add_argument("--size", default="small")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--until", type=float, default=0.0, help="time.time() at which a step ends")
    parser.add_argument("--station", default="")
    return parser.parse_args(arguments)


def _all(o: argparse.Namespace) -> int:
    began = time.time()
    o.out.mkdir(parents=True, exist_ok=True)
    data = o.work / "data"

    def at(share: float) -> float:
        return began + share * o.seconds

    def say(text: str) -> None:
        print(f"[{time.time() - began:6.1f} s] {text}", flush=True)

    say(f"{os.cpu_count()} processors, {o.device}")
    checked = _start(o, "selftest", at(SIMULATED))
    # Test stations are simulated while members train.
    some = max(round(TESTING * o.workers), 1)
    same = {"stations": o.stations, "validation": o.validation, "test": o.test, "months": o.months}
    same |= {"site-months": o.site_months}
    testing = {"test": _start(o, "test", at(TESTED), workers=some, **same)}
    simulating = _start(o, "simulate", at(SIMULATED), workers=max(o.workers - some, 1), **same)
    while simulating.poll() is None and checked.poll() in (None, 0):
        time.sleep(0.2)
    if checked.wait():
        simulating.kill()
        testing["test"].kill()
        say("the self-test of the device failed; nothing is trained")
        return 1
    simulating.wait()
    say(f"{len(tables(data, TRAIN))} cells to train on, {len(tables(data, VALIDATION))} held out, {digest_of(data)}")
    jobs = [("small", seed) for seed in range(o.members)] + ([("full", 0)] if o.full else [])
    boosting = {"boost": _start(o, "boost", at(TRAINED))}
    running = {
        f"{size}_{seed}": _start(o, "member", at(TRAINED) - FINISH_S, size=size, seed=seed) for size, seed in jobs
    }
    _wait(boosting, at(TRAINED), say)
    _wait(running, at(TRAINED) + 30.0, say)
    weights = {n: o.work / f"tower_{n}.safetensors" for n in running if (o.work / f"tower_{n}.json").is_file()}
    say(f"trained: {', '.join(weights) or 'none'}")
    results: dict[str, Any] = {
        "options": {k: str(v) for k, v in vars(o).items()},
        "manifest": _json(data / "manifest.json"),
    }
    if (o.work / "test" / "manifest.json").is_file():
        results["test_manifest"] = _json(o.work / "test" / "manifest.json")
    results["cards"] = {n: _json(path.with_suffix(".json")) for n, path in weights.items()}
    arrays: dict[str, np.ndarray] = {}
    _pack(o, results, arrays, weights)
    _wait(testing, at(TRAINED) + 5.0, say)
    if "small_0" in weights and o.site_months > 0.0:
        named = [p.stem for p in _test_tables(o) if p.stem[0] in "AB"]
        adapting = {n: _start(o, "adapt", at(ADAPTED) - 4.0, station=n) for n in named}
        _wait(adapting, at(ADAPTED) + 20.0, say)
        found = {n: _json(o.work / f"adapted_{n}.json") for n in named if (o.work / f"adapted_{n}.json").is_file()}
        results["adapted"] = found
        _pack(o, results, arrays, weights)
    try:
        from hil.training.tower.ensemble import assemble

        card = assemble(data, o.work / "tower_small", device=o.device)
        say(f"ensemble: {card}")
    except Exception:  # its members are worth having without it
        say(traceback.format_exc())
    _pack(o, results, arrays, weights)
    try:
        from hil.training.tower.evaluate import evaluate

        document, arrays = evaluate(data, weights, o.device, most=o.most or None, test=o.work / "test", note=say)
        results["evaluation"] = document
    except Exception:  # the weights are worth having without their scores
        results["evaluation_failed"] = traceback.format_exc()
        say(results["evaluation_failed"])
    results["seconds"] = round(time.time() - began, 1)
    _pack(o, results, arrays, weights)
    say("done")
    return 0 if weights else 1


def _start(o: argparse.Namespace, step: str, until: float, **more: Any) -> subprocess.Popen[bytes]:
    words = [sys.executable, "-m", "hil.training.tower.budgeted", step, "--out", str(o.out), "--work", str(o.work)]
    words += ["--device", o.device, "--until", f"{until:.1f}", "--batch", str(o.batch)]
    for name, value in more.items():
        words += [f"--{name}", str(value)]
    # Many processes share the processors: libraries that each take all of them stand in each other's way.
    threads = "2" if step in ("member", "adapt") else "1"
    limits = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), threads)
    environment = {**os.environ, **limits, "PYTHONUNBUFFERED": "1"}
    return subprocess.Popen(words, env=environment)


def _wait(running: dict[str, subprocess.Popen[bytes]], until: float, say: Any) -> None:
    for name, one in running.items():
        try:
            status = one.wait(max(until - time.time(), 0.5))
            if status:
                say(f"{name} failed with exit status {status}")
        except subprocess.TimeoutExpired:
            one.kill()
            say(f"{name} was stopped: its time was over")


def _simulate(o: argparse.Namespace) -> int:
    """Simulate the stations that members learn from, or those of the test."""
    if o.step == "test":
        plan, folder = DataPlan(0, 0, o.test, o.months, o.site_months), o.work / "test"
    else:
        plan, folder = DataPlan(o.stations, o.validation, 0, o.months, 0.0, parts=True), o.work / "data"
    until = time.monotonic() + o.until - time.time()
    began = time.time()

    def say(text: str) -> None:
        print(f"{o.step} {time.time() - began:6.1f} s: {text}", flush=True)

    count = generate(plan, folder, o.workers, until, say)
    say(f"{count} stations")
    return 0


def _test_tables(o: argparse.Namespace) -> list[Path]:
    try:
        return tables(o.work / "test", TEST)
    except ValueError:
        return []


def _member(o: argparse.Namespace) -> int:
    from hil.training.tower.starting import begin, load_start
    from twin.calibrators.hiera_unet.tower import MemberTraining, TowerPlan, load_fleet
    from twin.calibrators.hiera_unet.tower.member import LONGEST
    from twin.calibrators.hiera_unet.tower.predict import NOT_TESTED
    from twin.calibrators.hiera_unet.weights.device import ready

    ready(o.device, 2 if o.device != "cpu" else 1)
    data, name = o.work / "data", f"{o.size}_{o.seed}"
    began = time.time()
    family, held_out = load_fleet(tables(data, TRAIN), o.device), load_fleet(tables(data, VALIDATION), o.device)
    while not (data / STARTED).exists() and time.time() < began + START_S:
        time.sleep(0.1)
    trees = load_start(data)
    if trees is not None:
        begin(data, family)
        trees.to(family.device)
    print(f"{name}: {len(family)} windows loaded in {time.time() - began:.0f} s", flush=True)
    batch = o.batch or BATCH[o.size]
    while True:
        plan = TowerPlan(steps=LONGEST, batch=batch, rate=RATE[o.size], half=o.device != "cpu", seed=o.seed)
        try:
            training = MemberTraining(o.size, plan, family, held_out, None, digest_of(data), trees)
            until = time.monotonic() + o.until - time.time()
            training.run(until, lambda: False, lambda k, n, text: print(f"{name}: {k}/{n} {text}", flush=True))
            break
        except RuntimeError as error:
            if "out of memory" not in str(error) or batch < 8:
                raise
            batch //= 2
            print(f"{name}: the device's memory is full; {batch} windows a step", flush=True)
    path, more = o.work / f"tower_{name}.safetensors", {"command": "python -m hil.training.tower.budgeted"}
    # Refused until the gate has seen it; a member whose time is over is not lost.
    training.write(path, NOT_TESTED, more)
    gate = training.gate(GATED[o.device != "cpu"])
    print(f"{name}: {training.trainer.done} steps, gate {gate.document()}", flush=True)
    training.write(path, gate, more)
    return 0


def _adapt(o: argparse.Namespace) -> int:
    from twin.calibrators.hiera_unet.tower import TowerPlan, adapt, load_fleet, load_member
    from twin.calibrators.hiera_unet.tower.member import LONGEST, own_rows
    from twin.calibrators.hiera_unet.tower.predict import predict
    from twin.calibrators.hiera_unet.tower.score import believed, mixed, scores, targets_of
    from twin.calibrators.hiera_unet.weights.device import ready

    ready(o.device, 2 if o.device != "cpu" else 1)
    data = o.work / "data"
    network = load_member(o.work / "tower_small_0.safetensors", blind_too=True).network
    # An eighth of the family keeps what was learned there; it loads in an eighth of the time.
    family = load_fleet(tables(data, TRAIN)[::8], o.device)
    own = load_fleet([o.work / "test" / f"{o.station}.npz"], o.device)
    network.to(own.device)
    plan = TowerPlan(steps=LONGEST, batch=o.batch or 32, rate=2e-4, warmup=0.1, half=o.device != "cpu")
    adapted, steps = adapt(network, family, own, plan, time.monotonic() + o.until - time.time())
    rows = own_rows(own, 11.0 / 14.0, 1.0).cpu().numpy()
    t = targets_of(own, rows)
    rival = believed(t)
    document: dict[str, Any] = {"steps": steps, "windows": len(rows), "belief": scores(t, rival)}
    for name, one in (("family", network), ("adapted", adapted)):
        answer, _, _ = mixed(t, [predict(one, own, rows, half=plan.half)])
        document[name] = scores(t, answer, rival)
    (o.work / f"adapted_{o.station}.json").write_text(json.dumps(document) + "\n")
    print(
        f"adapted to {o.station}: {steps} steps, outlet {document['belief']['water_mae_K']:.4f} (Gauss-Newton), "
        f"{document['family']['water_mae_K']:.4f} (family), {document['adapted']['water_mae_K']:.4f} K",
        flush=True,
    )
    return 0


def _selftest(o: argparse.Namespace) -> int:
    from hil.training.tower.selftest import check

    o.work.mkdir(parents=True, exist_ok=True)
    batches = {"small": o.batch or BATCH["small"], "full": o.batch or BATCH["full"]}
    for text in check(o.device, o.work, batches):
        print(f"self-test, {text}", flush=True)
    return 0


def _boost(o: argparse.Namespace) -> int:
    from hil.training.tower.starting import fit_start

    began = time.time()
    data = o.work / "data"
    try:
        found = fit_start(data, os.cpu_count() or 1)
        print(f"boosted in {time.time() - began:.0f} s: {found or 'scikit-learn is not installed'}", flush=True)
    finally:
        (data / STARTED).touch()
    return 0


def _pack(
    o: argparse.Namespace, results: dict[str, Any], arrays: dict[str, np.ndarray], weights: dict[str, Path]
) -> None:
    """Write what comes back: weights of small members, results and arrays."""
    for name, path in weights.items():
        target = o.out / path.name
        if name.startswith("small") and not target.exists():
            target.write_bytes(path.read_bytes())
    card = o.work / "tower_small.json"
    if card.is_file():
        (o.out / card.name).write_bytes(card.read_bytes())
    (o.out / "results.json").write_text(json.dumps(results, default=float) + "\n")
    if arrays:
        named: dict[str, Any] = dict(arrays)
        np.savez_compressed(o.out / "windows.npz", **named)


def _json(path: Path) -> Any:
    return json.loads(path.read_text())


if __name__ == "__main__":
    sys.exit(main())
