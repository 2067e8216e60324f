"""Arrow in a command, which spares itself pandas, and in a program that uses both."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytest.importorskip("pandas", reason="pandas is not installed")

MAKES_ARRAYS = """
import sys
import numpy as np
import pyarrow as pa
from hil.files import look_for_pandas, spare_pandas
{told}
look_for_pandas()
table = pa.table({{"a": np.arange(3.0), "b": [1, 2, None]}})
print("pandas" in sys.modules)
print(table.to_pandas()["a"].sum())
"""


@pytest.mark.parametrize(("told", "loaded"), [("spare_pandas()", "False"), ("", "True")])
def test_arrays_of_a_command_load_no_pandas_and_a_table_still_becomes_a_frame(told: str, loaded: str) -> None:
    code = MAKES_ARRAYS.format(told=told)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout.split() == [loaded, "3.0"], done.stderr


def test_pandas_that_is_loaded_already_is_found() -> None:
    code = MAKES_ARRAYS.format(told="import pandas\nspare_pandas()") + "print(pa.array(pandas.Series(['x', None])))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and done.stdout.split()[:2] == ["True", "3.0"], done.stderr
