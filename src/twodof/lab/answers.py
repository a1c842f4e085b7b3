"""Answers in JSON: values without NaN, errors with the remedy and their HTTP status, the bodies of requests."""

import errno
import json
import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Annotated, Any

from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from fastapi.requests import Request
from fastapi.responses import JSONResponse, Response
from pydantic import BaseModel, ConfigDict, Field
from starlette.exceptions import HTTPException

from twodof.errors import (
    ControllerFault,
    DownloadError,
    LinkLost,
    RecordingError,
    Rejected,
    Timeout,
    TwodofError,
    finite,
    shown,
)


def dumps(value: Any) -> str:
    """Return the JSON text of a value, see `finite`. Raises TypeError for a type without a JSON form."""
    try:  # most values are finite and plain, which takes a tenth of the time
        return _encode(value)
    except (TypeError, ValueError):
        return _encode(finite(value))


_encode = json.JSONEncoder(ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode


class FiniteJSON(JSONResponse):
    """Answer in JSON without NaN."""

    def render(self, content: Any) -> bytes:
        """Return the bytes of the answer."""
        return dumps(content).encode("utf-8", "replace")


class RequestBody(BaseModel):
    """Body of a request: known fields only, finite numbers, and no conversion of types.

    A pitch of `false` is a mistake and not 0 rad, and so is a gain of `true` or of "1".
    """

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
"""Finite number; a truth value or a text is refused."""


REFUSED, NOT_THERE, MALFORMED, TOO_LATE, DISK_FULL = 409, 404, 422, 504, 507
_FOLDERS = re.compile(r"(?<![\w:/.~])/(?!api/)(?=\S)(?:(?:[^/\n:]|:(?! ))*(?<! )/)+")
_MOST_MISTAKES = 3


class NotThere(TwodofError):
    """Error for a drone, a log or a job that does not exist."""


class DiskFull(TwodofError):
    """Error for a full disk of the server."""


_STATUS: Mapping[type[TwodofError], int] = MappingProxyType(
    {
        NotThere: NOT_THERE,
        DiskFull: DISK_FULL,
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
        507: "The disk of the server is full.",
    }
)


class Refused(HTTPException):
    """Refusal of a request for its sender, origin or size, with its remedy; the connection is closed."""

    def __init__(self, status: int, what: str, remedy: str, headers: Mapping[str, str] = MappingProxyType({})) -> None:
        super().__init__(status, what, {"connection": "close", **headers})
        self.what, self.remedy = what, remedy


class Refusal(BaseModel):
    """Reason of a refused request: what is wrong, where, and what to do about it."""

    what: str
    where: str = ""
    remedy: str = ""


def status_of(error: TwodofError) -> int:
    """Return the HTTP status: 404 not there, 409 refused, 504 too late, 507 disk full, 422 can never work."""
    kind = type(full_disk(error) or error)
    return next((status for one, status in _STATUS.items() if issubclass(kind, one)), MALFORMED)


def full_disk(error: BaseException) -> DiskFull | None:
    """Return the error for a client if a full disk is the cause of `error`."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in (errno.ENOSPC, errno.EDQUOT):
            if isinstance(error, TwodofError):
                return DiskFull(error.what, error.where, error.remedy)
            return DiskFull("the disk of the server is full", "", "make room, then try again")
        cause = cause.__cause__
    return None


def without_folders(text: str) -> str:
    """Return a text in which absolute paths are shortened to file names, since folders are the server's own affair."""
    return _FOLDERS.sub("", text)


def refusal_of(error: TwodofError) -> dict[str, str]:
    """Return the fields of the Refusal that tells a client of an error."""
    told = {key: without_folders(str(getattr(error, key))) for key in ("what", "where", "remedy")}
    remedy = told["remedy"].replace("connect again", "wait: the server connects again by itself")
    return told | {"remedy": remedy.replace(", or watch with take_lease=False", "")}


def mistakes_in_words(errors: Sequence[Mapping[str, Any]]) -> tuple[str, str]:
    """Return a text about the first mistakes in a request's data, and a text of their places."""
    rows = errors[:_MOST_MISTAKES]
    where = ", ".join(".".join(str(part)[:80] for part in row["loc"]) for row in rows)
    return "; ".join(f"{row['msg']}, not {shown(row['input'])}" for row in rows), where


def install(app: FastAPI) -> None:
    """Answer every error of twodof and of the framework with a Refusal."""

    @app.exception_handler(TwodofError)
    async def ours(_: Request, error: TwodofError) -> Response:
        return FiniteJSON(refusal_of(error), status_of(error))

    @app.exception_handler(OSError)
    async def disk(request: Request, error: OSError) -> Response:
        if (full := full_disk(error)) is None:
            raise error
        return await ours(request, full)

    @app.exception_handler(RequestValidationError)
    async def malformed(request: Request, error: RequestValidationError) -> Response:
        what, where = mistakes_in_words(error.errors())
        return await ours(request, TwodofError(what, where, _WORDS[400][1]))

    @app.exception_handler(HTTPException)
    async def http(request: Request, error: HTTPException) -> Response:
        what, remedy = _WORDS.get(error.status_code, (str(error.detail), ""))
        if isinstance(error, Refused):
            what, remedy = error.what, error.remedy
        said = {"what": what, "where": request.url.path[:200], "remedy": remedy}
        # The framework answers 400 for a body that it cannot decode, and 422 for a wrong one.
        status = MALFORMED if error.status_code == 400 else error.status_code
        return FiniteJSON(said, status, headers=dict(error.headers or {}))
