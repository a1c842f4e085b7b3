"""What a client says over the web socket: to subscribe, to subscribe no more, or that it is there."""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError

from twodof.errors import LogError, listed, nearest
from twodof.lab.request_body import RequestBody
from twodof.lab.telemetry.tick_rows import COLUMNS

LONGEST = 8192
"""Characters of a message of a client."""
MOST_COLUMNS = 64


class MalformedRequest(Exception):
    """What a client sent is not a message: it is not JSON, too long, or not of a known form."""


class Subscribe(RequestBody):
    """Rows of these columns of a drone, at most `rate` a second; `id` names them in the binary messages."""

    do: Literal["subscribe"]
    id: int = Field(ge=0, lt=2**16)
    drone: int = Field(ge=1, le=255)
    columns: list[Annotated[str, Field(max_length=64)]] = Field(min_length=1, max_length=MOST_COLUMNS)
    rate: float = Field(default=250.0, ge=0.1, le=250.0, allow_inf_nan=False)

    def known_columns(self) -> tuple[str, ...]:
        """The columns. Raises LogError for one that there is not."""
        unknown = [name for name in self.columns if name not in COLUMNS]
        if unknown:
            raise LogError("no such column", listed(unknown, 3), f"there are {nearest(unknown[0], COLUMNS)}")
        return tuple(self.columns)


class Unsubscribe(RequestBody):
    """No more rows of that `id`."""

    do: Literal["unsubscribe"]
    id: int = Field(ge=0, lt=2**16)


class Here(RequestBody):
    """The answer to `alive`: its program runs, not only its socket."""

    do: Literal["here"]


Asked = Subscribe | Unsubscribe | Here
_ADAPTER: TypeAdapter[Asked] = TypeAdapter(Annotated[Asked, Field(discriminator="do")])


def read_request(text: str) -> Asked:
    """The request of a message. Raises MalformedRequest."""
    if len(text) > LONGEST:
        raise MalformedRequest(f"longer than {LONGEST} characters")
    try:
        found: Any = json.loads(text)
    except (ValueError, RecursionError):
        raise MalformedRequest("is not JSON") from None
    try:
        return _ADAPTER.validate_python(found)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = ".".join(str(part)[:40] for part in first["loc"])
        raise MalformedRequest(f"{place or 'message'}: {first['msg']}"[:200]) from None
