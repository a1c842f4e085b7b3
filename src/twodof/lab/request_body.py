"""RequestBody: what a client sends in JSON, and the numbers in it, as every route and the web socket read them."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field


class RequestBody(BaseModel):
    """A request of known fields, nothing of which is read into something else.

    A pitch of `false` is a mistake and not 0 rad, and so is a gain of `true` or of "1".
    """

    model_config = ConfigDict(extra="forbid", strict=True)


Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
"""A number: not a truth value, a text, NaN or infinity."""
