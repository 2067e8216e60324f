"""Rows of the outlet, from published results."""

from __future__ import annotations

from hil.bench.acceptance.outcome import HIDDEN, TRUTH, Outcome, Published, figure, not_measured
from hil.bench.measure import Cell

NETWORK, TOWER, RIVALS = "tower_network", "tower", "tower_rivals"
ENSEMBLE, BOOSTED = "network, ensemble", "the same, boosted"
NEVER_TRAINED = "not trained on these windows"
NO_ABLATION = "no ablation of the tower's network; those of the loop are in hiera_ablations"
TRAINED = {"bilstm": "BiLSTM", "unet": "temporal U-Net", "transformer": "flat transformer", "tcn": "TCN"}
"""Methods of the rivals' page by key."""
LEAST_SEEDS = 3
START = "the outlet is that of boosted trees, since the gate refused the members' outputs"


def outlet_rows(published: Published) -> dict[str, Outcome]:
    """Return the outcomes of A1 to A8 and A13 that published results have."""
    found = {key: not_measured(NEVER_TRAINED) for key in TRAINED} | {"ablations": not_measured(NO_ABLATION)}
    found |= _rivals(published) | _on_stations(published)
    found |= _on_one_station(published)
    return found


def _rivals(published: Published) -> dict[str, Outcome]:
    """Return the outcomes of the rivals and of the ablations; the gate asks that they are measured, or for a sign."""
    by_method = {str(row["method"]): row for row in published.rows(RIVALS, "outlet")}
    found: dict[str, Outcome] = {}
    for key, method in TRAINED.items():
        if one := by_method.get(method):
            mae, seeds, change = (figure(one[name]) for name in ("MAE K", "seeds", "change %"))
            found[key] = Outcome(
                f"{mae:.3f}",
                seeds >= LEAST_SEEDS,
                RIVALS,
                TRUTH,
                f"{seeds:.0f} seeds",
                f"{figure(one['95 % from']):+.1f} to {figure(one['to']):+.1f} %",
                f"against Gauss-Newton there {change:+.1f} %, with that interval",
            )
    parts = published.rows(RIVALS, "parts")
    if parts:
        found["ablations"] = _ablations(parts)
    return found


def _ablations(parts: list[dict[str, Cell]]) -> Outcome:
    """Return the outcome of A13: each part helps for sure, by the weights of the last step, with three seeds."""
    changes = [figure(one["last step: change %"]) for one in parts]
    helps = [str(one["part left out"]) for one in parts if figure(one["95 % from"]) > 0.0]
    seeds = min(figure(one["seeds"]) for one in parts)
    return Outcome(
        ", ".join(f"{one['part left out']} {change:+.1f} %" for one, change in zip(parts, changes, strict=True)),
        len(helps) == len(parts) and seeds >= LEAST_SEEDS,
        RIVALS,
        TRUTH,
        f"{seeds:.0f} seeds",
        "; ".join(f"{figure(one['95 % from']):+.1f} to {figure(one['to']):+.1f} %" for one in parts),
        f"change of the error without the part; {len(helps)} of {len(parts)} help beyond the interval",
    )


def _on_stations(published: Published) -> dict[str, Outcome]:
    """Return the outcomes on the test stations of the network."""
    by_method = {str(r["method"]): r for r in published.rows(NETWORK, "outlet_all")}
    cells = published.rows(NETWORK, "cells")
    seeds = f"{len(cells)} cells, {len({str(c['cell']).split('_')[0] for c in cells})} stations"
    found: dict[str, Outcome] = {}
    if plain := by_method.get("commissioned"):
        mae = figure(plain["MAE K"])
        found["commissioned"] = Outcome(
            f"{mae:.3f} / {figure(plain['RMSE K']):.3f}",
            1.0 <= mae <= 1.4,
            NETWORK,
            TRUTH,
            seeds,
            why="" if 1.0 <= mae <= 1.4 else "our stations leave their commissioned twins less than the paper's do",
        )
    for key, method in (("newton", "Gauss-Newton with discrepancy"), ("persistence", "persistence of the last error")):
        if one := by_method.get(method):
            found[key] = Outcome(f"{figure(one['MAE K']):.3f}", True, NETWORK, TRUTH, seeds)
    if ours := by_method.get(ENSEMBLE):
        hidden, mae, rmse = (figure(ours[name]) for name in ("readings MAE K", "MAE K", "RMSE K"))
        found["network"] = Outcome(
            f"{mae:.3f} / {rmse:.3f}; readings {hidden:.3f}", hidden <= 0.24, NETWORK, TRUTH, seeds, why=START
        )
        found["approach"] = Outcome(
            f"{mae:.3f}", mae <= 0.27, NETWORK, TRUTH, seeds, why="derived: the outlet's error at a measured wet bulb"
        )
        found["quantiles"] = Outcome(
            f"{figure(ours['p90 K']):.3f} / {figure(ours['p99 K']):.3f}", True, NETWORK, TRUTH, seeds
        )
    if gain := published.row(NETWORK, "goals", goal="outlet"):
        change, low, high = (figure(gain[name]) for name in ("change", "95 % from", "to"))
        found["network gain"] = Outcome(
            f"{100.0 * change:+.1f} %",
            change <= -0.10 and high < 0.0,
            NETWORK,
            TRUTH,
            seeds,
            f"{100.0 * low:+.1f} to {100.0 * high:+.1f} %",
            START,
        )
    if cells:
        errors = [figure(one[ENSEMBLE]) for one in cells]
        found["cells"] = Outcome(f"{min(errors):.3f} to {max(errors):.3f}", max(errors) <= 0.35, NETWORK, TRUTH, seeds)
    return found | _other_site(published)


def _other_site(published: Published) -> dict[str, Outcome]:
    site = {str(r["method"]): r for r in published.rows(NETWORK, "outlet_site_B")}
    if not {ENSEMBLE, "commissioned"} <= site.keys():
        return {}
    mae, before = figure(site[ENSEMBLE]["MAE K"]), figure(site["commissioned"]["MAE K"])
    why = f"Miami, which no training saw; its own commissioned twin {before:.3f} K"
    return {"cross outlet": Outcome(f"{mae:.3f}", mae <= 0.29, NETWORK, TRUTH, "2 cells, 1 station", why=why)}


def _on_one_station(published: Published) -> dict[str, Outcome]:
    """Return the outcomes of rivals that were measured on the cells of one station, with one seed."""
    found = {}
    for key, method in (("least squares", "monthly least squares"), ("forest", "random forest")):
        errors = [
            figure(row["MAE K"])
            for cell in ("cell1", "cell2")
            for row in published.rows(TOWER, cell)
            if row["method"] == method
        ]
        if errors:
            found[key] = Outcome(
                " and ".join(f"{e:.3f}" for e in errors),
                False,
                TOWER,
                HIDDEN,
                f"{len(errors)} cells, 1 station",
                why="one seed, and not on the network's windows",
            )
    return found
