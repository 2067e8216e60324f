"""Who may see and steer: a token in the first address, a session cookie, and checks of Host and Origin.

A page of another site can neither read nor change anything: its requests have another Origin, no cookie
(SameSite=Strict), and a name that it points at this machine (DNS rebinding) is no Host of the panel.
"""

from __future__ import annotations

import hmac
import secrets
from collections import deque
from collections.abc import Iterable

MOST_SESSIONS = 200
"""Sessions that are kept; the oldest ends when another one begins."""
HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}
"""Headers of every answer."""
FOLDER_POLICY = (
    "sandbox allow-scripts; default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
)
"""Content-Security-Policy of a page from a run's folder: an origin of its own, without session, forms and network."""


class Access:
    """Token, sessions and names of one panel.

    Parameters
    ----------
    names
        Names and addresses by which browsers may reach it, without port.
    port
        Its port.
    secure
        True with TLS.
    """

    def __init__(self, names: Iterable[str], port: int, *, secure: bool) -> None:
        self.token = secrets.token_urlsafe(32)
        self._scheme = "https" if secure else "http"
        self.names = [f"[{name}]" if ":" in name else name for name in names]
        self._hosts = {f"{name}:{port}".lower() for name in self.names}
        if port == (443 if secure else 80):
            self._hosts |= {name.lower() for name in self.names}
        self.cookie = f"hil_session_{port}"
        self._secure = secure
        self._sessions: deque[str] = deque(maxlen=MOST_SESSIONS)

    def knows_host(self, host: str | None) -> bool:
        """Return True for a Host header that names this panel."""
        return host is not None and host.lower() in self._hosts

    def is_own_origin(self, origin: str | None) -> bool:
        """Return True for the Origin of the panel's own page."""
        return origin is not None and origin.lower() in {f"{self._scheme}://{host}" for host in self._hosts}

    def takes(self, token: str) -> bool:
        """Return True for the token, in a time that does not depend on where another one differs."""
        return hmac.compare_digest(token.encode("utf-8"), self.token.encode("utf-8"))

    def begin_session(self) -> str:
        """Return the Set-Cookie header of a new session."""
        session = secrets.token_urlsafe(32)
        self._sessions.append(session)
        attributes = "; Path=/; HttpOnly; SameSite=Strict" + ("; Secure" if self._secure else "")
        return f"{self.cookie}={session}{attributes}"

    def knows_session(self, cookies: str | None) -> bool:
        """Return True if a Cookie header has a session."""
        # Cookies belong to a host, not to a port: another service's may stand beside, well-formed or not.
        parts = (part.partition("=") for part in (cookies or "").split(";"))
        given = [value.strip().encode("utf-8") for name, _, value in parts if name.strip() == self.cookie]
        return any(hmac.compare_digest(one, known.encode("utf-8")) for one in given for known in self._sessions)
