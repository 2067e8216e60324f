"""Ensembles of untrained members, which answer what the belief says: cards and weights for tests."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from tests.twin.hiera.tower_tables import made_table

WIDE = 1e6
FACTORS = {branch: {"theta": [1.5, 1.5, 1.5, 1.5], "water": 1.2} for branch in ("causal", "symmetric")}


def write_ensemble(
    folder: Path, blind: tuple[int, ...] = (), count: int = 2, blind_outputs: tuple[int, ...] = (), biased: float = 0.0
) -> Path:
    """Write members with weights that differ by their seed, and the card of their ensemble; return its path.

    Parameters
    ----------
    blind, blind_outputs
        Seeds of members whose both heads, or outputs alone, the gate refuses.
    biased
        Correction of the outlet by each member, in units of the output head.
    """
    import torch

    from twin.calibrators.hiera_unet.tower import Fleet, MemberTraining, TowerPlan
    from twin.calibrators.hiera_unet.tower.ensemble import FORMAT
    from twin.calibrators.hiera_unet.tower.predict import NOT_TESTED, Blindness
    from twin.calibrators.hiera_unet.tower.table import SUBJECT

    folder.mkdir(parents=True, exist_ok=True)
    fleet = Fleet([made_table()])
    sure = Blindness((0.2, 0.1, 0.3), (0.2, 0.1, 0.3), 10)
    members = {}
    for seed in range(count):
        path = folder / f"tower_made_{seed}.safetensors"
        training = MemberTraining("small", replace(TowerPlan(steps=1, batch=2), seed=seed), fleet, fleet, None, "data")
        with torch.no_grad():
            training.trainer.average.output_head.out.bias.add_(biased)
        gate = (
            NOT_TESTED if seed in blind else replace(sure, outputs=(0.0, 0.0, 0.0)) if seed in blind_outputs else sure
        )
        card = training.write(path, gate, {})
        # The made tables hold random channels: a record lies outside of their envelope.
        found = json.loads(card.read_text()) | {"envelope_limit": WIDE}
        card.write_text(json.dumps(found))
        members[path.name] = found["weights"]["sha256"]
    document: dict[str, Any] = {
        "format": FORMAT,
        "subject": "tower",
        "name": "tower_made",
        "table": SUBJECT.digest(),
        "members": members,
        "branches": FACTORS,
    }
    (folder / "tower_made.json").write_text(json.dumps(document))
    return folder / "tower_made.json"
