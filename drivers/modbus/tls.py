"""TLS for Modbus/TCP: certificates both ways, TLS 1.2 or later (Modbus/TCP Security protocol specification, v21).

Paths stand in the rig file, keys in files of their own that only their owner may read. A refusal is reported as one
sentence with its remedy.
"""

from __future__ import annotations

import asyncio
import base64
import datetime
import os
import re
import ssl
import stat
from pathlib import Path

from drivers.rig_file import ModbusTlsBus, read_regular
from drivers.signals import ConfigurationError

_THEIRS = {
    "CERTIFICATE_REQUIRED": "it wants a certificate from us, and got none that it takes",
    "UNKNOWN_CA": "it does not know the authority that signed {certificate}",
    "CERTIFICATE_EXPIRED": "{certificate} has expired",
    "BAD_CERTIFICATE": "it does not take {certificate}",
    "HANDSHAKE_FAILURE": "it does not take {certificate}",
    "DECRYPT_ERROR": "it does not take {certificate}",
}
"""Meaning of the rig's TLS alert (RFC 8446, 6.2)."""


def client_context(config: ModbusTlsBus) -> ssl.SSLContext:
    """Return the client's TLS context; raise ConfigurationError with the file that cannot be used, and the remedy."""
    for name in ("ca", "certificate", "key"):
        path = getattr(config, name)
        if not path.is_file():
            raise ConfigurationError(f"{path}: there is no such file; correct {name} in the rig file")
    check_key(config.key)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        context.load_verify_locations(config.ca)
    except (ssl.SSLError, OSError) as error:
        raise ConfigurationError(f"{config.ca}: is no certificate in PEM form ({_of(error)})") from error
    try:
        # Without the password callback OpenSSL would ask on the terminal, in the middle of a run.
        context.load_cert_chain(config.certificate, config.key, password=lambda: b"")
    except (ssl.SSLError, OSError) as error:
        raise ConfigurationError(
            f"{config.certificate} and {config.key} are no certificate and its key in PEM form ({_of(error)}); "
            "a key must not have a password"
        ) from error
    check_valid(config.certificate)
    return context


def check_key(path: Path) -> None:
    """Raise ConfigurationError where others than the owner of a key may read or change it."""
    mode = stat.S_IMODE(os.stat(path).st_mode)
    if mode & 0o077:
        raise ConfigurationError(
            f"{path}: others than its owner may read or change this key (mode {mode:04o}); chmod 600 {path}"
        )


def check_valid(path: Path) -> None:
    """Raise ConfigurationError where the first certificate of a PEM file is not valid now, by this machine's clock."""
    try:
        begins, ends = validity(path)
    except (ValueError, IndexError, OSError) as error:
        raise ConfigurationError(
            f"{path}: the validity of its first certificate cannot be read ({error}); write it anew, with "
            f"openssl x509 -in {path.name} -out new.pem"
        ) from error
    now = datetime.datetime.now(datetime.UTC)
    if now > ends:
        raise ConfigurationError(f"{path}: has expired on {ends:%Y-%m-%d %H:%M} UTC; have it renewed")
    if now < begins:
        raise ConfigurationError(
            f"{path}: is valid from {begins:%Y-%m-%d %H:%M} UTC only; is this machine's clock right?"
        )


def validity(path: Path) -> tuple[datetime.datetime, datetime.datetime]:
    """Return begin and end of the validity of a PEM file's first certificate (RFC 5280, 4.1.2.5).

    Text around a certificate is explanatory, in any encoding (RFC 7468, 2). A trusted certificate of OpenSSL has its
    trust settings behind the certificate.

    Raises
    ------
    ValueError, IndexError
        The file holds no certificate, or a damaged one. OSError: it cannot be read.
    """
    found = _CERTIFICATE.search(read_regular(path))
    if found is None:
        raise ValueError("no certificate is in it")
    der = base64.b64decode(found[2])
    fields = _parts(_parts(_parts(der)[0][1])[0][1])
    after_version = fields[1:] if fields[0][0] == 0xA0 else fields
    begins, ends = (_time(tag, value) for tag, value in _parts(after_version[3][1]))
    return begins, ends


_CERTIFICATE = re.compile(
    rb"-----BEGIN ((?:TRUSTED |X509 )?CERTIFICATE)-----([A-Za-z0-9+/=\s]*)-----END \1-----", re.ASCII
)
"""PEM of a certificate, in the three labels that OpenSSL reads."""


def _parts(der: bytes) -> list[tuple[int, bytes]]:
    """Return tags and contents of consecutive elements in DER (X.690, 8.1)."""
    found = []
    while der:
        tag, size, at = der[0], der[1], 2
        if size & 0x80:
            at += size & 0x7F
            size = int.from_bytes(der[2:at], "big")
        found.append((tag, der[at : at + size]))
        der = der[at + size :]
    return found


def _time(tag: int, value: bytes) -> datetime.datetime:
    text = value.decode("ascii")
    if tag == 0x17:  # UTCTime has two digits for the year, and 50 is 1950
        text = ("19" if int(text[:2]) >= 50 else "20") + text
    return datetime.datetime.strptime(text, "%Y%m%d%H%M%SZ").replace(tzinfo=datetime.UTC)


async def why_refused(config: ModbusTlsBus, context: ssl.SSLContext) -> str | None:
    """Open a connection; return a sentence with the cause of failing TLS, or None where TLS is not the cause."""
    try:
        async with asyncio.timeout(config.timeout_s + 1.0):
            reader, writer = await asyncio.open_connection(config.host, config.port, ssl=context)
    except ssl.SSLCertVerificationError as error:
        return f"the rig's certificate is refused: {error.verify_message}; see {config.ca}"
    except ssl.SSLError as error:
        return _theirs(config, error)
    except (OSError, TimeoutError):
        return None
    try:
        async with asyncio.timeout(config.timeout_s):
            await reader.read(1)
    except ssl.SSLError as error:
        return _theirs(config, error)
    except TimeoutError:
        return None  # it waits for a request, as it should
    except OSError:
        pass
    finally:
        writer.transport.abort()
    return (
        f"the rig hangs up as soon as it has seen {config.certificate}: another authority than its own has signed it, "
        "or its clock says that it is not valid"
    )


def _theirs(config: ModbusTlsBus, error: ssl.SSLError) -> str:
    reason = error.reason or str(error)
    for word, sentence in _THEIRS.items():
        if word in reason:
            said = sentence.format(certificate=config.certificate)
            return f"the rig refuses us: {said}; give it a certificate of its own authority"
    if "WRONG_VERSION_NUMBER" in reason or "RECORD_LAYER" in reason:
        return "the rig does not speak TLS on this port; is port right, or transport = 'modbus_tcp' meant?"
    return f"no TLS with the rig ({_of(error)}); TLS 1.2 or later is needed"


def _of(error: Exception) -> str:
    reason = getattr(error, "reason", None)
    return str(reason).lower().replace("_", " ") if reason else str(error)
