"""Answers to questions that several tests ask: learning from a healthy record, diagnosis by a command, pictures.

Records are told by their content, since each command reads its files anew.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable
from typing import Any

import pytest

from twin.discovery import engine
from twin.discovery.evidence import part
from twin.discovery.healthy.basis import Columns
from twin.discovery.healthy.health import Health
from twin.network import Network


def remember(patch: pytest.MonkeyPatch) -> None:
    """Have each answered once while the patch lasts."""
    healths: dict[bytes, Health] = {}
    learn = Health.of

    def of(network: Network, probe: Any, book: Any, healthy: Columns) -> Health:
        key = digest(network, healthy)
        if key not in healths:
            healths[key] = learn(network, probe, book, healthy)
        return healths[key]

    patch.setattr(Health, "of", of)
    # Files of tests are side by side already: fits of one search beside them would only wait for each other.
    patch.setattr(part, "SIDE_BY_SIDE", 1)
    from hil.diagnosis import session

    patch.setattr(session, "diagnose", _once(session.diagnose))
    from hil.diagnosis.page import document
    from hil.explain import page as explanation
    from hil.report import page as report

    for module, shown in ((report, lambda curves: curves), (document, _shown), (explanation, _rounds)):
        patch.setattr(module, "pictures", _drawn_once(module.pictures, shown))


def _once(search: Callable[..., Any]) -> Callable[..., Any]:
    found: dict[bytes, Any] = {}

    def diagnose(
        network: Network,
        record: Columns,
        healthy: Columns | None = None,
        *,
        more: Any = (),
        say: Any = lambda _: None,
        limits: Any = None,
    ) -> Any:
        key = digest(network, record, healthy, *more, repr(limits))
        if key not in found:
            found[key] = search(network, record, healthy, more=more, say=say, limits=limits)
        else:
            say("reading")
        return found[key]

    return diagnose


def _drawn_once(draw: Callable[[Any], Any], told: Callable[[Any], Any]) -> Callable[[Any], Any]:
    drawn: dict[bytes, Any] = {}

    def pictures(of: Any) -> Any:
        key = hashlib.sha256(pickle.dumps(told(of))).digest()
        if key not in drawn:
            drawn[key] = draw(of)
        return drawn[key]

    return pictures


def _shown(findings: Any) -> Any:
    """Return what pictures of a diagnosis may show: all but the names of its files and the time that it took."""
    named = {"provenance", "record", "seconds"}
    return {name: value for name, value in findings.document.items() if name not in named}, findings.curves


def _rounds(explanation: Any) -> Any:
    """Return what pictures of an explanation show of its rounds."""
    return [(one.number, one.verdict, one.beliefs, one.ran and one.ran.steps) for one in explanation.rounds]


def digest(*of: object) -> bytes:
    """Return a digest of twins, records and texts."""
    text = hashlib.sha256()
    for one in of:
        if isinstance(one, Columns):
            text.update(repr(getattr(one, "before", ())).encode())
            for array in (one.time_s, one.inputs, one.measured, *one.members.values()):
                text.update(repr(array.shape).encode() + array.tobytes())
            text.update(repr(sorted(one.members)).encode())
        else:
            text.update(repr(one).encode())
    return text.digest()


diagnose = _once(engine.diagnose)
"""The search, once for tests of one process that ask the same: each looks at another part of its frozen answer."""
