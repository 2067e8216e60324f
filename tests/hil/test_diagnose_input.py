"""`hil diagnose` with steady states, and with input that must be corrected: one sentence with file and remedy."""

from __future__ import annotations

import errno
import json
from pathlib import Path

import numpy as np
import pytest

from hil.files import held
from tests.discovery.conftest import Bench
from tests.discovery.test_records import TWINS, cooler
from tests.hil.command_line import hil
from tests.hil.made_record import written
from tests.twin.conftest import LOOP
from twin.twinfile import load


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A twin, four healthy hours, a record of ten minutes, four hours with heat, and one with words for readings."""
    folder = tmp_path_factory.mktemp("input")
    bench = Bench(load(LOOP))
    (folder / "twin.toml").write_text(LOOP.read_text(encoding="utf-8"), encoding="utf-8")
    written(bench.network, bench.record(4.0, seed=7), folder / "good.parquet")
    written(bench.network, bench.record(0.2), folder / "short.csv")
    hot = bench.with_element("more", {"kind": "heat_source", "node": "tank", "power": 150.0})
    written(bench.network, bench.record(4.0, changed=hot), folder / "hot.parquet")
    (folder / "empty.csv").write_text("", encoding="utf-8")
    rows = [row.split(",") for row in (folder / "short.csv").read_text(encoding="utf-8").splitlines()]
    at = [name.strip('"') for name in rows[0]].index("T_tank_C")
    worded = [row[:at] + ([row[at]] if i == 0 else ["warm"]) + row[at + 1 :] for i, row in enumerate(rows)]
    (folder / "words.csv").write_text("\n".join(map(",".join, worded)) + "\n", encoding="utf-8")
    return folder


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        (["{}/hto.parquet"], ["hto.parquet", "there is no such file"]),
        (["{}/empty.csv"], ["empty.csv is empty"]),
        (["{}/short.csv"], ["short.csv", "two windows", "steady state of its own, give --at-rest"]),
        (["{}/words.csv"], ["words.csv", "T_tank_C", "holds text"]),
        (
            ["{}/hot.parquet", "--healthy", "{}/hot.parquet"],
            ["hot.parquet: the healthy record does not", "commission"],
        ),
        (["{}/hot.parquet", "--healthy", "{}/short.csv"], ["short.csv", "two windows"]),
        (["{}/hot.parquet", "--healthy", "{}/good.parquet", "--with", "{}/short.csv"], ["short.csv", "two windows"]),
        (["{}/hot.parquet", "--healthy", "{}/good.parquet", "--at-rest"], ["--at-rest excludes --healthy"]),
        (["{}/hot.parquet", "--clock", "25:00"], ["25:00", "08:00"]),
    ],
)
def test_what_must_be_corrected_is_one_sentence_with_its_file(place: Path, typed: list[str], words: list[str]) -> None:
    code, printed = hil("diagnose", *(part.format(place) for part in typed), "--twin", place / "twin.toml", "--dry")
    assert code == 2 and "Traceback" not in printed
    for word in words:
        assert word in printed


def test_a_table_of_steady_states_grows_a_twin(tmp_path: Path) -> None:
    constant = load(TWINS / "dry_cooler_constant.toml")
    truth = constant.with_values({"fins.fan_exponent": 0.65, "fins.UA_100": 24000.0})
    u, y = cooler(truth, 32, 3)
    table = np.column_stack([u, y])
    states, twin, out = tmp_path / "states.csv", tmp_path / "cooler.toml", tmp_path / "out"
    names = [*constant.input_columns, *(c for columns in constant.sensor_columns.values() for c in columns)]
    np.savetxt(states, table, delimiter=",", header=",".join(names), comments="", fmt="%.6g")
    twin.write_bytes((TWINS / "dry_cooler_constant.toml").read_bytes())
    code, printed = hil("diagnose", states, "--twin", twin, "--out", out)
    assert code == 2 and "time_s" in printed and "--at-rest" in printed
    code, printed = hil("diagnose", states, "--at-rest", "--twin", twin, "--out", out)
    assert code == 1 and "effect found" in printed and "every fourth steady state" in printed
    document = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    assert document["method"] == "growth at rest" and len(document["left_out"]) == 12
    page = (out / "diagnosis.html").read_text(encoding="utf-8")
    assert "Significance and cross-validation" in page and "twin at rest" in page and "groups of states" in page
    grown = load(tmp_path / "cooler.r1.toml")
    assert grown.parameters["fins.fan_exponent"].value == pytest.approx(0.65, abs=0.05)
    assert grown.revision.error_after_K["T_out_C"] < 0.3 * grown.revision.error_before_K["T_out_C"]


def test_a_folder_that_cannot_be_written_or_is_in_use_is_refused_before_anything_is_computed(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hil.diagnosis.diagnose_files", None)
    typed = ["diagnose", place / "hot.parquet", "--twin", place / "twin.toml", "--out"]
    code, printed = hil(*typed, "/proc/results")
    assert code == 2 and "/proc/results: no file can be written there" in printed and "--dry" in printed
    with held(tmp_path / "out", ValueError):
        code, printed = hil(*typed, tmp_path / "out")
    assert code == 2 and "another process works on this folder" in printed


@pytest.mark.parametrize(("function", "said"), [("revise", "no revision of the twin is saved"), ("write", "hil: ")])
def test_the_verdict_is_printed_although_a_result_cannot_be_written(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, function: str, said: str
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", "somewhere")

    monkeypatch.setattr(f"hil.diagnosis.session.{function}", full)
    given = ["--twin", place / "twin.toml", "--healthy", place / "good.parquet"]
    code, printed = hil("diagnose", place / "hot.parquet", *given, "--out", tmp_path / "out")
    assert code == (1 if function == "revise" else 2)
    assert "effect found" in printed and said in printed and "No space left on device" in printed
    assert (tmp_path / "out" / "diagnosis.html").exists() == (function == "revise")
