"""Card of a tower ensemble: its members and the factors of its 90 % intervals.

    python -m hil.training.tower.ensemble DATA MEMBERS/tower_small

DATA holds simulated stations; those of the validation split set the factors. MEMBERS holds `tower_small_0.safetensors`
and others with their cards. The card is `MEMBERS/tower_small.json`.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

from hil.training.tower.generate import VALIDATION, digest_of, evenly, tables

HELD_OUT = 1000
"""Windows of the validation split that set the factors: 100 of them lie outside, give or take 10."""


def assemble(
    data: Path, stem: Path, *, same_data: bool = True, most: int = HELD_OUT, device: str = "cpu"
) -> Path | None:
    """Write the card `<stem>.json` of all members `<stem>_<seed>` and return its path; None with fewer than two.

    Members whose parameters the gate refused as blind are left out where two others passed.

    Parameters
    ----------
    data
        Folder of simulated stations.
    stem
        Path of the members without the underscore and seed.
    same_data
        Leave out members that were trained on other data than `data`; else the caller knows that none was trained on
        its validation split.
    most
        Number of windows that set the factors, at most.
    device
        Device of the networks, such as cpu or cuda.

    Raises
    ------
    HieraError
        A member cannot be used, or `data` has no validation split.
    OSError
        The card cannot be written.
    """
    from twin.calibrators.hiera_unet.tower import ensemble, load_fleet, load_member

    found = sorted(p for p in stem.parent.glob(f"{stem.name}_*.safetensors") if re.fullmatch(r".*_\d+", p.stem))
    if len(found) < ensemble.LEAST:
        return None
    loaded = {path.name: load_member(path, blind_too=True) for path in found}
    digest = digest_of(data)
    others = {n: "trained on other data" for n, one in loaded.items() if same_data and one.card["data"] != digest}
    if len(loaded) - len(others) < ensemble.LEAST:
        return None
    refused = {name: one.card.get("refused", "") for name, one in loaded.items() if name not in others}
    names, left_out = ensemble.passed(refused)
    members = {name: loaded[name] for name in names}
    fleet = load_fleet(tables(data, VALIDATION), device)
    rows = evenly(fleet.rows, most)
    for one in members.values():
        one.network.to(fleet.device)
    factors = ensemble.factors_of(list(members.values()), fleet, rows, 64 if device == "cpu" else 256)
    more = {"data": digest, "validation_cells": fleet.names, "windows": len(rows)}
    card = stem.with_suffix(".json")
    card.write_text(json.dumps(ensemble.card_of(stem.name, members, factors, left_out | others, more), indent=1) + "\n")
    return card


if __name__ == "__main__":
    from twin.calibrators.hiera_unet.weights.device import ready

    ready()
    print(assemble(Path(sys.argv[1]), Path(sys.argv[2]), same_data=False) or "fewer than two members: no card")
