"""Server: the application of routes, access and page behind uvicorn, on a socket that is opened here."""

import asyncio
import errno
import os
import socket
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, closing, contextmanager
from pathlib import Path

import uvicorn
from fastapi import APIRouter, FastAPI
from fastapi.responses import HTMLResponse, Response
from starlette.exceptions import HTTPException
from starlette.routing import Match
from starlette.staticfiles import StaticFiles
from starlette.types import Receive, Scope, Send

from twodof import __version__
from twodof.errors import LinkError
from twodof.lab import answers
from twodof.lab.access import API, Gate, lab_routes
from twodof.lab.connections import HEAD_S, LabConfig, Places, raise_file_limit
from twodof.lab.lab import LabServer
from twodof.lab.routes import commands, diagrams, identification, logs, parameters, session
from twodof.lab.settings import LabSettings
from twodof.lab.telemetry_client import LONGEST

_MISSING = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>twodof: the page is not built</title>
<body style="font: 1rem/1.5 system-ui; max-width: 40rem; margin: 3rem auto; padding: 0 1rem">
<h1>The page is not built</h1>
<p>The server runs, and its API answers; <a href="api/openapi.json">this</a> describes it.</p>
<p>Run <code>make web</code> in the folder of twodof, then load this page again.</p>
</body></html>
"""
READS = ("GET", "HEAD")
LONGEST_PATH = 200
"""Most characters of a path of the page: each of its folders is looked for."""
_FOR_EVER = "public, max-age=31536000, immutable"


class PageFiles(StaticFiles):
    """Built files of the page; browsers may keep those whose names contain a hash of their content."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Return the answer for a path; browsers must ask for the page itself each time."""
        if scope["method"] not in READS:
            raise HTTPException(405, headers={"Allow": ", ".join(READS)})
        answer = await super().get_response(path, scope)
        answer.headers["cache-control"] = _FOR_EVER if path.startswith("assets/") else "no-cache"
        return answer


def serve_page(app: FastAPI, folder: Path) -> None:
    """Serve the page in `folder`, which may be built later, at every path that is not of the API.

    A request to a path of the API with a wrong method ends up here too: the answer names the right methods.
    """
    files = PageFiles(directory=folder, html=True, check_dir=False)

    async def page(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and scope["path"].startswith(API):
            routes = [one for one in lab_routes(ROUTERS) if one.matches(scope)[0] is not Match.NONE]
            methods = sorted({method for route in routes for method in route.methods or ()})
            raise HTTPException(405, headers={"Allow": ", ".join(methods)}) if methods else HTTPException(404)
        if scope["type"] == "http" and len(scope["path"]) > LONGEST_PATH:
            raise HTTPException(404)
        if scope["type"] == "http" and not (folder / "index.html").is_file():
            await HTMLResponse(_MISSING, 503 if scope["path"] == "/" else 404)(scope, receive, send)
            return
        await files(scope, receive, send)

    app.mount("/", page)


ROUTERS: tuple[APIRouter, ...] = (
    session.router,
    session.drones_router,
    commands.router,
    commands.excitations_router,
    session.export_router,
    parameters.files_router,
    parameters.router,
    diagrams.router,
    diagrams.jobs_router,
    parameters.tuning_router,
    identification.models_router,
    identification.router,
    session.jobs_router,
    logs.router,
    session.telemetry_router,
)
"""Routers of the API, one for each subject."""
_ABOUT = "The API of the laboratory in the browser. All quantities are in SI units and radians."


def create_app(settings: LabSettings) -> FastAPI:
    """Return the application: the API under /api, the page elsewhere. It connects to the drones while it runs."""
    lab = LabServer(settings)

    @asynccontextmanager
    async def life(_: FastAPI) -> AsyncIterator[None]:
        async with lab:
            yield

    app = FastAPI(
        title="twodof lab",
        version=__version__,
        description=_ABOUT,
        lifespan=life,
        openapi_url=None,  # it would be written anew for each request, and the first one takes most of a second
        docs_url=None,
        redoc_url=None,
        default_response_class=answers.FiniteJSON,
        responses={
            status: {"model": answers.Refusal, "description": text} for status, text in answers.DESCRIPTIONS.items()
        },
    )
    app.state.lab = lab
    for router in ROUTERS:
        app.include_router(router)
    described, told = asyncio.Lock(), list[str]()

    @app.get(f"{API}openapi.json", include_in_schema=False)
    async def openapi() -> Response:
        async with described:
            if not told:
                told.append(await lab.log_bench.do(description, seconds=60.0))
        return Response(told[0], media_type="application/json")

    answers.install(app)
    serve_page(app, settings.page)
    app.add_middleware(Gate, settings=settings)
    return app


def description() -> str:
    """Return the API's description in JSON. That takes most of a second, in which a thread would delay the server."""
    return answers.dumps(create_app(LabSettings(Path())).openapi())


BACKLOG = 1024
SEND_BUFFER = 128 * 1024
"""Bytes that the kernel keeps for one client."""
END_S = 5
"""Time for requests to end when the server stops [s]."""


async def serve(settings: LabSettings, ready: Callable[[int], None]) -> None:
    """Serve until cancelled; call `ready` with the port once the server listens. Raises LinkError if it cannot."""
    places = Places(raise_file_limit())
    # For the processes of jobs: matrices are small, and two fits at once would have four threads wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with closing(_listening(settings)) as listening:
        port = int(listening.getsockname()[1])
        config = LabConfig(
            create_app(settings),
            places,
            settings,
            log_config=None,
            log_level="error",  # anybody can send what is not HTTP
            proxy_headers=False,  # anybody can claim to be another one
            access_log=False,  # the link holds a token
            server_header=False,
            lifespan="on",
            ws_max_size=4 * LONGEST,
            ws_per_message_deflate=False,  # rows hardly shrink, and it would cost more than all else
            ws_ping_interval=10.0,
            ws_ping_timeout=20.0,
            timeout_graceful_shutdown=END_S,
            timeout_keep_alive=300,  # as browsers; an idle connection ends where another one needs its place
            h11_max_incomplete_event_size=16 * 1024,
        )
        server = _Server(config)
        serving = asyncio.create_task(server.serve(sockets=[listening]))
        try:
            while not server.started and not serving.done():
                await asyncio.sleep(0.01)
            if server.started:
                listening.listen(BACKLOG)  # the configuration's is the number that is accepted at once
                ready(port)
            await asyncio.shield(serving)
        finally:
            server.should_exit = True
            await asyncio.wait([serving], timeout=4 * END_S)
            for connection in server.server_state.connections:  # what did not end in its time
                connection.transport.abort()


class _Server(uvicorn.Server):
    """Uvicorn's server that leaves signals to its caller, and closes connections whose time is over."""

    config: LabConfig

    async def on_tick(self, counter: int) -> bool:
        """Close late connections ten times a second; return True at the server's end."""
        self.config.places.end_late()
        return await super().on_tick(counter)

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Capture no signal."""
        yield


def _listening(settings: LabSettings) -> socket.socket:
    """Return a listening socket. Raises LinkError with the remedy."""
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    where = f"http://{settings.host}:{settings.port}"
    made = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)  # asyncio sets TCP_NODELAY for it
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        # Rows in the kernel's buffer for a slow client are stale: a small buffer is enough.
        made.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        made.bind((settings.host, settings.port))
        if hasattr(socket, "TCP_DEFER_ACCEPT"):  # who sends nothing costs nothing
            made.setsockopt(socket.IPPROTO_TCP, socket.TCP_DEFER_ACCEPT, round(HEAD_S))
        made.listen(BACKLOG)
    except OSError as error:
        made.close()
        what = f"cannot listen: {error.strerror or error}"
        taken = error.errno in (errno.EADDRINUSE, errno.EACCES)
        other = "give another --port, or --port 0 for a free one"
        remedy = other if taken else "give --host an address of this computer, such as 127.0.0.1 or 0.0.0.0"
        raise LinkError(what, where, remedy) from error
    return made
