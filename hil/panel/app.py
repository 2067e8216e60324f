"""Pages and requests of the panel, as a Starlette application.

Nothing changes by GET. A POST needs a session, the panel's own Origin and JSON, and steers the run through its control
socket, as `hil ctl` does.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, RedirectResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from hil.alarms import AlarmError
from hil.files import parse_json, plain
from hil.journal import JournalError
from hil.panel.access import FOLDER_POLICY, HEADERS, Access
from hil.panel.errors import PanelError
from hil.panel.feeds import Feed, Feeds
from hil.run.engine import ControlError, ask
from hil.run_folder import RunFolder, RunFolderError, add_note

MOST_BODY = 16_384
"""Bytes of a request's body: a note has two thousand characters."""
MOST_STREAMS = 100
"""Viewers at a time, of all runs together."""
STALLED_S = 10.0
"""So long a viewer may take no byte before it is dropped, s."""
VERBS = ("hold", "pause", "resume", "abort", "ack")
LONGEST_NAME = 60
"""Characters of an operator's name."""
PAGE = Path(__file__).parent / "page"
_FILES = {
    "panel.html": "text/html",
    "panel.js": "text/javascript",
    "trends.js": "text/javascript",
    "panel.css": "text/css",
    "icon.svg": "image/svg+xml",
}


class Panel:
    """Routes of one panel over the runs in `folder`."""

    def __init__(self, folder: Path, access: Access) -> None:
        self._access = access
        self._folder = folder
        self._feeds: Feeds | None = None
        self._streams = 0

    def application(self) -> ASGIApp:
        """Return the ASGI application, with its checks around it."""
        routes = [
            Route("/", self.page),
            *(Route(f"/{name}", self.page) for name in _FILES if name != "panel.html"),
            Route("/api/runs", self.runs),
            Route("/api/runs/{name}/history", self.history),
            Route("/api/runs/{name}/verb", self.verb, methods=["POST"]),
            Route("/api/runs/{name}/alarm", self.alarm, methods=["POST"]),
            Route("/api/runs/{name}/note", self.note, methods=["POST"]),
            Route("/runs/{name}/{file}", self.file),
        ]
        inner = Starlette(routes=routes, lifespan=self._lifespan, exception_handlers={Exception: _defect})
        return _Guarded(inner, self._access, self.stream)

    @contextlib.asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        self._feeds = Feeds(self._folder)
        try:
            yield
        finally:
            await self._feeds.close()

    async def page(self, request: Request) -> Response:
        """Return the page, its script or its style."""
        name = request.url.path.strip("/") or "panel.html"
        return Response((PAGE / name).read_bytes(), media_type=f"{_FILES[name]}; charset=utf-8")

    async def runs(self, request: Request) -> Response:
        """Return the list of runs."""
        assert self._feeds is not None
        return JSONResponse({"runs": await asyncio.to_thread(self._feeds.listing)})

    async def history(self, request: Request) -> Response:
        """Return the past of a run, thinned."""
        return await _answered(self._history(request))

    async def _history(self, request: Request) -> Response:
        feed = await self._feed(request)
        return Response(await feed.call(lambda run: run.history()), media_type="application/json")

    async def file(self, request: Request) -> Response:
        """Return the report, the diagnosis or the Rerun file of a run; pages get an origin of their own."""
        assert self._feeds is not None
        try:
            folder = RunFolder(self._feeds.folder_of(request.path_params["name"]))
            files = {
                "report.html": folder.report,
                "diagnosis.html": folder.diagnosis / "diagnosis.html",
                "review.rrd": folder.review,
            }
            path = files.get(request.path_params["file"])
            folder.read_manifest()  # it checks the folder for links to the outside
        except (PanelError, RunFolderError) as error:
            return _refused(str(error), 404)
        if path is None or path.is_symlink() or not path.is_file():
            return _refused("this run has no such file yet; `hil report RUN` makes what is missing", 404)
        if path.suffix == ".html":
            return FileResponse(path, media_type="text/html", headers={"content-security-policy": FOLDER_POLICY})
        return FileResponse(path, media_type="application/octet-stream", filename=path.name)

    async def verb(self, request: Request) -> Response:
        """Steer a run: hold, pause, resume, abort, acknowledge a trip."""
        return await _answered(self._verb(request))

    async def _verb(self, request: Request) -> Response:
        given = await _body(request)
        feed, verb = await self._feed(request), given.get("verb")
        if verb not in VERBS or given.get("confirmed") is not True:
            raise PanelError(f"give one of {', '.join(VERBS)}, and confirm it")
        await feed.begun()
        seen = given.get("seen")
        if verb in ("hold", "resume") and seen != feed.state:
            raise PanelError(f"the run is {feed.state} now, and was {str(seen)[:20]!r} on the page; look again")
        why, by = _text(given, "reason", 130), _name(given)
        reason = f"{why} (panel, {by})" if why else f"by {by} (panel)"
        socket = feed.folder / "control.sock"
        answer = await asyncio.to_thread(ask, socket, verb, reason)
        await feed.refresh()
        return JSONResponse({"ok": answer["ok"], "text": str(answer["text"])}, 200 if answer["ok"] else 409)

    async def alarm(self, request: Request) -> Response:
        """Acknowledge, shelve or unshelve an alarm."""
        return await _answered(self._alarm(request))

    async def _alarm(self, request: Request) -> Response:
        given = await _body(request)
        feed, act = await self._feed(request), given.get("act")
        if act not in ("acknowledge", "shelve", "unshelve"):
            raise PanelError("give act: acknowledge, shelve or unshelve")
        for_s = given.get("for_s")
        seconds = math.nan
        if isinstance(for_s, int | float) and not isinstance(for_s, bool):
            with contextlib.suppress(OverflowError):  # a number of hundreds of digits
                seconds = float(for_s)
        count = given.get("count")
        if act == "acknowledge" and (not isinstance(count, int) or isinstance(count, bool)):
            raise PanelError("give count: how often the alarm had come when you looked at it")
        alarm, by, reason = _text(given, "id", 200), _name(given), _text(given, "reason", 500)
        seen = count if isinstance(count, int) else None
        said = await feed.call(lambda run: run.act(act, alarm, by, reason, seconds, seen))
        await feed.refresh()
        return JSONResponse({"ok": True, "text": said})

    async def note(self, request: Request) -> Response:
        """Add a note to a run."""
        return await _answered(self._note(request))

    async def _note(self, request: Request) -> Response:
        given = await _body(request)
        feed = await self._feed(request)
        text, by = _text(given, "text", 2000), _name(given)
        await asyncio.to_thread(add_note, RunFolder(feed.folder), text, by)
        await feed.refresh()
        return JSONResponse({"ok": True, "text": "noted"})

    async def stream(self, name: str, send: Send) -> None:
        """Send the states of a run as server-sent events until the viewer goes or stalls, or the run is gone."""
        assert self._feeds is not None
        if self._streams >= MOST_STREAMS:
            await _send(send, _refused(f"{MOST_STREAMS} viewers look on already; close another page", 503))
            return
        self._streams += 1
        try:
            await self._states(name, send)
        finally:
            self._streams -= 1

    async def _states(self, name: str, send: Send) -> None:
        assert self._feeds is not None
        try:
            feed = await self._feeds.of(name)
        except PanelError as error:
            await _send(send, _refused(str(error), 404))
            return
        headers = Headers(HEADERS | {"content-type": "text/event-stream; charset=utf-8"}).raw
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        feed.viewers += 1
        try:
            version = 0
            while True:
                try:
                    version = await feed.after(version)
                    event = b"data: " + feed.latest + b"\n\n"
                except PanelError as error:
                    event = b"event: gone\ndata: " + json.dumps({"text": str(error)}).encode() + b"\n\n"
                    await asyncio.wait_for(_more(send, event, False), STALLED_S)
                    return
                await asyncio.wait_for(_more(send, event, True), STALLED_S)
        finally:
            feed.viewers -= 1

    async def _feed(self, request: Request) -> Feed:
        assert self._feeds is not None
        return await self._feeds.of(request.path_params["name"])


class _Guarded:
    """Checks of every request, before any route, and headers of every answer."""

    def __init__(self, inner: ASGIApp, access: Access, stream: Callable[[str, Send], Awaitable[None]]) -> None:
        self._inner, self._access, self._stream = inner, access, stream

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._inner(scope, receive, send)
            return
        if scope["type"] != "http":
            return

        async def guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        request = Request(scope)
        answer = self._refusal(request) or self._entered(request)
        if answer is not None:
            await answer(scope, receive, guarded)
            return
        parts = scope["path"].split("/")
        if request.method == "GET" and parts[1:3] == ["api", "runs"] and parts[4:] == ["stream"]:
            await self._until_gone(parts[3], receive, guarded)
            return
        await self._inner(scope, receive, guarded)

    def _entered(self, request: Request) -> Response | None:
        """Return the answer to the first address, which has the token: a session, and the address without it."""
        if request.method != "GET" or request.url.path != "/" or "token" not in request.query_params:
            return None
        if not self._access.takes(request.query_params["token"]):
            return None
        return RedirectResponse("/", 303, headers={"set-cookie": self._access.begin_session()})

    def _refusal(self, request: Request) -> Response | None:
        """Return the answer to a request that may not be, or None."""
        headers = request.headers
        if not self._access.knows_host(headers.get("host")):
            return _refused("this panel has another address; open the one that `hil serve` printed", 421)
        if request.method not in ("GET", "HEAD", "POST"):
            return _refused("this panel takes GET and POST", 405)
        if request.method == "POST":
            if not self._access.is_own_origin(headers.get("origin")):
                return _refused("the request comes from another page than this panel's", 403)
            if headers.get("content-type", "").partition(";")[0].strip() != "application/json":
                return _refused("send JSON", 415)
        token = request.query_params.get("token")
        if token is not None and request.url.path == "/" and request.method == "GET" and self._access.takes(token):
            return None
        if not self._access.knows_session(headers.get("cookie")):
            return _refused("open the address that `hil serve` printed: its token begins a session", 403)
        return None

    async def _until_gone(self, name: str, receive: Receive, send: Send) -> None:
        """Stream until the viewer has gone."""
        streaming = asyncio.ensure_future(self._stream(name, send))
        gone = asyncio.ensure_future(_disconnected(receive))
        try:
            await asyncio.wait({streaming, gone}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in (streaming, gone):
                task.cancel()
            await asyncio.gather(streaming, gone, return_exceptions=True)


async def _disconnected(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass


async def _more(send: Send, body: bytes, more: bool) -> None:
    await send({"type": "http.response.body", "body": body, "more_body": more})


async def _send(send: Send, response: Response) -> None:
    await send({"type": "http.response.start", "status": response.status_code, "headers": response.raw_headers})
    await _more(send, bytes(response.body), False)


async def _answered(work: Awaitable[Response]) -> Response:
    """Return the answer of `work`; what a user can correct is a sentence."""
    try:
        return await work
    except (PanelError, AlarmError, RunFolderError) as error:
        return _refused(str(error), 400)
    except (ControlError, JournalError) as error:
        return _refused(str(error), 409)
    except ClientDisconnect:
        return Response(status_code=400)


async def _body(request: Request) -> dict[str, Any]:
    """Return the JSON object of a request; raises PanelError for anything else, and for a body that is too long."""
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > MOST_BODY:
            raise PanelError(f"a request has at most {MOST_BODY} bytes; shorten the text")
    try:
        found = parse_json(body)
    except ValueError:
        raise PanelError("the request is no JSON") from None
    if not isinstance(found, dict):
        raise PanelError("the request is no JSON object")
    return found


def _text(given: dict[str, Any], key: str, longest: int) -> str:
    value = given.get(key, "")
    if not isinstance(value, str):
        raise PanelError(f"{key} must be text")
    return plain(value, longest).strip()


def _name(given: dict[str, Any]) -> str:
    return _text(given, "by", LONGEST_NAME) or "unknown"


def _refused(text: str, status: int) -> Response:
    return JSONResponse({"ok": False, "text": text}, status)


async def _defect(request: Request, error: Exception) -> Response:
    """Answer a defect of this program without its details."""
    return _refused("the panel has a defect; its terminal names it", 500)
