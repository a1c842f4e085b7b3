"""LabClient: who sends a request: what its token lets it do, and from where."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from fastapi import Depends
from fastapi.requests import Request

from twodof.lab.access.role import Role


class LabClient(NamedTuple):
    """Role and address of a client. The address is that of a proxy or a tunnel where one is in front."""

    role: Role
    address: str

    def __str__(self) -> str:
        who = "who commands" if self.role is Role.COMMAND else "who watches"
        return f"{who} at {self.address}"


def current_client(request: Request) -> LabClient:
    """Who sends this request, as the gate found it."""
    role = request.state.role
    assert isinstance(role, Role)
    return LabClient(role, "an unknown place" if request.client is None else request.client.host)


CurrentClient = Annotated[LabClient, Depends(current_client)]
