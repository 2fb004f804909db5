"""``drive-id serve``: the archive and a live page over HTTP, read-only.

The live page is fed by a node in a process of its own, ``drive_id.nodes.live_feed``, which prints lines of JSON:
nothing here knows ROS, and a page that is held up holds up no bench.
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib.util
import json
import os
import secrets
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import (
    FileResponse,
    HTMLResponse,
    PlainTextResponse,
    RedirectResponse,
    Response,
    StreamingResponse,
)
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send

from drive_id.reporting.web.archive import Archive
from drive_id.reporting.web.page import archive_page, rendered

LOOPBACK = ("127.0.0.1", "localhost")
SHOWN = ("report.html", "report.pdf", "flux_map.png", "diagnostics.png", "identification.json")
"""Files of a result folder that are served; nothing else of the disk is."""
_MOST_POINTS = 20_000  # operating points that a page holds: 400 s at the usual rate of 50 Hz
_RESTART = 2.0  # s between the end of the feed and its next start
_PATIENCE = 5.0  # s; the feed ends within 1 s, on a busy machine too
_LONGEST_LINE = 1 << 22  # bytes
_HEADERS = {"Cache-Control": "no-store", "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer"}
_LOG_APART = {"RCUTILS_LOGGING_USE_STDOUT": "0"}  # standard output is for the lines
_COOKIE = "drive_id"


def ros_found() -> bool:
    """Tell whether the messages that the live page needs can be imported."""
    return all(importlib.util.find_spec(name) is not None for name in ("rclpy", "drive_id_msgs"))


class Feed:
    """What the live page shows, and who waits for news of it."""

    def __init__(self, command: list[str]) -> None:
        self.command = command
        self.state: dict[str, Any] = {}
        self._waiting: set[asyncio.Queue[dict[str, Any]]] = set()

    def take(self, news: dict[str, Any]) -> None:
        """Merge news, and pass them on; a reader that does not keep up gets the whole state again."""
        points = [*self.state.get("points", []), *news.get("points", [])][-_MOST_POINTS:]
        self.state |= news | {"points": points}
        for queue in self._waiting:
            if queue.full():
                while not queue.empty():
                    queue.get_nowait()
                queue.put_nowait({"reset": True, **self.state})
            else:
                queue.put_nowait(news)

    async def news(self) -> AsyncIterator[str]:
        """Yield server-sent events: the whole state first, then what is new."""
        queue: asyncio.Queue[dict[str, Any]] = asyncio.Queue(50)
        queue.put_nowait({"reset": True, **self.state})
        self._waiting.add(queue)
        try:
            while True:
                yield f"data: {json.dumps(await queue.get())}\n\n"
        finally:
            self._waiting.discard(queue)

    async def run(self) -> None:
        """Keep the feed running and take its lines."""
        while True:
            process = await asyncio.create_subprocess_exec(
                *self.command, stdout=asyncio.subprocess.PIPE, limit=_LONGEST_LINE, env={**os.environ, **_LOG_APART}
            )
            assert process.stdout is not None
            try:
                while line := await process.stdout.readline():
                    self.take({"feed": "", **json.loads(line)})
            finally:
                code = await _ended(process)
            self.take({"feed": f"The process that listens to ROS ended with exit code {code}; it is started again."})
            await asyncio.sleep(_RESTART)


async def _ended(process: asyncio.subprocess.Process) -> int:
    """End a process and return its exit code; one whose output nobody takes any more may wait for that for ever."""
    with contextlib.suppress(ProcessLookupError):
        process.terminate()
    try:
        return await asyncio.wait_for(process.wait(), _PATIENCE)
    except asyncio.TimeoutError:
        process.kill()
        return await process.wait()


class TokenWall:
    """Lets only those in who know the token, from ``?token=`` once, then from a cookie, or as a bearer token."""

    def __init__(self, app: ASGIApp, token: str) -> None:
        self.app, self.token = app, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] != "http":
            return await self.app(scope, receive, send)
        request = Request(scope)
        given = request.query_params.get("token")
        if given is not None and self._right(given):
            response: Response = RedirectResponse(request.url.remove_query_params("token").path, 303)
            response.set_cookie(_COOKIE, self.token, httponly=True, samesite="strict")
            return await response(scope, receive, send)
        bearer = request.headers.get("authorization", "").removeprefix("Bearer ")
        if self._right(request.cookies.get(_COOKIE, "")) or self._right(bearer):
            return await self.app(scope, receive, send)
        refusal = PlainTextResponse("Open the address with the token that drive-id serve printed.", 401, _HEADERS)
        return await refusal(scope, receive, send)

    def _right(self, given: str) -> bool:
        return secrets.compare_digest(given.encode(), self.token.encode())


def application(
    root: Path, *, namespace: str = "", token: str = "", live: bool = True, feed: Feed | None = None
) -> Starlette:
    """Return the application.

    Parameters
    ----------
    root : Path
        Folder of the archive.
    namespace : str
        ROS namespace of the drive on the live page.
    token : str
        Empty: only this computer is served, and only under its own name.
    live : bool
        Whether there is a live page.
    feed : Feed, optional
        Of the live page. Default: it listens to ROS.
    """
    archive = Archive(root)
    title = f"Results in {'/'.join(root.resolve().parts[-2:])}"
    command = [sys.executable, "-m", "drive_id.nodes.live_feed"]
    command += ["--ros-args", "-r", f"__ns:=/{namespace.strip('/')}"] if namespace else []
    feed = feed or Feed(command)

    @contextlib.asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        task = asyncio.create_task(feed.run()) if live else None
        yield
        if task is not None:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task

    async def index(_: Request) -> Response:
        entries = await run_in_threadpool(archive.entries)
        return HTMLResponse(archive_page(entries, title, live=live), headers=_HEADERS)

    async def file(request: Request) -> Response:
        path = (root / request.path_params["folder"] / request.path_params["name"]).resolve()
        if request.path_params["name"] not in SHOWN or not path.is_relative_to(root.resolve()) or not path.is_file():
            raise HTTPException(404)
        return FileResponse(path, headers=_HEADERS)

    async def page(_: Request) -> Response:
        return HTMLResponse(rendered("live.html", title=f"Experiment on {namespace or 'the drive'}"), headers=_HEADERS)

    async def events(_: Request) -> Response:
        return StreamingResponse(feed.news(), media_type="text/event-stream", headers=_HEADERS)

    Handler = Callable[[Request], Awaitable[Response]]
    pages: list[tuple[str, Handler]] = [("/", index), ("/live", page), ("/events", events)] if live else [("/", index)]
    routes = [Route(path, act, methods=["GET"]) for path, act in (*pages, ("/{folder:path}/{name}", file))]
    wall = Middleware(TokenWall, token=token) if token else Middleware(TrustedHostMiddleware, allowed_hosts=LOOPBACK)
    return Starlette(routes=routes, middleware=[wall], lifespan=lifespan)
