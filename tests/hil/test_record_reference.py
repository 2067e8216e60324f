"""`docs/reference/record-file.md` against the reader of records."""

from __future__ import annotations

import click
import pytest

from drivers.bus.contract import judge
from drivers.rig_file.model import Point
from drivers.signals.points import Quality
from drivers.signals.units import PLAUSIBLE, SUFFIX_OF_UNIT
from hil.cli.rig_commands import check
from hil.cli.twin_commands import commission, diagnose, track
from hil.record.reader import read_record
from hil.record.values.numbers import ALWAYS_LOST, LOST
from tests.hil.reference_pages import FOLDER, page

PAGE = page("record-file")


def test_the_ranges_are_those_of_the_code() -> None:
    told = {row["Unit"].strip("`"): (float(row["From"]), float(row["To"])) for row in PAGE.rows["Ranges"]}
    assert told == {unit: pytest.approx(limits, rel=1e-5) for unit, limits in PLAUSIBLE.items()}
    suffixes = {row["Unit"].strip("`"): row["Suffix"].strip("`").removeprefix("_") for row in PAGE.rows["Ranges"]}
    assert suffixes == {unit: SUFFIX_OF_UNIT[unit] or "none" for unit in PLAUSIBLE}


@pytest.mark.parametrize("command", [check.command, commission.command, track.command, diagnose.command])
def test_every_command_that_reads_a_record_has_the_options(command: click.Command) -> None:
    options = {name: option for option in command.params for name in option.opts}
    for row in PAGE.rows["Options"]:
        option = options[row["Option"].strip("`")]
        if isinstance(option.type, click.Choice):
            assert [value.strip(" `") for value in row["Values"].replace("`,`", "`comma`").split("`, `")] == [
                "comma" if choice == "," else choice for choice in option.type.choices
            ]


def test_the_example_is_read_without_a_remark(tmp_path) -> None:
    path = tmp_path / "record.csv"
    path.write_text(PAGE.code["csv"][0], encoding="utf-8")
    assert read_record(path).messages == ()


def test_the_losses_are_those_of_the_code() -> None:
    text = (FOLDER / "record-file.md").read_text(encoding="utf-8")
    assert f"more than {LOST:.0%}".replace("%", " %") in text and ALWAYS_LOST == 2


@pytest.mark.parametrize("unit", [unit for unit in PLAUSIBLE if unit != "1"])
def test_a_reading_of_a_live_point_passes_the_same_range(unit: str) -> None:
    point = Point(name="x", bus="b", unit=unit, table="input", address=0)
    low, high = PLAUSIBLE[unit]
    assert judge(point, high)[1] == judge(point, low)[1] == Quality.GOOD
    assert judge(point, 9.9e37)[1] == judge(point, -9.9e37)[1] == Quality.OUT_OF_RANGE
    wider = Point(name="x", bus="b", unit=unit, table="input", address=0, plausible=(low * 2, high * 2))
    assert judge(wider, high * 1.5)[1] == Quality.GOOD
