"""Weights, cards and curves of a budgeted training, put where the project ships them.

    python -m hil.training.tower.unpack OUT profiles/trained

OUT holds `results.json` and the members' weights, as `hil.training.tower.budgeted` left them. Weights whose checksum is
not that of their card are refused. The codes of the gate are those of the present rule, from the figures of the cards.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from twin.calibrators.hiera_unet import HieraError

PER_DEVIATION = ("fill", "air", "uniformity", "bias")


def unpack(source: Path, target: Path) -> list[Path]:
    """Copy each member of `source` with its card and a picture of its curves to `target`; return the written files.

    Raises
    ------
    HieraError
        There is no result, weights do not belong to their card, or an ensemble's factors are of other members than
        those that the gate passes.
    """
    path = source / "results.json"
    try:
        results = json.loads(path.read_text())
        cards: Mapping[str, Any] = results["cards"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise HieraError(
            f"{path}: cannot be read as results of a training ({error}); give the folder of one"
        ) from error
    target.mkdir(parents=True, exist_ok=True)
    written = []
    told: dict[str, Any] = {}
    for name, card in judged_cards(cards).items():
        weights = source / f"tower_{name}.safetensors"
        if not weights.is_file():
            continue
        data = weights.read_bytes()
        if hashlib.sha256(data).hexdigest() != card["weights"]["sha256"]:
            raise HieraError(f"{weights}: is not the file that its card in {path} describes; copy it again")
        out = target / weights.name
        out.write_bytes(data)
        out.with_suffix(".json").write_text(json.dumps(card, indent=1) + "\n")
        written += [out, out.with_suffix(".json")]
        told[out.name] = card
        if card.get("curves"):
            title = f"tower {name}: {card['steps_done']} steps, {_said(card)}"
            written.append(draw(card["curves"], out.with_suffix(".png"), title))
    for path in sorted(source.glob("tower_*.json")):
        document = json.loads(path.read_text())
        if "members" in document:
            from twin.calibrators.hiera_unet.tower import ensemble

            document = ensemble.judged_again(document, told)
        (target / path.name).write_text(json.dumps(document, indent=1) + "\n")
        written.append(target / path.name)
    return written


def judged_cards(cards: Mapping[str, Any]) -> dict[str, Any]:
    """Return cards with the codes of their heads by the present rule; one without figures of the gate as it is."""
    if not any("gate" in card for card in cards.values()):
        return dict(cards)
    from twin.calibrators.hiera_unet.tower.predict import judged

    return {name: judged(card) if "gate" in card else card for name, card in cards.items()}


def _said(card: Mapping[str, Any]) -> str:
    heads = card.get("gate", {}).get("heads", {})
    passed = [name for name, code in heads.items() if code == "none"]
    return card["refused"] or f"gate passed {' and '.join(passed) or 'it'}"


def draw(curves: Sequence[Mapping[str, Any]], path: Path, title: str) -> Path:
    """Write a PNG of losses, outlet error and errors of the deviations over Gauss-Newton's, on held-out windows."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 3.6), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    steps = [c["step"] for c in curves]
    for name in ("parameters", "outputs"):
        known = [(c["step"], c[name]) for c in curves if name in c]
        if known:
            left.plot(*zip(*known, strict=True), label=name, linewidth=1)
    left.set(title="training loss, the start's is 1", xlabel="step", ylim=(0, None))
    middle.plot(steps, [c["water_mae_K"] for c in curves], label="network")
    middle.plot(steps, [c["rival_water_mae_K"] for c in curves], color="0.5", label="Gauss-Newton")
    middle.margins(y=0.2)
    middle.set(title="held-out outlet error, K", xlabel="step", ylim=(0, None))
    for name in PER_DEVIATION:
        right.plot(steps, [c[f"{name}_mae"] / c[f"rival_{name}_mae"] for c in curves], label=name, linewidth=1)
    right.axhline(1.0, color="0.5", linewidth=1)
    right.set(title="held-out error over Gauss-Newton's", xlabel="step", ylim=(0, 2))
    for axes in (left, middle, right):
        if axes.lines:
            axes.legend(frameon=False, fontsize=8)
        axes.spines[["top", "right"]].set_visible(False)
    figure.suptitle(title, fontsize=10)
    figure.savefig(path, dpi=110)
    return path


if __name__ == "__main__":
    for one in unpack(Path(sys.argv[1]), Path(sys.argv[2])):
        print(one)
