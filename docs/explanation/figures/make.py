"""Figures of the design chapters, made from the project's own code, twins and published results.

    python docs/explanation/figures/make.py [NAME ...]

Without a name all figures are made; the names are those of the SVG files. The figures are deterministic: seeds are
fixed, and the files carry no date.
"""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch, Rectangle

HERE = Path(__file__).resolve().parent
PROJECT = HERE.parents[2]
BLUE, ORANGE, GREEN, RED, GREY = "#0072b2", "#d55e00", "#009e73", "#cc3311", "#777777"
SEED = 3
HOURS = 8.0
"""Length of the records of the virtual rig that two figures show, h."""


def integrator() -> plt.Figure:
    """Draw the kernel's error against the matrix exponential, and water that leaves a pipe against a mixed volume."""
    from twin.kernel import simulate
    from twin.network import Network
    from twin.reference_simulation import simulate_exact
    from twin.twinfile import load

    network: Network = load(PROJECT / "profiles" / "twins" / "loop.toml")
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.2))
    steps = np.array([0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 60.0])
    nodes = [network.nodes.index(s.node) for s in network.sensors]
    errors = []
    for dt in steps:
        time = np.arange(0.0, 1800.0 + 0.5 * dt, dt)
        inputs = np.tile(network.nominal_inputs, (len(time), 1))
        for column, low, high in (("heater_power_W", 600.0, 900.0), ("fan_speed_pct", 40.0, 100.0)):
            k = network.input_columns.index(column)
            inputs[:, k] = np.where((time // 300.0) % 2 == 0, low, high)
        start = np.full(len(network.nodes), 25.0)
        exact = simulate_exact(network, time, inputs, start)[:, nodes]
        errors.append(np.abs(simulate(network, time, inputs, start) - exact).max())
    left.loglog(steps, errors, "o-", color=BLUE)
    left.axhline(network.sigma.min(), color=GREY, ls="--", lw=1)
    left.text(steps[0], 0.55 * network.sigma.min(), "noise of a reading", color=GREY, fontsize=8, va="top")
    left.set(xlabel="sampling interval of the inputs, s", ylabel="largest error, K", ylim=(1e-13, 1.0))
    left.set_title("kernel against matrix exponential")

    pipe = load(PROJECT / "profiles" / "twins" / "heated_pipe.toml")
    mixed = load(PROJECT / "profiles" / "twins" / "heated_pipe_mixed.toml")
    time = np.arange(0.0, 301.0, 1.0)
    for twin, colour, name in ((pipe, BLUE, "pipe: plug flow, wall, loss"), (mixed, ORANGE, "one mixed volume")):
        inputs = np.tile(twin.nominal_inputs, (len(time), 1))
        inputs[time >= 20.0, twin.input_columns.index("T_water_in_C")] = 40.0
        start = np.full(len(twin.nodes), 18.0)
        right.plot(time, simulate(twin, time, inputs, start)[:, 0], color=colour, label=name)
    right.axvline(20.0, color=GREY, ls=":", lw=1)
    right.set(xlabel="time, s", ylabel="outlet temperature, degC", title="39 m of pipe, inlet step at 20 s")
    right.legend(frameon=False, fontsize=8, loc="lower right")
    return figure


def _virtual(effects: str) -> tuple[Any, Any, Any]:
    """Return twin, record and healthy record: `HOURS` of the virtual rig with a shipped effect, without its wires."""
    from drivers.rig_file.reader import load_rig
    from drivers.virtual.plant.effects import load_effects
    from hil.profile.load_profile import Profile
    from hil.synthetic.plant_record import direct_record
    from twin.discovery.healthy.basis import Columns
    from twin.twinfile import load

    profiles = PROJECT / "profiles"
    network = load(profiles / "twins" / "virtual.toml")
    rng = np.random.default_rng(SEED)
    begins = np.arange(0.0, HOURS * 3600.0 + 1.0, 1500.0)
    levels = np.column_stack(
        [
            rng.uniform(600.0, 900.0, len(begins)),
            rng.uniform(70.0, 100.0, len(begins)),
            rng.uniform(50.0, 100.0, len(begins)),
        ]
    )
    load_profile = Profile(
        name="steps", columns=("heater_power_W", "pump_speed_pct", "fan_speed_pct"), time_s=begins, values=levels
    )
    rig = load_rig(profiles / "rigs" / "virtual.toml")
    made = direct_record(load_profile, rig, seed=SEED, unit=1, effects=load_effects(profiles / "effects" / effects))
    record = Columns.of(network, made.time_s, made.columns)
    import pyarrow.parquet as pq

    table = pq.read_table(profiles / "twins" / "virtual.healthy.parquet")
    columns = {name: table[name].to_numpy() for name in table.column_names}
    return network, record, Columns.of(network, columns["time_s"], columns)


def windows() -> plt.Figure:
    """Draw errors of windows before calibration, and the power that a calibrator finds, on the virtual rig."""
    from twin.tracking import TwinTracker

    network, record, _ = _virtual("modules_heat.toml")
    figure, (top, bottom) = plt.subplots(2, 1, figsize=(8.0, 5.2), sharex=True)
    rows = (("pso_paper", "o", ORANGE), ("pso", "s", GREEN), ("kalman", "^", GREY), ("least_squares", "D", BLUE))
    for name, marker, colour in rows:
        tracker = TwinTracker(network, name, seed=0)
        found = tracker.push(record.time_s, record.inputs, record.measured).calibrations
        hours = np.array([c.end_s for c in found]) / 3600.0
        top.semilogy(hours, [c.error_before_K for c in found], marker, ms=3.5, color=colour, label=name)
        if name == "least_squares":
            k = tracker.calibrator.ids.index("modules_power.power")
            power = np.array([c.values["modules_power.power"] for c in found])
            half = 1.645 * np.array([np.sqrt(c.covariance[k, k]) for c in found])
            bottom.errorbar(hours, power, half, fmt="D", ms=3, lw=0.8, color=colour, label="least_squares, 90 %")
    top.axhline(network.rules.calibrated_K, color=GREY, ls="--", lw=1)
    top.text(0.05, 1.08 * network.rules.calibrated_K, "calibrated", fontsize=8, color=GREY)
    top.set(ylabel="error of the prediction, K", title="each window, predicted before it was calibrated")
    top.set_ylim(top=4.0)  # room for the legend above the first window after the change
    top.legend(frameon=False, fontsize=8, ncol=4, loc="upper right")
    bottom.step([0.0, 3.5, 3.5, HOURS], [0.0, 0.0, 180.0, 180.0], color=RED, lw=1, label="heat that the rig gives off")
    bottom.set(xlabel="time, h", ylabel="heat in the modules, W")
    bottom.legend(frameon=False, fontsize=8, loc="upper left")
    return figure


def hiera() -> plt.Figure:
    """Draw the network's scales from its configuration, and a fit beside the belief that few parameters moved."""
    from twin.calibrators.hiera_unet.context_fit.sparse import Likelihood, Usual, posterior
    from twin.calibrators.hiera_unet.model.config import named

    config = named("small", groups=(1,), bounds=(1.0,), tolerances=(1.0,), meta=6)
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.6, 3.6), width_ratios=(1.35, 1.0))
    minutes, names = config.context * config.step_s / 60.0, list[str]()
    for row, (stride, window) in enumerate(zip(config.strides, config.windows, strict=True)):
        token = stride * config.step_s / 60.0
        count = config.context // stride
        for k in range(count):
            if stride > 1:
                left.add_patch(Rectangle((k * token, -row - 0.3), token, 0.6, fc="#dcebf5", ec=BLUE, lw=0.3))
        if stride == 1:
            left.add_patch(Rectangle((0.0, -0.3), minutes, 0.6, fc="#dcebf5", ec=BLUE, lw=0.3))
        left.add_patch(
            Rectangle((minutes - window * token, -row - 0.38), window * token, 0.76, fill=False, ec=RED, lw=1.4)
        )
        names.append(f"{count} tokens of {stride * config.step_s:g} s,\nwindow {window * token:.3g} min")
    begin = minutes - config.target * config.step_s / 60.0
    left.axvspan(begin, minutes, ymin=0.0, color=ORANGE, alpha=0.18, lw=0)
    left.text(begin, 0.62, "target", color=ORANGE, fontsize=8, ha="left")
    left.set(xlim=(0.0, minutes), ylim=(-3.6, 0.9), xlabel="time in the window, min")
    left.set_yticks([0, -1, -2, -3], names, fontsize=8)
    left.tick_params(axis="y", length=0)
    left.set_title("four stages, one attention window of each in red", fontsize=10)
    left.spines[["left", "right", "top"]].set_visible(False)

    rng = np.random.default_rng(SEED)
    truth = np.zeros(9)
    truth[2] = 0.35
    slopes = rng.normal(0.0, 1.0, (40, 9)) @ (np.eye(9) + 0.75)
    information = slopes.T @ slopes * 2.0
    noise = rng.multivariate_normal(np.zeros(9), information)
    fit = np.linalg.solve(information + np.eye(9) * 0.4**-2, information @ truth + noise)
    belief = posterior(
        Likelihood(information, information @ truth + noise),
        Usual(chance=np.full(9, 0.05), slab=np.full(9, 0.3), spike=np.full(9, 0.01)),
    )
    place = np.arange(9)
    sd = np.sqrt(np.diag(np.linalg.inv(information + np.eye(9) * 0.4**-2)))
    right.errorbar(place - 0.15, fit, 1.645 * sd, fmt="o", color=GREY, ms=4, lw=1, label="Gauss-Newton")
    right.errorbar(place + 0.15, belief.mean, 1.645 * belief.sd, fmt="D", color=BLUE, ms=4, lw=1, label="few moved")
    right.plot(place, truth, "_", color=RED, ms=14, mew=1.6, label="truth")
    right.axhline(0.0, color=GREY, lw=0.5)
    right.set(xlabel="parameter", ylabel="deviation", xticks=place)
    right.set_title("synthetic data: one parameter moved", fontsize=10)
    right.legend(frameon=False, fontsize=8)
    return figure


def scores() -> plt.Figure:
    """Draw residual, scores by onset and residual with the effect, of a record of the virtual rig."""
    from twin.discovery.engine import diagnose
    from twin.discovery.evidence.part import Part
    from twin.discovery.healthy.basis import basis
    from twin.discovery.records.grid import on_grid
    from twin.discovery.scoring.sweep import Courses, LawSquares

    network, record, healthy = _virtual("tank_insulation.toml")
    grid = on_grid(network, record.time_s, record.inputs, record.measured)
    whole = Part.of(basis(network, healthy, grid), grid)
    found = diagnose(network, record, healthy)
    figure, axes = plt.subplots(3, 1, figsize=(8.0, 7.4), sharex=True)
    colours = (RED, GREY, ORANGE, BLUE)
    for j, (name, colour) in enumerate(zip(network.sensor_names, colours, strict=True)):
        axes[0].plot(found.hours, found.residual[:, j], color=colour, lw=1, label=name)
        axes[2].plot(found.hours, found.residual_after[:, j], color=colour, lw=1)
    axes[0].legend(frameon=False, fontsize=8, ncol=2)
    axes[0].set(ylabel="residual, K", title="measured minus commissioned twin")
    courses, best = Courses.of(whole.score_test), {}
    for law in whole.laws:
        squares = LawSquares.of(whole.score_test, law)
        top = whole.score_test.scored(squares.blocks) @ courses.steps
        size = top / np.maximum(squares.steps, 1e-30)
        c = law.candidate
        z = np.where(
            (size >= c.lower) & (size <= c.upper), np.abs(top) / np.sqrt(np.maximum(squares.steps, 1e-30)), 0.0
        )
        label = f"{c.kind.replace('_', ' ')} at {c.where}"
        if label not in best or z.max() > best[label].max():
            best[label] = z
    order = sorted(best, key=lambda label: -best[label].max())
    for label in order[3:]:
        axes[1].plot(courses.onsets / 3600.0, best[label], color="#cccccc", lw=0.5)
    for label, colour in zip(order[:3], (BLUE, ORANGE, GREEN), strict=True):
        axes[1].plot(courses.onsets / 3600.0, best[label], color=colour, lw=1.4, label=label)
    axes[1].set(ylabel="score z", title="score of each law as a step, by its onset")
    axes[1].set_ylim(0.0, 1.6 * best[order[0]].max())
    axes[1].legend(frameon=False, fontsize=8, ncol=2, loc="upper left")
    axes[2].axvspan(found.held_out_s[0] / 3600.0, found.held_out_s[1] / 3600.0, color=GREY, alpha=0.15, lw=0)
    axes[2].text(found.held_out_s[0] / 3600.0 + 0.05, axes[2].get_ylim()[0], "held out", fontsize=8, va="bottom")
    axes[2].set(ylabel="residual, K", xlabel="time, h", title=f"with the effect: {found.verdict}")
    return figure


PLACES = {
    "idle": (0.4, 4.6),
    "validating": (3.2, 4.6),
    "connecting": (6.0, 4.6),
    "restoring": (8.8, 4.6),
    "running": (3.0, 2.6),
    "held": (0.4, 0.9),
    "suspended": (5.6, 0.9),
    "paused": (3.0, -0.8),
    "finishing": (7.4, 2.6),
    "done": (10.2, 3.5),
    "aborted": (10.2, 2.6),
    "faulted": (10.2, 1.7),
}
AGAIN = {"restoring": (3.0, 2.6), "held": (0.4, 0.9), "suspended": (5.6, 0.9), "paused": (3.0, -0.8)}
"""Places of the states of a thermal restore."""
FILL = {"heat": "#fde3d3", "safe": "#dcf0e6", "none": "#eeeeee"}


def states() -> plt.Figure:
    """Draw the transition table of a run, and apart from it the part that belongs to a thermal restore."""
    module = importlib.import_module("hil.journal.states")
    figure, (left, right) = plt.subplots(1, 2, figsize=(12.5, 5.0), width_ratios=(11.5, 7.0))
    arrows: dict[tuple[str, str], list[str]] = {}
    for (source, event), target in module.TABLE.items():
        if source != target and target != "finishing" and not (source in module.UNTOUCHED and target in module.ENDED):
            arrows.setdefault((source.value, target.value), []).append(event.value)
    again = {pair: e for pair, e in arrows.items() if "restoring" in pair and set(pair) <= set(AGAIN)}
    again |= {pair: e for pair, e in arrows.items() if set(pair) <= set(AGAIN) - {"restoring"}}
    # A trip ends a thermal restore (the supervisor asks for `fail` instead).
    again = {pair: [e for e in events if e != "trip"] for pair, events in again.items()}
    first = {pair: e for pair, e in arrows.items() if not ("restoring" in pair and set(pair) <= set(AGAIN))}
    _draw(left, module, PLACES, first)
    _draw(right, module, AGAIN, again)
    left.add_patch(FancyArrowPatch((3.7, 2.6), (6.75, 2.6), arrowstyle="-|>", mutation_scale=10, color=RED, lw=1.1))
    left.text(5.2, 2.72, "complete", fontsize=7, ha="center", color=RED)
    left.text(8.3, 0.95, "abort, fail: to finishing\nfrom every state with outputs", fontsize=7, ha="center", color=RED)
    left.set_title("a run (events on the arrows)")
    right.set_title("thermal restore after a cut")
    said = {"heat": "outputs may be away from safe", "safe": "outputs at safe values", "none": "outputs untouched"}
    for k, (key, text) in enumerate(said.items()):
        left.add_patch(Rectangle((7.0, 0.4 - 0.45 * k), 0.3, 0.25, fc=FILL[key], ec="black", lw=0.6))
        left.text(7.45, 0.52 - 0.45 * k, text, fontsize=8, va="center")
    left.set(xlim=(-0.5, 11.0), ylim=(-1.3, 5.1))
    right.set(xlim=(-0.5, 6.5), ylim=(-1.3, 5.1))
    return figure


def _draw(
    axes: Any, module: Any, places: dict[str, tuple[float, float]], arrows: dict[tuple[str, str], list[str]]
) -> None:
    for (source, target), events in arrows.items():
        a, b = np.array(places[source]), np.array(places[target])
        bend = 0.22 if (target, source) in arrows else 0.0
        axes.add_patch(
            FancyArrowPatch(
                a,
                b,
                connectionstyle=f"arc3,rad={bend}",
                arrowstyle="-|>",
                mutation_scale=10,
                shrinkA=22,
                shrinkB=22,
                color=GREY,
                lw=0.9,
            )
        )
        across = np.array([b[1] - a[1], a[0] - b[0]])
        axes.text(
            *(0.5 * (a + b) + 0.5 * bend * across),
            ",\n".join(events),
            fontsize=7,
            ha="center",
            va="center",
            bbox={"fc": "white", "ec": "none", "pad": 0.4},
        )
    for name, (x, y) in places.items():
        state = module.State(name)
        fill = "heat" if state in module.HEATED else "none" if state in module.UNTOUCHED else "safe"
        box = FancyBboxPatch(
            (x - 0.55, y - 0.2), 1.1, 0.4, boxstyle="round,pad=0.04", fc=FILL[fill], ec="black", lw=0.8
        )
        axes.add_patch(box)
        axes.text(x, y, name, fontsize=8.5, ha="center", va="center")
    axes.axis("off")


def reads() -> plt.Figure:
    """Draw the read plan of an example device under three limits, from `plan_reads`."""
    from drivers.modbus.read_plan import plan_reads
    from drivers.rig_file.model import Point

    layout = (
        (0, "float32"),
        (2, "float32"),
        (4, "int16"),
        (5, "int16"),
        (9, "int16"),
        (10, "uint32"),
        (24, "int16"),
        (40, "float32"),
        (42, "float32"),
        (44, "int16"),
    )
    points = [Point(name=f"p{a}", bus="plc", unit="degC", table="holding", address=a, type=kind) for a, kind in layout]
    cases = (
        ("max_gap = 8", {}),
        ("max_gap = 16", {"max_gap": 16}),
        ("max_gap = 16, max_read = 24", {"max_gap": 16, "max_read": 24}),
    )
    figure, axes = plt.subplots(figsize=(9.0, 2.9))
    for row, (name, limits) in enumerate(cases):
        for block in plan_reads(points, **limits):
            axes.add_patch(Rectangle((block.address, -row - 0.36), block.count, 0.72, fill=False, ec=RED, lw=1.5))
        for point in points:
            axes.add_patch(Rectangle((point.address, -row - 0.22), point.width, 0.44, fc="#a9cfe8", ec=BLUE, lw=0.7))
        count = len(plan_reads(points, **limits))
        axes.text(47.0, -row, f"{name}: {count} {'request' if count == 1 else 'requests'}", fontsize=8.5, va="center")
    axes.set(
        xlim=(-1.0, 64.0), ylim=(-2.6, 0.6), yticks=[], xlabel="address of the holding register", xticks=range(0, 48, 8)
    )
    axes.spines[["left", "right", "top"]].set_visible(False)
    return figure


def safety() -> plt.Figure:
    """Draw the time from an event to the layer that makes the virtual rig safe, from the constants of the program."""
    from drivers.rig_file import CanBus, load_rig
    from hil.guardian.process import POLL_S
    from hil.run.outputs import SAFE_WITHIN_S, SILENCE_S

    rig = load_rig(PROJECT / "profiles" / "rigs" / "virtual.toml")
    assert rig.watchdog_s is not None
    timeouts_s = sum(bus.timeout_s for bus in rig.bus.values() if not isinstance(bus, CanBus))
    alive_s = rig.period_s + 1.0 + rig.abort_after_s + 2.0 * timeouts_s
    engine, guardian, watchdog = "engine", "guardian", "watchdog of the rig"
    layers = {engine: GREEN, guardian: BLUE, watchdog: ORANGE}
    at_last = (watchdog, rig.watchdog_s)
    cases: tuple[tuple[str, tuple[tuple[str, float], ...]], ...] = (
        ("the run ends, pauses, trips or fails", ((engine, 0.0),)),
        ("its process is killed", ((guardian, POLL_S), at_last)),
        ("its process is stopped or hangs", ((guardian, SILENCE_S + POLL_S), at_last)),
        ("a tick waits for mute devices", (at_last, (guardian, alive_s + SILENCE_S))),
        ("the machine loses power", (at_last,)),
    )
    figure, axes = plt.subplots(figsize=(9.0, 2.6))
    axes.axvspan(0.0, SAFE_WITHIN_S, color=GREEN, alpha=0.12, lw=0)
    for row, (event, acts) in enumerate(cases):
        axes.plot([0.0, acts[0][1]], [-row, -row], color=GREY, lw=1.0)
        for layer, after_s in acts:
            axes.plot(after_s, -row, "o", color=layers[layer], ms=6)
        axes.text(-0.2, -row, event, fontsize=8, va="center", ha="right")
    for layer, colour in layers.items():
        axes.plot([], [], "o", color=colour, ms=6, label=layer)
    axes.legend(loc="upper right", fontsize=8, frameon=False)
    axes.set(ylim=(-4.6, 0.6), xlim=(-0.1, alive_s + SILENCE_S + 0.5), yticks=[], xlabel="s after the event")
    axes.spines[["left", "right", "top"]].set_visible(False)
    return figure


def trial() -> plt.Figure:
    """Draw the scores of the published blind trial with their 90 % Wilson intervals."""
    text = (PROJECT / "docs" / "results" / "discovery.json").read_text(encoding="utf-8")
    rows = [row for row in json.loads(text)["tables"]["scores"]["rows"] if row[2]]
    figure, axes = plt.subplots(figsize=(9.0, 6.6))
    for k, (name, hits, of, share, low, high) in enumerate(rows):
        axes.plot([low, high], [-k, -k], color=BLUE, lw=1.6)
        axes.plot(share, -k, "o", color=BLUE, ms=4)
        axes.text(103.0, -k, f"{hits} of {of}", fontsize=7.5, va="center")
        axes.text(-2.0, -k, name, fontsize=7.5, va="center", ha="right")
    axes.set(xlim=(0.0, 100.0), yticks=[], xlabel="share of the cases, %, with 90 % interval")
    axes.spines[["left", "right", "top"]].set_visible(False)
    axes.grid(axis="x", lw=0.3)
    return figure


def tower() -> plt.Figure:
    """Draw the rise of a cell's outlet for a loss of 10 % of each deviation, over the water flow and the fan speed."""
    from twin.tower.cell import CellDeviations, Design, Inputs, solve_cell

    design = Design(250.0, 200.0, 1.5, 0.6, 45.0, 1.13)
    figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.2), sharey=True)
    share = np.linspace(0.5, 1.15, 60)
    speed = np.linspace(0.3, 1.0, 60)
    one = np.ones(60)
    for axis, flow, fan, x, label in (
        (axes[0], share, one, share, "water flow over that of design"),
        (axes[1], one, speed, speed, "fan speed"),
    ):
        u = Inputs(36.0 * one, 250.0 * flow, fan, 30.0 * one, 24.0 * one, 99.0 * one)
        clean = solve_cell(u, design).t_out
        for lost, colour, name in (
            (CellDeviations(fill=0.9), BLUE, "fill"),
            (CellDeviations(air=0.9), ORANGE, "air"),
            (CellDeviations(uniformity=0.9), GREEN, "uniformity"),
        ):
            dashes = (4, 3) if name == "uniformity" else (None, None)
            axis.plot(x, solve_cell(u, design, lost).t_out - clean, color=colour, label=name, dashes=dashes)
        axis.set(xlabel=label)
    axes[0].set(ylabel="rise of the outlet, K")
    axes[0].set_ylim(bottom=0.0)
    axes[1].legend(frameon=False, fontsize=8)
    return figure


FIGURES: dict[str, Callable[[], plt.Figure]] = {
    "integrator": integrator,
    "windows": windows,
    "hiera": hiera,
    "scores": scores,
    "states": states,
    "reads": reads,
    "safety": safety,
    "trial": trial,
    "tower": tower,
}


def main() -> None:
    """Make the figures that are named, or all."""
    sys.path.insert(0, str(PROJECT))
    unknown = [name for name in sys.argv[1:] if name not in FIGURES]
    if unknown:
        sys.exit(f"no figure {', '.join(unknown)}; there are: {', '.join(FIGURES)}")
    style = {"svg.hashsalt": "hil", "font.size": 9, "axes.titlesize": 10, "savefig.facecolor": "white"}
    with mpl.rc_context(style):
        for name in sys.argv[1:] or FIGURES:
            figure = FIGURES[name]()
            figure.savefig(HERE / f"{name}.svg", bbox_inches="tight", metadata={"Date": None, "Creator": None})
            plt.close(figure)
            print(f"{name}.svg")


if __name__ == "__main__":
    main()
