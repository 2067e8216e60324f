"""Streams of a run to other systems: MQTT, PostgreSQL and OPC UA, by a process that follows the journal.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.stream.errors import StoreDownError, StreamError
    from hil.stream.session import StreamOptions, StreamResult, stream_run

__all__ = ["StoreDownError", "StreamError", "StreamOptions", "StreamResult", "stream_run"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "errors": ("StoreDownError", "StreamError"),
        "session": ("StreamOptions", "StreamResult", "stream_run"),
    },
)
