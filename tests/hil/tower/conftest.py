"""A commissioned cell for tests of what is made of it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.hil.tower.made_plant import SHEET, files, iso, run, write_points, write_record
from tests.twin.historian.made_station import clean_store
from tests.twin.tower.made_cell import made_cell
from twin.historian.tags import Series


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with record, datasheet, test points, labels and the commissioned twin."""
    root = tmp_path_factory.mktemp("plant")
    write_record(root / "record")
    (root / "datasheet.json").write_text(json.dumps(SHEET))
    write_points(root / "points.csv")
    at = iso(made_cell(0.5).time_s[0] + 3 * 86400)
    (root / "labels.csv").write_text(
        "time,cell,parameter,kind,value,sd,lo,hi,source\n"
        f"{at},1,fill,interval,,,0.83,0.91,inspection\n{at},1,bias,point,0.3,0.05,,,certificate\n{at},1,air,point,0.93,0.02,,,traverse\n"
    )
    done = run("commission", root / "record", "--cell", 1, *files(root), "--out", root / "cell1.toml")
    assert done.exit_code == 0, done.output
    return root


@pytest.fixture(scope="module")
def clean() -> list[Series]:
    """The series of a station without a defect, of eight days."""
    return clean_store(np.random.default_rng(50), 8.0)
