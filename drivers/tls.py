"""TLS for Modbus/TCP: certificates both ways, TLS 1.2 or later (Modbus/TCP Security protocol specification, v21).

Paths stand in the rig file, keys in files of their own that only their owner may read. A refusal is told in one
sentence with its remedy.
"""

from __future__ import annotations

import asyncio
import os
import ssl
import stat
from pathlib import Path

from drivers.points import ConfigurationError
from drivers.rigfile import ModbusTlsBus

_THEIRS = {
    "CERTIFICATE_REQUIRED": "it wants a certificate from us, and got none that it takes",
    "UNKNOWN_CA": "it does not know the authority that signed {certificate}",
    "CERTIFICATE_EXPIRED": "{certificate} has expired",
    "BAD_CERTIFICATE": "it does not take {certificate}",
    "HANDSHAKE_FAILURE": "it does not take {certificate}",
    "DECRYPT_ERROR": "it does not take {certificate}",
}
"""What the rig's alert means (RFC 8446, 6.2)."""


def client_context(config: ModbusTlsBus) -> ssl.SSLContext:
    """Our half of the handshake; raises ConfigurationError naming the file that cannot be used, and what to do."""
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
    return context


def check_key(path: Path) -> None:
    """Raise ConfigurationError where others than the owner of a key may read or change it."""
    mode = stat.S_IMODE(os.stat(path).st_mode)
    if mode & 0o077:
        raise ConfigurationError(
            f"{path}: others than its owner may read or change this key (mode {mode:04o}); chmod 600 {path}"
        )


async def why_refused(config: ModbusTlsBus, context: ssl.SSLContext) -> str | None:
    """Why there is no TLS with the rig, as a sentence; None where TLS is not the reason. Opens a connection to ask."""
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
    except (OSError, TimeoutError):
        return None
    finally:
        writer.transport.abort()
    return None


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
