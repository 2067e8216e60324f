"""Command `hil track`: replay the calibrators on a record."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hil.cli.options import CALIBRATORS, INPUT_FILE, INPUT_PATH, NETWORK, NETWORK_MODE, reading

if TYPE_CHECKING:
    from hil.record import ReadingOptions, Record
    from hil.tracking import Adoption, NetworkMode, Proposed


@click.command()
@click.argument("target", type=INPUT_PATH, metavar="RUN|RECORD")
@click.option("--twin", type=INPUT_FILE, help="Twin file; default for a run: the twin that it ran with.")
@CALIBRATORS
@NETWORK
@NETWORK_MODE
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the calibrators.")
@click.option(
    "--out", type=click.Path(dir_okay=False, path_type=Path), help="File for the predictions, .parquet or .csv."
)
@reading
@click.option("--json", "as_json", is_flag=True, help="Print the table as JSON.")
def command(
    target: Path,
    twin: Path | None,
    calibrators: tuple[str, ...],
    card: Path | None,
    network_mode: NetworkMode,
    seed: int,
    out: Path | None,
    as_json: bool,
    choice: ReadingOptions,
) -> None:
    """Replay RUN or RECORD (Parquet or CSV) past a static twin and tracked ones, and print their errors per sensor.

    \b
    Example:
      hil commission commissioning.parquet --datasheet datasheet.json --out my_twin.toml
      hil track campaign.parquet --twin my_twin.toml
      hil track runs/<a run>
    """
    import time

    from hil.cli.options import subject_of
    from hil.record import read_record, require_record_suffix
    from hil.run.session import ProgressBar, check_calibrators, chosen_calibrators, console, show_comparison
    from hil.run_folder import RunFolderError, require_output
    from hil.tracking import (
        Advice,
        TrackingConfig,
        Twins,
        adoption_manifest,
        closed_gates,
        replay,
        too_coarse,
        window_words,
        write_predictions,
    )

    if out is not None:
        require_record_suffix(out)
    check_calibrators(calibrators)
    names, optional = chosen_calibrators(calibrators or None, card)
    subject = subject_of(target, twin)
    if out is not None:
        require_output(out, RunFolderError, (subject.record, subject.twin))
    data = read_record(subject.record, choice=choice)
    twins = Twins(TrackingConfig(subject.twin, tuple(data.columns), names, seed, optional, card=card))
    began = time.monotonic()
    with ProgressBar("tracking", len(data.time_s), quiet=as_json) as steps:
        for name, why in twins.left_out.items():
            steps.print_line(f"{name} is left out: {why}")
        for message in (*data.messages, *(f"{c} is not in the record" for c in twins.network.unread(data.columns))):
            steps.print_line(message)
        found = replay(twins, data, steps.update)
    comparison, windows, proposals = found.comparison, found.windows, list(found.proposals)
    if out is not None:
        write_predictions(out, twins, data, found)
    advise = Advice(twins.network).news
    advice = [] if network_mode == "shadow" else [(p.time_s, said) for p in proposals if (said := advise(p))]
    adopted = _adopted(network_mode, subject.twin, data, proposals)
    if as_json:
        document = {
            **found.document(twins),
            "advice": [said for _, said in advice],
            "adoption": adoption_manifest(adopted),
        }
        click.echo(json.dumps(document, indent=1))
        return
    to = console()
    show_comparison(to, comparison, f"RMSE in K over {data.time_s[-1] / 3600:.1f} h of {subject.record}")
    for line in twins.tuning():
        to.print(line, markup=False, soft_wrap=True)
    for name, counts in windows.items():
        listed = ", ".join(f"{count} {kind}" for kind, count in counts.items()) or "none complete"
        to.print(f"{name}: windows: {listed}")
    if kinds := {kind for counts in windows.values() for kind in counts}:
        to.print(window_words(kinds, twins.network.rules), markup=False, soft_wrap=True)
    if kinds == {"skipped"} and (sentence := too_coarse(data.period_s, twins.network.rules)):
        to.print(sentence, markup=False, soft_wrap=True)
    if proposals:
        to.print(closed_gates(proposals), markup=False, soft_wrap=True)
    for item in (d for d in found.disturbed if d["calibrator"] == twins.calibrators[0]):
        to.print(f"{item['calibrator']}, window to {float(str(item['window_end_s'])) / 3600:.2f} h: {item['found']}")
    for time_s, said in advice:
        to.print(f"{time_s / 3600:.2f} h: {said}", markup=False, soft_wrap=True)
    if adopted is not None:
        to.print(adopted.sentence, markup=False, soft_wrap=True)
    to.print(f"{len(data.time_s)} samples in {time.monotonic() - began:.1f} s")


def _adopted(mode: NetworkMode, twin: Path, record: Record, proposals: list[Proposed]) -> Adoption | None:
    """Return the accepted parameters as the next revision of the twin, in controlled mode."""
    from hil.tracking import adopt

    if mode != "controlled":
        return None
    name = record.path.name if record.path is not None else "a record"
    return adopt(twin, record, proposals, f"hil track {name} --network-mode controlled")
