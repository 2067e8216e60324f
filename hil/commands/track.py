"""`hil track`: replay the calibrators on a record."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hil.commands.paths import INPUT_FILE

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

BLOCK_ROWS = 1200


@click.command()
@click.argument("record", type=INPUT_FILE)
@click.option("--twin", type=INPUT_FILE, required=True, help="Twin file, usually one that `hil commission` wrote.")
@click.option(
    "--calibrator", "calibrators", multiple=True, default=("pso",), show_default=True, help="May be repeated."
)
@click.option("--seed", default=0, show_default=True, help="Seed of the calibrators.")
@click.option(
    "--out", type=click.Path(dir_okay=False, path_type=Path), help="Write predictions there, .parquet or .csv."
)
@click.option("--json", "as_json", is_flag=True, help="Print the table as JSON.")
def command(record: Path, twin: Path, calibrators: tuple[str, ...], seed: int, out: Path | None, as_json: bool) -> None:
    """Replay RECORD (Parquet or CSV) past a static twin and tracked ones, and print their errors per sensor.

    \b
    Example:
      hil commission commissioning.parquet --datasheet datasheet.json --out my_twin.toml
      hil track campaign.parquet --twin my_twin.toml
    """
    import time

    from hil.record import read_record, require_record_suffix
    from hil.terminal import Steps, console, error_table
    from hil.tracking import TrackingConfig, disturbance, make_trackers, track_arrays
    from hil.tracking import error_table as errors_of

    if out is not None:
        require_record_suffix(out)
    data = read_record(record)
    trackers = make_trackers(TrackingConfig(twin, tuple(data.columns), calibrators, seed))
    network = next(iter(trackers.values())).network
    data.require(*network.input_columns)
    began = time.monotonic()
    outputs: dict[str, list[NDArray[np.float64]]] = {}
    windows: dict[str, dict[str, int]] = {name: {} for name in trackers}
    disturbed: list[dict[str, object]] = []
    with Steps("tracking", len(data.time_s), quiet=as_json) as steps:
        for message in data.messages:
            steps.say(message)
        for done, block_outputs, calibrations in track_arrays(trackers, data.time_s, data.columns, BLOCK_ROWS):
            for name, values in block_outputs.items():
                outputs.setdefault(name, []).append(values)
            for name, _, end_s, document in calibrations:
                windows[name][document["kind"]] = windows[name].get(document["kind"], 0) + 1
                if (found := disturbance(document)) is not None:
                    disturbed.append({"calibrator": name, "window_end_s": end_s, "found": found})
            steps.update(done)
    errors = errors_of(trackers)
    if out is not None:
        _write_predictions(out, data.time_s, network.sensor_names, outputs)
    if as_json:
        click.echo(
            json.dumps({"errors_K": dataclasses.asdict(errors), "windows": windows, "disturbed": disturbed}, indent=1)
        )
        return
    to = console()
    to.print(error_table(errors, f"RMSE in K over {data.time_s[-1] / 3600:.1f} h of {record}"))
    for name, counts in windows.items():
        listed = ", ".join(f"{count} {kind}" for kind, count in counts.items()) or "none complete"
        to.print(f"{name}: windows: {listed}")
    for item in disturbed:
        to.print(f"{item['calibrator']}, window to {float(str(item['window_end_s'])) / 3600:.2f} h: {item['found']}")
    to.print(f"{len(data.time_s)} samples in {time.monotonic() - began:.1f} s")


def _write_predictions(
    out: Path, time_s: NDArray[np.float64], sensors: tuple[str, ...], outputs: dict[str, list[NDArray[np.float64]]]
) -> None:
    import numpy as np

    from hil.record import Record, write_record

    columns: dict[str, NDArray[np.float64]] = {}
    for name, blocks in outputs.items():
        values = np.concatenate(blocks)
        columns |= {f"{sensor.removesuffix('_C')}_{name}_C": values[:, i] for i, sensor in enumerate(sensors)}
    write_record(Record(time_s, columns), out)
