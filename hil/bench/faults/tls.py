"""Certificates for one case: an authority, the rig's and the harness's, made by the `openssl` program."""

from __future__ import annotations

import os
import shutil
import ssl
import subprocess
from dataclasses import dataclass
from pathlib import Path


class NoOpenSSLError(RuntimeError):
    """Error of a missing `openssl` program."""


@dataclass(frozen=True, slots=True)
class Certificates:
    """Certificate files: `rig` is certificate, key and authority of the server, `harness` the entries of a rig file."""

    rig: tuple[Path, Path, Path]
    harness: dict[str, Path]

    def context(self) -> ssl.SSLContext:
        """Return the harness's part of the handshake."""
        context = ssl.create_default_context(cafile=self.harness["ca"])
        context.load_cert_chain(self.harness["certificate"], self.harness["key"])
        return context


def make_certificates(folder: Path) -> Certificates:
    """Make an authority and two certificates of it, for 127.0.0.1; raise NoOpenSSLError."""
    ca = authority(folder, "authority")
    rig, rig_key = signed(folder, "rig", ca)
    ours, our_key = signed(folder, "harness", ca)
    return Certificates((rig, rig_key, ca[0]), {"ca": ca[0], "certificate": ours, "key": our_key})


def authority(folder: Path, name: str) -> tuple[Path, Path]:
    """Make a self-signed certificate authority: certificate and key."""
    certificate, key = folder / f"{name}.pem", folder / f"{name}.key"
    _openssl(
        "req",
        "-x509",
        "-newkey",
        "ec",
        "-pkeyopt",
        "ec_paramgen_curve:P-256",
        "-nodes",
        "-days",
        "2",
        "-subj",
        f"/CN={name}",
        "-addext",
        "basicConstraints=critical,CA:TRUE",
        "-addext",
        "keyUsage=keyCertSign",
        "-keyout",
        str(key),
        "-out",
        str(certificate),
    )
    os.chmod(key, 0o600)
    return certificate, key


def signed(folder: Path, name: str, ca: tuple[Path, Path], days: int = 2) -> tuple[Path, Path]:
    """Make a certificate for 127.0.0.1 signed by `ca`, valid for `days` from now (0: expired), and its key."""
    request, certificate, key = folder / f"{name}.csr", folder / f"{name}.pem", folder / f"{name}.key"
    extensions = folder / f"{name}.ext"
    extensions.write_text("subjectAltName=IP:127.0.0.1,DNS:localhost\n", encoding="utf-8")
    _openssl(
        "req",
        "-new",
        "-newkey",
        "ec",
        "-pkeyopt",
        "ec_paramgen_curve:P-256",
        "-nodes",
        "-subj",
        f"/CN={name}",
        "-keyout",
        str(key),
        "-out",
        str(request),
    )
    _openssl(
        "x509",
        "-req",
        "-in",
        str(request),
        "-CA",
        str(ca[0]),
        "-CAkey",
        str(ca[1]),
        "-CAcreateserial",
        "-days",
        str(days),
        "-extfile",
        str(extensions),
        "-out",
        str(certificate),
    )
    os.chmod(key, 0o600)
    return certificate, key


def _openssl(*arguments: str) -> None:
    if shutil.which("openssl") is None:
        raise NoOpenSSLError("certificates are made by the openssl program, which is not installed; install it")
    done = subprocess.run(["openssl", *arguments], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"openssl {arguments[0]} failed: {done.stderr.strip()[-300:]}")
