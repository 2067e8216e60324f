"""`pytest tests/contract --contract-table FILE` writes which test passed on which transport."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil.bench.faults.tls import Certificates
from tests.contract.table import Table
from tests.contract.wires import certificates_in

_TABLE = pytest.StashKey[Table]()


def pytest_configure(config: pytest.Config) -> None:
    """Keep the outcomes of this session."""
    config.stash[_TABLE] = Table()


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
    """Note what became of a test on its transport."""
    outcome = yield
    item.config.stash[_TABLE].note(item, outcome.get_result())


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write the table where that was asked for."""
    path = session.config.getoption("--contract-table")
    if path:
        session.config.stash[_TABLE].write(Path(path))


@pytest.fixture(scope="session")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Certificates | None:
    """Certificates for TLS, made once; None without the openssl program."""
    return certificates_in(tmp_path_factory.mktemp("tls")) if shutil.which("openssl") else None
