"""The matrices are small: with a second BLAS thread a busy machine waits for it, up to five times as long."""

from __future__ import annotations

import subprocess
import sys

import pytest

threadpoolctl = pytest.importorskip("threadpoolctl")
INFO = "import numpy, scipy.linalg; from threadpoolctl import threadpool_info as info"
THREADS = f"{INFO}; print(*{{one['num_threads'] for one in info()}})"


def test_these_tests_run_on_one_blas_thread():
    import numpy  # noqa: F401
    import scipy.linalg  # noqa: F401

    assert {one["num_threads"] for one in threadpoolctl.threadpool_info() if one["user_api"] == "blas"} == {1}


def test_the_command_runs_on_one_blas_thread_unless_the_user_says_otherwise():
    for given, threads in (({}, "1"), ({"OPENBLAS_NUM_THREADS": "2"}, "2")):
        code = f"import hil.cli; {THREADS}"
        ran = subprocess.run([sys.executable, "-c", code], env=given, capture_output=True, text=True, check=True)
        assert ran.stdout.split() == [threads]
