"""Roles: what a token lets a client do."""

from __future__ import annotations

import hmac
from enum import StrEnum
from urllib.parse import parse_qs

from fastapi.requests import HTTPConnection

from twodof.lab.settings import LabSettings

_BEARER = "bearer "
_LONGEST = 200


class Role(StrEnum):
    """What a client may do: everything, or only look."""

    COMMAND = "command"
    WATCH = "watch"


def token_of(connection: HTTPConnection) -> str:
    """The token of a request, from its header; of a web socket, whose browser sends none, from `?token=`."""
    header = connection.headers.get("authorization", "")
    if header[: len(_BEARER)].lower() == _BEARER:
        return str(header[len(_BEARER) :].strip())
    if connection.scope["type"] == "websocket":
        query = connection.scope.get("query_string", b"")[:4096].decode("latin-1")
        return str(parse_qs(query).get("token", [""])[0])
    return ""


def role_of(token: str, settings: LabSettings) -> Role | None:
    """What its token lets a client do; None for one that is not let in."""
    if not token:
        return None if settings.needs_token else Role.COMMAND
    given = token[:_LONGEST].encode()
    for known, role in ((settings.command_token, Role.COMMAND), (settings.watch_token, Role.WATCH)):
        if known and hmac.compare_digest(given, known.encode()):
            return role
    return None
