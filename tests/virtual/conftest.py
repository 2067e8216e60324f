"""Fixtures of the virtual rig's tests."""

import contextlib
from collections.abc import Callable, Iterator

import pytest
from raw_client import RawClient


@pytest.fixture
def connect() -> Iterator[Callable[[object], RawClient]]:
    """Connects raw clients to a rig and closes them after the test."""
    with contextlib.ExitStack() as stack:
        yield lambda rig: stack.enter_context(RawClient(rig))
