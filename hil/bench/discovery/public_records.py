"""Public records of other rigs, with incomplete twins: the effects that the diagnosis adds, in order.

Each twin begins with less than textbook physics and grows on one record; every rung is then simulated on records that
no fit and no choice saw. No healthy record exists for any of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.bench.experiments import FITTED_TEST, TWINS
from hil.bench.measure import Cell, ReportTable, number
from hil.record import PIPE_TESTS, PublicRecord, dry_cooler, heated_pipe, tclab, wet_tower
from hil.run.session import ProgressBar
from twin import Network, load, simulate, steady_readings
from twin.discovery.growing.growth import Added, Growth, grow, grow_at_rest

Array = NDArray[np.float64]
Say = Callable[[str], None]

LADDER = ("rung", "driver", "size", "90 %", "gain", "elsewhere", "hidden")
"""Columns at the beginning of every ladder."""
GAIN = (
    "gain: fall of -2 log likelihood when the effect joins its rung; elsewhere: how much worse the last twin would "
    "predict the further records without it; hidden: of four parts of the record, each hidden from the fit in turn, "
    "how many the last twin predicts no worse with it"
)


@dataclass(frozen=True, slots=True)
class EvaluationRecord:
    """Record with a simulation of every rung, and its published figure."""

    column: str
    error: Callable[[Network], float]
    published: float | None = None


def measure(data: Path, seed: int) -> tuple[tuple[ReportTable, ...], tuple[str, ...]]:
    """Return a ladder for each record, the effects not added, and a line if there is no record.

    Raises
    ------
    PublicRecordError
        A record is absent or not what it should be.
    """
    del seed
    real = data / "real"
    if not real.is_dir():
        return (), (f"records: no {real}; set HIL_DATA to the folder that holds 'real'",)
    tables: list[ReportTable] = []
    refused: list[tuple[Cell, ...]] = []
    with ProgressBar("growing twins", float(len(PARTS))) as steps:
        for done, (name, part) in enumerate(PARTS.items()):

            def say(what: str, done: int = done, name: str = name) -> None:
                steps.update(float(done), f"{name}: {what}")

            growth, table = part(real, say)
            tables.append(table)
            refused += [(name, r.kind, r.where, r.driver, r.why) for r in growth.refused]
    tables.append(ReportTable("refused", "Not added", ("record", "effect", "at", "driver", "why"), tuple(refused)))
    return tuple(tables), LEFT_OUT


def _tclab(real: Path, say: Say) -> tuple[Growth, ReportTable]:
    network = load(TWINS / "tclab_bare.toml")
    train, validation = (tclab(real, f"mimo_{part}") for part in ("train", "validation"))
    single = tclab(real, "siso_train")
    growth = grow(
        network,
        train.time_s,
        *network.select(train.columns),
        more=((single.time_s, *network.select(single.columns)),),
        say=say,
    )

    def summed(record: PublicRecord) -> Callable[[Network], float]:
        return lambda net: float(np.nansum(np.abs(_free_run(net, record))))

    judged = (
        EvaluationRecord("train", summed(train), 270.26),
        EvaluationRecord("validation", summed(validation), 840.95),
    )
    notes = (
        "train, validation: sum over all samples and both sensors of |simulated - measured|, K, free run from the "
        "first reading, of mimo_train and mimo_validation; published: the balance with radiation, exchange and lag of "
        "Park et al. 2020, fitted by them to mimo_train",
        "fitted on mimo_train alone; siso_train, without another fit, chooses between sets that mimo_train does not "
        "distinguish, and effects that both together need are added",
    )
    return growth, ladder("tclab", "Temperature Control Lab, from a balance of two heaters", growth, judged, notes)


def _heated_pipe(real: Path, say: Say) -> tuple[Growth, ReportTable]:
    network = load(TWINS / "heated_pipe_mixed.toml")
    tests = {test: heated_pipe(real, test) for test in PIPE_TESTS}
    own = tests[FITTED_TEST]
    others = tuple((t.time_s, *network.select(t.columns)) for name, t in tests.items() if name != FITTED_TEST)
    growth = grow(network, own.time_s, *network.select(own.columns), more=others, say=say)

    def rmse(record: PublicRecord) -> Callable[[Network], float]:
        return lambda net: float(np.sqrt(np.nanmean(_free_run(net, record) ** 2)))

    judged = tuple(EvaluationRecord(name.removeprefix("ulg_"), rmse(test)) for name, test in tests.items())
    notes = (
        "columns by test: RMSE of the outlet's water, K, free run from the first reading, flow and inlet as measured",
        f"fitted on {FITTED_TEST} alone; the others, at other flows, only choose between sets of effects that it "
        "does not distinguish, without another fit",
    )
    return growth, ladder("heated_pipe", "Heated pipe, from one mixed volume", growth, judged, notes)


def _dry_cooler(real: Path, say: Say) -> tuple[Growth, ReportTable]:
    network = load(TWINS / "dry_cooler_constant.toml")
    calibration, validation = (dry_cooler(real, f"dc_{part}") for part in ("exp1", "exp3"))
    growth = grow_at_rest(network, *network.select(calibration.columns), say=say)
    judged = (
        EvaluationRecord("dc_exp1", _at_rest(calibration)),
        EvaluationRecord("dc_exp3", _at_rest(validation), 0.50),
    )
    notes = (
        "dc_exp1, dc_exp3: RMSE of the outlet over steady states, K; grown and fitted on dc_exp1 alone",
        "published for dc_exp3: 0.50 K by its authors' physical model, 0.32 K by their Gaussian process",
    )
    return growth, ladder("dry_cooler", "Dry cooler, steady states, from a constant conductance", growth, judged, notes)


def _wet_tower(real: Path, say: Say) -> tuple[Growth, ReportTable]:
    network = load(TWINS / "wet_tower_constant.toml")
    calibration, validation = (wet_tower(real, f"wct_{part}") for part in ("exp1", "exp3"))
    growth = grow_at_rest(network, *network.select(calibration.columns), say=say)
    judged = (
        EvaluationRecord("wct_exp1", _at_rest(calibration)),
        EvaluationRecord("wct_exp3", _at_rest(validation), 0.33),
    )
    notes = (
        "wct_exp1, wct_exp3: RMSE of the outlet over steady states, K; grown and fitted on wct_exp1 alone; flow ratio: "
        "that of air to water",
        "published for wct_exp3: 0.33 K by Poppe's method, 0.37 K by a Gaussian process, 1.85 K by a random forest",
    )
    return growth, ladder("wet_tower", "Wet tower, steady states, from a constant Merkel number", growth, judged, notes)


def ladder(
    key: str, title: str, growth: Growth, judged: tuple[EvaluationRecord, ...], notes: tuple[str, ...]
) -> ReportTable:
    """Return one row for each rung: the effect, its evidence, and the error of the twin so far on each record."""
    rows = []
    for rung in growth.rungs:
        rows.append((*_added(rung.added), *(one.error(rung.network) for one in judged)))
    if any(one.published is not None for one in judged):
        rows.append(("published", *[""] * (len(LADDER) - 1), *(one.published for one in judged)))
    same = tuple(
        f"{_name(a)} is not distinguishable from {', '.join(' '.join(o).replace('_', ' ') for o in a.others)}"
        for rung in growth.rungs
        if (a := rung.added) is not None and a.others
    )
    return ReportTable(
        key, title, (*LADDER, *(one.column for one in judged)), tuple(rows), (growth.summary, *same, GAIN, *notes)
    )


def _added(added: Added | None) -> tuple[Cell, ...]:
    if added is None:
        return ("baseline, fitted", *[""] * (len(LADDER) - 1))
    low, high = (number(v) for v in added.interval90)
    size = f"{number(added.value)} {added.unit}"
    return (
        _name(added),
        added.driver.replace("_", " "),
        size,
        f"{low} to {high}",
        added.gain,
        added.elsewhere,
        f"{added.folds} of 4",
    )


def _name(added: Added) -> str:
    return f"{added.kind.replace('_', ' ')}, {added.where}"


def _free_run(network: Network, record: PublicRecord) -> Array:
    """Return simulated less measured (n, m), K."""
    inputs, measured = network.select(record.columns)
    difference: Array = simulate(network, record.time_s, inputs, network.initial_state(measured[:1])) - measured
    return difference


def _at_rest(states: PublicRecord) -> Callable[[Network], float]:
    def error(network: Network) -> float:
        inputs, measured = network.select(states.columns)
        return float(np.sqrt(np.nanmean((steady_readings(network, inputs) - measured) ** 2)))

    return error


PARTS: dict[str, Callable[[Path, Say], tuple[Growth, ReportTable]]] = {
    "tclab": _tclab,
    "heated_pipe": _heated_pipe,
    "dry_cooler": _dry_cooler,
    "wet_tower": _wet_tower,
}
LEFT_OUT = ("the tower's loss of water: Merkel's method does not say it",)
