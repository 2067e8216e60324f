"""Ablations of the method on the same records, and the visibility of the truth; run after answers are sealed.

    python -m hil.bench.discovery.ablation

`linear` is the score test alone, without the joint fit and its verdict; `raw` the same without projecting the tunables
out of the signatures; `sindy` is pysindy on the same data, where it is installed.

How visible it was is the score of what the rig would have shown less without it: same weather, same noise.
"""

from __future__ import annotations

import dataclasses
import importlib.util
from pathlib import Path
from typing import Any

import numpy as np

from hil.bench.discovery.detectability import signature, true_size, visible
from hil.bench.discovery.worker import Request, serve
from twin import Array, Network
from twin.discovery.effects.laws import Book
from twin.discovery.engine import HELD_OUT
from twin.discovery.healthy.basis import basis
from twin.discovery.records.grid import on_grid
from twin.discovery.scoring.null import FALSE_ALARMS, null_scores
from twin.discovery.scoring.score_tests import ScoreTest
from twin.discovery.scoring.search import Entry, scan

STIFF = 1e12
"""Precision of a prior that fixes a parameter."""
NEAR = 4


def answer(request: Request) -> Request:
    """Return both ablations over one record, and forecasts of the true effects."""
    from hil.diagnosis import read_columns, with_clock
    from twin import load

    network = with_clock(load(Path(request["twin"])))
    record, _ = read_columns(network, Path(request["record"]), request["hour"])
    healthy, _ = read_columns(network, Path(request["healthy"]), request["hour"])
    whole = on_grid(network, record.time_s, record.inputs, record.measured)
    known = basis(network, healthy, whole)
    grid = whole.part(0, int(len(whole.time) * (1.0 - HELD_OUT)))
    state = known.probe.first_state(grid)
    run = known.probe.run(grid, state)
    found = Book(network).laws(grid, run)
    stiff = dataclasses.replace(known.prior, precision=STIFF * np.eye(len(known.prior.precision)))
    said: Request = {}
    for name, prior in (("linear", known.prior), ("raw", stiff)):
        bare = ScoreTest(known.probe, grid, state, run, known.noise, prior) if prior is not known.prior else None
        score_test = bare or known.score_test(grid, state, run, found)
        said[name] = [_row(e) for e in scan(score_test, found)[:NEAR]]
        if name == "linear":
            said["threshold"] = null_scores(score_test, found).quantile(FALSE_ALARMS)
            said["sizes"] = [
                true_size(found, network, table, label, whole.span_s)
                for table, label in zip(request["effects"], request["labels"], strict=False)
            ]
            shown = [_readings(network, Path(path), request["hour"]) for path in request["records"]]
            if shown:
                signatures = [signature(score_test, shown[0], other) for other in shown[1:]]
                said["z_truth"], said["z_beside"] = visible(score_test, signatures)
    if importlib.util.find_spec("pysindy"):
        from hil.bench.peers.sindy_peer import contributions

        calm = on_grid(network, healthy.time_s, healthy.inputs, healthy.measured)
        usual = contributions(network, calm, known.probe.run(calm, known.probe.first_state(calm)))
        rows = contributions(network, grid, run)
        said["sindy"] = [{**row, "z": row["z"] / max(usual[0]["z"], 1e-9)} for row in rows[:NEAR]]
    return said


def _readings(network: Network, path: Path, hour: float) -> Array:
    from hil.diagnosis import read_columns

    record, _ = read_columns(network, path, hour)
    return on_grid(network, record.time_s, record.inputs, record.measured).measured


def _row(e: Entry) -> dict[str, Any]:
    return {"kind": e.candidate.kind, "where": e.candidate.where, "driver": e.driver, "z": e.z, "size": e.size}


if __name__ == "__main__":
    serve(answer)
