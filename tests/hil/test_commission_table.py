"""What `hil commission` shows of a sensor that the record has no reading of: nothing but the note."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace

import pytest

from hil.cli.twin_commands.commission import _document, _show


def test_a_sensor_without_a_reading_has_no_row_and_no_nan(capsys: pytest.CaptureFixture[str]) -> None:
    errors = {"T1_C": 0.3, "T2_C": math.nan}
    result = SimpleNamespace(
        values={},
        interval90={},
        unidentifiable=(),
        at_bound=(),
        held_out_s=(0.0, 3600.0),
        notes=("T2_C: no reading",),
        rmse_before=errors,
        rmse_after=errors,
        rmse_fitted=errors,
    )
    _show(result, (), Path("my.toml"), Path("my.healthy.parquet"))  # type: ignore[arg-type]
    shown = capsys.readouterr().out
    assert "T1_C" in shown and "nan" not in shown and "T2_C: no reading" in shown
    document = _document(result, Path("my.toml"), Path("my.healthy.parquet"))  # type: ignore[arg-type]
    assert document["rmse_after_K"] == {"T1_C": 0.3, "T2_C": None}
    json.dumps(document, allow_nan=False)
