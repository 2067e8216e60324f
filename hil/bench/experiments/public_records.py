"""Public records of other rigs, simulated and fitted with the shipped twins, with published figures.

The rules: a twin is fitted on the calibration part of a record alone, judged on the other; "unfitted" are the values
in the twin file, which are published ones or come from geometry and textbooks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.record import PIPE_TESTS, WATER_DENSITY, PublicRecord, dry_cooler, heated_pipe, held_steady, tclab
from twin import (
    CommissionOptions,
    CommissionResult,
    Kernel,
    Network,
    commission,
    load,
    parse,
    right_hand_side,
    simulate,
    steady_readings,
)
from twin.commissioning import INITIAL_SD_K

Array = NDArray[np.float64]

TWINS = Path(__file__).resolve().parents[3] / "profiles" / "twins"
FITTED_TEST = PIPE_TESTS[0]
RUN_IN_ROWS = 100
DRAWS = 500
AT_REST_K = 0.1
"""Standard deviation in K of the initial state: the heaters' record begins at rest, with readings in steps of 0.32 K.
"""
HELD_OUT = 0.05
"""Least held-out share of commissioning; the records have their own validation part."""

DEFINITIONS = {
    "tclab": "sum over all samples and both sensors of |simulated - measured|, free run from the first reading; the "
    "source simulates with one implicit Euler step a second, the heater value of a row acting before the row",
    "heated_pipe": "RMSE of the water temperature at the outlet, free run, inlet temperature and flow as measured, the "
    "content at the beginning linear between the two readings; after the first transit: once what entered before the "
    f"record has left; fitted on {FITTED_TEST} alone",
    "dry_cooler": "RMSE of the outlet temperature over steady states; fitted on dc_exp1 alone, dc_exp3 untouched",
}


@dataclass(frozen=True)
class Row:
    """Error figure: as published, with the twin file's own values, and fitted; None if there is none."""

    record: str
    figure: str
    published: float | None
    unfitted: float | None
    fitted: float | None
    note: str = ""


@dataclass(frozen=True)
class FittedValue:
    """Fitted parameter: before, after, and the 90 % interval, in its unit."""

    parameter: str
    before: float
    after: float
    low90: float
    high90: float
    unit: str
    told: str


@dataclass(frozen=True)
class Definition:
    record: str
    definition: str


@dataclass(frozen=True)
class RecordsResult:
    """Result of `run`. `messages` are those of the records' readers, a sentence each."""

    errors: tuple[Row, ...]
    parameters: tuple[FittedValue, ...]
    definitions: tuple[Definition, ...]
    messages: tuple[str, ...] = field(default=())

    def error(self, record: str, figure: str) -> Row:
        """Return the row of one record and figure."""
        return next(row for row in self.errors if row.record == record and row.figure == figure)


def run(
    data: Path, seed: int = 0, twins: Path = TWINS, progress: Callable[[float, str], None] = lambda done, note: None
) -> RecordsResult:
    """Simulate and fit all public records.

    Parameters
    ----------
    data
        The folder that holds `real` (environment variable HIL_DATA).
    seed
        Of the random starts of the fits.
    twins
        Folder of the twin files.
    progress
        Told how many of `PARTS` are done, and which comes next.

    Raises
    ------
    PublicRecordError
        A record is absent or not what it should be.
    """
    real = data / "real"
    rows: list[Row] = []
    fits: list[tuple[Network, CommissionResult]] = []
    messages: list[str] = []
    for done, (name, part) in enumerate(PARTS.items()):
        progress(done, name)
        found, fit, said = part(real, twins, seed)
        rows += found
        fits.append(fit)
        messages += said
    values = tuple(
        FittedValue(
            f"{network.name}: {name}",
            fit.start[name],
            fit.values[name],
            *fit.interval90[name],
            network.parameters[name].unit,
            "no" if name in fit.unidentifiable else "at its bound" if name in fit.at_bound else "yes",
        )
        for network, fit in fits
        for name in fit.values
    )
    definitions = tuple(Definition(name, text) for name, text in DEFINITIONS.items())
    return RecordsResult(tuple(rows), values, definitions, tuple(dict.fromkeys(messages)))


_Part = tuple[list[Row], tuple[Network, CommissionResult], list[str]]


def _tclab(real: Path, twins: Path, seed: int) -> _Part:
    network = load(twins / "tclab.toml")
    train, validation = (tclab(real, f"mimo_{part}") for part in ("train", "validation"))
    fit = _fitted(network, train, seed, AT_REST_K)
    figure = "sum |error|, K"
    rows = []
    for record, published in ((train, 270.26), (validation, 840.95)):
        errors = [float(np.nansum(np.abs(_residual(net, record)))) for net in (network, fit.network)]
        low, high = band(fit, record)
        note = "fitted on this" if record is train else f"untouched; the fit's own uncertainty: {low:.0f} to {high:.0f}"
        rows.append(Row(f"tclab {record.name}", figure, published, errors[0], errors[1], note))
        euler = float(np.nansum(np.abs(_implicit_euler(network, record))))
        rows.append(Row(f"tclab {record.name}", f"{figure}, integrated as the source does", published, euler, None))
    return rows, (network, fit), [f"tclab: {m}" for m in train.messages]


def _heated_pipe(real: Path, twins: Path, seed: int) -> _Part:
    network = load(twins / "heated_pipe.toml")
    mixed = parse(MIXED)
    tests = [heated_pipe(real, test) for test in PIPE_TESTS]
    fit = _fitted(network, tests[PIPE_TESTS.index(FITTED_TEST)], seed)
    rows = []
    for test in tests:
        stale, fresh = (_from_linear_profile(net, test) for net in (network, fit.network))
        note = "fitted on this" if test.name == FITTED_TEST else "untouched"
        rows.append(Row(f"heated_pipe {test.name}", "RMSE, K", None, _rmse(stale), _rmse(fresh), note))
        known = test.time_s > _transit_s(network, test)
        figure = "RMSE after the first transit, K"
        rows.append(Row(f"heated_pipe {test.name}", figure, None, _rmse(stale[known]), _rmse(fresh[known]), note))
        figure = "RMSE as one mixed volume, K"
        rows.append(Row(f"heated_pipe {test.name}", figure, None, _rmse(_residual(mixed, test)), None))
    return rows, (network, fit), [f"heated_pipe {test.name}: {m}" for test in tests for m in test.messages]


def _dry_cooler(real: Path, twins: Path, seed: int) -> _Part:
    network = load(twins / "dry_cooler.toml")
    calibration, validation = (dry_cooler(real, f"dc_{part}") for part in ("exp1", "exp3"))
    fit = _fitted(network, held_steady(calibration, ("T_out_C",)), seed)
    rows = []
    for states, published, note in (
        (calibration, None, "fitted on this, but for its last two states"),
        (validation, 0.50, "untouched; Gaussian process 0.32 as published"),
    ):
        errors = []
        for net in (network, fit.network):
            inputs, measured = net.select(states.columns)
            errors.append(_rmse(steady_readings(net, inputs) - measured))
        rows.append(Row(f"dry_cooler {states.name}", "RMSE, K", published, errors[0], errors[1], note))
    return rows, (network, fit), []


PARTS: dict[str, Callable[[Path, Path, int], _Part]] = {
    "tclab": _tclab,
    "heated_pipe": _heated_pipe,
    "dry_cooler": _dry_cooler,
}


def _fitted(network: Network, record: PublicRecord, seed: int, initial_sd: float = INITIAL_SD_K) -> CommissionResult:
    inputs, measured = network.select(record.columns)
    return commission(
        network,
        record.time_s,
        inputs,
        measured,
        CommissionOptions(held_out=HELD_OUT, seed=seed, initial_sd=initial_sd, made_by=record.name),
    )


def band(fit: CommissionResult, record: PublicRecord) -> tuple[float, float]:
    """Return the middle 90 % of sum |error| on `record` over parameters that the fit does not distinguish from its best
    ones.
    """
    inputs, measured = fit.network.select(record.columns)
    state = fit.network.initial_state(measured[:1])
    kernel = Kernel(fit.network, tuple(fit.values))
    readings, _ = kernel.trace(fit.sample(DRAWS), state, record.time_s, inputs)
    low, high = np.quantile(np.nansum(np.abs(readings - measured), axis=(1, 2)), [0.05, 0.95])
    return float(low), float(high)


def _residual(network: Network, record: PublicRecord) -> Array:
    """Return simulated less measured (n, m), free run from the first reading; NaN without a measurement."""
    inputs, measured = network.select(record.columns)
    readings = simulate(network, record.time_s, inputs, network.initial_state(measured[:1]))
    difference: Array = readings - measured
    return difference


def _from_linear_profile(network: Network, record: PublicRecord) -> Array:
    """Return `_residual` for a pipe whose water falls evenly from the first inlet to the outlet reading.

    A pipe holds what entered before the record. The profile is made by letting the inlet go from the one reading to
    the other during one transit before the record begins.
    """
    inputs, measured = network.select(record.columns)
    inlet = network.input_columns.index("T_water_in_C")
    before = np.tile(inputs[0], (RUN_IN_ROWS, 1))
    before[:, inlet] = np.linspace(measured[0, 0], inputs[0, inlet], RUN_IN_ROWS)
    ago = np.linspace(-_transit_s(network, record), 0.0, RUN_IN_ROWS, endpoint=False)
    time_s = np.concatenate([record.time_s[0] + ago, record.time_s])
    readings = simulate(network, time_s, np.vstack([before, inputs]), network.initial_state(measured[:1]))
    difference: Array = readings[RUN_IN_ROWS:] - measured
    return difference


def _transit_s(network: Network, record: PublicRecord) -> float:
    """Return the transport delay from inlet to outlet, s: water and wall pass at the record's first flow."""
    volume, wall = (network.parameters[f"pipe.{name}"].value for name in ("volume", "wall_capacity"))
    cp = network.parameters["supply.cp"].value
    return 60.0 * (volume + wall / (WATER_DENSITY * cp)) / float(record.columns["flow_pct"][0])


def _rmse(residual: Array) -> float:
    return float(np.sqrt(np.nanmean(residual**2)))


def _implicit_euler(network: Network, record: PublicRecord) -> Array:
    """Return `_residual` with one implicit Euler step between samples; sensors follow with their lag."""
    inputs, measured = network.select(record.columns)
    rhs, values = right_hand_side(network), network.values
    lag = values[network.index(f"{s.name}.lag_s" for s in network.sensors)]
    at = [network.nodes.index(s.node) for s in network.sensors]
    state = network.initial_state(measured[:1])
    readings = np.empty_like(measured)
    readings[0] = state[at]
    k = state.size
    for i, dt in enumerate(np.diff(record.time_s)):
        new = state.copy()
        for _ in range(5):
            rate = np.array(rhs(new, inputs[i], values))
            slope = np.column_stack([np.array(rhs(new + 1e-4 * e, inputs[i], values)) - rate for e in np.eye(k)]) / 1e-4
            new = new - np.linalg.solve(np.eye(k) - dt * slope, new - state - dt * rate)
        state = new
        readings[i + 1] = (readings[i] + dt / lag * state[at]) / (1.0 + dt / lag)
    difference: Array = readings - measured
    return difference


MIXED = """
format = 1
name = "heated_pipe_mixed"
[inputs]
flow_pct = { nominal = 75.0 }
T_water_in_C = { nominal = 18.0 }
T_ambient_C = { nominal = 18.0 }
[elements.water]
kind = "node"
capacitance = { value = 452700.0, source = "84.36 L of water and the wall" }
[elements.supply]
kind = "flow"
path = ["water"]
inlet = "T_water_in_C"
pump = "flow_pct"
nominal = 100.0
[elements.loss]
kind = "ambient_loss"
node = "water"
hA = 18.02
[elements.T_water_out_C]
kind = "sensor"
node = "water"
columns = ["T_water_out_C"]
"""
"""Heated pipe as one well-mixed volume, for comparison."""
