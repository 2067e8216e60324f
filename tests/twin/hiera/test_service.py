"""The network as a calibrator: it moves what the record tells, and withholds the rest with a reason."""

from __future__ import annotations

import json
from functools import partial
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")
pytest.importorskip("safetensors", reason="safetensors is not installed: trained networks cannot be read")

from tests.twin.hiera.loop_ensemble import CHANGE, DEVIATIONS, HOURS, LOOP, TANK, calibrator, fouling, lying, record
from twin.calibrators.hiera_unet.context_fit.evidence import HORIZONS, estimate
from twin.calibrators.hiera_unet.serve import gates, service
from twin.calibrators.hiera_unet.serve.members import Ensemble
from twin.calibrators.hiera_unet.serve.proposal import Proposal
from twin.calibrators.hiera_unet.serve.service import HieraUNetCalibrator
from twin.calibrators.least_squares import LeastSquares
from twin.tracking import TwinTracker


def tracked(ensemble: Ensemble, hours: float = HOURS) -> Any:
    tracker = TwinTracker(LOOP, calibrator(ensemble))
    return tracker, tracker.push(*record(CHANGE, hours)).calibrations


def test_a_change_is_followed_and_what_cannot_be_told_is_held_with_its_code(ensemble: Ensemble) -> None:
    tracker, done = tracked(ensemble, hours=2.2)
    assert all("SHORT_RECORD" in c.flags[0] and len(c.frozen) == 9 for c in done[:2])
    last = done[-1]
    assert abs(last.values["fins.UA_100"] - 45.0) < 2.0
    assert abs(last.values["tank_loss.hA"] - 8.0) < 1.5
    assert "heater_to_modules.resistance" in last.frozen
    assert any(f.startswith("LOW_SENSITIVITY: heater_to_modules.resistance is not identifiable") for f in last.flags)
    assert last.values["heater_to_modules.resistance"] == pytest.approx(5.0, rel=1e-3)
    table_of = tracker.table()
    assert all(row["tracked"] < row["static"] for row in table_of.values())


def test_the_twin_takes_on_an_open_proposal_within_the_window_too(
    ensemble: Ensemble, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first that every gate lets through moves nothing; the third, at 2,700 s, lies within a window."""
    monkeypatch.setattr(service, "FAR_OFF", np.inf)
    t, u, y = record(CHANGE)
    tracker = TwinTracker(LOOP, calibrator(ensemble))
    first = tracker.push(t[:2101], u[:2101], y[:2101]).proposals[-1]
    assert set(first["held"].values()) <= {"UNCONFIRMED", "LOW_SENSITIVITY"} and "UNCONFIRMED" in str(first["reasons"])
    assert tracker.values == dict(zip(DEVIATIONS.ids, LOOP.values[DEVIATIONS.index], strict=True))
    tracker.push(t[2101:2700], u[2101:2700], y[2101:2700])
    before = tracker.values
    update = tracker.push(t[2700:2701], u[2700:2701], y[2700:2701])
    (proposal,) = update.proposals
    assert proposal["time_s"] == 2699.0 and not update.calibrations
    moved = {name for name, value in tracker.values.items() if value != before[name]}
    assert moved and moved == set(before) - set(proposal["held"])
    assert all(tracker.values[name] == proposal["values"][name] for name in moved)


def test_a_twin_that_is_far_off_takes_on_what_is_held_too(ensemble: Ensemble, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first proposal that a record is long enough for: nothing bears it out, and some of it nothing tells apart."""
    t, u, y = record(CHANGE)
    end, later, usual = 2101, slice(2101, 2700), service.FAR_OFF

    def after(far_off: float) -> tuple[dict[str, Any], float]:
        monkeypatch.setattr(service, "FAR_OFF", far_off)
        tracker = TwinTracker(LOOP, calibrator(ensemble))
        proposal = tracker.push(t[:end], u[:end], y[:end]).proposals[-1]
        return proposal, float(np.abs(tracker.push(t[later], u[later], y[later]).tracked - y[later]).mean())

    (waits, far), (takes, near) = after(np.inf), after(usual)
    assert not waits["adrift"] and takes["adrift"]
    # What may be said of a parameter is the same; only the live twin does not wait for it.
    assert waits["held"] == takes["held"] and "UNCONFIRMED" in takes["held"].values()
    # Noise alone is 0.04 K.
    assert near < 0.045 < 0.065 < far


def test_a_twin_that_is_right_is_not_adrift(ensemble: Ensemble) -> None:
    proposals = TwinTracker(LOOP, calibrator(ensemble)).push(*record({})).proposals
    assert len(proposals) > 10 and not any(p["adrift"] for p in proposals)


@pytest.fixture(scope="module")
def changed_loop(ensemble: Ensemble) -> tuple[HieraUNetCalibrator, Any]:
    """The calibrator that was given the whole record of a changed loop at once, and the tracker's answer."""
    own = calibrator(ensemble)
    return own, TwinTracker(LOOP, own).push(*record(CHANGE))


def test_it_goes_on_from_its_saved_state(ensemble: Ensemble, changed_loop: tuple[HieraUNetCalibrator, Any]) -> None:
    t, u, y = record(CHANGE)
    first, second = (TwinTracker(LOOP, calibrator(ensemble)) for _ in range(2))
    expected = changed_loop[1].calibrations[-1]
    cut = 3100
    first.push(t[:cut], u[:cut], y[:cut])
    second.restore(json.loads(json.dumps(first.state())))
    found = second.push(t[cut:], u[cut:], y[cut:]).calibrations[-1]
    assert found.values == expected.values and found.flags == expected.flags


def test_what_happened_in_the_last_ten_minutes_is_proposed(ensemble: Ensemble) -> None:
    """The target of a window is hidden from the fit that is evidence, so it has to be one that is still to come."""
    t, u, y = fouling(onset=3600)
    tracker = TwinTracker(LOOP, calibrator(ensemble))
    proposals = tracker.push(t[:4201], u[:4201], y[:4201]).proposals
    before, after = (next(p for p in proposals if p["time_s"] == moment) for moment in (3599.0, 4199.0))
    assert before["values"]["fins.UA_100"] == pytest.approx(60.0, abs=1.0)
    assert after["values"]["fins.UA_100"] == pytest.approx(45.0, abs=2.0)


def test_a_fit_of_the_latest_minutes_alone_hides_nothing(ensemble: Ensemble, monkeypatch: pytest.MonkeyPatch) -> None:
    """The channels of such a fit begin late, as after a change; what the rig delivers is there all along."""
    seen: list[list[float]] = []
    reasons = gates.reasons

    def noted(e: gates.Evidently, ids: tuple[str, ...]) -> tuple[gates.Reason, ...]:
        seen[-1].append(e.hidden)
        return reasons(e, ids)

    monkeypatch.setattr(gates, "reasons", noted)
    for horizons in (HORIZONS, (45,)):
        monkeypatch.setattr(service, "estimate", partial(estimate, horizons=horizons))
        seen.append([])
        TwinTracker(LOOP, calibrator(ensemble)).push(*record({}))
    assert len(seen[0]) > 10 and seen[0] == seen[1]


def test_it_proposes_every_five_minutes_however_the_stream_is_cut(
    ensemble: Ensemble, changed_loop: tuple[HieraUNetCalibrator, Any]
) -> None:
    t, u, y = record(CHANGE)
    own = [changed_loop[0], calibrator(ensemble)]
    update = changed_loop[1]
    spread = update.spread
    pieces = TwinTracker(LOOP, own[1])
    parts = [pieces.push(*(a[first : first + 1111] for a in (t, u, y))) for first in range(0, len(t), 1111)]
    assert list(own[0].records) == list(own[1].records) == [p for part in parts for p in part.proposals]
    assert list(update.proposals) == list(own[0].records)
    assert np.array_equal(update.tracked, np.concatenate([part.tracked for part in parts]))
    times = np.array([r["time_s"] for r in own[0].records])
    assert len(times) == int(HOURS * 12) and np.abs(np.diff(times) - 300.0).max() <= 1.0
    json.dumps(list(own[0].records), allow_nan=False)
    assert spread is not None and np.isnan(spread[:300]).all() and (spread[400:] > 0.0).all()


@pytest.mark.parametrize(
    ("damage", "code"),
    [
        ("flat", "FLAT_RECORD"),
        ("shuffled", "SHUFFLED_RECORD"),
        ("blocks", "SHUFFLED_RECORD"),
        ("hidden", "MISSING_REQUIRED"),
    ],
)
def test_a_record_that_says_nothing_is_refused_with_the_reason(ensemble: Ensemble, damage: str, code: str) -> None:
    t, u, y = record(CHANGE)
    if damage == "flat":
        y[:] = 30.0 + 1.0 / 3.0  # the mean of such readings is not always the reading
    elif damage == "shuffled":
        y = np.random.default_rng(1).permutation(y)
    elif damage == "blocks":
        u, y = (a[: len(a) // 600 * 600].reshape(-1, 600, a.shape[1])[::-1].reshape(-1, a.shape[1]) for a in (u, y))
        t = t[: len(y)]
    else:
        y[600:] = np.where(np.random.default_rng(1).random(y[600:].shape) < 0.02, y[600:], np.nan)
        y[600:, :2] = np.nan
    done = TwinTracker(LOOP, calibrator(ensemble)).push(t, u, y).calibrations
    judged = [c for c in done if c.kind != "skipped"]
    assert judged and any(f.startswith(code) for f in judged[-1].flags)
    assert all(c.values == dict(zip(DEVIATIONS.ids, LOOP.values[DEVIATIONS.index], strict=True)) for c in judged)


def test_an_input_that_is_no_longer_read_holds_every_parameter_and_says_so(ensemble: Ensemble) -> None:
    """The heater goes on as it likes; what a fit makes of that is no parameter."""
    t, u, y = record({})
    u[t >= 1800.0, 0] = np.nan
    done = TwinTracker(LOOP, calibrator(ensemble)).push(t, u, y)
    after = [p for p in done.proposals if p["time_s"] > 1800.0 + 400.0]
    assert not any("LOST_INPUT" in str(p["reasons"]) for p in done.proposals if p["time_s"] < 1800.0)
    assert after and all(p["reasons"][0].startswith("LOST_INPUT") and len(p["held"]) == 9 for p in after)
    assert set(after[0]["held"].values()) == {"LOST_INPUT"} and any(p["adrift"] for p in after)
    assert any(
        f == "LOST_INPUT: heater_power_W was not read, which parameters would only make up for"
        for f in done.calibrations[-1].flags
    )


def test_an_input_that_is_logged_twice_a_minute_is_not_lost(ensemble: Ensemble) -> None:
    t, u, y = record({})
    u[t % 30.0 > 0.0] = np.nan
    proposals = [p for p in TwinTracker(LOOP, calibrator(ensemble)).push(t, u, y).proposals if p["time_s"] > 1800.0]
    assert len(proposals) > 5
    assert not any("LOST_INPUT" in str(p["reasons"]) or "MISSING" in str(p["reasons"]) for p in proposals)


@pytest.fixture(scope="module")
def doubted(ensemble: Ensemble) -> Any:
    """The tracker's answer to the whole record in which the tank's thermometer comes to read too much."""
    return TwinTracker(LOOP, calibrator(ensemble)).push(*lying()[:3])


def test_a_thermometer_that_lies_is_left_aside_and_the_twin_reads_what_it_ought_to(doubted: Any) -> None:
    t, u, y, true = lying()
    done = doubted
    after = t >= 6000.0 + 600.0
    assert np.sqrt(np.mean((done.tracked - true)[after] ** 2)) < 0.08  # noise of 0.05 K included
    told = done.proposals[-1]["doubted"]
    assert [d["sensor"] for d in told] == ["T_tank_C"] and told[0]["off_K"] == pytest.approx(0.6, abs=0.1)
    assert not any(p["doubted"] for p in done.proposals if p["time_s"] < 6000.0)
    last = done.calibrations[-1]
    assert last.kind == "calibrated" and last.error_before_K < 0.08
    assert last.calibrated and any(f.startswith("DOUBTED_SENSOR: T_tank_C has come to read 0.6") for f in last.flags)
    alone = TwinTracker(LOOP, LeastSquares(LOOP)).push(t, u, y)
    assert np.abs((alone.tracked - true)[after, TANK]).mean() > 0.3


def test_what_is_left_aside_is_so_after_going_on_from_a_saved_state(ensemble: Ensemble, doubted: Any) -> None:
    t, u, y, _ = lying()
    cut = 7200
    first, second = (calibrator(ensemble) for _ in range(2))
    until = doubted.proposals
    TwinTracker(LOOP, first).push(t[:cut], u[:cut], y[:cut])
    second.restore(json.loads(json.dumps(first.state())))
    assert second.state() == first.state() and second.state()["doubts"][0]["sensor"] == TANK
    assert until[-1]["doubted"][0]["since_s"] == second.state()["doubts"][0]["since_s"]


def test_the_interval_of_what_is_taken_on_reaches_as_far_as_it_was_moved(ensemble: Ensemble) -> None:
    sd, values, held = np.full(9, 3.0), np.full(9, 14.0), np.arange(9) > 0
    none = np.zeros(9)
    proposal = Proposal(0.0, np.full(9, 10.0), sd, held, held, values, (), none, 1.0, none, 0)
    told = proposal.document(LOOP, DEVIATIONS.ids)
    assert list(told["values"].values()) == [14.0, *[10.0] * 8]
    assert list(told["standard_errors"].values()) == [5.0, *[3.0] * 8]


def test_a_network_is_asked_whether_it_leaks_before_any_gate_opens(ensemble: Ensemble, monkeypatch: Any) -> None:
    monkeypatch.setattr(Ensemble, "leakage", lambda *_: 0.2)
    told = TwinTracker(LOOP, calibrator(ensemble)).push(*record(CHANGE)).proposals
    assert all(p["held"].keys() == p["values"].keys() for p in told)
    assert sum("LEAKAGE" in str(p["reasons"]) for p in told) == len(told) - 6


def test_a_context_that_was_fitted_before_its_target_came_is_not_fitted_again(
    ensemble: Ensemble, monkeypatch: pytest.MonkeyPatch
) -> None:
    fits = 0

    def counted(*args: Any, **options: Any) -> Any:
        nonlocal fits
        fits += 1
        return estimate(*args, **options)

    def proposals() -> list[dict[str, Any]]:
        return list(TwinTracker(LOOP, calibrator(ensemble)).push(*record(CHANGE)).proposals)

    monkeypatch.setattr(service, "estimate", counted)
    kept = proposals()
    fewer, fits = fits, 0
    monkeypatch.setattr(service, "FITS", 0)
    assert proposals() == kept
    assert fewer < 0.7 * fits
