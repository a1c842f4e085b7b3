"""Who a client is to the server: its role, and the link with which others may watch."""

from typing import Annotated, Any

from fastapi import APIRouter, Depends
from fastapi.requests import Request

from twodof import __version__
from twodof.lab.access.role import Role
from twodof.lab.current_lab import CurrentLab

router = APIRouter(prefix="/api/session", tags=["session"])


def current_role(request: Request) -> Role:
    """What the client may do, as the gate found it."""
    role = request.state.role
    assert isinstance(role, Role)
    return role


@router.get("")
async def session(lab: CurrentLab, role: Annotated[Role, Depends(current_role)]) -> dict[str, Any]:
    """Role of this client, version of the server, and the path of the link with which others may only watch.

    `watch_link` is empty for who only watches, and where the server was started without such a link.
    """
    token = lab.settings.watch_token if role is Role.COMMAND else ""
    return {
        "role": role,
        "version": __version__,
        "watch_link": f"/?token={token}" if token else "",
        "clients": len(lab.audience),
    }
