"""Training within a time limit: simulate stations, train members side by side, adapt one to stations, score, pack.

    python -m hil.training.tower.budgeted --out OUT --seconds 540 --device cuda --workers 15 --members 4 --full

Each member is a process of its own, so that one that fails leaves the others as they are. OUT gets the small members'
weights, `results.json` with cards, curves and scores, and `windows.npz` with errors by window.
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

SIMULATED, TRAINED, ADAPTED = 0.31, 0.77, 0.855
"""Shares of the time at which simulating, training and adapting end."""
FINISH_S = 12.0
"""Seconds that a member needs for its gate and its files after the last step."""
BATCH = {"small": 64, "full": 24}
GATED = (96, 768)
"""Windows of the gate on a processor and on a device."""
RATE = {"small": 1.2e-3, "full": 4e-4}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one of the steps, or all of them; return the exit status."""
    options = _options(arguments)
    if options.step == "member":
        return _member(options)
    if options.step == "adapt":
        return _adapt(options)
    if options.step == "boost":
        return _boost(options)
    if options.step == "selftest":
        return _selftest(options)
    return _all(options)


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", nargs="?", default="all", choices=("all", "member", "adapt", "boost", "selftest"))
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--work", type=Path, default=Path("/tmp/tower_training"))
    parser.add_argument("--seconds", type=float, default=540.0)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--members", type=int, default=4)
    parser.add_argument("--full", action="store_true")
    parser.add_argument("--stations", type=int, default=200)
    parser.add_argument("--validation", type=int, default=4)
    parser.add_argument("--test", type=int, default=4)
    parser.add_argument("--months", type=float, default=8.0)
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
    plan = DataPlan(o.stations, o.validation, o.test, o.months, o.site_months)
    until = time.monotonic() + at(SIMULATED) - time.time()
    checked = _start(o, "selftest", at(SIMULATED))
    broken = [False]

    def failed() -> bool:
        broken[0] = checked.poll() not in (None, 0)
        return broken[0]

    count = generate(plan, data, o.workers, until, say, failed)
    if checked.wait() or broken[0]:
        say("the self-test of the device failed; nothing is trained")
        return 1
    say(f"{count} stations, {len(tables(data, TRAIN))} cells to train on, data {digest_of(data)}")
    jobs = [("small", seed) for seed in range(o.members)] + ([("full", 0)] if o.full else [])
    running = {
        f"{size}_{seed}": _start(o, "member", at(TRAINED) - FINISH_S, size=size, seed=seed) for size, seed in jobs
    }
    # The rival learns on the processor meanwhile.
    boosting = {"boost": _start(o, "boost", at(ADAPTED), most=o.most)}
    _wait(running, at(TRAINED) + 30.0, say)
    weights = {n: o.work / f"tower_{n}.safetensors" for n in running if (o.work / f"tower_{n}.json").is_file()}
    say(f"trained: {', '.join(weights) or 'none'}")
    results: dict[str, Any] = {
        "options": {k: str(v) for k, v in vars(o).items()},
        "manifest": _json(data / "manifest.json"),
    }
    results["cards"] = {n: _json(path.with_suffix(".json")) for n, path in weights.items()}
    arrays: dict[str, np.ndarray] = {}
    _pack(o, results, arrays, weights)
    if "small_0" in weights and o.site_months > 0.0:
        named = [p.stem for p in tables(data, TEST) if p.stem[0] in "AB"]
        adapting = {n: _start(o, "adapt", at(ADAPTED) - 4.0, station=n) for n in named}
        _wait(adapting, at(ADAPTED) + 25.0, say)
        found = {n: _json(o.work / f"adapted_{n}.json") for n in named if (o.work / f"adapted_{n}.json").is_file()}
        results["adapted"] = found
        _pack(o, results, arrays, weights)
    _wait(boosting, at(ADAPTED) + 30.0, say)
    try:
        from hil.training.tower.evaluate import evaluate

        document, arrays = evaluate(
            data, weights, o.device, most=o.most or None, boosted=o.work / "boosted.npz", note=say
        )
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
    threads = str(max((os.cpu_count() or 2) - 8, 1)) if step == "boost" else "2"
    environment = {**os.environ, "OMP_NUM_THREADS": threads, "PYTHONUNBUFFERED": "1"}
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


def _member(o: argparse.Namespace) -> int:
    from twin.calibrators.hiera_unet.device import ready
    from twin.calibrators.hiera_unet.tower import MemberTraining, TowerPlan, load_fleet
    from twin.calibrators.hiera_unet.tower.member import LONGEST
    from twin.calibrators.hiera_unet.tower.predict import NOT_TESTED

    ready(o.device, 2 if o.device != "cpu" else 1)
    data, name = o.work / "data", f"{o.size}_{o.seed}"
    began = time.time()
    family, held_out = load_fleet(tables(data, TRAIN), o.device), load_fleet(tables(data, VALIDATION), o.device)
    plan = TowerPlan(
        steps=LONGEST, batch=o.batch or BATCH[o.size], rate=RATE[o.size], half=o.device != "cpu", seed=o.seed
    )
    training = MemberTraining(o.size, plan, family, held_out, None, digest_of(data))
    print(f"{name}: {len(family)} windows loaded in {time.time() - began:.0f} s", flush=True)
    until = time.monotonic() + o.until - time.time()
    training.run(until, lambda: False, lambda k, n, text: print(f"{name}: {k}/{n} {text}", flush=True))
    path, more = o.work / f"tower_{name}.safetensors", {"command": "python -m hil.training.tower.budgeted"}
    # Refused until the gate has seen it; a member whose time is over is not lost.
    training.write(path, NOT_TESTED, more)
    gate = training.gate(GATED[o.device != "cpu"])
    print(f"{name}: {training.trainer.done} steps, gate {gate.document()}", flush=True)
    training.write(path, gate, more)
    return 0


def _adapt(o: argparse.Namespace) -> int:
    from twin.calibrators.hiera_unet.device import ready
    from twin.calibrators.hiera_unet.tower import TowerPlan, adapt, load_fleet, load_member
    from twin.calibrators.hiera_unet.tower.member import LONGEST, own_rows
    from twin.calibrators.hiera_unet.tower.predict import predict
    from twin.calibrators.hiera_unet.tower.score import believed, mixed, scores, targets_of

    ready(o.device, 2 if o.device != "cpu" else 1)
    data = o.work / "data"
    network = load_member(o.work / "tower_small_0.safetensors", blind_too=True).network
    # A quarter of the family keeps what was learned there; it loads in a quarter of the time.
    family = load_fleet(tables(data, TRAIN)[::4], o.device)
    own = load_fleet([data / f"{o.station}.npz"], o.device)
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
    from hil.training.tower.evaluate import boost, evenly, write_boosted
    from twin.calibrators.hiera_unet.tower import load_fleet

    began = time.time()
    test = load_fleet(tables(o.work / "data", TEST), "cpu")
    rows = evenly(test.rows, o.most or None)
    figures = boost(o.work / "data", test, rows)
    if figures is not None:
        write_boosted(o.work / "boosted.npz", rows, figures)
    print(f"boosted in {time.time() - began:.0f} s", flush=True)
    return 0


def _pack(
    o: argparse.Namespace, results: dict[str, Any], arrays: dict[str, np.ndarray], weights: dict[str, Path]
) -> None:
    """Write what comes back: weights of small members, results and arrays."""
    for name, path in weights.items():
        target = o.out / path.name
        if name.startswith("small") and not target.exists():
            target.write_bytes(path.read_bytes())
    (o.out / "results.json").write_text(json.dumps(results, default=float) + "\n")
    if arrays:
        named: dict[str, Any] = dict(arrays)
        np.savez_compressed(o.out / "windows.npz", **named)


def _json(path: Path) -> Any:
    return json.loads(path.read_text())


if __name__ == "__main__":
    sys.exit(main())
