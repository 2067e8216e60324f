"""Messages about alarms by webhook, e-mail, MQTT and others, through Apprise, from a process that follows the journal.

Addresses hold passwords and tokens: messages and files name an address by its kind and host alone.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import logging
import os
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from hil.alarms.alarm_list import AlarmList
from hil.alarms.errors import AlarmError, NotSentError
from hil.alarms.outbox import Key, Outbox, is_announced, key_of, line_of, message
from hil.alarms.states import WAITING
from hil.alarms.watch import AlarmWatch
from hil.files import parse_json, plain, replacing

POLL_S = 0.5
"""Time from one look at the journal to the next, s: its rows are committed as often."""
RETRY_S = (2.0, 10.0, 60.0)
"""Times from one try of an address that takes no message to the next, s; the last one repeats."""
LAST_TRIES_S = 60.0
"""So long an address that takes no message is tried after the run has ended, s."""
MOST_KEYS = 5000
"""Transitions that the file of what was sent remembers."""
LONGEST_FILE = 10**6
_SENT = "alarms-notified.json"


@dataclass(frozen=True, slots=True)
class NotifyOptions:
    """Options of messages: at most `per_hour` to an address in an hour."""

    per_hour: int = 10


def read_addresses(file: Path) -> tuple[str, ...]:
    """Return the addresses in a file, one a line; empty lines and those that begin with # are left out.

    Raises
    ------
    AlarmError
        The file cannot be read, holds no address, or others may read it.
    """
    try:
        with file.expanduser().open("rb") as opened:
            mode = os.fstat(opened.fileno()).st_mode
            text = opened.read(LONGEST_FILE).decode("utf-8")
    except (OSError, UnicodeDecodeError, RuntimeError) as error:
        why = getattr(error, "strerror", None) or "it is no text in UTF-8"
        raise AlarmError(f"{file} cannot be read ({why}); give a file with one address a line") from None
    if mode & 0o077:
        raise AlarmError(f"{file} may be read by others, and addresses hold passwords; run chmod 600 {file}")
    lines = (line.strip() for line in text.splitlines())
    found = tuple(line for line in lines if line and not line.startswith("#"))
    if not found:
        raise AlarmError(f"{file} holds no address; write one a line, as json://host/path or mailto://...")
    return found


def shown(address: str) -> str:
    """Return an address by its kind and host: everything else may be a secret."""
    try:
        parts = urlsplit(address)
        host = parts.hostname or ""
    except ValueError:
        return "an address that cannot be read"
    return f"{parts.scheme}://{host}/..." if parts.scheme else "an address without a kind"


def notify_run(run: Path, addresses: Sequence[str], options: NotifyOptions, announce: Callable[[str], None]) -> int:
    """Follow the alarms of a run until it ends, announce each change, send it, and return the number of messages.

    What was sent is kept beside the journal, so that a second start repeats nothing. At the first start the alarms that
    wait for an operator are sent, and not the past.

    Parameters
    ----------
    run
        Run folder with a journal.
    addresses
        Addresses as Apprise has them: `json://`, `mailto://`, `mqtt://` and others; none to follow alone.
    options
        Rate of messages.
    announce
        Function for a line on each change.

    Raises
    ------
    AlarmError
        Apprise is missing, an address cannot be read, or another process sends the alarms of this run.
    NotSentError
        An address takes no message after the end of the run.
    JournalError, RunFolderError
        The run cannot be read.
    """
    senders = [_Sender(address, _opened(address), options.per_hour) for address in addresses]
    with contextlib.ExitStack() as stack:
        watch = stack.enter_context(AlarmWatch(run))
        sent = stack.enter_context(_sent_file(run)) if senders else _Sent(None, None)
        return _Following(watch, senders, sent, announce).until_the_end()


class _Following:
    def __init__(self, watch: AlarmWatch, senders: list[_Sender], sent: _Sent, announce: Callable[[str], None]) -> None:
        self._watch, self._senders, self._sent, self._announce = watch, senders, sent, announce
        self._seen: set[Key] | None = sent.keys
        self._messages = 0
        self._kept: AlarmList | None = None
        self._queued: list[Key] = []

    def until_the_end(self) -> int:
        while True:
            ended = self._watch.has_ended()
            kept = self._watch.poll()
            self._queue(kept)
            if ended:
                break
            self._send(last=False)
            time.sleep(POLL_S)
        deadline = time.monotonic() + LAST_TRIES_S
        while True:
            self._send(last=True)
            if not any(sender.outbox.waiting for sender in self._senders):
                return self._messages
            if time.monotonic() > deadline:
                hosts = ", ".join(sender.shown for sender in self._senders if sender.outbox.waiting)
                raise NotSentError(
                    f"{hosts} took no message within {LAST_TRIES_S:g} s after the end of the run; start again"
                )
            time.sleep(POLL_S)

    def _queue(self, kept: AlarmList) -> None:
        """Put the transitions that are new into the outboxes."""
        if kept is self._kept:
            return
        self._kept = kept
        announced = [record for record in kept.records if is_announced(record)]
        if self._seen is None:
            standing = {item.definition.id: item for item in kept.standing() if item.state in WAITING}
            last = {record.id: record for record in announced}
            fresh = [record for name, record in last.items() if name in standing]
            self._seen = {key_of(record) for record in announced}
        else:
            fresh = [record for record in announced if key_of(record) not in self._seen]
            self._seen |= {key_of(record) for record in fresh}
        for record in fresh:
            line = line_of(record, kept)
            self._announce(line)
            for sender in self._senders:
                sender.outbox.add([line], kept.statuses[record.id].definition.rank)
        self._queued += [key_of(record) for record in fresh]

    def _send(self, *, last: bool) -> None:
        name = self._watch.folder.path.resolve().name
        for sender in self._senders:
            if (said := sender.send(name, last=last)) is not None:
                self._announce(said)
            self._messages += sender.left
            sender.left = 0
        if not any(sender.outbox.waiting for sender in self._senders):
            self._sent.write(self._seen or set(), bool(self._queued))
            self._queued = []


class _Sender:
    """One address: its outbox, its next try, and what is said about it."""

    def __init__(self, address: str, opened: Any, per_hour: int) -> None:
        self.shown, self._opened, self.outbox = shown(address), opened, Outbox(per_hour)
        self.left = 0
        self._failed, self._try_at = 0, 0.0

    def send(self, run: str, *, last: bool) -> str | None:
        """Send what is due; return a sentence where the address stops or begins again to take messages."""
        now = time.monotonic()
        lines = self.outbox.due(now, last=last)
        if not lines or now < self._try_at:
            return None
        title = f"hil: {len(lines)} alarm message{'s' if len(lines) > 1 else ''} of {run}"
        try:
            taken = bool(self._opened.notify(body=message(lines), title=plain(title), body_format="text"))
        except Exception:  # a plug-in's own error may repeat the address
            taken = False
        if taken:
            self.outbox.sent(len(lines))
            self.left += 1
            back, self._failed, self._try_at = self._failed > 0, 0, 0.0
            return f"{self.shown} takes messages again" if back else None
        self._try_at = now + RETRY_S[min(self._failed, len(RETRY_S) - 1)]
        self._failed += 1
        if self._failed > 1:
            return None
        return f"{self.shown} did not take a message; it is tried again"


def _opened(address: str) -> Any:
    """Return the Apprise object of one address; raises AlarmError where it is none, or Apprise is missing."""
    try:
        import apprise
    except ImportError:
        raise AlarmError(
            "messages need the package apprise, which is not installed; pip install 'hil-rig[notify]'"
        ) from None
    log = logging.getLogger("apprise")  # its warnings may repeat an address
    log.propagate = False
    if not log.handlers:
        log.addHandler(logging.NullHandler())
    asset = apprise.AppriseAsset(app_id="hil", app_desc="hil", secure_logging=True, plugin_paths=[], async_mode=False)
    opened = apprise.Apprise(asset=asset)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # its plug-ins import modules that Python will remove
        added = opened.add(address)
    if not added:
        raise AlarmError(
            f"{shown(address)} is no address that Apprise knows; use json://HOST/PATH, mailto://USER:PASSWORD@HOST or "
            "mqtt://HOST/TOPIC"
        )
    for plugin in opened:
        plugin.notify_format = apprise.NotifyFormat.TEXT  # mail is HTML otherwise, and names in it would be markup
    return opened


class _Sent:
    """Transitions that were sent, in a file beside the journal; nothing is kept without one."""

    def __init__(self, path: Path | None, keys: set[Key] | None) -> None:
        self._path, self.keys = path, keys
        self._is_new = keys is None

    def write(self, keys: set[Key], changed: bool) -> None:
        """Replace the file, where that changes it; raises AlarmError where the folder takes none."""
        if self._path is None or not (changed or self._is_new):
            return
        self._is_new = False
        latest = sorted(keys, key=lambda key: (key[2], key[3]))[-MOST_KEYS:]
        try:
            with replacing(self._path) as unfinished:
                unfinished.write_text(json.dumps({"sent": latest}) + "\n", encoding="utf-8")
        except OSError as error:
            raise AlarmError(f"{self._path} cannot be written ({error.strerror}); make room or writable") from None


@contextlib.contextmanager
def _sent_file(run: Path) -> Iterator[_Sent]:
    """Yield what was sent before, and hold it for this process."""
    path = run / _SENT
    try:
        lock = os.open(path.with_suffix(".lock"), os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise AlarmError(f"{run} takes no file ({error.strerror}); make room or writable") from None
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise AlarmError(
                f"another process sends the alarms of {run}; end it, or give it all addresses in one file"
            ) from None
        except OSError:
            pass  # a file system without locks
        yield _Sent(path, _read_sent(path))
    finally:
        os.close(lock)


def _read_sent(path: Path) -> set[Key] | None:
    try:
        with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), encoding="utf-8") as file:
            found = parse_json(file.read(LONGEST_FILE))["sent"]
        return {(str(name), str(event), int(tick), float(wall_s)) for name, event, tick, wall_s in found}
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError, KeyError, OverflowError):
        raise AlarmError(f"{path} is damaged; remove it, and alarms that wait are sent again") from None
