"""Rows of governance: ramp of the fill, cleaning of nozzles, gates against errors, proposals against inspections."""

from __future__ import annotations

from hil.bench.acceptance.outcome import ONLINE, TRUTH, Outcome, Published, figure, not_measured

GOVERNANCE = "tower_governance"
LOSS, DELAY_D, ALARMS = (12.0, 1.5), 4.6, 1.0
"""Loss of fill and its tolerance %, longest mean delay, and most false alarms a cell-year of row A17."""
RATIO, PRECISION = 2.0, 0.9


def governance_rows(published: Published) -> dict[str, Outcome]:
    """Return the outcomes of A17, A19, of the error of A20, and of A21."""
    figures = {str(r["figure"]): figure(r["value"]) for r in published.rows(GOVERNANCE, "figures")}
    if not figures:
        why = "run hil bench tower-governance --out docs/results"
        return {key: not_measured(why) for key in ("ramp", "cleaning", "withheld error", "proposals")}
    return {
        "ramp": _ramp(figures),
        "cleaning": _cleaning(figures),
        "withheld error": _gates(figures),
        "proposals": _proposals(figures),
    }


def _ramp(f: dict[str, float]) -> Outcome:
    """Return the outcome of A17: every ramp is valued and proposed, none too early, with few alarms where there is
    none."""
    ramps, error = int(f["ramps"]), f["mean absolute error of that loss, % of the clean fill"]
    delay, rate = f["mean delay at 5 %, d"], f["false alarms a cell-year"]
    valued, proposed = int(f["ramps with a proposal at the end"]), int(f["ramps proposed at 5 %"])
    complete = valued == proposed == ramps and f["ramps proposed too early"] == 0.0
    good = complete and error <= LOSS[1] and delay <= DELAY_D and rate <= ALARMS
    of_ramp = LOSS[0] + f["loss of fill at the end, mean, %"] - f["true loss of fill then, mean, %"]
    why = (
        f"mean absolute error {error:.1f} %; {proposed} of {ramps} proposed, {int(f['ramps proposed too early'])} too "
        f"early; {int(f['ramps with a drift alarm'])} with a drift alarm; {rate:.1f} false alarms a cell-year "
        f"in {f['cell-years without a ramp']:.1f}"
    )
    text = f"{of_ramp:.1f} %; {delay:.1f} d"
    return Outcome(text, good, GOVERNANCE, ONLINE, f"{ramps} ramps", why=why)


def _cleaning(f: dict[str, float]) -> Outcome:
    count, seen = int(f["cleanings"]), int(f["cleanings seen within 3 excited windows"])
    why = (
        f"uniformity moves by {f['uniformity moved, median sd']:.1f} sd in the median, another deviation by "
        f"{f['largest other change, sd']:.1f} at most"
    )
    good = seen == count > 0
    return Outcome(f"{seen} of {count}", good, GOVERNANCE, ONLINE, f"{count} cleanings", why=why)


def _gates(f: dict[str, float]) -> Outcome:
    accepted, withheld = f["outlet MAE of accepted windows, K"], f["outlet MAE of withheld windows, K"]
    ratio = withheld / accepted
    why = (
        f"ratio {ratio:.1f}, {f['windows withheld, %']:.1f} % withheld; AUROC for errors above 0.5 K: gates "
        f"{f['AUROC of the gates for these']:.2f}, width of the interval {f['AUROC of the width for these']:.2f}"
    )
    windows = f"{int(f['windows'])} windows"
    return Outcome(f"{accepted:.3f} / {withheld:.3f}", ratio >= RATIO, GOVERNANCE, TRUTH, windows, why=why)


def _proposals(f: dict[str, float]) -> Outcome:
    """Return the outcome of A21: the precision holds for the decided proposals, and for all by the truth alone."""
    confirmed, still, false = (int(f[f"proposals {one}"]) for one in ("confirmed", "open", "false"))
    count, precision = int(f["persistent proposals"]), f["precision of the decided"]
    nearer = int(f["proposals nearer to the truth than the value before"])
    why = f"precision {precision:.2f} of those decided; by the truth alone {nearer} of {count} are nearer to it"
    text = f"{confirmed} / {still} / {false} of {count}"
    good = min(precision, nearer / max(count, 1)) >= PRECISION
    return Outcome(text, good, GOVERNANCE, ONLINE, f"{count} proposals", why=why)
