"""A PostgreSQL server of its own for tests: on a socket in a temporary folder, as its own user, no network."""

from __future__ import annotations

import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

BINARIES = sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)


class NoServer(Exception):
    """There is no PostgreSQL here; the message says what is missing."""


class Server:
    """A cluster in a temporary folder. Without TCP; whoever reaches the socket and knows the password gets in."""

    password = "correct horse"

    def __init__(self) -> None:
        found = shutil.which("initdb")
        self.bin = Path(found).resolve().parent if found else BINARIES[0] if BINARIES else None
        if self.bin is None:
            raise NoServer("PostgreSQL is not installed (Debian: postgresql)")
        self.user = self._own_user()
        self.folder = Path(tempfile.mkdtemp(prefix="pg", dir="/tmp"))
        if self.user is not None:
            record = pwd.getpwnam(self.user)
            os.chown(self.folder, record.pw_uid, record.pw_gid)
        self.folder.chmod(0o755)
        secret = self.folder / "secret"
        secret.write_text(self.password)
        secret.chmod(0o644)
        self._run(
            "initdb",
            "-D",
            str(self.data),
            "-U",
            "plant",
            "--auth=scram-sha-256",
            f"--pwfile={secret}",
            "--no-sync",
            "-E",
            "UTF8",
            "--locale=C",
        )
        self.start()

    @property
    def data(self) -> Path:
        return self.folder / "data"

    def url(self, password: str | None = None, database: str = "postgres") -> str:
        from urllib.parse import quote

        host = quote(str(self.folder), safe="")
        return f"postgresql://plant:{quote(password or self.password)}@{host}/{database}"

    def start(self) -> None:
        options = f"-k {self.folder} -c listen_addresses= -c fsync=off -c shared_buffers=16MB -c max_connections=20"
        self._run(
            "pg_ctl", "-D", str(self.data), "-w", "-t", "60", "-l", str(self.folder / "log"), "-o", options, "start"
        )

    def stop(self) -> None:
        self._run("pg_ctl", "-D", str(self.data), "-w", "-m", "immediate", "stop")

    def remove(self) -> None:
        try:
            self.stop()
        finally:
            shutil.rmtree(self.folder, ignore_errors=True)

    @staticmethod
    def _own_user() -> str | None:
        """Return the user to run as: PostgreSQL refuses root."""
        if os.geteuid() != 0:
            return None
        try:
            pwd.getpwnam("postgres")
        except KeyError:
            raise NoServer("PostgreSQL does not run as root, and there is no user postgres") from None
        if shutil.which("runuser") is None:
            raise NoServer("PostgreSQL does not run as root, and runuser is not installed")
        return "postgres"

    def _run(self, program: str, *arguments: str) -> None:
        assert self.bin is not None
        command = [str(self.bin / program), *arguments]
        if self.user is not None:
            command = ["runuser", "-u", self.user, "--", *command]
        # A server that inherits a pipe keeps it open: its output goes to a file.
        with (self.folder / "output").open("ab") as output:
            done = subprocess.run(command, cwd="/tmp", stdout=output, stderr=output, timeout=120, check=False)
        if done.returncode:
            raise NoServer(f"{program} failed: {(self.folder / 'output').read_text()[-300:]}")


def serving() -> Iterator[Server]:
    """Yield a server for a fixture, and skip its tests where none can be started."""
    try:
        running = Server()
    except NoServer as error:
        pytest.skip(str(error))
    yield running
    running.remove()


def emptied(server: Server, name: str) -> str:
    """Return the URL of a database of this name that is made anew."""
    import psycopg

    with psycopg.connect(server.url(), autocommit=True) as base:
        base.execute(f"DROP DATABASE IF EXISTS {name} WITH (FORCE)")
        base.execute(f"CREATE DATABASE {name}")
    return server.url(database=name)
