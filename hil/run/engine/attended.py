"""Work that a request or trouble may cut short: a rig that is polled once an hour is made safe at once all the same."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

CUT_AFTER_S = 0.3
"""So long work may go on after the request before it is cancelled, s."""
LOOK_EVERY_S = 0.5
"""Interval at which trouble is looked for while work goes on, s."""

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Cut:
    """Work that was cut short, and `trouble`, where that was the cause."""

    trouble: str | None


@dataclass(frozen=True, slots=True)
class Finished(Generic[T]):
    """Work that came to its end, with its result."""

    result: T


async def attended(work: Awaitable[T], request: asyncio.Event, trouble: Callable[[], str | None]) -> Finished[T] | Cut:
    """Return the result of `work`, or that it was cut short.

    It is cut by `request`, `CUT_AFTER_S` after that was set, and as soon as `trouble` returns a reason. Raises what
    `work` raises.
    """
    task = asyncio.ensure_future(work)
    asked = asyncio.ensure_future(request.wait())
    found: str | None = None
    try:
        while not task.done() and not asked.done() and found is None:
            await asyncio.wait({task, asked}, timeout=LOOK_EVERY_S, return_when=asyncio.FIRST_COMPLETED)
            found = None if task.done() else trouble()
        if not task.done() and found is None:
            await asyncio.wait({task}, timeout=CUT_AFTER_S)
        if task.done():
            return Finished(task.result())
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        return Cut(found)
    finally:
        asked.cancel()
        if not task.done():
            task.cancel()
