"""Choice of the executor by the option `--on`: this process, a cluster of its own, or a scheduler elsewhere."""

from __future__ import annotations

import contextlib
import importlib.util
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from hil.executor.contract import Executor, ExecutorError, Hear
from hil.executor.serial import SerialExecutor

LOCAL = "local"
SERIAL = "here"
EXTRA = "hil-rig[fleet]"
_ADDRESS = re.compile(r"(tcp|tls)://(\[[0-9A-Fa-f:]+\]|[^\s:/\[\]]+):(\d{1,5})")


@dataclass(frozen=True, slots=True)
class ExecutorOptions:
    """Options of an executor.

    Attributes
    ----------
    on
        `local` for a cluster of this process, `here` for this process alone, `tcp://host:port` or `tls://host:port`
        for a Dask scheduler.
    workers
        Workers of the own cluster.
    tls_ca, tls_cert, tls_key
        Certificate of the authority, own certificate and key for `tls://`; all or none.
    """

    on: str = LOCAL
    workers: int = 1
    tls_ca: Path | None = None
    tls_cert: Path | None = None
    tls_key: Path | None = None


class ExecutorOptionError(ValueError):
    """Error of an option of an executor; the message is one plain sentence."""


def check_options(options: ExecutorOptions) -> None:
    """Check the address and the certificates.

    Raises
    ------
    ExecutorOptionError
        The address is none, or certificates are missing or not of use.
    ExecutorError
        Dask is needed and not installed.
    """
    files = (options.tls_ca, options.tls_cert, options.tls_key)
    if options.on not in (LOCAL, SERIAL):
        found = _ADDRESS.fullmatch(options.on)
        if found is None or not 0 < int(found[3]) < 65536:
            raise ExecutorOptionError(
                f"--on {options.on} is no address of a scheduler; give local, tcp://HOST:PORT or tls://HOST:PORT"
            )
        if found[1] == "tls" and None in files:
            raise ExecutorOptionError("--on tls://... needs --tls-ca, --tls-cert and --tls-key; give all three")
    if any(files) and not options.on.startswith("tls://"):
        raise ExecutorOptionError(f"--tls-ca, --tls-cert and --tls-key are for --on tls://..., not for {options.on}")
    if options.on != SERIAL:
        # Certificates of the own cluster are made by cryptography.
        for package in ("distributed", "cryptography"):
            if importlib.util.find_spec(package) is None:
                raise ExecutorError(
                    f"several workers need the package {package}, which is not installed; pip install '{EXTRA}'"
                )


@contextlib.contextmanager
def opened(options: ExecutorOptions, hear: Hear) -> Iterator[Executor]:
    """Yield the executor of the options; it is closed at the end of the block.

    Raises
    ------
    ExecutorOptionError
        An option is wrong.
    ExecutorError
        The scheduler cannot be reached, a worker has other code, or Dask is not installed.
    """
    check_options(options)
    executor: Executor
    if options.on == SERIAL:
        executor = SerialExecutor(hear)
    else:
        from hil.executor.dask_cluster import DaskExecutor, TlsFiles

        tls = None
        if options.tls_ca and options.tls_cert and options.tls_key:
            tls = TlsFiles(options.tls_ca, options.tls_cert, options.tls_key)
        executor = DaskExecutor(hear, None if options.on == LOCAL else options.on, options.workers, tls)
    try:
        yield executor
    finally:
        executor.close()
