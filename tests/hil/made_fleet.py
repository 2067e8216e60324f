"""A fleet that a test made: short records of the virtual rig, a twin, and a file with a job for each of them."""

from __future__ import annotations

import shutil
from functools import cache
from pathlib import Path

from drivers.rig_file import load_rig
from hil.record import Record, write_record
from hil.synthetic import direct_record, profile, setting
from tests.docs.fences import PROJECT

TRACKED = '[[job]]\nkind = "track"\ncalibrators = ["least_squares"]\n'


@cache
def _record(number: int, hours: float) -> Record:
    case = setting(number, 0, hours, "healthy")
    return direct_record(profile(case), load_rig(PROJECT / "profiles/rigs/virtual.toml"), seed=case.seed, unit=0)


def made_fleet(folder: Path, records: int = 2, hours: float = 0.6, jobs: str = TRACKED, more: str = "") -> Path:
    """Write records, twin and fleet file into a folder; return the file."""
    (folder / "records").mkdir(parents=True)
    for number in range(records):
        write_record(_record(number, hours), folder / f"records/r{number}.parquet")
    shutil.copyfile(PROJECT / "profiles/twins/loop.toml", folder / "loop.toml")
    rig = f'[[rig]]\nname = "lab"\ntwin = "loop.toml"\nrecords = ["records/*.parquet"]\n{more}\n'
    file = folder / "night.toml"
    file.write_text(f'id = "night"\n\n{rig}\n{jobs}', encoding="utf-8")
    return file
