"""The server: create_app puts routes, access and page together; `serve` runs it until it is told to end."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import APIRouter, FastAPI

from twodof import __version__
from twodof.lab import refusals
from twodof.lab.access.gate import Gate
from twodof.lab.access.route_table import RouteTable
from twodof.lab.finite_json import FiniteJSON
from twodof.lab.lab import Lab
from twodof.lab.page import serve_page
from twodof.lab.routes import (
    commands,
    diagram_jobs,
    diagrams,
    drones,
    excitations,
    export,
    identification,
    jobs,
    logs,
    models,
    parameter_files,
    parameters,
    session,
    telemetry,
    tuning,
)
from twodof.lab.settings import LabSettings

ROUTERS: tuple[APIRouter, ...] = (
    session.router,
    drones.router,
    commands.router,
    excitations.router,
    export.router,
    parameter_files.router,
    parameters.router,
    diagrams.router,
    diagram_jobs.router,
    tuning.router,
    models.router,
    identification.router,
    jobs.router,
    logs.router,
    telemetry.router,
)
"""A line a subject."""
_ABOUT = "The API of the laboratory in the browser. All quantities are in SI units and radians."


def create_app(settings: LabSettings) -> FastAPI:
    """The application: the API under /api, the page elsewhere. It connects to the drones while it runs."""
    lab = Lab(settings)

    @asynccontextmanager
    async def life(_: FastAPI) -> AsyncIterator[None]:
        async with lab:
            yield

    app = FastAPI(
        title="twodof lab",
        version=__version__,
        description=_ABOUT,
        lifespan=life,
        openapi_url="/api/openapi.json",
        docs_url=None,
        redoc_url=None,
        default_response_class=FiniteJSON,
        responses={
            status: {"model": refusals.Refusal, "description": text} for status, text in refusals.DESCRIPTIONS.items()
        },
    )
    app.state.lab = lab
    for router in ROUTERS:
        app.include_router(router)
    refusals.install(app)
    routes = RouteTable(ROUTERS)
    serve_page(app, settings.page, routes)
    app.add_middleware(Gate, settings=settings, routes=routes)
    return app
