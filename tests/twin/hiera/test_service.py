"""The network as a calibrator: it moves what the record tells, and withholds the rest with a reason."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")
pytest.importorskip("safetensors", reason="safetensors is not installed: trained networks cannot be read")

from twin.calibrators.hiera_unet.context_fit.evidence import HORIZONS, estimate  # noqa: E402
from twin.calibrators.hiera_unet.data.channels import table  # noqa: E402
from twin.calibrators.hiera_unet.data.features import Features  # noqa: E402
from twin.calibrators.hiera_unet.data.parameters import Deviations  # noqa: E402
from twin.calibrators.hiera_unet.model.config import HieraError  # noqa: E402
from twin.calibrators.hiera_unet.model.network import HieraUNet  # noqa: E402
from twin.calibrators.hiera_unet.serve import gates, service  # noqa: E402
from twin.calibrators.hiera_unet.serve.members import Ensemble, load_ensemble  # noqa: E402
from twin.calibrators.hiera_unet.serve.proposal import Proposal  # noqa: E402
from twin.calibrators.hiera_unet.serve.refined import RefinedCalibrator  # noqa: E402
from twin.calibrators.hiera_unet.serve.service import HieraUNetCalibrator  # noqa: E402
from twin.calibrators.hiera_unet.weights.binding import config_for, identity_of  # noqa: E402
from twin.calibrators.hiera_unet.weights.checkpoint import Member, load, save  # noqa: E402
from twin.calibrators.hiera_unet.weights.envelope import Envelope  # noqa: E402
from twin.calibrators.least_squares import LeastSquares  # noqa: E402
from twin.kernel import simulate  # noqa: E402
from twin.tracking import TwinTracker  # noqa: E402
from twin.twinfile import load as load_twin  # noqa: E402

LOOP = load_twin(Path(__file__).resolve().parents[3] / "profiles" / "twins" / "loop.toml")
DEVIATIONS = Deviations.of(LOOP)
TABLE = table(LOOP)
IDENTITY = identity_of(LOOP, TABLE, DEVIATIONS)
HOURS = 1.2


def untrained(seed: int = 0) -> Member:
    """Says what the evidence says, and that it is sure of it."""
    torch.manual_seed(seed)
    net = HieraUNet(config_for("small", LOOP, TABLE, DEVIATIONS)).eval()
    with torch.no_grad():
        net.parameter_head.out.bias[len(DEVIATIONS) : 2 * len(DEVIATIONS)] = -8.0
    width = 2 * net.config.channels
    return Member(net, IDENTITY, Envelope(np.zeros(width), np.eye(width), 1e6), {"leakage": 0.0, "seed": seed})


def ensemble_card(folder: Path, **other: Any) -> Path:
    for seed in (0, 1):
        save(replace(untrained(seed), card={"leakage": 0.0, **other}), folder / f"loop_small_{seed}.safetensors")
    names = {f"loop_small_{s}.safetensors" for s in (0, 1)}
    factors = {"confidence": 0.9, "overall": [2.0] * 4, "binned": {}, "counts": {}, "method": "split conformal"}
    document = {
        "format": 2,
        "name": "loop_small",
        "members": {n: load(folder / n).card["weights"]["sha256"] for n in sorted(names)},
        "modes": {"online": {"outputs": factors, "parameters": None}},
    }
    card = folder / "loop_small.json"
    card.write_text(json.dumps(document))
    return card


@pytest.fixture(scope="module")
def ensemble(tmp_path_factory: pytest.TempPathFactory) -> Ensemble:
    return load_ensemble(ensemble_card(tmp_path_factory.mktemp("trained")), IDENTITY)


def record(change: dict[str, float], hours: float = HOURS, seed: int = 0) -> tuple[Any, Any, Any]:
    """The loop, excited, with values that changed before the record began."""
    rng = np.random.default_rng(seed)
    n = int(hours * 3600)
    t = np.arange(n, dtype=np.float64)
    level = lambda low, high, every: np.repeat(rng.uniform(low, high, n // every + 1), every)[:n]  # noqa: E731
    u = np.column_stack([level(400, 900, 700), level(60, 100, 1100), level(30, 90, 900), np.full(n, 22.0)])
    clean = simulate(LOOP.with_values(change), t, u, np.array([35.0, 32.0, 29.0, 30.0]))
    return t, u, clean + 0.05 * rng.standard_normal(clean.shape)


def calibrator(ensemble: Ensemble) -> HieraUNetCalibrator:
    return HieraUNetCalibrator(LOOP, ensemble, Features(LOOP, TABLE, DEVIATIONS))


def tracked(ensemble: Ensemble, hours: float = HOURS) -> Any:
    tracker = TwinTracker(LOOP, calibrator(ensemble))
    return tracker, tracker.push(*record(CHANGE, hours)).calibrations


CHANGE = {"fins.UA_100": 45.0, "tank_loss.hA": 8.0}


def test_a_change_is_followed_and_what_cannot_be_told_is_held_with_its_code(ensemble: Ensemble) -> None:
    tracker, done = tracked(ensemble, hours=2.2)
    assert all("SHORT_RECORD" in c.flags[0] and len(c.frozen) == 9 for c in done[:2])
    last = done[-1]
    assert abs(last.values["fins.UA_100"] - 45.0) < 2.0
    assert abs(last.values["tank_loss.hA"] - 8.0) < 1.5
    assert "heater_to_modules.resistance" in last.frozen
    assert any(
        f.startswith("LOW_SENSITIVITY: the record does not tell heater_to_modules.resistance") for f in last.flags
    )
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


def fouling(onset: int, hours: float = HOURS) -> tuple[Any, Any, Any]:
    """The loop as commissioned, and with a fouled radiator from second `onset` on."""
    t, u, _ = record({}, hours)
    start = np.array([35.0, 32.0, 29.0, 30.0])
    before = simulate(LOOP, t[: onset + 1], u[: onset + 1], start)
    after = simulate(LOOP.with_values({"fins.UA_100": 45.0}), t[onset:], u[onset:], before[-1])
    clean = np.vstack([before[:-1], after])
    return t, u, clean + 0.05 * np.random.default_rng(0).standard_normal(clean.shape)


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


def refined(ensemble: Ensemble) -> TwinTracker:
    return TwinTracker(LOOP, RefinedCalibrator(LOOP, calibrator(ensemble)))


@pytest.fixture(scope="module")
def fouled(ensemble: Ensemble) -> tuple[Any, Any]:
    """Calibrations of least squares alone, and led by the network, where the radiator fouls at 3,330 s."""
    whole = fouling(3330)
    both = TwinTracker(LOOP, "least_squares"), refined(ensemble)
    return both[0].push(*whole).calibrations, both[1].push(*whole).calibrations


def test_a_change_inside_a_window_is_followed_before_the_next_where_least_squares_alone_lags(
    fouled: tuple[Any, Any],
) -> None:
    alone, led = fouled
    assert led[5].flags[-1] == "led by the network"
    assert alone[6].error_before_K > 0.1 > led[6].error_before_K
    assert abs(led[5].values["fins.UA_100"] - 45.0) < 3.0 < abs(alone[5].values["fins.UA_100"] - 45.0)
    assert led[5].error_K < alone[5].error_K


def test_a_change_early_in_a_window_is_followed_from_its_middle_on(ensemble: Ensemble) -> None:
    """What least squares alone makes of the window at its end, where nothing is far better, is the answer still."""
    t, u, y = fouling(3030)
    alone, led = (tracker.push(t, u, y) for tracker in (TwinTracker(LOOP, "least_squares"), refined(ensemble)))
    late = (t > 3300.0) & (t < 3600.0)
    missed, less = (np.sqrt(np.mean((update.tracked - y)[late] ** 2)) for update in (alone, led))
    assert missed > 0.1 > less  # noise of 0.05 K included
    assert np.array_equal(led.tracked[t < 3300.0], alone.tracked[t < 3300.0]) and not led.proposals
    assert all(c.flags[-1].startswith("on its own") for c in led.calibrations[:5])


def test_where_the_network_does_not_lead_least_squares_answers_as_if_it_were_alone(fouled: tuple[Any, Any]) -> None:
    """To the last bit, before a change and, once both have seen it, nearly so after it."""
    alone, led = fouled
    for first, second in zip(alone[:5], led[:5], strict=True):
        assert second.flags[-1].startswith("on its own") and second.values == pytest.approx(first.values, rel=1e-9)
        assert np.allclose(second.fitted, first.fitted, atol=1e-6)
    assert led[6].flags[-1].startswith("on its own")
    assert led[6].values == pytest.approx(alone[6].values, rel=1e-6)


def test_least_squares_and_network_go_on_from_their_saved_state(ensemble: Ensemble, fouled: tuple[Any, Any]) -> None:
    t, u, y = fouling(3330)
    first, second = (refined(ensemble) for _ in range(2))
    expected = fouled[1][-1]
    first.push(t[:3500], u[:3500], y[:3500])
    second.restore(json.loads(json.dumps(first.state())))
    found = second.push(t[3500:], u[3500:], y[3500:]).calibrations[-1]
    assert found.values == expected.values and found.flags == expected.flags


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


def test_an_ensemble_of_something_else_is_refused(tmp_path: Path) -> None:
    with pytest.raises(HieraError, match="no trained network"):
        load_ensemble(tmp_path / "none.json", IDENTITY)
    card = ensemble_card(tmp_path)
    with pytest.raises(HieraError, match="another channel table"):
        load_ensemble(card, replace(IDENTITY, table="other"))
    save(untrained(7), tmp_path / "loop_small_0.safetensors")
    with pytest.raises(HieraError, match="not the one that"):
        load_ensemble(card, IDENTITY)
    with pytest.raises(HieraError, match="hang on a record's last moments"):
        load_ensemble(ensemble_card(tmp_path, leakage=0.2), IDENTITY)


def changed(card: Path, **other: Any) -> Path:
    """A card of the same members with something else on it."""
    document = json.loads(card.read_text())
    own = card.with_name("changed.json")
    own.write_text(json.dumps(document | other))
    return own


@pytest.mark.parametrize(
    ("outputs", "parameters", "words"),
    [
        ({"overall": [2.0]}, None, r"factors 2.0 for outputs, not a positive one for each of T_heater"),
        ({"overall": [2.0, 2.0, 2.0, float("nan")]}, None, r"nan for outputs, not a positive one"),
        ({"overall": ["a"] * 4}, None, "cannot be read"),
        ({"binned": {"7": [2.0, 2.0]}}, None, r"factors 2.0, 2.0 for outputs in bin 7"),
        ({}, {"overall": [1.0, 2.0]}, r"factors 1.0, 2.0 for parameters, not a positive one for all parameters"),
        ({}, {"overall": [1.0], "binned": {"3": [-1.0]}}, r"factors -1.0 for parameters in bin 3, not a positive one"),
        ({}, [None] * 9, "cannot be read"),
    ],
)
def test_a_card_has_a_factor_for_each_output_and_one_for_parameters(
    tmp_path: Path, outputs: dict[str, Any], parameters: Any, words: str
) -> None:
    card = ensemble_card(tmp_path)
    usual = json.loads(card.read_text())["modes"]["online"]["outputs"]
    own, parameters = usual | outputs, usual | parameters if isinstance(parameters, dict) else parameters
    with pytest.raises(HieraError, match=words) as caught:
        load_ensemble(changed(card, modes={"online": {"outputs": own, "parameters": parameters}}), IDENTITY)
    assert "changed.json" in str(caught.value) and "hil train loop" in str(caught.value)


def test_a_card_of_another_format_or_of_too_few_or_unlike_members_is_refused(tmp_path: Path) -> None:
    card = ensemble_card(tmp_path)
    with pytest.raises(HieraError, match=r"format 99, not 2; have `hil train loop` write it again"):
        load_ensemble(changed(card, format=99), IDENTITY)
    with pytest.raises(HieraError, match="cannot be read"):
        load_ensemble(changed(card, members=3), IDENTITY)
    members = json.loads(card.read_text())["members"]
    for count, said in ((1, "1 trained member, and"), (0, "0 trained members, and")):
        with pytest.raises(HieraError, match=f"names {said} an ensemble has at least 2; train more"):
            load_ensemble(changed(card, members=dict(list(members.items())[:count])), IDENTITY)
    width = 2 * untrained().network.config.channels
    other = HieraUNet(replace(config_for("small", LOOP, TABLE, DEVIATIONS), name="full"))
    hull = Envelope(np.zeros(width), np.eye(width), 1e6)
    save(Member(other, IDENTITY, hull, {"leakage": 0.0}), tmp_path / "loop_small_1.safetensors")
    sha = load(tmp_path / "loop_small_1.safetensors").card["weights"]["sha256"]
    with pytest.raises(HieraError, match=r"two configurations, 'small' and, in loop_small_1.safetensors, 'full'"):
        load_ensemble(changed(card, members=members | {"loop_small_1.safetensors": sha}), IDENTITY)


def open_gates() -> gates.Evidently:
    rng = np.random.default_rng(0)
    return gates.Evidently(
        hidden=0.1,
        steps=1440,
        measured=rng.normal(size=(120, 2)),
        noise=np.ones(2),
        condition=30.0,
        told=np.array([True, True]),
        half_width=np.array([0.1, 0.2]),
        missed=np.array([0.1, np.nan]),
        left=np.array([0.02, np.nan]),
        tolerated=0.1,
        lost=(),
        sd=np.array([0.1, 0.1]),
        prior=np.array([0.4, 0.4]),
        distance=0.5,
        leakage=0.0,
    )


def warming(steps: int, *jumps: float) -> Any:
    """Thermometers (n, 2) that rise, and jump by so much in the middle."""
    return np.arange(float(steps))[:, None] / 20.0 + np.repeat([[0.0, 0.0], jumps], steps // 2, axis=0)


@pytest.mark.parametrize(
    ("other", "code", "held"),
    [
        ({}, "", [False, False]),
        ({"hidden": 0.3}, "MISSING_REQUIRED", [True, True]),
        ({"steps": 100}, "SHORT_RECORD", [True, True]),
        ({"told": np.array([False, False])}, "LOW_SENSITIVITY", [True, True]),
        ({"told": np.array([True, False])}, "LOW_SENSITIVITY", [False, True]),
        ({"half_width": np.array([0.1, 0.9])}, "HIGH_UNCERTAINTY", [True, True]),
        ({"sd": np.array([0.3, 0.1])}, "HIGH_UNCERTAINTY", [True, False]),
        ({"distance": 1.2}, "OUT_OF_ENVELOPE", [True, True]),
        ({"missed": np.array([0.5, np.nan]), "left": np.array([0.2, 0.0])}, "CONTRADICTORY_EVENT", [True, True]),
        ({"missed": np.array([0.5, np.nan])}, "", [False, False]),
        ({"missed": np.full(2, 0.09), "half_width": np.full(2, 0.01), "left": np.full(2, 0.2)}, "", [False, False]),
        ({"leakage": 0.1}, "LEAKAGE", [True, True]),
        ({"lost": ("T_ambient_C",)}, "LOST_INPUT", [True, True]),
        ({"measured": warming(500, 25.0, 25.0)}, "SHUFFLED_RECORD", [True, True]),
        ({"measured": warming(120, 0.0, 20.0)}, "", [False, False]),
    ],
)
def test_each_gate_closes_for_its_own_reason(other: dict[str, Any], code: str, held: list[bool]) -> None:
    found = gates.reasons(replace(open_gates(), **other), ("a", "b"))
    assert {r.code for r in found} == ({code} if code else set())
    assert gates.held(found, ("a", "b")).tolist() == held


def test_a_record_that_is_a_little_too_short_is_said_to_be_so() -> None:
    (reason,) = gates.reasons(replace(open_gates(), steps=354), ("a", "b"))
    assert reason.sentence == "29.5 minutes of record have been seen, fewer than 30"


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


def lying(hours: float = 2.4, since_s: float = 6000.0) -> tuple[Any, Any, Any, Any]:
    """A healthy record in which the tank's thermometer reads 0.6 K more from a moment on; what it ought to read."""
    t, u, y = record({}, hours)
    true = y.copy()
    y[t >= since_s, TANK] += 0.6
    return t, u, y, true


TANK = LOOP.sensor_names.index("T_tank_C")


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


def test_least_squares_after_the_network_leaves_aside_what_the_network_does(ensemble: Ensemble) -> None:
    t, u, y, true = lying()
    done = TwinTracker(LOOP, RefinedCalibrator(LOOP, calibrator(ensemble))).push(t, u, y)
    assert np.abs((done.tracked - true)[t >= 6000.0 + 1200.0, TANK]).mean() < 0.12
    last = done.calibrations[-1].flags
    assert [f[:24] for f in last if "SENSOR" in f] == ["DOUBTED_SENSOR: T_tank_C"], last


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
