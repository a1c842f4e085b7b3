"""The page: the files that the front end was built into, or, where it was not, a page that says how."""

from __future__ import annotations

from pathlib import Path

from fastapi import FastAPI
from fastapi.responses import HTMLResponse, Response
from starlette.exceptions import HTTPException
from starlette.staticfiles import StaticFiles
from starlette.types import Receive, Scope, Send

from twodof.lab.access.route_table import RouteTable

_MISSING = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>twodof: the page is not built</title>
<body style="font: 1rem/1.5 system-ui; max-width: 40rem; margin: 3rem auto; padding: 0 1rem">
<h1>The page is not built</h1>
<p>The server runs, and its API answers; <a href="api/openapi.json">this</a> describes it.
What is missing is the page in front of it.</p>
<p>Run <code>make web</code> in the folder of twodof, then load this page again.</p>
</body></html>
"""
READS = ("GET", "HEAD")
_FOR_EVER = "public, max-age=31536000, immutable"


class PageFiles(StaticFiles):
    """The built files; those whose names hold a hash of their content are kept by the browser."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        """The answer for a path; the page itself is asked for anew each time."""
        if scope["method"] not in READS:
            raise HTTPException(405, headers={"Allow": ", ".join(READS)})
        answer = await super().get_response(path, scope)
        answer.headers["cache-control"] = _FOR_EVER if path.startswith("assets/") else "no-cache"
        return answer


def serve_page(app: FastAPI, folder: Path, routes: RouteTable) -> None:
    """Serve the page in `folder` at every path that is not the API's; it may be built meanwhile.

    The paths of the API come here too with a method that no route of theirs takes: what they do take is answered.
    """
    files = PageFiles(directory=folder, html=True, check_dir=False)

    async def page(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and scope["path"].startswith("/api/"):
            methods = routes.methods(scope)
            raise HTTPException(405, headers={"Allow": ", ".join(methods)}) if methods else HTTPException(404)
        if scope["type"] == "http" and not (folder / "index.html").is_file():
            await HTMLResponse(_MISSING, 503 if scope["path"] == "/" else 404)(scope, receive, send)
            return
        await files(scope, receive, send)

    app.mount("/", page)
