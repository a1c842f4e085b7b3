"""CurrentLab: how a route gets the laboratory that its server runs."""

from typing import Annotated

from fastapi import Depends
from fastapi.requests import HTTPConnection

from twodof.lab.lab import Lab


def current_lab(connection: HTTPConnection) -> Lab:
    """The laboratory of the server that serves this request."""
    lab = connection.app.state.lab
    assert isinstance(lab, Lab)
    return lab


CurrentLab = Annotated[Lab, Depends(current_lab)]
