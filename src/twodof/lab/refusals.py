"""Errors as answers: what went wrong, where, and what to do, with the HTTP status that says whose matter it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from fastapi.requests import Request
from fastapi.responses import Response
from pydantic import BaseModel
from starlette.exceptions import HTTPException

from twodof.errors import (
    ControllerFault,
    DownloadError,
    LinkLost,
    RecordingError,
    Rejected,
    Timeout,
    TwodofError,
    shown,
)
from twodof.lab.finite_json import FiniteJSON

REFUSED, NOT_THERE, MALFORMED, TOO_LATE = 409, 404, 422, 504
_MOST_MISTAKES = 3
_STATUS: Mapping[type[TwodofError], int] = MappingProxyType(
    {
        Timeout: TOO_LATE,
        LinkLost: TOO_LATE,
        DownloadError: TOO_LATE,
        Rejected: REFUSED,
        RecordingError: REFUSED,
        ControllerFault: REFUSED,
    }
)
_WORDS = MappingProxyType(
    {
        400: ("the body cannot be read: it is not JSON in UTF-8", "correct it; GET /api/openapi.json has the forms"),
        404: ("there is no such page or route", "GET /api/openapi.json lists the routes"),
        405: ("the route does not take this method", "GET /api/openapi.json lists the routes"),
    }
)


DESCRIPTIONS: Mapping[int, str] = MappingProxyType(
    {
        401: "The token is missing or wrong.",
        403: "The link is for watching only, or another site's page asks.",
        404: "What the path names does not exist.",
        409: "It is refused, with the drone's reason where it gave one.",
        413: "The request is too large.",
        421: "The request is for another host.",
        422: "The request could never work: it is malformed, or beyond its bounds.",
        504: "The drone did not answer in time, or is lost.",
    }
)


class NotThere(TwodofError):
    """What a request names does not exist: a drone, a log, a job."""


class Refusal(BaseModel):
    """Why a request was refused: what is wrong, where, and what to do about it."""

    what: str
    where: str = ""
    remedy: str = ""


def status_of(error: TwodofError) -> int:
    """The HTTP status: 404 not there, 409 refused, 504 too late, 422 for what could never have worked."""
    if isinstance(error, NotThere):
        return NOT_THERE
    return next((status for kind, status in _STATUS.items() if isinstance(error, kind)), MALFORMED)


def answer_of(error: TwodofError) -> Response:
    """The answer that tells an error."""
    said = {"what": error.what, "where": error.where, "remedy": error.remedy}
    return FiniteJSON(said, status_of(error))


def mistakes_in_words(errors: Sequence[Mapping[str, Any]]) -> tuple[str, str]:
    """What is wrong with a request's data, and where, of the first mistakes that pydantic found."""
    rows = errors[:_MOST_MISTAKES]
    where = ", ".join(".".join(str(part)[:80] for part in row["loc"]) for row in rows)
    what = "; ".join(f"{row['msg']}, not {shown(row['input'])}" for row in rows)
    return what, where


def install(app: FastAPI) -> None:
    """Let every error of ours, and of the framework, be answered as a Refusal."""

    async def ours(_: Request, error: Exception) -> Response:
        assert isinstance(error, TwodofError)
        return answer_of(error)

    async def malformed(_: Request, error: Exception) -> Response:
        assert isinstance(error, RequestValidationError)
        what, where = mistakes_in_words(error.errors())
        return FiniteJSON(
            {"what": what, "where": where, "remedy": "correct it; GET /api/openapi.json has the forms"}, MALFORMED
        )

    async def http(request: Request, error: Exception) -> Response:
        assert isinstance(error, HTTPException)
        what, remedy = _WORDS.get(error.status_code, (str(error.detail), ""))
        said = {"what": what, "where": request.url.path[:200], "remedy": remedy}
        # The framework alone answers 400, for a body that it cannot decode; one that it can and that is wrong is 422.
        status = MALFORMED if error.status_code == 400 else error.status_code
        return FiniteJSON(said, status, headers=dict(error.headers or {}))

    app.add_exception_handler(TwodofError, ours)
    app.add_exception_handler(RequestValidationError, malformed)
    app.add_exception_handler(HTTPException, http)
