"""`hil diagnose --with`: how far the diagnosed twin is off on the further records, in table, page and JSON."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from hil.diagnosis.columns import further_columns
from hil.record import ReadingOptions
from tests.discovery.conftest import Bench
from tests.hil.command_line import hil
from tests.hil.made_diagnosis import made
from tests.hil.made_record import written
from tests.twin.conftest import LOOP
from twin.discovery.further_records import errors_on_further_record
from twin.twinfile import load


def test_an_effect_that_is_not_in_a_further_record_does_not_carry_over_to_it(tmp_path: Path) -> None:
    bench = Bench(load(LOOP))
    twin = tmp_path / "twin.toml"
    twin.write_bytes(LOOP.read_bytes())
    hot = bench.with_element("more", {"kind": "heat_source", "node": "tank", "power": 150.0})
    for name, seed, changed in (("good", 7, None), ("hot", 1, hot), ("again", 3, hot), ("cool", 4, None)):
        written(bench.network, bench.record(4.0, seed=seed, changed=changed), tmp_path / f"{name}.parquet")
    code, printed = hil(
        "diagnose",
        tmp_path / "hot.parquet",
        "--twin",
        twin,
        "--healthy",
        tmp_path / "good.parquet",
        "--with",
        tmp_path / "again.parquet",
        "--with",
        tmp_path / "cool.parquet",
        "--out",
        tmp_path / "out",
    )
    assert code == 1 and "effect found" in printed
    assert "this effect does not carry over to cool.parquet: T_" in printed
    assert "over to again.parquet" not in printed
    assert "free run over again.parquet" in printed and "free run over cool.parquet" in printed
    document = json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    again, cool = document["further_records"]
    assert (again["record"], again["carried"], cool["carried"]) == ("again.parquet", "over", "not")
    tank = again["sensors"]["T_tank_C"]
    assert tank["after"] < 2.0 * tank["noise"] < tank["stale"]
    assert cool["sensors"]["T_tank_C"]["stale"] < cool["sensors"]["T_tank_C"]["after"]
    assert any("does not carry over" in note for note in document["notes"])
    page = (tmp_path / "out" / "diagnosis.html").read_text(encoding="utf-8")
    assert "RMSE in K, again.parquet, all of it" in page and "RMSE in K, cool.parquet, all of it" in page


def test_a_grown_twin_is_tried_on_further_records_by_its_own_measure() -> None:
    bench = Bench(load(LOOP))
    hot = bench.with_element("more", {"kind": "heat_source", "node": "tank", "power": 150.0})
    grown = replace(made("effect found"), network=hot, moved=(), method="growth", elsewhere=())
    again = errors_on_further_record(grown, bench.network, bench.record(1.0, changed=hot), "again")
    assert again.carried == "over" and again.says == ""
    assert all(e.after < 2.0 * e.noise < e.before == e.stale for e in again.errors.values())
    less = bench.with_element("more", {"kind": "heat_source", "node": "tank", "power": 110.0})
    part = errors_on_further_record(grown, bench.network, bench.record(1.0, changed=less), "less")
    assert part.carried == "in part" and part.says.startswith("this effect carries over to less in part only: T_")
    cool = errors_on_further_record(
        replace(grown, network=None, verdict="adequate"), bench.network, bench.record(1.0, changed=hot), "x"
    )
    assert cool.says.startswith("re-tuned, the twin does not fit x: T_")
    assert (
        errors_on_further_record(replace(grown, network=None), bench.network, bench.record(1.0, changed=hot), "x").says
        == ""
    )


def test_options_for_a_foreign_record_do_not_change_the_record_of_a_run(tmp_path: Path) -> None:
    """A logger in minutes, and later a run, whose record is in seconds and has no column of that name."""
    bench = Bench(load(LOOP))
    (tmp_path / "run").mkdir()
    (tmp_path / "run/run.json").write_text("{}", encoding="utf-8")
    made_record = bench.record(0.5)
    paths = [
        written(bench.network, made_record, folder / f"{name}.parquet")
        for folder, name in ((tmp_path, "foreign"), (tmp_path / "run", "record"))
    ]
    foreign, run = further_columns(bench.network, paths, None, ReadingOptions(time_scale=60.0)).values()
    assert foreign.time_s[-1] == 60.0 * made_record.time_s[-1]
    assert run.time_s[-1] == made_record.time_s[-1]
