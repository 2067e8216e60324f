"""Stream of a run: the journal is followed, and the store is filled from the position that it has confirmed."""

from __future__ import annotations

import importlib
import math
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hil.stream.address import Address, parse_address, require_known_host
from hil.stream.errors import StoreDownError, StreamError
from hil.stream.journal_source import JournalSource
from hil.stream.store import Position, RunState, Store

POLL_S = 0.25
"""Time from one look at the journal to the next, s: its rows are committed every half second."""
RETRY_S = 1.0
"""Time from one call of a store that is down to the next, s."""
EVERY_S = 1.0
"""Time from a message of a signal to the next, s of rig time, where none is given."""


@dataclass(frozen=True, slots=True)
class StreamOptions:
    """Options of a stream.

    `every_s` is the time from a message of a signal to the next, s of rig time, and `everything` sends a finished run
    in full; a database gets every sample in any case. A store that is down for `give_up_s` seconds ends the stream;
    None for never. `certificate`, `key` and the `trusted` certificates of clients are for an OPC UA server, as files.
    """

    every_s: float | None = None
    everything: bool = False
    give_up_s: float | None = None
    certificate: Path | None = None
    key: Path | None = None
    trusted: tuple[Path, ...] = ()

    @property
    def has_certificates(self) -> bool:
        """Return True where any file of an OPC UA server is given."""
        return self.certificate is not None or self.key is not None or bool(self.trusted)


@dataclass(frozen=True, slots=True)
class StreamResult:
    """Result of a stream: address without password, state of the run, ticks and events that it advanced by.

    `positions` is the file with the position that a broker has confirmed, None for a database.
    """

    to: str
    state: str
    ticks: int
    events: int
    positions: Path | None = None


def stream_run(run: Path, to: str, options: StreamOptions, announce: Callable[[str], None]) -> StreamResult:
    """Send the samples and events of a run to a store until the run has ended, and return what was sent.

    A live run is followed. A store that does not answer is called again, and then gets all that it has not confirmed.
    An OPC UA server goes on after the end of the run, until KeyboardInterrupt.

    Parameters
    ----------
    run
        Run folder with a journal.
    to
        Address: `mqtt://HOST/PREFIX`, `mqtts://HOST/PREFIX`, `postgresql://USER@HOST/DATABASE`, or
        `opc.tcp://ADDRESS:PORT/` for a server of this machine.
    options
        Choice of samples, patience, certificates.
    announce
        Function for one sentence when the store goes away, when it is back, and when a server listens.

    Raises
    ------
    StreamError
        Wrong address, password or certificate, no journal, no library, a port in use, or another stream of the run to
        this address.
    StoreDownError
        The store was down for longer than `give_up_s`.
    JournalError, RunFolderError
        The run cannot be read.
    """
    address = parse_address(to)
    if options.has_certificates and not address.is_server:
        raise StreamError("--cert, --key and --trust are for an OPC UA server; leave them out for this store")
    with ExitStack() as stack:
        if address.is_server:
            _require_no_choice(options)
            module = _library("opcua_store", "asyncua", "asyncua", "opcua")
            access = module.checked_access(address, options.certificate, options.key, options.trusted)
            source = stack.enter_context(JournalSource(run))
            start = source.last_position()
            opened, positions = (lambda: module.OpcuaStore(access, run, source.run, start, announce)), None
        else:
            source = stack.enter_context(JournalSource(run))
            opened, positions = _opener(address, run, source, options, stack)
        return replace(_Stream(source, address, opened, options, announce).follow(), positions=positions)


class _Stream:
    """Stream of one run to one store."""

    def __init__(
        self,
        source: JournalSource,
        address: Address,
        opened: Callable[[], Store],
        options: StreamOptions,
        announce: Callable[[str], None],
    ) -> None:
        self._source, self._address, self._open = source, address, opened
        self._give_up_s, self._announce = options.give_up_s, announce
        self._down_since: float | None = None
        self._first: Position | None = None
        self._at = Position()
        self._state = ""

    def follow(self) -> StreamResult:
        """Send until the run has ended; see `stream_run`."""
        while True:
            store: Store | None = None
            ended = False
            try:
                store = self._open()
                self._send_all(store)
                ended = True
                break
            except StoreDownError as error:
                self._wait(error)
            finally:
                if store is not None:
                    store.close(ended=ended)
        first = self._first or Position()
        ticks, events = self._at.tick - first.tick, self._at.event - first.event
        return StreamResult(self._address.shown, self._state, ticks, events)

    def _send_all(self, store: Store) -> None:
        self._at = store.position()
        if self._first is None:
            self._first = self._at
        state: RunState | None = None
        while True:
            ended = self._source.ended()
            block = self._source.read(self._at, store.longest_block, ended=ended)
            if block.is_empty and block.state == state:
                if ended and not store.stays:
                    return
                time.sleep(POLL_S)
                continue
            self._at = store.send(block)
            state, self._state = block.state, block.state.name
            if self._down_since is not None:
                self._announce(f"{self._address.shown} is back; the stream catches up")
                self._down_since = None

    def _wait(self, error: StoreDownError) -> None:
        """Announce a store that is down, and wait until it is called again; raises StoreDownError to give up."""
        now = time.monotonic()
        first = self._down_since is None
        self._down_since = now if self._down_since is None else self._down_since
        if self._give_up_s is not None and now - self._down_since >= self._give_up_s:
            raise StoreDownError(f"{error}; given up after {self._give_up_s:g} s, start the stream again to go on")
        if first:
            self._announce(f"{error}; the stream goes on when it is back")
        time.sleep(RETRY_S)


def _opener(
    address: Address, run: Path, source: JournalSource, options: StreamOptions, stack: ExitStack
) -> tuple[Callable[[], Store], Path | None]:
    """Return the function that connects to the store, and the file of its position where the run's folder has one.

    What must be right before the first try is checked here.

    Raises
    ------
    StreamError
        The library is missing, or there is no such host.
    """
    if address.is_broker:
        module = _library("mqtt_store", "paho.mqtt.client", "paho-mqtt")
        _unless_down(lambda: require_known_host(address.host))
        from hil.stream.position_file import PositionFile

        positions = PositionFile(run, address, options.everything)
        stack.callback(positions.close)
        start, stride = Position(), _stride(options, source.run.period_s)
        if not options.everything and positions.read() is None and source.ended():
            start, stride = source.last_position(), 1  # the last values of a run that nobody followed
        return lambda: module.MqttStore(address, source.run, positions, start=start, stride=stride), positions.path
    if options.every_s is not None or options.everything:
        raise StreamError("a database gets every sample of a run; leave out --every and --all, which are for MQTT")
    module = _library("postgres_store", "psycopg", "psycopg")
    _unless_down(lambda: module.require_known_database_host(address))
    return lambda: module.PostgresStore(address, source.run), None


def _stride(options: StreamOptions, period_s: float) -> int:
    """Return the ticks from a message of a signal to the next."""
    every_s = options.every_s
    if every_s is None:
        every_s = 0.0 if options.everything else EVERY_S
    return max(1, math.ceil(every_s / period_s - 1e-9))  # 1 s of 0.1 s each are 10, not 11


def _unless_down(check: Callable[[], None]) -> None:
    """Make a check that needs the name service; where that is down, the stream tries again later."""
    try:
        check()
    except StoreDownError:
        return


def _require_no_choice(options: StreamOptions) -> None:
    """Check that no option of other stores is given; raises StreamError."""
    if options.every_s is not None or options.everything or options.give_up_s is not None:
        raise StreamError(
            "an OPC UA server has every sample of a run and goes on until Ctrl-C; leave out --every, --all, --give-up"
        )


def _library(module: str, package: str, project: str, extra: str = "stream") -> Any:
    try:
        importlib.import_module(package)
    except ImportError:
        raise StreamError(
            f"this store needs the package {project}, which is not installed; pip install 'hil-rig[{extra}]'"
        ) from None
    return importlib.import_module(f"hil.stream.{module}")
