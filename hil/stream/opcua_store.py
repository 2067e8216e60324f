"""OPC UA server of a run: a thread of its own, access, certificates, limits for clients."""

from __future__ import annotations

import asyncio
import contextlib
import datetime
import hmac
import ipaddress
import logging
import socket
import threading
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from asyncua import Server, ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import SimpleRoleRuleset, User, UserRole
from asyncua.server.internal_server import InternalServer
from asyncua.server.user_managers import UserManager
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import rsa

from hil.stream.address import SERVER_PASSWORD_VARIABLE, Address
from hil.stream.errors import StreamError
from hil.stream.opcua_model import BackwardHistory, JournalHistory, RunModel
from hil.stream.store import Block, Position, RunIdentity, RunState

STOP_WITHIN_S = 5.0
"""Longest time for the connections to close, s; after it they are cut."""
MOST_CLIENTS = 100
"""Connections and subscriptions at a time."""
MOST_QUEUED = 1_000
"""Values of a signal that wait for a client that does not fetch them, 100 s at 10 Hz; the past has the rest."""
MOST_UNREAD_BYTES = 32 * 2**20
"""Bytes that wait in a connection for a client that does not read: six full answers about the past. It is cut then."""
CHECK_S = 1.0
"""Time from one look for clients that stall to the next, s."""
SESSION_MS = 60_000
"""Longest time that a session without a connection lives, ms; clients keep theirs alive on their own."""
SHORTEST_KEY = 2048
"""Bits of the shortest RSA key that Basic256Sha256 permits (OPC 10000-7)."""
_ADVICE = "see 'OPC UA' in the guide 'Stream a run'"
_CHANGES = frozenset(
    ua.NodeId(kind)
    for kind in (ua.ObjectIds.WriteRequest_Encoding_DefaultBinary, ua.ObjectIds.CallRequest_Encoding_DefaultBinary)
)


@dataclass(frozen=True)
class Access:
    """Address of a server, who may read, and its certificate; made by `checked_access`.

    `trusted` holds the certificates of clients in DER form. Without user and trusted certificates everybody on this
    machine may read.
    """

    address: Address
    user: str | None = None
    password: str | None = field(default=None, repr=False)
    trusted: frozenset[bytes] = frozenset()
    certificate: x509.Certificate | None = None
    key: rsa.RSAPrivateKey | None = field(default=None, repr=False)
    uri: str = f"urn:{socket.gethostname()}:hil-rig"

    @property
    def is_open(self) -> bool:
        """Return True where everybody on this machine may read."""
        return self.user is None and not self.trusted


def checked_access(address: Address, certificate: Path | None, key: Path | None, trusted: tuple[Path, ...]) -> Access:
    """Return the access to a server at `address`, once all that it needs is right.

    Parameters
    ----------
    address
        Address, with user and password where clients need them.
    certificate, key
        Certificate of the server with its RSA key, as files in PEM form.
    trusted
        Certificates of clients that may read, as files in PEM or DER form.

    Raises
    ------
    StreamError
        The address is none of this machine, can be reached from others without encryption and identification, or a
        certificate cannot be used.
    """
    at_home = _is_loopback(address.host)
    if (certificate is None) != (key is None):
        raise StreamError("a certificate and its key belong together; give both --cert and --key")
    if address.user is not None and address.password is None:
        raise StreamError(f"there is no password for user {address.user!r}; set {SERVER_PASSWORD_VARIABLE}")
    if not at_home and (certificate is None or (address.user is None and not trusted)):
        raise StreamError(
            f"{address.host} can be reached from other machines, and that needs --cert and --key, with a user in the "
            f"address or --trust; {_ADVICE}"
        )
    if trusted and certificate is None:
        raise StreamError("--trust needs a certificate of the server as well; add --cert and --key")
    known = frozenset(_certificate(path).public_bytes(serialization.Encoding.DER) for path in trusted)
    access = Access(address, address.user, address.password if address.user is not None else None, known)
    if certificate is None or key is None:
        return access
    found, private, uri = _checked_pair(certificate, key)
    return Access(address, access.user, access.password, known, found, private, uri)


class OpcuaStore:
    """OPC UA server of one run, in a thread of its own.

    Parameters
    ----------
    access
        Address and access.
    folder
        Run folder, for the past.
    run
        Identity of the run.
    start
        Position from which values are shown: the last one when the server starts. The past has those before.
    announce
        Function for the address once the server listens.

    Raises
    ------
    StreamError
        The address cannot be had.
    """

    longest_block = 1000
    stays = True

    def __init__(
        self, access: Access, folder: Path, run: RunIdentity, start: Position, announce: Callable[[str], None]
    ) -> None:
        logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # a client's mistake is no matter of this terminal
        self._access, self._folder, self._run = access, folder, run
        self._at = start
        self._state: RunState | None = None
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="opcua", daemon=True)
        self._thread.start()
        try:
            self._server, self._model, port = self._wait(self._started(), None)
        except BaseException:
            self._end_thread()
            raise
        place = access.address.shown.replace(":0/", f":{port}/") if access.address.port == 0 else access.address.shown
        announce(f"{run.name} is served at {place}; Ctrl-C ends the server, not the run")

    def position(self) -> Position:
        return self._at

    def send(self, block: Block) -> Position:
        self._wait(self._shown(block), None)
        self._at = block.after
        return self._at

    def close(self, *, ended: bool) -> None:
        with contextlib.suppress(Exception):
            self._wait(self._server.stop(), STOP_WITHIN_S)
        self._end_thread()

    async def _shown(self, block: Block) -> None:
        await self._model.show(block)
        if block.state != self._state:
            await self._model.show_state(block.state.name, block.state.reason, block.state.time_us)
            self._state = block.state

    async def _started(self) -> tuple[Server, RunModel, int]:
        access, address = self._access, self._access.address
        server = Server(iserver=_ReadOnlyServer(_Users(access)))
        _limit(server)
        await server.init()
        server.name, server.manufacturer_name, server.product_uri = "hil stream", "hil", "urn:hil-rig"
        server.application_type = ua.ApplicationType.Server
        await server.set_application_uri(access.uri)
        server.set_endpoint(address.shown)
        policies = [] if access.certificate is not None and not _is_loopback(address.host) else _PLAIN
        if access.certificate is not None and access.key is not None:
            server.iserver.certificate, server.iserver.private_key = access.certificate, access.key
            policies = [*policies, ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt]
        server.set_security_policy(policies, _ReadOnlyRules())
        server.set_identity_tokens(_tokens(access))
        model = RunModel(server, self._run)
        await model.build()
        server.iserver.history_manager = BackwardHistory(server.iserver)
        server.iserver.history_manager.set_storage(JournalHistory(self._folder, model))
        try:
            await server.start()
        except (OSError, UnicodeError) as error:
            reason = getattr(error, "strerror", None) or "no such address"
            raise StreamError(
                f"port {address.port} of {address.host} cannot be had ({reason.lower()}); give another address"
            ) from None
        assert server.bserver is not None
        self._watch = asyncio.ensure_future(_cut_clients_that_stall(server))
        return server, model, server.bserver.port

    def _wait(self, work: Coroutine[Any, Any, Any], timeout_s: float | None) -> Any:
        """Return the result of work in the thread of the server."""
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(timeout_s)

    def _end_thread(self) -> None:
        async def cancelled() -> None:
            rest = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
            for task in rest:
                task.cancel()
            await asyncio.gather(*rest, return_exceptions=True)

        with contextlib.suppress(Exception):
            self._wait(cancelled(), STOP_WITHIN_S)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(STOP_WITHIN_S)
        if not self._thread.is_alive():
            self._loop.close()


_PLAIN = [ua.SecurityPolicyType.NoSecurity]


class _ReadOnlyServer(InternalServer):
    """Server that takes no other servers: that service asks for no user."""

    def register_server(self, server: Any, conf: Any = None) -> None:
        raise ServiceError(ua.StatusCodes.BadServiceUnsupported)


class _ReadOnlyRules(SimpleRoleRuleset):
    """Services of a user that change nothing."""

    def check_validity(self, user: Any, action_type_id: Any, body: Any) -> bool:
        return action_type_id not in _CHANGES and bool(super().check_validity(user, action_type_id, body))


class _Users(UserManager):
    """User with a password, and clients with a trusted certificate."""

    def __init__(self, access: Access) -> None:
        self._access = access

    def get_user(
        self, iserver: Any, username: str | None = None, password: str | None = None, certificate: Any = None
    ) -> User | None:
        access = self._access
        if username is not None:
            # Both are compared, in a time that does not depend on where they differ.
            given = (username, password or "")
            right = (access.user or "", access.password or "")
            same = [hmac.compare_digest(_bytes(a), _bytes(b)) for a, b in zip(given, right, strict=True)]
            return User(UserRole.User, username) if all(same) and access.user is not None else None
        if access.is_open or (certificate is not None and certificate in access.trusted):
            return User(UserRole.User)
        return None


def _bytes(text: str) -> bytes:
    """Return the bytes of text, also those of the environment that are no UTF-8."""
    return text.encode("utf-8", "surrogateescape")


def _tokens(access: Access) -> list[type]:
    """Return the kinds of identification that the server takes."""
    tokens: list[type] = []
    if access.user is not None:
        tokens.append(ua.UserNameIdentityToken)
    if access.trusted:
        tokens.append(ua.X509IdentityToken)
    if access.is_open or access.trusted:  # an anonymous user of a trusted application is known by its channel
        tokens.append(ua.AnonymousIdentityToken)
    return tokens


def _limit(server: Server) -> None:
    """Bound what clients can take."""
    inner = server.iserver
    inner.allow_remote_admin = False
    inner.max_connections = inner.max_subscriptions = MOST_CLIENTS
    inner.max_monitored_item_queue_size = MOST_QUEUED
    inner.max_unacked_messages_per_subscription = 20
    inner.max_session_timeout_ms = SESSION_MS


async def _cut_clients_that_stall(server: Server) -> None:
    """Cut connections whose client sends requests and does not read the answers."""
    while True:
        await asyncio.sleep(CHECK_S)
        for transport in list(server.iserver.asyncio_transports):
            if transport.get_write_buffer_size() > MOST_UNREAD_BYTES:
                transport.abort()


def _is_loopback(host: str) -> bool:
    """Return True for an address that only this machine reaches; raises StreamError for a name."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        raise StreamError(
            f"{host!r} is no address on which this machine can listen; give an IP address, as opc.tcp://127.0.0.1:4840/"
        ) from None


def _certificate(path: Path) -> x509.Certificate:
    """Return the certificate of a file; raises StreamError."""
    try:
        content = path.read_bytes()
        if content.startswith(b"-----BEGIN"):
            return x509.load_pem_x509_certificate(content)
        return x509.load_der_x509_certificate(content)
    except OSError as error:
        raise StreamError(f"{path} cannot be read ({error.strerror}); give a certificate in PEM or DER form") from None
    except ValueError:
        raise StreamError(f"{path} is no certificate; give one in PEM or DER form") from None


def _checked_pair(certificate: Path, key: Path) -> tuple[x509.Certificate, rsa.RSAPrivateKey, str]:
    """Return the server's certificate, key and application URI; raises StreamError where clients would refuse it."""
    found = _certificate(certificate)
    try:
        private = serialization.load_pem_private_key(key.read_bytes(), None)
    except OSError as error:
        raise StreamError(f"{key} cannot be read ({error.strerror}); give the key in PEM form") from None
    except TypeError:
        raise StreamError(f"the key {key} has a passphrase; give one without, readable by you alone") from None
    except ValueError:
        raise StreamError(f"{key} is no key in PEM form; give that of {certificate}") from None
    if not isinstance(private, rsa.RSAPrivateKey) or private.key_size < SHORTEST_KEY:
        raise StreamError(f"{key} is no RSA key of {SHORTEST_KEY} bits or more, which OPC UA needs; make another one")
    if private.public_key() != found.public_key():
        raise StreamError(f"{key} is not the key of {certificate}; give the one that belongs to it")
    if not found.not_valid_before_utc <= datetime.datetime.now(datetime.UTC) <= found.not_valid_after_utc:
        raise StreamError(f"{certificate} is not valid at this time; make another one")
    try:
        names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        uris = names.get_values_for_type(x509.UniformResourceIdentifier)
    except (x509.ExtensionNotFound, ValueError):
        uris = []
    if not uris:
        raise StreamError(f"{certificate} has no application URI, which OPC UA clients check; {_ADVICE}")
    return found, private, str(uris[0])
