"""The review holds what the journal holds, whoever dies on the way, and shows it without complaints."""

from __future__ import annotations

import io
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from drivers.signals.points import Quality
from hil.journal.writer import JournalError, JournalReader, JournalWriter
from hil.review import (
    ViewerError,
    follow,
    open_viewer,
    read_columns,
    read_words,
    screenshot,
    start_follower,
    write_review,
)
from hil.review import show as show_module
from hil.review.batches.twin_bands import proposal_text
from hil.review.plan import make_plan
from hil.review.plan.styles import path
from hil.review.viewer import HOST, _free_port, binary, listens, require_complete
from hil.tracking.twins import Proposed
from tests.hil.synthetic_journal import COMMISSIONED, SENSORS, Truth, make, put_ticks, write

TICKS = 2000


@pytest.fixture(scope="module")
def truth() -> Truth:
    return make(TICKS)


@pytest.fixture(scope="module")
def journal(truth: Truth, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("run") / "journal.sqlite"
    write(path, truth)
    return path


@pytest.fixture(scope="module")
def rrd(journal: Path) -> Path:
    path = journal.with_name("review.rrd")
    write_review(journal, path)
    return path


def good(truth: Truth) -> NDArray[np.float64]:
    return np.where(truth.quality == Quality.GOOD, truth.values, np.nan)


def entities(truth: Truth) -> list[str]:
    """Every entity with numbers that a run of `truth` must have."""
    names = [lines.entity for lines in make_plan(truth.header).lines]
    trackers = truth.header.twin_names[1:]
    names += [path("parameters", name, tracker) for name in COMMISSIONED for tracker in trackers]
    names += [path("proposed", name, trackers[-1]) for name in COMMISSIONED]
    return names + [path("relative", tracker, name) for name in COMMISSIONED for tracker in trackers]


def assert_same_review(one: Path, other: Path, truth: Truth) -> None:
    for entity in entities(truth):
        time_a, values_a = read_columns(one, entity)
        time_b, values_b = read_columns(other, entity)
        np.testing.assert_array_equal(time_a, time_b, err_msg=entity)
        np.testing.assert_array_equal(values_a, values_b, err_msg=entity)
    lanes = [lane.entity for lane in make_plan(truth.header).lanes]
    proposer = truth.header.twin_names[-1]
    for entity in [*lanes, "/events", "/writes", path("gates", proposer), path("proposals", proposer)]:
        assert read_words(one, entity) == read_words(other, entity), entity


def test_every_signal_equals_the_journal_sample_for_sample(truth: Truth, rrd: Path) -> None:
    expected = good(truth)
    columns = [signal.column for signal in truth.header.signals]
    where = {column: (path("sensors", name, "measured"), 0) for name, (column, *more) in SENSORS.items() if not more}
    for entity, parts in make_plan(truth.header).columns_of.items():
        where |= {column: (entity, k) for k, column in enumerate(parts)}
    assert set(where) == set(columns)
    for column, (entity, k) in where.items():
        time_s, values = read_columns(rrd, entity)
        np.testing.assert_array_equal(time_s, truth.time_s)
        np.testing.assert_array_equal(values[:, k], expected[:, columns.index(column)], err_msg=column)


def test_bands_and_proposals_equal_the_journal(truth: Truth, journal: Path, rrd: Path) -> None:
    reader = JournalReader(journal)
    bands, proposals = [b for b in reader.bands() if b.twin == "pso"], reader.proposals()
    reader.close()
    time_s, values = read_columns(rrd, "/sensors/T_tank_C/band/pso")
    assert time_s.tolist() == [b.start_s for b in bands]
    assert np.isnan(values[0]).all() and (values[1:] == [0.1, -0.1]).all()
    _, mean = read_columns(rrd, "/sensors/T_tank_C/miss/pso")
    assert mean[:, 0].tolist() == [b.document["mean_K"]["T_tank_C"] for b in bands]
    for name in COMMISSIONED:
        _, proposed = read_columns(rrd, path("proposed", name, "pso"))
        for row, value in zip(proposals, proposed[:, 0], strict=True):
            assert np.isnan(value) if name in row.document["held"] else value == row.document["values"][name]
    assert [state for _, state in read_words(rrd, "/gates/pso")] == ["SHORT_RECORD", "some held"]
    words = [text or "" for _, text in read_words(rrd, "/proposals/pso")]
    assert words[0] == "SHORT_RECORD: withheld: all held"
    assert all(text.startswith("accepts ") and "LOW_SENSITIVITY holds " in text for text in words[1:])


def test_a_proposal_of_a_twin_that_is_far_off_says_so() -> None:
    document = {
        "values": {"fan": 2.0, "loss": 1.0},
        "standard_errors": {"fan": 0.1, "loss": 0.1},
        "held": {"loss": "LOW_SENSITIVITY"},
        "reasons": ["LOW_SENSITIVITY: loss is not identifiable from the record: held"],
    }
    still, adrift = (proposal_text(Proposed("pso", 9.0, {**document, "adrift": far})) for far in (False, True))
    assert "LOW_SENSITIVITY holds loss" in still and "far off" not in still
    assert adrift == f"{still}; the live twin is far off, and accepts held parameters too"
    doubted = {"sensor": "T_tank_C", "since_s": 3.0, "off_K": -0.48}
    aside = proposal_text(Proposed("pso", 9.0, {**document, "doubted": [doubted]}))
    assert aside == f"{still}; T_tank_C is excluded: 0.48 K less"


def test_stamps_are_kept_to_the_nanosecond(tmp_path: Path) -> None:
    truth = make(50, period_s=0.1)
    write(tmp_path / "journal.sqlite", truth)
    write_review(tmp_path / "journal.sqlite", tmp_path / "review.rrd")
    time_s, _ = read_columns(tmp_path / "review.rrd", "/sensors/T_tank_C/measured")
    np.testing.assert_array_equal(np.rint(time_s * 1e9), np.rint(truth.time_s * 1e9))


def test_twins_and_residuals_equal_the_journal(truth: Truth, rrd: Path) -> None:
    expected = good(truth)
    columns = [signal.column for signal in truth.header.signals]
    for k, (sensor, parts) in enumerate(SENSORS.items()):
        table = expected[:, [columns.index(column) for column in parts]]
        present = np.isfinite(table).any(axis=1)
        mean = np.full(TICKS, np.nan)
        mean[present] = np.nanmean(table[present], axis=1)
        noise_K = truth.header.noise_K[sensor]
        residual_s, residual = read_columns(rrd, path("sensors", sensor, "residual"))
        np.testing.assert_array_equal(residual_s, truth.time_s)
        assert residual.shape[1] == len(truth.twins)
        for twin, output, own in zip(truth.twins, truth.twins.values(), residual.T, strict=True):
            time_s, values = read_columns(rrd, path("sensors", sensor, "twin", twin))
            assert (time_s[0], time_s[-1]) == (truth.time_s[0], truth.time_s[-1])
            drawn = np.interp(truth.time_s, time_s, values[:, 0])
            np.testing.assert_allclose(drawn, output[:, k], rtol=0, atol=noise_K / 19.0)
            np.testing.assert_allclose(own, mean - output[:, k], rtol=0, atol=noise_K / 15.0)


def test_calibrations_equal_the_journal(journal: Path, truth: Truth, rrd: Path) -> None:
    reader = JournalReader(journal)
    windows = [row for row in reader.calibrations() if row.calibrator == "pso"]
    reader.close()
    assert len(windows) > 10
    for name, (commissioned, _) in COMMISSIONED.items():
        time_s, values = read_columns(rrd, path("parameters", name, "pso"))
        np.testing.assert_array_equal(time_s, [row.end_s for row in windows])
        np.testing.assert_array_equal(values[:, 0], [row.document["parameters"][name] for row in windows])
        _, relative = read_columns(rrd, path("relative", "pso", name))
        np.testing.assert_allclose(relative[:, 0], (values[:, 0] / commissioned - 1) * 100, atol=1e-9)
    kinds = read_words(rrd, "/windows/pso")
    assert [kind for _, kind in kinds][:4] == ["recovery", "calibrated", "stall", "calibrated"]
    assert kinds[2][0] == windows[11].start_s
    assert {flag for _, flag in read_words(rrd, "/calibrated/pso")} == {"calibrated", "not calibrated"}


def test_what_is_not_good_is_a_gap_and_a_state(truth: Truth, rrd: Path) -> None:
    columns = [signal.column for signal in truth.header.signals]
    _, plates = read_columns(rrd, "/sensors/T_modules_C/columns")
    bad = truth.quality[:, columns.index("T_pm3_C")] != Quality.GOOD
    assert np.isnan(plates[bad, 2]).all()
    assert np.isfinite(plates[~bad, 2]).all()
    lane = read_words(rrd, "/quality/T_pm3_C")
    assert lane == [(0.0, "good"), (600.0, "sensor fault"), (720.0, "good"), (1600.0, "link fault"), (1620.0, "good")]
    worst = [state for _, state in read_words(rrd, "/quality")]
    assert worst[:4] == ["good", "T_pm3_C: sensor fault", "good", "T_tank_C: stale"]
    assert "17 signals: link fault" in worst


def test_events_and_unusual_writes_are_told(rrd: Path) -> None:
    events = read_words(rrd, "/events")
    assert events[0][1] == "run started: battle_40h on the virtual rig"
    assert len(events) == 4
    assert [text for _, text in read_words(rrd, "/writes")] == ["heater_power_set = 0 (safe: CAN link lost)"]


def test_a_file_written_live_equals_one_written_afterwards(tmp_path: Path, truth: Truth, rrd: Path) -> None:
    live = tmp_path / "live.sqlite"
    thread = threading.Thread(
        target=write, args=(live, truth), kwargs={"block": 100, "after_block": lambda tick: time.sleep(0.02)}
    )
    thread.start()
    follow(live, rrd=tmp_path / "live.rrd", viewer=None, stop=lambda: False, poll_s=0.01)
    thread.join()
    late = tmp_path / "late.rrd"
    write_review(live, late)
    assert_same_review(tmp_path / "live.rrd", late, truth)
    time_s, values = read_columns(late, "/sensors/T_tank_C/measured")
    np.testing.assert_array_equal(values, read_columns(rrd, "/sensors/T_tank_C/measured")[1])
    np.testing.assert_array_equal(time_s, truth.time_s)


@pytest.fixture
def proxy() -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    """Takes a recording like a viewer does, and needs no graphics."""
    port = _free_port()
    process = subprocess.Popen(
        [binary(), "--serve-grpc", "--bind", HOST, "--port", str(port)],
        env={"CI": "true"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    deadline = time.monotonic() + 20.0
    while not listens(port):
        assert time.monotonic() < deadline, "the gRPC server did not start"
        time.sleep(0.02)
    yield process, port
    process.kill()
    process.wait()


def test_a_viewer_that_dies_leaves_the_file_complete(
    tmp_path: Path,
    truth: Truth,
    rrd: Path,
    proxy: tuple[subprocess.Popen[bytes], int],
    caplog: pytest.LogCaptureFixture,
) -> None:
    process, port = proxy
    live = tmp_path / "journal.sqlite"
    killed = threading.Event()
    passes = 0

    def after_block(tick: int) -> None:
        if tick == TICKS // 2:
            assert killed.wait(30.0)

    def stop() -> bool:
        nonlocal passes
        passes += 1
        if passes == 4:
            process.kill()
            process.wait()
            killed.set()
        return False

    thread = threading.Thread(target=write, args=(live, truth), kwargs={"after_block": after_block})
    thread.start()
    follow(live, rrd=tmp_path / "review.rrd", viewer=f"rerun+http://{HOST}:{port}/proxy", stop=stop, poll_s=0.01)
    thread.join()
    assert "the viewer is gone" in caplog.text
    assert_same_review(tmp_path / "review.rrd", rrd, truth)


def test_no_viewer_at_the_url_is_no_delay(tmp_path: Path, journal: Path) -> None:
    began = time.monotonic()
    url = f"rerun+http://{HOST}:{_free_port()}/proxy"
    follow(journal, rrd=tmp_path / "review.rrd", viewer=url, stop=lambda: False)
    assert time.monotonic() - began < 4.0
    assert (tmp_path / "review.rrd").is_file()


def test_sigterm_leaves_a_valid_file_with_all_that_was_committed(tmp_path: Path, truth: Truth) -> None:
    journal, rrd = tmp_path / "journal.sqlite", tmp_path / "review.rrd"
    writer = JournalWriter(journal, truth.header)
    put_ticks(writer, truth, 0, 500)
    writer.commit()
    process = subprocess.Popen([sys.executable, "-m", "hil.review", "follow", str(journal), "--rrd", str(rrd)])
    deadline = time.monotonic() + 30.0
    while not list(tmp_path.glob(".*part")):
        assert time.monotonic() < deadline, "the follower did not start"
        time.sleep(0.02)
    put_ticks(writer, truth, 500, 700)
    writer.commit()
    process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=30) == 0
    writer.close()
    verified = subprocess.run([binary(), "rrd", "verify", rrd], env={"CI": "true"}, capture_output=True, check=False)
    assert verified.returncode == 0, verified.stderr
    time_s, _ = read_columns(rrd, "/sensors/T_tank_C/measured")
    np.testing.assert_array_equal(time_s, truth.time_s[:700])
    assert list(tmp_path.glob(".*part")) == []


def test_a_follower_without_a_viewer_still_writes_the_file(
    tmp_path: Path, truth: Truth, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_viewer() -> None:
        raise ViewerError("no display")

    monkeypatch.setattr(show_module, "open_viewer", no_viewer)
    journal, rrd = tmp_path / "journal.sqlite", tmp_path / "review.rrd"
    write(journal, truth)
    follower = start_follower(journal, rrd)
    assert follower.finish()
    assert follower.viewer is None
    assert len(read_columns(rrd, "/status")[0]) == TICKS


def test_a_follower_that_fails_leaves_no_file_and_says_so_to_its_caller_alone(
    tmp_path: Path, truth: Truth, capfd: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "journal.sqlite", truth)
    follower = start_follower(tmp_path / "journal.sqlite", tmp_path / "moved" / "review.rrd", show=False)
    assert not follower.finish()
    assert [path.name for path in tmp_path.iterdir()] == ["journal.sqlite"]
    assert capfd.readouterr().err == ""


def test_a_file_that_rerun_could_not_write_in_full_is_no_review(tmp_path: Path, truth: Truth) -> None:
    """As on a full disk, of which Rerun says nothing."""
    write(tmp_path / "journal.sqlite", truth)
    rrd = tmp_path / "review.rrd"
    write_review(tmp_path / "journal.sqlite", rrd)
    require_complete(rrd)
    whole = rrd.read_bytes()
    for damaged in (whole[: len(whole) // 2], whole[:2000] + whole[6000:]):
        rrd.write_bytes(damaged)
        with pytest.raises(OSError, match="make room"):
            require_complete(rrd)


def test_a_missing_journal_is_one_sentence_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(JournalError, match="does not exist"):
        write_review(tmp_path / "journal.sqlite", tmp_path / "review.rrd")
    assert list(tmp_path.iterdir()) == []


def test_headless_picture_shows_curves_and_no_view_complains(tmp_path: Path, rrd: Path) -> None:
    try:
        complaints = screenshot(rrd, tmp_path / "review.png", timeout_s=60.0)
    except ViewerError as error:
        pytest.skip(str(error))
    assert complaints == []
    pixels = np.asarray(Image.open(io.BytesIO((tmp_path / "review.png").read_bytes())).convert("RGB")).astype(int)
    assert pixels.shape == (1000, 1600, 3)
    orange = (np.abs(pixels - (245, 140, 30)) < 25).all(axis=2)
    blue = (np.abs(pixels - (45, 150, 255)) < 25).all(axis=2)
    assert orange.sum() > 1000
    assert blue.sum() > 500


@pytest.mark.skipif(sys.platform != "linux", reason="reads the kernel's table of sockets")
def test_a_viewer_listens_on_the_loopback_interface_only() -> None:
    try:
        viewer = open_viewer(headless=True)
    except ViewerError as error:
        pytest.skip(str(error))
    try:
        sockets = [
            line.split()[1]
            for table in ("/proc/net/tcp", "/proc/net/tcp6")
            for line in Path(table).read_text().splitlines()[1:]
            if line.split()[3] == "0A"
        ]
        assert [address for address in sockets if int(address.rpartition(":")[2], 16) == viewer.port] == [
            f"0100007F:{viewer.port:04X}"
        ]
    finally:
        viewer.close()


def test_the_harness_does_not_load_rerun_by_itself() -> None:
    code = "import sys, hil, hil.cli; sys.exit('rerun' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
