"""`hil bench sinks`: followers of a live run at 10 Hz, viewers of its panel and exports, each in a small size."""

from __future__ import annotations

import re

import pytest

from hil.bench import sinks
from hil.bench.commands import output

for _library in ("asyncua", "starlette", "uvicorn"):
    pytest.importorskip(_library, reason=f"{_library} is not installed")


@pytest.mark.slow
def test_every_follower_viewer_and_format_is_measured(monkeypatch):
    monkeypatch.setattr(sinks, "SETTLES_S", 3.0)
    notes: list[str] = []
    size = sinks.SinksSize(rounds=1, segment_s=2.0, hours=0.2)
    (followers, viewers, exports), skipped = sinks.measure(size, (), lambda share, note: notes.append(note))
    assert [row[0] for row in followers.rows] == ["OPC UA", "alarms", "panel, one viewer"]
    for row in followers.rows:
        assert 0.1 < row[1] < 50.0 and row[7] > 0.0, "processor time of a tick, and of the follower"
    assert [row[0] for row in viewers.rows] == [0, 1, sinks.VIEWERS]
    for _, states, share in viewers.rows[1:]:
        assert states == pytest.approx(1.0, abs=0.5) and share > 0.0, "a state a second for each viewer"
    written = {row[0] for row in exports.rows}
    assert {"csv", "parquet"} <= written and all(row[3] > 0.0 for row in exports.rows)
    assert written | {re.split("[ :]", line)[2] for line in skipped} == set(sinks.FORMATS)
    assert not any("Goal" in note for note in exports.notes), "a short run says nothing on forty hours"
    assert notes


def test_a_follower_that_does_not_start_is_named_with_its_last_line(tmp_path):
    with sinks._started(tmp_path, "stream", tmp_path, "--to", "kafka://x") as process:
        process.wait(60)
        with pytest.raises(RuntimeError, match="it said: hil: kafka:// is no store that is known"):
            sinks._require(process, tmp_path)


def test_a_page_names_no_password_of_a_store(monkeypatch):
    words = [
        "hil",
        "bench",
        "sinks",
        "--to",
        "mqtt://127.0.0.1/bench",
        "--to=postgresql://plant:se%20cret@db/b",
        "--out",
        "x",
    ]
    monkeypatch.setattr("sys.argv", words)
    assert output._typed("sinks") == "hil bench sinks --to mqtt://127.0.0.1/bench --to=postgresql://..."
